# SPDX-License-Identifier: Apache-2.0
"""The command ``watch``. It looks at the ROS graph: the package ``ftcm_ros`` brings it, by an entry point."""

from __future__ import annotations

import argparse

from ftcm_core.cli.brought import brought
from ftcm_core.errors import FtcmError


def watch_options(parser: argparse.ArgumentParser) -> None:
    """Declare the options of the command."""
    parser.add_argument("--once", action="store_true", help="show what there is once, and end")
    parser.add_argument(
        "--health", action="store_true",
        help="only what the nodes report once a second: no topic that has a message per tick is subscribed",
    )  # fmt: skip
    parser.add_argument("--domain-id", type=int, help="ROS domain; default: ROS_DOMAIN_ID")
    parser.add_argument(
        "--timeout", type=float, default=10.0, metavar="SECONDS",
        help="of --once: how long to wait for a node that says something (default: 10)",
    )  # fmt: skip


def watch_command(arguments: argparse.Namespace) -> int:
    """Show a run that is on."""
    function = brought("watch")
    if function is None:
        raise FtcmError(
            "watch looks at the ROS graph, which needs the package ftcm_ros; source the workspace in which "
            "it is built"
        )
    status: int = function(arguments)
    return status
