# SPDX-License-Identifier: Apache-2.0
"""The transport ``waitset``: the main thread waits in a wait set of its own for the data topics."""

from __future__ import annotations

import threading
import time
from typing import Any

from rclpy.impl.implementation_singleton import rclpy_implementation as _rclpy
from rclpy.node import Node

from ftcm_ros.transport.plane import DataPlane
from ftcm_ros.transport.topics import Topic


class WaitSetPlane(DataPlane):
    """Takes messages on the main thread when the middleware says that some are here."""

    def __init__(self, node: Node, gather: Topic | None = None) -> None:
        """Begin without any topic; see :func:`~ftcm_ros.transport.plane.make_plane`."""
        super().__init__(node, gather)
        self._wait_set: Any = None
        self._enough = threading.Event()
        """Set to end the wait of :meth:`collect` before its time."""

    def _opened(self) -> None:
        self._wait_set = _rclpy.WaitSet(len(self._subscriptions), 0, 0, 0, 0, 0, self._node.context.handle)

    def poll(self, timeout_ns: int, trigger: Topic | None = None) -> None:
        """Wait for the trigger, or for any topic; then handle one message of each topic that has one.

        Raises:
            Exception: what a handler has raised.
        """
        self._raise_failure()
        wait_set = self._wait_set
        if wait_set is None:  # not opened yet
            time.sleep(timeout_ns / 1e9)
            return
        wait_set.clear_entities()
        for entry in self._taken:
            if trigger is None or entry.topic is trigger:
                wait_set.add_subscription(entry.handle)
        wait_set.wait(timeout_ns)
        for entry in self._taken:
            taken = entry.take()
            if taken is not None:
                entry.callback(*taken)

    def collect(self, seconds: float) -> None:
        """Wait, while messages gather with the middleware; then handle all of them.

        Raises:
            Exception: what a handler has raised.
        """
        self._raise_failure()
        self._enough.wait(seconds)
        self._enough.clear()
        self._handle_all(self._taken)

    def wake(self) -> None:
        """End the wait of :meth:`collect`. That of :meth:`poll` is short."""
        self._enough.set()
