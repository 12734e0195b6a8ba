# SPDX-License-Identifier: Apache-2.0
"""Constant reference (set-point)."""

from __future__ import annotations

from ftcm_core.params import param, per_joint
from ftcm_core.references import Reference
from ftcm_core.registry import register
from ftcm_core.signals import ReferencePoint


@register("reference", "constant")
class Constant(Reference):
    """x_r = position: a set-point."""

    position: float = param(
        0.0, unit="rad", per_joint=True, doc="desired position", source="chosen: zero pose"
    )

    def at(self, t: float, joints: int) -> ReferencePoint:
        """The set-point, at rest."""
        rest = (0.0,) * joints
        return ReferencePoint(per_joint(self.position, joints), rest, rest)
