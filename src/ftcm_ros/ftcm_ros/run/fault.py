# SPDX-License-Identifier: Apache-2.0
"""Lists, arms and clears the faults of a run that is on, from the terminal."""

from __future__ import annotations

import argparse
import os
import sys
import time
from collections.abc import Sequence
from typing import Any

import rclpy
from rclpy.node import Node
from std_srvs.srv import Trigger

from ftcm_core.cli.output import drop_stdout
from ftcm_core.errors import FtcmError, suggestion
from ftcm_ros.transport.joining import join_as

ASK_AGAIN_SECONDS = 1.5
"""After so long without an answer, ask again: the middleware drops one that is ready too early."""


def build_parser() -> argparse.ArgumentParser:
    """Return the command's parser."""
    parser = argparse.ArgumentParser(
        prog="fault",
        description=(
            "Lists, arms and clears the faults of a run that is on, in the environment's ROS domain. A fault "
            "can be armed that has trigger: hand in the scenario, and cleared that has that or lifetime: "
            "until_cleared."
        ),
        epilog="example: ros2 run ftcm_ros fault arm sensor_bias_0",
    )
    parser.add_argument("action", choices=("list", "arm", "clear"))
    parser.add_argument("label", nargs="?", help="which fault, as `list` names it")
    parser.add_argument("--domain-id", type=int, help="ROS domain; default: ROS_DOMAIN_ID")
    parser.add_argument(
        "--timeout", type=float, default=10.0, metavar="SECONDS", help="how long to wait (default: 10)"
    )
    return parser


def run_fault(options: argparse.Namespace) -> str:
    """Do what the options say; return what to print.

    Raises:
        FtcmError: there is no run, no such fault, or the order is refused.
    """
    if (options.action == "list") != (options.label is None):
        expected = "none" if options.action == "list" else "one; `list` names them"
        raise FtcmError(f"{options.action}: label {options.label!r}; expected {expected}")
    if options.domain_id is not None:
        os.environ["ROS_DOMAIN_ID"] = str(options.domain_id)
    node = join_as("fault")
    try:
        end = time.monotonic() + options.timeout
        told = _call(node, "list", end)
        if options.action == "list":
            return str(told.message)
        labels = [line.partition(":")[0] for line in told.message.splitlines()]
        if options.label not in labels:
            raise FtcmError(f"no fault {options.label!r} in this run; {suggestion(options.label, labels)}")
        answer = _call(node, f"{options.label}/{options.action}", end)
        if not answer.success:
            raise FtcmError(str(answer.message))
        return str(answer.message)
    finally:
        node.destroy_node()
        rclpy.try_shutdown()


def _call(node: Node, name: str, end: float) -> Any:
    client = node.create_client(Trigger, f"/injector/faults/{name}")
    try:
        if not client.wait_for_service(max(0.0, end - time.monotonic())):
            domain = os.environ.get("ROS_DOMAIN_ID", "0")
            reach = os.environ.get("ROS_AUTOMATIC_DISCOVERY_RANGE", "SUBNET")
            raise FtcmError(
                f"no injector with faults answers in ROS_DOMAIN_ID={domain}, "
                f"ROS_AUTOMATIC_DISCOVERY_RANGE={reach}; expected a run that is on: set both as it says them"
            )
        while time.monotonic() < end:
            future = client.call_async(Trigger.Request())
            rclpy.spin_until_future_complete(node, future, timeout_sec=ASK_AGAIN_SECONDS)
            if future.done():
                return future.result()
        raise FtcmError("the injector does not answer; is the run still on?")
    finally:
        node.destroy_client(client)


def main(argv: Sequence[str] | None = None) -> None:
    """Entry point of ``ros2 run ftcm_ros fault``."""
    options = build_parser().parse_args(argv)
    try:
        print(run_fault(options))
        sys.stdout.flush()
    except FtcmError as error:
        print(f"fault: error: {error}", file=sys.stderr)
        sys.exit(2)
    except BrokenPipeError:
        drop_stdout()
        sys.exit(141)
    except KeyboardInterrupt:
        sys.exit(130)


if __name__ == "__main__":
    main()
