# SPDX-License-Identifier: Apache-2.0
"""How tests start the suite's programs: from the sources, without console scripts."""

from __future__ import annotations

import sys
from pathlib import Path

TOOLS = Path(__file__).resolve().parents[2] / "tools"
_MODULES = {
    "experiment": "ftcm_ros.run.experiment",
    "analyse": "ftcm_ros.analysis.analyse",
    "replay": "ftcm_ros.analysis.replay",
}


def program(name: str) -> list[str]:
    """Return the command of a program.

    Args:
        name: ``experiment``, ``analyse``, ``replay``, ``nodes.NODE``, or the file name of a tool.
    """
    if name.endswith(".py"):
        return [sys.executable, str(TOOLS / name)]
    return [sys.executable, "-m", _MODULES.get(name, f"ftcm_ros.{name}")]
