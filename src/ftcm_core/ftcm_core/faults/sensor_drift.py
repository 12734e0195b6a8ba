# SPDX-License-Identifier: Apache-2.0
"""Drift of the position sensors, steady and at random."""

from __future__ import annotations

import math
from typing import Any, ClassVar

from ftcm_core.faults import Moment, SensorFault
from ftcm_core.faults.timing import shifted
from ftcm_core.params import param
from ftcm_core.random_streams import gaussian
from ftcm_core.registry import register
from ftcm_core.signals import Vector


@register("fault", "sensor_drift")
class SensorDrift(SensorFault):
    """Sensor drift: position = q + ψ (drift (t - T_f) + w), w a random walk; velocity = q̇ + ψ drift.

    Source: a calibration fault; Ni et al. (2009), Sensor network data fault types, ACM TOSN 5(3).
    """

    rank: ClassVar[int] = 20
    initial: ClassVar[Vector] = (0.0,)

    drift: float = param(
        0.001, unit="rad/s", per_joint=True, doc="growth of the bias; the velocity is off by it too",
        source="chosen: 2 degrees within the paper's run",
    )  # fmt: skip
    walk: float = param(
        0.0, unit="rad/√s", at_least=0.0, per_joint=True,
        doc="standard deviation of the random walk w after one second", source="chosen: none",
    )  # fmt: skip

    @staticmethod
    def sense(
        p: Any, size: float, now: Moment, position: float, velocity: float, s: Vector
    ) -> tuple[float, float, Vector]:
        """Add the drift to the position and its steady part to the velocity."""
        walk = s[0] + random_step(size, p.walk, now.dt, now.key, now.number)
        return (
            shifted(size, position, p.drift * now.since + walk),
            shifted(size, velocity, p.drift),
            (walk,),
        )


def random_step(psi: float, intensity: float, dt: float, key: float, number: float) -> float:
    """One step of a random walk, rad; none while the fault does not act.

    Args:
        psi: size of the fault.
        intensity: standard deviation after one second, rad/√s.
        dt: tick length, s.
        key: the stream.
        number: which number of it.
    """
    if psi == 0.0 or intensity == 0.0:
        return 0.0
    return intensity * math.sqrt(dt) * gaussian(key, number)
