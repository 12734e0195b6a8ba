# SPDX-License-Identifier: Apache-2.0
"""White noise of the joint sensors."""

from __future__ import annotations

from typing import Any, ClassVar

from ftcm_core.faults import Moment, SensorFault
from ftcm_core.faults.timing import shifted
from ftcm_core.params import param
from ftcm_core.random_streams import gaussian_pair
from ftcm_core.registry import register
from ftcm_core.signals import Vector


@register("fault", "sensor_noise")
class SensorNoise(SensorFault):
    """White noise: position = q + ψ noise n_1, velocity = q̇ + ψ velocity_noise n_2, n_i ~ N(0, 1) each tick.

    Source: a loss of accuracy; Alwi, Edwards and Tan (2011), Fault Detection and Fault-Tolerant Control Using
    Sliding Modes.
    """

    rank: ClassVar[int] = 30

    noise: float = param(
        1e-3, unit="rad", at_least=0.0, per_joint=True, doc="standard deviation of the position's noise",
        source="chosen: ten steps of the encoder",
    )  # fmt: skip
    velocity_noise: float = param(
        1e-2, unit="rad/s", at_least=0.0, per_joint=True, doc="standard deviation of the velocity's noise",
        source="chosen",
    )  # fmt: skip

    @staticmethod
    def sense(
        p: Any, size: float, now: Moment, position: float, velocity: float, s: Vector
    ) -> tuple[float, float, Vector]:
        """Add the noise."""
        first, second = gaussian_pair(now.key, now.number)
        return shifted(size, position, p.noise * first), shifted(size, velocity, p.velocity_noise * second), s
