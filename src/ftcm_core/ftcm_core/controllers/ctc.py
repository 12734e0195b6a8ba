# SPDX-License-Identifier: Apache-2.0
"""Computed torque control, a sanity baseline."""

from __future__ import annotations

from ftcm_core.controllers import AccelerationLaw
from ftcm_core.params import param
from ftcm_core.registry import register
from ftcm_core.signals import Vector


@register("controller", "ctc")
class CTC(AccelerationLaw):
    """Computed torque: v = ẍ_r - kd ė - kp e."""

    kp: float = param(
        100.0,
        unit="1/s²",
        above=0.0,
        per_joint=True,
        doc="position gain",
        source="chosen: 10 rad/s bandwidth",
    )
    kd: float = param(
        20.0, unit="1/s", at_least=0.0, per_joint=True, doc="velocity gain", source="chosen: critical damping"
    )

    @staticmethod
    def law(p: CTC, e: float, de: float, dt: float, s: Vector) -> tuple[float, Vector]:
        """-kd ė - kp e."""
        return -p.kd * de - p.kp * e, s
