# SPDX-License-Identifier: Apache-2.0
"""Optional real-time scheduling of a node's process: priority, memory locking, processors."""

from __future__ import annotations

import contextlib
import ctypes
import os
from collections.abc import Callable
from pathlib import Path

import psutil

from ftcm_core.errors import FtcmError

_MCL_CURRENT, _MCL_FUTURE = 1, 2
_PR_SET_TIMERSLACK = 29


def apply(priority: int, lock_memory: bool, processors: str) -> list[str]:
    """Apply what is asked for to every thread of this process; those started later inherit it.

    The threads of the middleware are there before: with them left out, the thread that receives a message
    would wait for the processor behind threads that have nothing to do with the tick.

    Args:
        priority: SCHED_FIFO priority 1 to 99; 0 leaves ordinary scheduling.
        lock_memory: keep all memory from being paged out.
        processors: processors to run on, such as ``0`` or ``0,1``; empty: all.

    Returns:
        One line for each thing that the system does not permit, with what would permit it.

    Raises:
        FtcmError: a value makes no sense.
    """
    refused = []
    libc = ctypes.CDLL(None, use_errno=True)
    libc.prctl(_PR_SET_TIMERSLACK, 1)  # ns; else Linux ends every wait up to 50 µs late, on purpose
    if processors:
        try:
            wanted = {int(p) for p in processors.split(",")}
        except ValueError:
            raise FtcmError(f"processors: {processors!r}; expected numbers with commas, e.g. 0,1") from None
        there = os.sched_getaffinity(0)
        if not wanted <= there:
            raise FtcmError(f"processors: {processors!r}; this process may use {sorted(there)}")
        _each_thread(lambda thread: os.sched_setaffinity(thread, wanted))
    if not 0 <= priority <= 99:
        raise FtcmError(f"priority: {priority} is out of range; expected 0 (ordinary) to 99")
    if priority:
        try:
            first = os.sched_param(priority)
            _each_thread(lambda thread: os.sched_setscheduler(thread, os.SCHED_FIFO, first))
        except PermissionError:
            refused.append(
                f"priority {priority} is not permitted; ordinary scheduling is used. Allow it with rtprio in "
                "/etc/security/limits.conf, or run as root"
            )
    if lock_memory and libc.mlockall(_MCL_CURRENT | _MCL_FUTURE) != 0:
        refused.append(
            f"memory cannot be locked ({os.strerror(ctypes.get_errno())}); raise memlock in "
            "/etc/security/limits.conf, or run as root"
        )
    return refused


def waited_seconds() -> float:
    """Return how long threads of this process were ready to run without a processor, s.

    It is 0 if Linux does not tell. psutil does not offer it.
    """
    waited = 0
    for file in Path("/proc/self/task").glob("*/schedstat"):
        with contextlib.suppress(OSError, ValueError, IndexError):  # it has just ended
            waited += int(file.read_text(encoding="ascii").split()[1])
    return waited / 1e9


def release() -> None:
    """Give all threads of this process ordinary scheduling again, so that its end holds up nobody."""
    _each_thread(lambda thread: os.sched_setscheduler(thread, os.SCHED_OTHER, os.sched_param(0)))


def _each_thread(act: Callable[[int], None]) -> None:
    for thread in psutil.Process().threads():
        with contextlib.suppress(ProcessLookupError):  # it has just ended
            act(thread.id)
