# SPDX-License-Identifier: Apache-2.0
"""Accommodation policies, one per file: what is done about a fault that the detector has told.

A policy waits for a verdict. From the tick after it on, and for the rest of the run, it changes something:
the law, the observer, what is measured, or how fast the reference goes. (Active fault-tolerant control:
Y. Zhang, J. Jiang, "Bibliographical review on reconfigurable fault-tolerant control systems", Annual Reviews
in Control 32, 2008.) It sees what the detector says, never what really is.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar

from ftcm_core.detectors import VERDICTS
from ftcm_core.params import param
from ftcm_core.registry import Component
from ftcm_core.robots import Robot
from ftcm_core.signals import Detection, Measurement, Vector


@dataclass(frozen=True, kw_only=True)
class Policy(Component):
    """What is done once a verdict has lasted; a subclass says what, by one of the methods below."""

    each_joint: ClassVar[bool] = False
    """Whether it decides about each joint by itself, not once for the robot."""

    verdict: str = param(
        "any", unit="-", choices=("any", *VERDICTS[1:]),
        doc="what the detector must say of a joint; any: every alarm. Only `isolating` tells them apart",
        source="chosen",
    )  # fmt: skip
    joint: int = param(
        0, unit="-", at_least=0, at_most=100, doc="number of the joint it must be said of; 0: whichever",
        source="chosen",
    )  # fmt: skip
    hold: float = param(
        0.0, unit="s", at_least=0.0, doc="how long it must be said without a break", source="chosen: at once"
    )

    def says(self, found: Detection) -> tuple[bool, ...]:
        """Whether the detector says of each joint what this policy waits for."""
        code = VERDICTS.index(self.verdict) if self.verdict != "any" else None
        return tuple(
            [
                alarm != 0.0 and self.joint in (0, j + 1) and code in (None, verdict)
                for j, (alarm, verdict) in enumerate(zip(found.alarm, found.verdict))
            ]
        )

    def unsuited(self, robot: Robot) -> str:
        """Return why it cannot do what it says on a robot; empty if it can."""
        if self.joint > robot.joints:
            return f"joint: {self.joint} is out of range; expected 0 (whichever) to {robot.joints}"
        return ""

    def components(self) -> dict[str, Component]:
        """Return what it puts in the place of the ``controller`` or the ``observer``, by kind."""
        return {}

    @property
    def pace(self) -> tuple[float, float] | None:
        """How fast the reference goes on, 1 as planned, and over how long it comes to that, s."""
        return None

    def memory(self, joints: int) -> Any:
        """Return what it remembers of measurements before the first one."""
        del joints
        return ()

    def measured(self, dt: float, y: Measurement, broken: Vector, memory: Any) -> tuple[Measurement, Any]:
        """Return what observer and law are given in place of a measurement.

        Args:
            dt: time since the last measurement, s.
            y: the measurement.
            broken: per joint, 1 from the decision about it on, else 0.
            memory: what the last call returned.
        """
        del dt, broken
        return y, memory
