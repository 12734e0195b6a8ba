# SPDX-License-Identifier: Apache-2.0
"""Bias of the drives: a constant torque comes with what they apply."""

from __future__ import annotations

from typing import Any, ClassVar

from ftcm_core.faults import ActuatorFault, Moment
from ftcm_core.faults.timing import shifted
from ftcm_core.params import param
from ftcm_core.registry import register
from ftcm_core.signals import Vector


@register("fault", "actuator_bias")
class ActuatorBias(ActuatorFault):
    """Bias of the drives: torque on the joint = torque of the drive + ψ bias."""

    rank: ClassVar[int] = 60

    bias: float = param(
        5.0, unit="N·m", per_joint=True, doc="torque that is added",
        source="additive fault: Isermann 2006; value chosen",
    )  # fmt: skip

    @staticmethod
    def act(
        p: Any, size: float, now: Moment, torque: float, q: float, v: float, s: Vector
    ) -> tuple[float, Vector]:
        """Add the bias."""
        return shifted(size, torque, p.bias), s
