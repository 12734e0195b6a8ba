# SPDX-License-Identifier: Apache-2.0
"""Joining the ROS graph with the suite's defaults; what ROS cannot do becomes one line."""

from __future__ import annotations

import contextlib
import os
import warnings
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import TypeVar

import rclpy
from rclpy.impl.implementation_singleton import rclpy_implementation as _rclpy
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions

from ftcm_core.errors import FtcmError
from ftcm_ros.transport.domain import lost_ports
from ftcm_ros.transport.network import PROFILES, enclave, secured, set_defaults

T = TypeVar("T")
TRIES = 5
"""How often ports are opened before a process gives up (chosen)."""


class JoinError(FtcmError):
    """ROS cannot start as the environment asks: nothing that uses it can."""


@contextlib.contextmanager
def joining() -> Iterator[None]:
    """Turn ROS's errors while a process joins into the suite's.

    Raises:
        JoinError: ROS cannot start as the environment asks.
    """
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", RuntimeWarning)  # what ROS could not undo after the error
            yield
    except _rclpy.RCLError as error:
        reason = " ".join(str(error).partition(", at /")[0].split())
        if secured():
            store = os.environ.get("ROS_SECURITY_KEYSTORE", "")
            reason += (
                f"; with ROS_SECURITY_ENABLE=true expected a middleware that has security and, in "
                f"ROS_SECURITY_KEYSTORE={store!r}, this process's enclave: see docs/security.md"
            )
        raise JoinError(f"cannot join the ROS graph: {reason}") from error


def join(arguments: Sequence[str] | None = None, profiles: Path = PROFILES) -> None:
    """Initialise ROS; signals stay the caller's.

    Args:
        arguments: the command line; None: that of the process.
        profiles: settings of Fast DDS.

    Raises:
        JoinError: ROS cannot start as the environment asks.
    """
    set_defaults(profiles)
    with joining():
        rclpy.init(args=arguments, signal_handler_options=SignalHandlerOptions.NO)


def join_as(name: str, profiles: Path = PROFILES) -> Node:
    """Initialise ROS and return an ordinary node of the suite's, with its enclave.

    Args:
        name: the node's.
        profiles: settings of Fast DDS.

    Raises:
        JoinError: ROS cannot start as the environment asks.
    """
    join(["--ros-args", *enclave(name)], profiles)
    return made(lambda: rclpy.create_node(name))


def made(make: Callable[[], T]) -> T:
    """Make the nodes of this process where messages arrive.

    The first node of a process opens its shared-memory ports, and the last one closes them. So a node without
    anything is made, again while a port is lost, and the others beside it.

    Args:
        make: makes all of them.

    Raises:
        JoinError: ROS cannot start as the environment asks, or ports are lost however often opened.
    """
    with joining():
        for _ in range(TRIES):
            first = Node(
                "_joining", use_global_arguments=False, enable_rosout=False, start_parameter_services=False
            )
            if not (lost := lost_ports()):
                nodes = make()
                first.destroy_node()
                return nodes
            first.destroy_node()
    ports = ", ".join(map(str, lost))
    raise JoinError(
        f"cannot join the ROS graph: other processes have removed its shared-memory ports ({ports}), {TRIES} "
        "times; start it again when fewer ROS processes begin and end"
    )
