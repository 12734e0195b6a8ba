# SPDX-License-Identifier: Apache-2.0
"""Sinusoidal reference."""

from __future__ import annotations

import math

from ftcm_core.params import param, per_joint
from ftcm_core.references import Reference
from ftcm_core.registry import register
from ftcm_core.signals import ReferencePoint


@register("reference", "sine")
class Sine(Reference):
    """x_r = offset + amplitude sin(2π frequency t + phase)."""

    amplitude: float = param(
        0.5, unit="rad", per_joint=True, doc="amplitude", source="chosen: moderate motion"
    )
    frequency: float = param(
        0.1, unit="Hz", at_least=0.0, per_joint=True, doc="frequency", source="chosen: slow motion"
    )
    phase: float = param(0.0, unit="rad", per_joint=True, doc="phase at t = 0", source="chosen")
    offset: float = param(0.0, unit="rad", per_joint=True, doc="centre of the motion", source="chosen")

    def at(self, t: float, joints: int) -> ReferencePoint:
        """The sine and its derivatives."""
        columns = [per_joint(x, joints) for x in (self.amplitude, self.frequency, self.phase, self.offset)]
        position, velocity, acceleration = [], [], []
        for a, f, phase, offset in zip(*columns):
            w = 2.0 * math.pi * f
            s, c = math.sin(w * t + phase), math.cos(w * t + phase)
            position.append(offset + a * s)
            velocity.append(a * w * c)
            acceleration.append(-a * w * w * s)
        return ReferencePoint(tuple(position), tuple(velocity), tuple(acceleration))
