# SPDX-License-Identifier: Apache-2.0
"""What the controller sends to a robot's drives: within the limits, begun and ended gently, watched."""

from __future__ import annotations

import time
from collections.abc import Callable
from math import isfinite
from operator import add
from typing import Any

from ftcm_core.errors import FtcmError
from ftcm_core.limits import command_beyond, motion_beyond
from ftcm_core.signals import NANOSECONDS, Measurement, Vector, saturate
from ftcm_core.simulation.drive import drive_torque
from ftcm_ros.nodes.suite_node import SuiteNode
from ftcm_ros.transport.float_array import FloatArray, joints_of
from ftcm_ros.transport.topics import COMMAND

SETTINGS = (
    "command_topic", "command_joints", "dry_run", "measurement_timeout", "stop_command", "stop_ramp",
)  # fmt: skip
"""Parameters of the node that are looked at here."""


class CommandOutput:
    """Publishes torques as ``std_msgs/Float64MultiArray``, until something is wrong: then it has stopped.

    To have stopped is for good: the torque of ``stop_command`` has been published, once, and nothing follows
    until the node is deactivated and activated again.
    """

    def __init__(self, node: SuiteNode, settings: dict[str, Any], missing: Callable[[], str]) -> None:
        """Begin without anything published.

        Args:
            node: the controller.
            settings: its parameters, those of :data:`SETTINGS`.
            missing: says what does not come, when nothing can be answered.

        Raises:
            FtcmError: a parameter is not valid.
        """
        scenario = node.scenario
        self._node = node
        self._missing = missing
        self._names, self._model = scenario.robot.joint_names, scenario.model
        self._limits = scenario.limits
        self.topic: str = settings["command_topic"]
        self._array = FloatArray(self._names, joints_of(settings["command_joints"]))
        self.dry_run: bool = settings["dry_run"]
        self._timeout_ns = round(settings["measurement_timeout"] * NANOSECONDS)
        self._stop_command: str = settings["stop_command"]
        self._stop_ramp_ns = round(settings["stop_ramp"] * NANOSECONDS)
        if node.composition is None and node.get_parameter("data_path").value == "executor":
            raise FtcmError(
                "data_path: executor has no watch over the measurements; expected listener or waitset"
            )
        self._publish = None if self.dry_run else node.plane.publisher(COMMAND._replace(name=self.topic))
        self.begin()

    def begin(self) -> None:
        """Nothing published yet: the node becomes active."""
        self.stopped = ""
        """Why nothing is published any more."""
        self.published = 0
        self.clipped = 0
        """Torques that are not those of the law, because of the limits; and the last of them."""
        self._last_clipped = ""
        self._torque: Vector | None = None
        """What was published last, N·m."""
        self._wanted: Vector = ()
        """What the law said last, N·m."""
        self._position: Vector = ()
        self._answered_ns = 0
        self._ending: tuple[int, Vector] | None = None
        """When the end began (steady clock, ns), and the torque that it leads to."""

    def torque(self, y: Measurement, u: Vector) -> Vector | None:
        """Return what is published in a tick; None if nothing is any more.

        Args:
            y: the measurement.
            u: the law's torque, N·m.
        """
        if beyond := motion_beyond(self._limits, self._names, y.position, y.velocity):
            self.stop(beyond)
        elif not isfinite(sum(u)):
            self.stop(f"the law's torque is not finite: {list(u)} N·m")
        if self.stopped:
            return None
        self._wanted, self._position = u, y.position
        self._answered_ns = time.monotonic_ns()
        if self._torque is None:  # the drives do what they have been told before
            self._torque = saturate(y.effort, self._limits.torque)
        return self._limited(u)

    def _limited(self, u: Vector) -> Vector:
        if self._ending is not None:
            begun, last = self._ending
            share = min(1.0, (time.monotonic_ns() - begun) / self._stop_ramp_ns)
            u = tuple(map(add, [(1.0 - share) * x for x in u], [share * x for x in last]))
        before = self._torque or u
        self._torque = drive_torque(self._limits, before, u)
        if self._torque != u:
            self.clipped += 1
            self._last_clipped = command_beyond(self._limits, self._names, before, u)
        return self._torque

    def send(self, torque: Vector) -> None:
        """Publish a torque, if it is not only computed."""
        if self._publish is not None and not self.stopped:
            self._publish(self._array.encode(torque))
            self.published += 1

    def watch(self) -> None:
        """Stop if no measurement has been answered for too long; called now and then by the main thread."""
        silent = time.monotonic_ns() - self._answered_ns
        if self._answered_ns and self._timeout_ns and silent > self._timeout_ns and not self.stopped:
            self.stop(f"{self._missing()} for {silent / NANOSECONDS:.2g} s")

    def stop(self, reason: str) -> None:
        """Publish the last torque and nothing after it, and say why."""
        if self.stopped:
            return
        self._send_last()
        self.stopped = reason
        self._node.get_logger().error(
            f"stopped: {reason}; {self._stop_command} torque published; deactivate and activate to go on"
            if self.published
            else f"stopped: {reason}"
        )

    def _end_torque(self) -> Vector:
        torque = self._torque or (0.0,) * len(self._names)
        if self._stop_command == "hold":
            return torque
        if self._stop_command == "gravity":
            return saturate(self._model.gravity(self._position), self._limits.torque)
        return (0.0,) * len(torque)

    def _send_last(self) -> None:
        if self.published:
            self.send(self._end_torque())

    def begin_end(self) -> None:
        """Begin to go to the last torque, if there is anything to end gently."""
        if self.published and self._stop_ramp_ns and not self.stopped:
            self._ending = time.monotonic_ns(), self._end_torque()

    def at_end(self) -> bool:
        """Whether the last torque should have been reached."""
        return self._ending is None or time.monotonic_ns() - self._ending[0] >= self._stop_ramp_ns

    def coast(self) -> None:
        """Go on towards the last torque though no measurement was answered."""
        if not self.stopped:
            self.send(self._limited(self._wanted))

    def end(self) -> None:
        """Publish the last torque, as the last that is published."""
        if not self.stopped:
            self._send_last()

    def health(self, level: str, message: str) -> tuple[str, str, dict[str, Any]]:
        """Level, message and values of the diagnostics."""
        if self.clipped:
            level = "warn" if level == "ok" else level
            message += f"; {self.clipped} torques clipped, last: {self._last_clipped}"
        if self.dry_run:
            message += "; dry run, no command is published"
        if self.stopped:
            level, message = "error", f"{message}; stopped: {self.stopped}"
        return level, message, {
            "command_topic": self.topic,
            "command_joints": ", ".join(self._array.order),
            "commands_published": self.published,
            "clipped": self.clipped,
            "stopped": self.stopped,
        }  # fmt: skip
