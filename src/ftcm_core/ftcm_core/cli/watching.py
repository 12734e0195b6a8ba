# SPDX-License-Identifier: Apache-2.0
"""The command ``watch``. It looks at the ROS graph: the package ``ftcm_ros`` brings it, by an entry point."""

from __future__ import annotations

import argparse

from ftcm_core.cli.brought import brought
from ftcm_core.errors import FtcmError

HOST, PORT = "127.0.0.1", 8080
"""Where the page in the browser is, unless another address is given."""


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
    web = parser.add_argument_group("in a browser")
    web.add_argument(
        "--web", action="store_true",
        help="serve a page with the arm, moving plots and tables; needs the extra ftcm_core[web]",
    )  # fmt: skip
    web.add_argument(
        "--control", action="store_true",
        help="with buttons that change the run: arm and clear faults, swap the law, pause",
    )  # fmt: skip
    web.add_argument("--host", help=f"address to serve at; default: {HOST}, which only this machine reaches")
    web.add_argument("--port", type=int, help=f"default: {PORT}")


def check_watch(options: argparse.Namespace) -> None:
    """Check that options fit each other, and fill in what was not given.

    Raises:
        FtcmError: they do not.
    """
    beside = [
        f"--{name}" for name in ("control", "host", "port") if getattr(options, name) not in (None, False)
    ]
    if beside and not options.web:
        raise FtcmError(f"{beside[0]} is for a browser; expected --web beside it")
    for name in ("once", "health"):
        if options.web and getattr(options, name):
            raise FtcmError(f"--web and --{name}; expected one of them")
    options.host = HOST if options.host is None else options.host
    options.port = PORT if options.port is None else options.port
    if not 0 < options.port < 65536:
        raise FtcmError(f"--port {options.port}; expected 1 to 65535")


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
