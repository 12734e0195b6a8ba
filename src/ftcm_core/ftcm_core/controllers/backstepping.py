# SPDX-License-Identifier: Apache-2.0
"""Adaptive backstepping, a baseline."""

from __future__ import annotations

from typing import ClassVar

from ftcm_core.controllers import AccelerationLaw
from ftcm_core.params import param
from ftcm_core.registry import register
from ftcm_core.signals import Vector


@register("controller", "backstepping")
class Backstepping(AccelerationLaw):
    """Adaptive backstepping: v = ẍ_r - c1 ė - e - c2 z - d̂, z = ė + c1 e, d̂̇ = γ z (Krstić et al. 1995).

    With a constant disturbance d, V = e²/2 + z²/2 + (d - d̂)²/(2γ) has the rate V̇ = -c1 e² - c2 z², so
    the error vanishes; one that changes leaves an error, as with any integral. Without adaptation, γ = 0,
    the law is plain backstepping, which is ctc with kp = 1 + c1 c2 and kd = c1 + c2. Held over ticks, V
    changes by dt V̇ a tick, but for a share of the order of dt².
    """

    c1: float = param(
        10.0,
        unit="1/s",
        above=0.0,
        per_joint=True,
        doc="gain c1 of the position",
        source="Krstić et al. (1995); value chosen: as for ctc",
    )
    c2: float = param(
        10.0,
        unit="1/s",
        above=0.0,
        per_joint=True,
        doc="gain c2 of the velocity",
        source="Krstić et al. (1995); value chosen: as for ctc",
    )
    gamma: float = param(
        400.0,
        unit="1/s²",
        at_least=0.0,
        per_joint=True,
        doc="adaptation gain γ of the disturbance; 0: none",
        source="Krstić et al. (1995); value chosen: d̂ follows at 4 rad/s or more",
    )

    initial: ClassVar[Vector] = (0.0,)
    """The estimate d̂, rad/s²."""

    @staticmethod
    def law(p: Backstepping, e: float, de: float, dt: float, s: Vector) -> tuple[float, Vector]:
        """-c1 ė - e - c2 z - d̂; then d̂ advances by forward Euler."""
        z = de + p.c1 * e
        return -p.c1 * de - e - p.c2 * z - s[0], (s[0] + dt * p.gamma * z,)
