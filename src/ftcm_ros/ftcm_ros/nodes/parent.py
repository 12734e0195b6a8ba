# SPDX-License-Identifier: Apache-2.0
"""What a node has from the process that started it: it ends with it, and when it says so."""

from __future__ import annotations

import contextlib
import ctypes
import os
import signal
from collections.abc import Iterator

PARENT_VARIABLE = "FTCM_PARENT_PID"
"""Environment variable that tells a node whose child it is."""
_PR_SET_PDEATHSIG = 1
_SIGNALS = {signal.SIGINT, signal.SIGTERM}


@contextlib.contextmanager
def holding_signals() -> Iterator[None]:
    """Processes started meanwhile hold back what asks them to end, until they call :func:`take_signals`."""
    before = signal.pthread_sigmask(signal.SIG_BLOCK, _SIGNALS)
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def take_signals() -> None:
    """Take what asks this process to end, now that it knows what to do then."""
    signal.pthread_sigmask(signal.SIG_UNBLOCK, _SIGNALS)


def end_with_parent() -> None:
    """In a node started by an experiment: get SIGTERM when that process ends, however it ends."""
    parent = os.environ.get(PARENT_VARIABLE)
    if parent is not None:
        ctypes.CDLL(None).prctl(_PR_SET_PDEATHSIG, signal.SIGTERM)
        if os.getppid() != int(parent):  # it ended before the request took effect
            os.kill(os.getpid(), signal.SIGTERM)
