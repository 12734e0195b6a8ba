# SPDX-License-Identifier: Apache-2.0
"""The processes that an experiment has started."""

from __future__ import annotations

import contextlib

import psutil


def node_pids(parent: int) -> dict[str, int]:
    """Process numbers of the nodes that an experiment has started."""
    found = {}
    for process in psutil.Process(parent).children():
        with contextlib.suppress(psutil.Error):  # it has just ended
            module = next((w for w in process.cmdline() if w.startswith("ftcm_ros.nodes.")), "")
            if module:
                found[module.rpartition(".")[2]] = process.pid
    return found
