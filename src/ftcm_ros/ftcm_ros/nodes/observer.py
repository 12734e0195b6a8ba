# SPDX-License-Identifier: Apache-2.0
"""The observer node: ``joint_states`` in, ``disturbance_estimate`` out."""

from __future__ import annotations

import math
import sys
from typing import cast

from ftcm_core.observers import Observer
from ftcm_core.simulation.stages import ObserverStage
from ftcm_ros.nodes.accommodating_node import AccommodatingNode
from ftcm_ros.nodes.main import run
from ftcm_ros.nodes.reactive_node import Answer
from ftcm_ros.transport.codec import JointSample
from ftcm_ros.transport.composed import Composition
from ftcm_ros.transport.topics import ESTIMATE, JOINT_STATES


class ObserverNode(AccommodatingNode):
    """Runs the disturbance observer."""

    def __init__(self, composition: Composition | None = None) -> None:
        """Subscribe measurements, publish estimates."""
        super().__init__("observer", composition)
        self.listen({JOINT_STATES: ("position", "velocity", "effort")})
        self._estimate = self.plane.sender(ESTIMATE, self.codec.torque)
        self.configure()

    def configure(self) -> None:
        """A fresh observer."""
        super().configure()
        observer = cast(Observer, self.parameters.component)
        stage = ObserverStage(observer, self.scenario.model, self.scenario.dt)
        self.stage = self.staged(stage, observer)
        self.require(JOINT_STATES)

    def answer(self, time_ns: int, values: dict[str, JointSample]) -> Answer:
        """One estimate."""
        try:
            tau_hat = self.stage.step(self.accommodated(time_ns, values), self.elapsed)
        except (ArithmeticError, ValueError) as error:  # driven out of its domain: the run has diverged
            self.get_logger().error(f"tick {self.run_ns // self.scenario.dt_ns}: {error}")
            tau_hat = (math.nan,) * self.scenario.robot.joints
        self.announce(time_ns, self.stage.observer, tau_hat)
        return [(self._estimate.send, self._estimate.ready(time_ns, tau_hat))]


def main() -> None:
    """Entry point of ``ros2 run ftcm_ros observer``."""
    sys.exit(run(ObserverNode))


if __name__ == "__main__":
    main()
