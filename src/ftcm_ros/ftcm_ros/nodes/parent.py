# SPDX-License-Identifier: Apache-2.0
"""A node ends with the process that started it."""

from __future__ import annotations

import ctypes
import os
import signal

PARENT_VARIABLE = "FTCM_PARENT_PID"
"""Environment variable that tells a node whose child it is."""
_PR_SET_PDEATHSIG = 1


def end_with_parent() -> None:
    """In a node started by an experiment: get SIGTERM when that process ends, however it ends."""
    parent = os.environ.get(PARENT_VARIABLE)
    if parent is not None:
        ctypes.CDLL(None).prctl(_PR_SET_PDEATHSIG, signal.SIGTERM)
        if os.getppid() != int(parent):  # it ended before the request took effect
            os.kill(os.getpid(), signal.SIGTERM)
