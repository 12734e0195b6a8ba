# SPDX-License-Identifier: Apache-2.0
"""Super-twisting control whose gains adapt themselves, a baseline."""

from __future__ import annotations

from ftcm_core.controllers import AccelerationLaw
from ftcm_core.controllers.super_twisting import super_twisting
from ftcm_core.numeric import sgn
from ftcm_core.params import joint_parameters, param
from ftcm_core.registry import register
from ftcm_core.signals import State, Vector


def adapted(
    alpha: float, sigma: float, mu: float, rate: float, floor: float, floor_rate: float, dt: float
) -> float:
    """α one tick later: α̇ = rate sgn(|σ| - μ) above the floor, α̇ = floor_rate at it.

    Args:
        alpha: gain α at t_k.
        sigma: sliding variable σ, rad/s.
        mu: |σ| above which the gain grows, below which it falls, rad/s.
        rate: speed of the adaptation.
        floor: smallest gain.
        floor_rate: speed at which the gain leaves the floor.
        dt: tick length, s.
    """
    if alpha <= floor:
        return floor + dt * floor_rate
    return max(floor, alpha + dt * rate * sgn(abs(sigma) - mu))


@register("controller", "adaptive_super_twisting")
class AdaptiveSuperTwisting(AccelerationLaw):
    """Adaptive super-twisting: v = ẍ_r - c ė - α |σ|^½ sgn σ - η, η̇ = εα sgn σ (Shtessel et al. 2012).

    σ = ė + c e; α̇ = ω sgn(|σ| - μ), not below the floor α_m. No bound of the disturbance or of its rate is
    asked for: the gain grows until |σ| <= μ, and falls while it is more than enough. σ comes near |σ| <= μ in
    finite time and stays near it, and α stays bounded. When a disturbance begins anew after a quiet time, the
    error is large until α has grown again.

    Held over ticks the law itself makes σ ripple, by about (α dt/2)². Where that, or the noise of the
    measurement, is more than μ, the gain grows without end: the default allows α up to 63 at 1 kHz, and exact
    sensors.
    """

    c: float = param(
        2.0, unit="1/s", above=0.0, per_joint=True, doc="slope c of the linear surface", source="Table 1"
    )
    alpha_start: float = param(
        16.0,
        unit="(rad/s)^½/s",
        above=0.0,
        per_joint=True,
        doc="gain α at the start",
        source="chosen: Υ1 of Table 1",
    )
    alpha_floor: float = param(
        4.0,
        unit="(rad/s)^½/s",
        above=0.0,
        per_joint=True,
        doc="smallest gain α_m",
        source="Shtessel et al. (2012); value chosen",
    )
    epsilon: float = param(
        2.0,
        unit="(rad/s)^½/s",
        above=0.0,
        per_joint=True,
        doc="ratio ε of the integral gain to α",
        source="Shtessel et al. (2012), β = 2εα; value chosen",
    )
    omega: float = param(
        100.0,
        unit="(rad/s)^½/s²",
        above=0.0,
        per_joint=True,
        doc="speed ω of the adaptation",
        source="Shtessel et al. (2012), ω1 (γ1/2)^½; value chosen",
    )
    floor_rate: float = param(
        1.0,
        unit="(rad/s)^½/s²",
        above=0.0,
        per_joint=True,
        doc="speed at which α leaves its floor",
        source="Shtessel et al. (2012); value chosen",
    )
    mu: float = param(
        1e-3,
        unit="rad/s",
        above=0.0,
        per_joint=True,
        doc="|σ| up to which the gain is enough",
        source="Shtessel et al. (2012); value chosen: above the ripple of a sampled law",
    )

    def init(self, joints: int) -> State:
        """η = 0, and α at its start."""
        return tuple([(0.0, p.alpha_start) for p in joint_parameters(self, joints)])

    @staticmethod
    def surface(p: AdaptiveSuperTwisting, e: float, de: float) -> float:
        """σ = ė + c e (rad/s)."""
        return de + p.c * e

    @staticmethod
    def law(p: AdaptiveSuperTwisting, e: float, de: float, dt: float, s: Vector) -> tuple[float, Vector]:
        """-c ė - α |σ|^½ sgn σ - η; then η and α advance."""
        eta, alpha = s
        sigma = AdaptiveSuperTwisting.surface(p, e, de)
        u_r, eta = super_twisting(sigma, eta, alpha, p.epsilon * alpha, dt)
        return -p.c * de - u_r, (
            eta,
            adapted(alpha, sigma, p.mu, p.omega, p.alpha_floor, p.floor_rate, dt),
        )
