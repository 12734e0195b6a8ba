# SPDX-License-Identifier: Apache-2.0
"""Backlash of the drives: after a reversal their torque has to cross a gap first."""

from __future__ import annotations

from typing import Any, ClassVar

from ftcm_core.faults import ActuatorFault, Moment, scaled
from ftcm_core.params import param
from ftcm_core.registry import register
from ftcm_core.signals import Vector


@register("fault", "backlash")
class Backlash(ActuatorFault):
    """Backlash: torque on the joint y_k = clip(y_{k-1}, u_k ± ψ gap), u the torque of the drive.

    The play operator, the standard model of backlash as a hysteresis at the input of a plant (Tao and
    Kokotović 1996): y follows u at the distance of the gap, and rests while u crosses it. A gap between the
    *positions* of motor and joint would need the motor as a body of its own, which these robots have not.
    """

    rank: ClassVar[int] = 25
    initial: ClassVar[Vector] = (0.0,)
    remembers: ClassVar[bool] = True

    gap: float = param(
        5.0, unit="N·m", at_least=0.0, per_joint=True, doc="half the width of the hysteresis",
        source="model: Tao, Kokotović 1996; value chosen",
    )  # fmt: skip

    @staticmethod
    def act(
        p: Any, size: float, now: Moment, torque: float, q: float, v: float, s: Vector
    ) -> tuple[float, Vector]:
        """What was there, dragged along by the torque."""
        applied = dragged(s[0], torque, scaled(size, p.gap))
        return applied, (applied,)


def dragged(y: float, x: float, gap: float) -> float:
    """Nearest number to y in x ± gap; bit for bit x if the gap is 0."""
    return x if gap == 0.0 else max(x - gap, min(x + gap, y))
