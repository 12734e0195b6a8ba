# SPDX-License-Identifier: Apache-2.0
"""What a node has from the process that started it: it ends with it, and when it says so."""

from __future__ import annotations

import ctypes
import os
import signal

PARENT_VARIABLE = "FTCM_PARENT_PID"
"""Environment variable that tells a node whose child it is."""
_PR_SET_PDEATHSIG = 1
_SIGNALS = {signal.SIGINT, signal.SIGTERM}


def hold_signals() -> None:
    """Have what asks this process to end wait for :func:`take_signals`: no import is interrupted by it."""
    signal.pthread_sigmask(signal.SIG_BLOCK, _SIGNALS)


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
