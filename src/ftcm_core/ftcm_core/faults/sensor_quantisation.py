# SPDX-License-Identifier: Apache-2.0
"""A coarse resolution of the joint sensors, as of a damaged disc or of lost bits."""

from __future__ import annotations

from typing import Any, ClassVar

from ftcm_core.faults import Moment, SensorFault
from ftcm_core.params import param
from ftcm_core.registry import register
from ftcm_core.sensors.encoder import encode
from ftcm_core.signals import Vector


@register("fault", "sensor_quantisation")
class SensorQuantisation(SensorFault):
    """Quantisation: position = Δ round(q / Δ), Δ = ψ resolution; the velocity with Δ = ψ velocity_resolution.

    Source: Widrow and Kollár (2008), Quantization Noise.
    """

    rank: ClassVar[int] = 40

    resolution: float = param(
        1e-2, unit="rad", at_least=0.0, per_joint=True, doc="step of the position; 0: none",
        source="chosen: a hundred steps of the encoder",
    )  # fmt: skip
    velocity_resolution: float = param(
        1e-2, unit="rad/s", at_least=0.0, per_joint=True, doc="step of the velocity; 0: none", source="chosen"
    )

    @staticmethod
    def sense(
        p: Any, size: float, now: Moment, position: float, velocity: float, s: Vector
    ) -> tuple[float, float, Vector]:
        """Round both to their steps."""
        return encode(position, size * p.resolution), encode(velocity, size * p.velocity_resolution), s
