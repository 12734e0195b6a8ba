# SPDX-License-Identifier: Apache-2.0
"""The processes that an experiment has started."""

from __future__ import annotations

from pathlib import Path


def node_pids(parent: int) -> dict[str, int]:
    """Process numbers of the nodes that an experiment has started."""
    found = {}
    for entry in Path("/proc").iterdir():
        if entry.name.isdecimal():
            try:
                fields = (entry / "stat").read_text().rpartition(")")[2].split()
                words = (entry / "cmdline").read_bytes().split(b"\0")
            except OSError:
                continue
            module = next((w.decode() for w in words if w.startswith(b"ftcm_ros.nodes.")), "")
            if module and int(fields[1]) == parent:
                found[module.rpartition(".")[2]] = int(entry.name)
    return found
