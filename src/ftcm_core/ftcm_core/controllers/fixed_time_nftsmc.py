# SPDX-License-Identifier: Apache-2.0
"""Fixed-time non-singular terminal sliding mode control, a baseline."""

from __future__ import annotations

import math

from ftcm_core.controllers import AccelerationLaw
from ftcm_core.errors import ParameterError
from ftcm_core.numeric import sat, sgn, sig
from ftcm_core.params import param, per_joint
from ftcm_core.registry import register
from ftcm_core.signals import Vector


def fixed_time_surface(
    e: float, de: float, alpha1: float, beta1: float, m1: float, r1: float
) -> tuple[float, float, float]:
    """σ = e + |w|^(1/r1) sgn w with w = ė/g, g = α1 |e|^(m1-r1) + β1.

    On σ = 0 the error follows ė = -α1 |e|^m1 sgn e - β1 |e|^r1 sgn e.

    Args:
        e: tracking error, rad.
        de: velocity error, rad/s.
        alpha1: gain far from zero, rad^(1-m1)/s.
        beta1: gain near zero, rad^(1-r1)/s.
        m1: exponent far from zero, above 1.
        r1: exponent near zero, in (1/2, 1).

    Returns:
        σ (rad), w and g.
    """
    g = alpha1 * abs(e) ** (m1 - r1) + beta1
    w = de / g
    return e + sig(w, 1.0 / r1), w, float(g)


def fixed_time_feedback(
    e: float,
    de: float,
    alpha1: float,
    beta1: float,
    m1: float,
    r1: float,
    alpha2: float,
    beta2: float,
    m2: float,
    r2: float,
    tau: float,
) -> float:
    """Feedback acceleration that makes σ̇ = -μ (α2 |σ|^m2 + β2 |σ|^r2) sgn σ, rad/s².

    The factor by which the acceleration acts on σ̇ is x/(r1 g), x = |w|^(1/r1-1), zero at ė = 0. Dividing
    by it would be singular, so the reaching law gets the factor μ = sin(π x/(2τ)) for x < τ, else 1.

    Args:
        e: tracking error, rad.
        de: velocity error, rad/s.
        alpha1: as of :func:`fixed_time_surface`, as are the next three.
        beta1: gain near zero.
        m1: exponent far from zero.
        r1: exponent near zero.
        alpha2: reaching gain far from the surface, rad^(1-m2)/s.
        beta2: reaching gain near the surface, rad^(1-r2)/s.
        m2: reaching exponent far from the surface, above 1.
        r2: reaching exponent near the surface, in (0, 1).
        tau: width τ of the region in which the reaching law is weakened.
    """
    sigma, w, g = fixed_time_surface(e, de, alpha1, beta1, m1, r1)
    x = abs(w) ** (1.0 / r1 - 1.0)
    if x >= tau:
        gain = 1.0 / x
    elif x > 0.0:
        gain = math.sin(0.5 * math.pi * x / tau) / x
    else:
        gain = 0.5 * math.pi / tau
    slope = alpha1 * (m1 - r1) * abs(e) ** (m1 - r1 - 1.0) * sgn(e)
    reaching = alpha2 * sig(sigma, m2) + beta2 * sig(sigma, r2)
    return float(-r1 * g * g * sig(w, 2.0 - 1.0 / r1) + slope * de * de / g - r1 * g * gain * reaching)


def fixed_time(alpha: float, beta: float, m: float, r: float) -> float:
    """1/(α(m-1)) + 1/(β(1-r)), s: within it ẋ = -α |x|^m sgn x - β |x|^r sgn x is at zero from anywhere.

    Args:
        alpha: gain of the large exponent.
        beta: gain of the small exponent.
        m: exponent above 1.
        r: exponent in (0, 1).
    """
    far, near = alpha * (m - 1.0), beta * (1.0 - r)
    return (
        1.0 / far + 1.0 / near if far > 0.0 and near > 0.0 else math.inf
    )  # they may be too small for a float


@register("controller", "fixed_time_nftsmc")
class FixedTimeNFTSMC(AccelerationLaw):
    """Fixed-time NFTSMC: v = ẍ_r + a - (Σ + ξ) sat(σ/Φ), σ = e + |κ ė|^(1/r1) sgn ė (Zuo 2015).

    1/κ = α1 |e|^(m1-r1) + β1, and a makes σ̇ = -μ (α2 |σ|^m2 + β2 |σ|^r2) sgn σ. The error vanishes within a
    time that is the same for all initial errors: at most 1/(α2(m2-1)) + 1/(β2(1-r2)) until σ = 0, then at
    most 1/(α1(m1-1)) + 1/(β1(1-r1)). On top comes the passage through |κ ė|^(1/r1-1) < τ, where μ < 1 keeps
    the torque finite; it is short. With Φ = 0 a disturbance of |d| < Σ + ξ changes nothing of this; a layer
    leaves |e| <= Φ |d|/(Σ + ξ).

    Held over ticks, "all" ends where dt α m |x|^(m-1) comes near 1: beyond, the torque overshoots and the run
    diverges, as for any law with an exponent above 1. What Φ = 0 leaves is of the order of dt.
    """

    alpha1: float = param(
        2.0,
        unit="rad^(1-m1)/s",
        above=0.0,
        per_joint=True,
        doc="surface gain α1, far from zero",
        source="Zuo (2015); value chosen: γ1 of Table 1",
    )
    beta1: float = param(
        2.0,
        unit="rad^(1-r1)/s",
        above=0.0,
        per_joint=True,
        doc="surface gain β1, near zero",
        source="Zuo (2015); value chosen: γ2 of Table 1",
    )
    m1: float = param(
        2.0,
        unit="-",
        above=1.0,
        per_joint=True,
        doc="surface exponent m1, far from zero",
        source="Zuo (2015); value chosen",
    )
    r1: float = param(
        0.7,
        unit="-",
        above=0.5,
        below=1.0,
        per_joint=True,
        doc="surface exponent r1, near zero",
        source="Zuo (2015); value chosen: the error vanishes within 2.2 s",
    )
    alpha2: float = param(
        2.0,
        unit="rad^(1-m2)/s",
        above=0.0,
        per_joint=True,
        doc="reaching gain α2, far from the surface",
        source="Zuo (2015); value chosen",
    )
    beta2: float = param(
        2.0,
        unit="rad^(1-r2)/s",
        above=0.0,
        per_joint=True,
        doc="reaching gain β2, near the surface",
        source="Zuo (2015); value chosen",
    )
    m2: float = param(
        2.0,
        unit="-",
        above=1.0,
        per_joint=True,
        doc="reaching exponent m2, far from the surface",
        source="Zuo (2015); value chosen",
    )
    r2: float = param(
        0.7,
        unit="-",
        above=0.0,
        below=1.0,
        per_joint=True,
        doc="reaching exponent r2, near the surface",
        source="Zuo (2015); value chosen",
    )
    tau: float = param(
        0.3,
        unit="-",
        above=0.0,
        per_joint=True,
        doc="width τ of the region around ė = 0 in which the reaching law is weakened",
        source="Zuo (2015); value chosen: less raises the first torque",
    )
    sigma_gain: float = param(
        20.0,
        unit="rad/s²",
        at_least=0.0,
        per_joint=True,
        doc="switching gain Σ, bound of Δ",
        source="Zuo (2015); value chosen: as for nftsmc, Table 1",
    )
    xi: float = param(
        0.01,
        unit="rad/s²",
        at_least=0.0,
        per_joint=True,
        doc="margin ξ on the switching gain",
        source="chosen: as for nftsmc, Table 1",
    )
    layer: float = param(
        0.005,
        unit="rad",
        at_least=0.0,
        per_joint=True,
        doc="half-width Φ of a boundary layer; 0: the sign, as published",
        source="chosen: the sign itself chatters",
    )

    def check(self) -> None:
        """The surface's rate is bounded at e = 0 for m1 - r1 > 1 only (Zuo 2015)."""
        joints = max(len(x) if isinstance(x, tuple) else 1 for x in (self.m1, self.r1))
        for m1, r1 in zip(per_joint(self.m1, joints), per_joint(self.r1, joints)):
            if not m1 - r1 > 1.0:
                raise ParameterError(f"m1: m1 - r1 = {m1:g} - {r1:g} is out of range; expected above 1")

    @staticmethod
    def surface(p: FixedTimeNFTSMC, e: float, de: float) -> float:
        """σ = e + |κė|^(1/r1) sgn ė (rad)."""
        return fixed_time_surface(e, de, p.alpha1, p.beta1, p.m1, p.r1)[0]

    @staticmethod
    def law(p: FixedTimeNFTSMC, e: float, de: float, dt: float, s: Vector) -> tuple[float, Vector]:
        """The fixed-time feedback, and -(Σ + ξ) sat(σ/Φ)."""
        surface = (p.alpha1, p.beta1, p.m1, p.r1)
        feedback = fixed_time_feedback(e, de, *surface, p.alpha2, p.beta2, p.m2, p.r2, p.tau)
        return feedback - (p.sigma_gain + p.xi) * sat(FixedTimeNFTSMC.surface(p, e, de), p.layer), s

    def settling_time_bound(self, e0: float, joint: int) -> float:
        """Time on the surface from any error to zero, s; the time to reach it is bounded alike."""
        del e0
        p = self.for_joint(joint)
        return fixed_time(p.alpha1, p.beta1, p.m1, p.r1)
