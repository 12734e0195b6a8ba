# SPDX-License-Identifier: Apache-2.0
"""Pausing a run: the plant's services ``~/pause`` and ``~/step``.

While the run is paused the present tick is done and the next one does not begin; everyone else waits.
"""

from __future__ import annotations

import time
from collections.abc import Callable

from rcl_interfaces.msg import ParameterDescriptor
from std_srvs.srv import SetBool, Trigger

from ftcm_ros.nodes.suite_node import SuiteNode


class Pause:
    """Whether the plant may go on."""

    def __init__(self, node: SuiteNode, go_on: Callable[[], None]) -> None:
        """Offer the services.

        Args:
            node: the plant.
            go_on: called on its main thread when ticks may begin again.
        """
        self._node = node
        self._go_on = go_on
        self.clear()
        node.declare_parameter(
            "step_ticks", 1, ParameterDescriptor(description="ticks that ~/step goes on for while paused")
        )
        node.create_service(SetBool, "~/pause", self._on_pause)
        node.create_service(Trigger, "~/step", self._on_step)

    def clear(self) -> None:
        """A run begins: not paused."""
        self._paused, self._left = False, 0
        self.count = 0
        """How often the run has been paused."""
        self._since = self._seconds = 0.0

    @property
    def on(self) -> bool:
        """Whether no tick may end now."""
        return self._paused and self._left == 0

    @property
    def paused(self) -> bool:
        """Whether the run is paused, be it for steps."""
        return self._paused

    @property
    def seconds(self) -> float:
        """How long the run has been paused, s."""
        return self._seconds + (time.monotonic() - self._since if self._paused else 0.0)

    def ticked(self) -> None:
        """A tick has ended."""
        if self._left:
            self._left -= 1

    def _on_pause(self, request: SetBool.Request, response: SetBool.Response) -> SetBool.Response:
        response.success, response.message = self._node.on_main_thread(lambda: self._set(request.data))
        return response

    def _set(self, wanted: bool) -> tuple[bool, str]:
        if not self._node.active:
            return False, "no run is on; expected the node to be active"
        if wanted == self._paused:
            return True, f"{self._where()} already"
        self._paused, self._left = wanted, 0
        if wanted:
            self.count += 1
            self._since = time.monotonic()
        else:
            self._seconds += time.monotonic() - self._since
            self._go_on()
        self._node.get_logger().info(self._where())
        return True, self._where()

    def _where(self) -> str:
        return f"tick {self._node.ticks}: {'paused' if self._paused else 'goes on'}"

    def _on_step(self, request: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        response.success, response.message = self._node.on_main_thread(self._step)
        return response

    def _step(self) -> tuple[bool, str]:
        wanted = self._node.get_parameter("step_ticks").value
        if wanted < 1:
            return False, f"step_ticks: {wanted} is out of range; expected a whole number, at least 1"
        if not self._node.active or not self._paused:
            return False, "the run is not paused; call ~/pause with data: true first"
        self._left += wanted
        self._go_on()
        return True, f"tick {self._node.ticks}: goes on for {self._left}"
