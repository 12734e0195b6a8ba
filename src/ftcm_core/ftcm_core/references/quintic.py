# SPDX-License-Identifier: Apache-2.0
"""Quintic point-to-point reference (minimum jerk)."""

from __future__ import annotations

from ftcm_core.params import param, per_joint
from ftcm_core.references import Reference
from ftcm_core.registry import register
from ftcm_core.signals import ReferencePoint


@register("reference", "quintic")
class Quintic(Reference):
    """Rest to rest in a given time: x_r = from + (to - from)(10 s³ - 15 s⁴ + 6 s⁵), s = t/duration."""

    start: float = param(0.0, unit="rad", per_joint=True, doc="position before the motion", source="chosen")
    goal: float = param(0.5, unit="rad", per_joint=True, doc="position after the motion", source="chosen")
    begin: float = param(0.0, unit="s", at_least=0.0, doc="time at which the motion begins", source="chosen")
    duration: float = param(5.0, unit="s", above=0.0, doc="length of the motion", source="chosen")

    def at(self, t: float, joints: int) -> ReferencePoint:
        """Position, velocity and acceleration, at rest outside the motion."""
        s = min(max((t - self.begin) / self.duration, 0.0), 1.0)
        shape = s * s * s * (10.0 + s * (6.0 * s - 15.0))
        rate = 30.0 * s * s * (1.0 - s) * (1.0 - s) / self.duration
        curve = 60.0 * s * (1.0 - s) * (1.0 - 2.0 * s) / (self.duration * self.duration)
        points = list(zip(per_joint(self.start, joints), per_joint(self.goal, joints)))
        return ReferencePoint(
            tuple([a + (b - a) * shape for a, b in points]),
            tuple([(b - a) * rate for a, b in points]),
            tuple([(b - a) * curve for a, b in points]),
        )
