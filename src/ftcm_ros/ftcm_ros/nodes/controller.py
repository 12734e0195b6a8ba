# SPDX-License-Identifier: Apache-2.0
"""The controller node: ``joint_states`` and ``disturbance_estimate`` in, ``joint_torques`` out."""

from __future__ import annotations

import contextlib
import math
import sys
from typing import Any, cast

from ftcm_core.controllers import Controller
from ftcm_core.limits import command_beyond
from ftcm_core.registry import Component
from ftcm_core.signals import Measurement
from ftcm_core.simulation.accommodation import Pace
from ftcm_core.simulation.stages import ControllerStage
from ftcm_ros.nodes.accommodating_node import AccommodatingNode
from ftcm_ros.nodes.fault_desk import FaultDesk
from ftcm_ros.nodes.main import run
from ftcm_ros.nodes.reactive_node import Answer
from ftcm_ros.transport.codec import JointSample
from ftcm_ros.transport.composed import Composition
from ftcm_ros.transport.topics import ESTIMATE, JOINT_STATES, REFERENCE, TORQUES


class ControllerNode(AccommodatingNode):
    """Runs the control law; a law that uses no observer does not wait for the estimate."""

    tells = True

    def __init__(self, composition: Composition | None = None) -> None:
        """Subscribe measurements and estimates, publish torques and the reference."""
        super().__init__("controller", composition)
        self.listen({JOINT_STATES: ("position", "velocity", "effort"), ESTIMATE: ("effort",)})
        self._torques = self.plane.sender(TORQUES, self.codec.torque)
        self._reference = self.plane.sender(REFERENCE, self.codec.motion)
        self.faults = FaultDesk(self, self.next_tick)
        self._zeros = (0.0,) * self.scenario.robot.joints
        self._limits = self.scenario.limits
        self.beyond_limits = 0
        """Commands that the drives cannot follow, and what was wrong with the last."""
        self.last_beyond = ""
        self.configure()

    def configure(self) -> None:
        """A fresh control law."""
        super().configure()
        law = cast(Controller, self.parameters.component)
        self.stage = self.staged(ControllerStage(self.scenario, law), law)
        if self.active:  # the plant has begun another run
            self.faults.begin()
        self._require(law)

    def activate(self) -> None:
        """Tell when faults will act."""
        self.faults.begin()

    def _require(self, law: Controller) -> None:
        self.require(JOINT_STATES, *[ESTIMATE] * law.needs_observer)

    def use(self, component: Component) -> None:
        """Wait for the estimate, or not, as the law needs it."""
        self._require(cast(Controller, component))

    def slow(self, pace: Pace | None) -> None:
        """The reference is here."""
        self.stage.slow(pace)

    def prepare(self, time_ns: int, sample: JointSample) -> None:
        """All of the torque but the estimate, while the observer works."""
        if self.accommodation:
            return  # what the tick is made of is decided when all of it is there
        with contextlib.suppress(ArithmeticError, ValueError):  # the answer meets it again, and says so
            self.stage.prepare(time_ns, Measurement(*sample[1:]))

    def answer(self, time_ns: int, values: dict[str, JointSample]) -> Answer:
        """One torque and the reference it followed."""
        y, estimate = self.accommodated(time_ns, values), values.get(ESTIMATE.name)
        try:
            u, reference = self.stage.step(time_ns, y, estimate.effort if estimate else self._zeros)
        except (ArithmeticError, ValueError) as error:  # a law driven out of its domain: the run has diverged
            self.get_logger().error(f"tick {time_ns // self.scenario.dt_ns}: {error}")
            u = (math.nan,) * self.scenario.robot.joints
            reference = self.stage.reference_at(time_ns)
        if beyond := command_beyond(self._limits, self.codec.joint_names, self._output, u):
            self.beyond_limits += 1
            self.last_beyond = f"t = {time_ns / 1e9:g} s: {beyond}"
        self.announce(time_ns, self.stage.controller, u)
        return [
            (self._torques.send, self._torques.ready(time_ns, u)),
            (self._reference.send, self._reference.ready(time_ns, reference.position, reference.velocity)),
        ]

    def health(self) -> tuple[str, str, dict[str, Any]]:
        """Besides, commands beyond the robot's limits; the plant enforces them."""
        level, message, values = super().health()
        values["beyond_limits"] = self.beyond_limits
        if self.beyond_limits:
            level = "warn" if level == "ok" else level
            message += f"; {self.beyond_limits} commands beyond the limits, last: {self.last_beyond}"
        return level, message, values


def main() -> None:
    """Entry point of ``ros2 run ftcm_ros controller``."""
    sys.exit(run(ControllerNode))


if __name__ == "__main__":
    main()
