# SPDX-License-Identifier: Apache-2.0
"""Hard-over of the drives: full torque to one side."""

from __future__ import annotations

from typing import Any, ClassVar

from ftcm_core.faults import ActuatorFault, Moment
from ftcm_core.faults.timing import mixed
from ftcm_core.params import param
from ftcm_core.registry import register
from ftcm_core.signals import Vector


@register("fault", "hard_over")
class HardOver(ActuatorFault):
    """Hard-over: torque on the joint = (1 - ψ) torque of the drive + ψ level, its full torque to one side.

    With ``profile: ramp`` the drive runs away to it (a runaway).
    """

    rank: ClassVar[int] = 70

    level: float = param(
        80.0, unit="N·m", per_joint=True, doc="full torque of the drive, the sign says to which side",
        source="model: Ducard 2009, hard-over; value chosen: what each drive of the PUMA 560 has",
    )  # fmt: skip

    @staticmethod
    def act(
        p: Any, size: float, now: Moment, torque: float, q: float, v: float, s: Vector
    ) -> tuple[float, Vector]:
        """Full torque in the place of what is asked for."""
        return mixed(size, torque, p.level), s

    def check(self) -> None:
        """It takes the place of the torque."""
        ActuatorFault.check(self)
        self.check_share()
