# SPDX-License-Identifier: Apache-2.0
"""The detector node: measurement, command and estimate in, ``detection`` out."""

from __future__ import annotations

import math
import sys
from typing import Any, cast

from ftcm_core.detectors import Detector
from ftcm_core.registry import Component
from ftcm_core.signals import Detection, Measurement
from ftcm_core.simulation.stages import DetectorStage
from ftcm_ros.nodes.component_node import ComponentNode
from ftcm_ros.nodes.main import run
from ftcm_ros.nodes.reactive_node import Answer
from ftcm_ros.transport.codec import JointSample
from ftcm_ros.transport.composed import Composition
from ftcm_ros.transport.topics import DETECTION, ESTIMATE, JOINT_STATES, TORQUES


class DetectorNode(ComponentNode):
    """Runs the fault detector; one that uses no observer does not wait for the estimate."""

    def __init__(self, composition: Composition | None = None) -> None:
        """Subscribe what a detector looks at, publish residuals, alarms and verdicts.

        Raises:
            FtcmError: the scenario has no detector.
        """
        super().__init__("detector", composition)
        self.count_ticks()
        self.listen(
            {JOINT_STATES: ("position", "velocity", "effort"), ESTIMATE: ("effort",), TORQUES: ("effort",)}
        )
        self._detection = self.plane.sender(DETECTION, self.codec.state)
        self._zeros = (0.0,) * self.scenario.robot.joints
        self.alarms = 0
        """Ticks with an alarm."""
        self.last: Detection | None = None
        self.configure()

    def configure(self) -> None:
        """A fresh detector."""
        super().configure()
        detector = cast(Detector, self.parameters.component)
        stage = DetectorStage(self.scenario)
        stage.detector, stage.state = detector, detector.init(self.scenario.robot.joints)
        self.stage = self.staged(stage, detector)
        self.alarms, self.last = 0, None
        self._require(detector)

    def _require(self, detector: Detector) -> None:
        names = (JOINT_STATES.name, ESTIMATE.name, TORQUES.name)
        self.aligner.required = names if detector.needs_observer else (names[0], names[2])

    def use(self, component: Component) -> None:
        """Wait for the estimate, or not, as the detector needs it."""
        self._require(cast(Detector, component))

    def answer(self, time_ns: int, values: dict[str, JointSample]) -> Answer:
        """One set of residuals, alarms and verdicts."""
        estimate = values.get(ESTIMATE.name)
        try:
            found = self.stage.step(
                Measurement(*values[JOINT_STATES.name][1:]),
                values[TORQUES.name].effort,
                estimate.effort if estimate else self._zeros,
                self.elapsed,
            )
        except (ArithmeticError, ValueError) as error:  # driven out of its domain
            self.get_logger().error(f"tick {self.run_ns // self.scenario.dt_ns}: {error}")
            found = Detection((math.nan,) * len(self._zeros), self._zeros)
        self.alarms += any(found.alarm)
        self.last = found
        self.announce(time_ns, self.stage.detector, found.residual)
        return [
            (self._detection.send, self._detection.ready(time_ns, found.alarm, found.verdict, found.residual))
        ]

    def health(self) -> tuple[str, str, dict[str, Any]]:
        """Besides, which joints have an alarm."""
        level, message, values = super().health()
        names = self.codec.joint_names
        now = [name for name, alarm in zip(names, self.last.alarm) if alarm] if self.last else []
        values["ticks_with_alarm"] = self.alarms
        values["alarms"] = ", ".join(now)
        if now:
            level = "warn" if level == "ok" else level
            message += f"; alarm: {', '.join(now)}"
        return level, message, values


def main() -> None:
    """Entry point of ``ros2 run ftcm_ros detector``."""
    sys.exit(run(DetectorNode))


if __name__ == "__main__":
    main()
