# SPDX-License-Identifier: Apache-2.0
"""Gain error of the joint sensors: a wrong calibration, or one that has changed."""

from __future__ import annotations

from typing import Any, ClassVar

from ftcm_core.faults import Moment, SensorFault, scaled
from ftcm_core.params import param
from ftcm_core.registry import register
from ftcm_core.signals import Vector


@register("fault", "sensor_gain")
class SensorGain(SensorFault):
    """Gain error of a sensor: position = (1 + ψ gain) q, velocity = (1 + ψ velocity_gain) q̇.

    Source: a calibration fault; Ni et al. (2009), Sensor network data fault types, ACM TOSN 5(3).
    """

    rank: ClassVar[int] = 10

    gain: float = param(
        0.05, unit="-", per_joint=True, doc="relative error of the position's gain", source="chosen: 5 %"
    )
    velocity_gain: float = param(
        0.05, unit="-", per_joint=True, doc="relative error of the velocity's gain",
        source="chosen: as the position",
    )  # fmt: skip

    @staticmethod
    def sense(
        p: Any, size: float, now: Moment, position: float, velocity: float, s: Vector
    ) -> tuple[float, float, Vector]:
        """Multiply by the gains."""
        return position * (1.0 + scaled(size, p.gain)), velocity * (1.0 + scaled(size, p.velocity_gain)), s
