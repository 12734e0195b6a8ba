# SPDX-License-Identifier: Apache-2.0
"""Outliers of the joint sensors: single samples that are far off."""

from __future__ import annotations

from typing import Any, ClassVar

from ftcm_core.faults import Moment, SensorFault
from ftcm_core.faults.timing import shifted
from ftcm_core.params import param
from ftcm_core.random_streams import uniform
from ftcm_core.registry import register
from ftcm_core.signals import Vector


@register("fault", "sensor_outliers")
class SensorOutliers(SensorFault):
    """Outliers: position = q + ψ s spike, velocity = q̇ + ψ s velocity_spike, s = ±1 at random, else 0.

    s is drawn anew for each sample: 1 and -1 with half the probability each. A sample's position and velocity
    are off together.

    Source: Ni et al. (2009), Sensor network data fault types, ACM TOSN 5(3).
    """

    rank: ClassVar[int] = 50

    probability: float = param(
        0.01, unit="-", at_least=0.0, at_most=1.0, per_joint=True, doc="share of the samples that are off",
        source="chosen: ten a second",
    )  # fmt: skip
    spike: float = param(
        0.1, unit="rad", at_least=0.0, per_joint=True, doc="by how much the position is off", source="chosen"
    )
    velocity_spike: float = param(
        1.0, unit="rad/s", at_least=0.0, per_joint=True, doc="by how much the velocity is off",
        source="chosen",
    )  # fmt: skip

    @staticmethod
    def sense(
        p: Any, size: float, now: Moment, position: float, velocity: float, s: Vector
    ) -> tuple[float, float, Vector]:
        """Add the spikes."""
        sign = spike_sign(p.probability, now.key, now.number)
        return shifted(size, position, sign * p.spike), shifted(size, velocity, sign * p.velocity_spike), s


def spike_sign(probability: float, key: float, number: float) -> float:
    """-1 or 1, each with half the probability, else 0.

    Args:
        probability: of a spike.
        key: stream of random numbers.
        number: which number of it.
    """
    u = uniform(key, number)
    if u < 0.5 * probability:
        return -1.0
    return 1.0 if u > 1.0 - 0.5 * probability else 0.0
