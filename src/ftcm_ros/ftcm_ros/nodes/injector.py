# SPDX-License-Identifier: Apache-2.0
"""The injector node: ``joint_states`` and ``joint_torques`` in, ``disturbance`` out."""

from __future__ import annotations

import math
import sys

from ftcm_core.simulation.stages import InjectorStage
from ftcm_ros.nodes.fault_desk import FaultDesk, FaultServices
from ftcm_ros.nodes.main import run
from ftcm_ros.nodes.reactive_node import Answer, ReactiveNode
from ftcm_ros.transport.codec import JointSample
from ftcm_ros.transport.composed import Composition
from ftcm_ros.transport.topics import DISTURBANCE, JOINT_STATES, TORQUES, TRUE_STATE


class InjectorNode(ReactiveNode):
    """Adds the scenario's disturbances and faults as joint torques."""

    def __init__(self, composition: Composition | None = None) -> None:
        """Subscribe the robot's true motion and torques, publish the added torque."""
        super().__init__("injector", composition)
        self._motion = TRUE_STATE if self.scenario.hidden else JOINT_STATES
        self.listen({self._motion: ("position", "velocity"), TORQUES: ("effort",)})
        self._disturbance = self.plane.sender(DISTURBANCE, self.codec.torque)
        self.faults = FaultDesk(self, self.next_tick)
        self.fault_services = FaultServices(self, self.faults)
        self.configure()

    def configure(self) -> None:
        """Disturbances and faults as they are before the first tick."""
        super().configure()
        self.stage = self.staged(InjectorStage(self.scenario))
        if self.active:  # the plant has begun another run
            self.faults.begin()

    def activate(self) -> None:
        """Tell when faults will act."""
        self.faults.begin()

    def answer(self, time_ns: int, values: dict[str, JointSample]) -> Answer:
        """One disturbance."""
        state = values[self._motion.name]
        try:
            u = values[TORQUES.name].effort
            d = self.stage.step(time_ns, state.position, state.velocity, u, self.elapsed).torque
        except (
            ArithmeticError,
            ValueError,
        ) as error:  # a fault driven out of its domain: the run has diverged
            self.get_logger().error(f"tick {time_ns // self.scenario.dt_ns}: {error}")
            d = (math.nan,) * self.scenario.robot.joints
        self.faults.look(time_ns)
        return [(self._disturbance.send, self._disturbance.ready(time_ns, d))]

    def deactivate(self) -> None:
        """The run ends: tell what has not been told."""
        self.faults.tell(max(0, self.next_tick() - 1))


def main() -> None:
    """Entry point of ``ros2 run ftcm_ros injector``."""
    sys.exit(run(InjectorNode))


if __name__ == "__main__":
    main()
