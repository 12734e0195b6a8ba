# SPDX-License-Identifier: Apache-2.0
"""Bias of the joint sensors."""

from __future__ import annotations

from typing import Any, ClassVar

from ftcm_core.faults import Moment, SensorFault
from ftcm_core.faults.timing import shifted
from ftcm_core.params import param
from ftcm_core.registry import register
from ftcm_core.signals import Vector


@register("fault", "sensor_bias")
class SensorBias(SensorFault):
    """Sensor bias: position = q + ψ bias, velocity = q̇ + ψ velocity_bias.

    Source: a calibration fault; Ni et al. (2009), Sensor network data fault types, ACM TOSN 5(3).
    """

    rank: ClassVar[int] = 20

    bias: float = param(
        0.01, unit="rad", per_joint=True, doc="bias of the position", source="chosen: half a degree"
    )
    velocity_bias: float = param(
        0.0, unit="rad/s", per_joint=True, doc="bias of the velocity", source="chosen: none"
    )

    @staticmethod
    def sense(
        p: Any, size: float, now: Moment, position: float, velocity: float, s: Vector
    ) -> tuple[float, float, Vector]:
        """Add the biases."""
        return shifted(size, position, p.bias), shifted(size, velocity, p.velocity_bias), s
