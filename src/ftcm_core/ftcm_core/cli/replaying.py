# SPDX-License-Identifier: Apache-2.0
"""The command ``replay``. It reads bags, so the package ``ftcm_ros`` brings it, by an entry point."""

from __future__ import annotations

import argparse
from pathlib import Path

from ftcm_core.cli.brought import brought
from ftcm_core.errors import FtcmError


def replay_options(parser: argparse.ArgumentParser) -> None:
    """Declare the options of the command; ``--plugin`` every command has."""
    parser.add_argument("bags", nargs="+", type=Path, metavar="BAG", help="folder of a bag")
    parser.add_argument(
        "--accept-damage",
        action="store_true",
        help="exit status 0 for a bag that is not what was recorded, if what is left of it is equal",
    )
    parser.add_argument("--json", action="store_true", help="print the results as one JSON object")


def replay_command(arguments: argparse.Namespace) -> int:
    """Run recorded runs again and compare."""
    function = brought("replay")
    if function is None:
        raise FtcmError(
            "replay reads bags, which needs the package ftcm_ros; source the workspace in which it is built"
        )
    status: int = function(arguments)
    return status
