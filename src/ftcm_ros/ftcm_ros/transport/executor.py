# SPDX-License-Identifier: Apache-2.0
"""The transport ``executor``: data messages and all other callbacks share one ordinary executor of rclpy."""

from __future__ import annotations

from rclpy.callback_groups import CallbackGroup, MutuallyExclusiveCallbackGroup

from ftcm_ros.transport.plane import DataPlane
from ftcm_ros.transport.topics import Topic


class ExecutorPlane(DataPlane):
    """Lets the executor take messages and call the handlers, on the main thread."""

    def _callback_group(self) -> CallbackGroup:
        return MutuallyExclusiveCallbackGroup()

    def _serve_others(self) -> None:
        """No thread: the main thread serves them while it polls."""

    def _opened(self) -> None:
        """Nothing is to be done: the executor takes the messages of every subscription."""

    def poll(self, timeout_ns: int, trigger: Topic | None = None) -> None:
        """Serve one callback, of whatever kind.

        Raises:
            Exception: what the callback has raised.
        """
        self._raise_failure()
        self._spin(timeout_ns / 1e9)

    def collect(self, seconds: float) -> None:
        """Serve one callback: nothing gathers here.

        Raises:
            Exception: what the callback has raised.
        """
        self._raise_failure()
        self._spin(seconds)

    def wake(self) -> None:
        """Nothing is to be done: a wait ends by itself soon."""
