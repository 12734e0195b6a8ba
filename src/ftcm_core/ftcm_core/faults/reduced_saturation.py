# SPDX-License-Identifier: Apache-2.0
"""Reduced saturation of the drives: less than their full torque is to be had."""

from __future__ import annotations

from typing import Any, ClassVar

from ftcm_core.faults import ActuatorFault, Moment
from ftcm_core.numeric import clamp
from ftcm_core.params import param
from ftcm_core.registry import register
from ftcm_core.signals import Vector


@register("fault", "reduced_saturation")
class ReducedSaturation(ActuatorFault):
    """Reduced saturation: torque on the joint = clip(torque of the drive, ±limit / ψ).

    A growing fault lowers the limit from above, to ``limit`` when it is fully there, and to half of it with
    twice the severity: a drive that heats up, or whose supply sags. The drive does not notice.
    """

    rank: ClassVar[int] = 30

    limit: float = param(
        30.0, unit="N·m", above=0.0, per_joint=True, doc="largest torque that is left",
        source="chosen: a third of what the PUMA 560's weakest drive has",
    )  # fmt: skip

    @staticmethod
    def act(
        p: Any, size: float, now: Moment, torque: float, q: float, v: float, s: Vector
    ) -> tuple[float, Vector]:
        """What of the torque is within the limit."""
        return limited(torque, p.limit, size), s


def limited(x: float, limit: float, psi: float) -> float:
    """Nearest number to x in ±limit / ψ; x for ψ = 0."""
    return x if psi == 0.0 else clamp(x, limit / psi)
