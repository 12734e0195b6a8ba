# SPDX-License-Identifier: Apache-2.0
"""Continuous terminal sliding mode control with a fast terminal reaching law, a baseline."""

from __future__ import annotations

from ftcm_core.controllers import AccelerationLaw
from ftcm_core.numeric import sig
from ftcm_core.params import param
from ftcm_core.registry import register
from ftcm_core.signals import Vector


def terminal_time(e0: float, beta: float, gamma: float) -> float:
    """Time that ė = -(|e|/β)^(1/γ) sgn e takes from |e0| to zero, s.

    Args:
        e0: initial error, rad.
        beta: β, rad·(s/rad)^γ.
        gamma: γ above 1.
    """
    return float(beta ** (1.0 / gamma) * abs(e0) ** (1.0 - 1.0 / gamma)) * gamma / (gamma - 1.0)


@register("controller", "continuous_tsmc")
class ContinuousTSMC(AccelerationLaw):
    """Continuous TSMC: v = ẍ_r - |ė|^(2-γ) sgn ė/(βγ) - k1 σ - k2 |σ|^ρ sgn σ (Yu et al. 2005).

    σ = e + β |ė|^γ sgn ė. Without disturbance σ and the error vanish in finite time, by a torque without
    jumps. A disturbance of |d| <= D leaves |σ| <= φ with k1 φ + k2 φ^ρ = D, hence |e| <= φ and
    |ė| <= (2φ/β)^(1/γ); a constant one leaves e = φ. Both powers are infinitely steep at zero, so a torque
    that is held over the tick ripples there.
    """

    beta: float = param(
        0.5,
        unit="rad·(s/rad)^γ",
        above=0.0,
        per_joint=True,
        doc="surface gain β",
        source="Yu et al. (2005); value chosen: 1/ϖ of nftsmc, Table 1",
    )
    gamma: float = param(
        5.0 / 3.0,
        unit="-",
        above=1.0,
        below=2.0,
        per_joint=True,
        doc="surface exponent γ",
        source="Yu et al. (2005); value chosen: l/q of nftsmc, Table 1",
    )
    k1: float = param(
        20.0,
        unit="1/s²",
        at_least=0.0,
        per_joint=True,
        doc="linear reaching gain k1",
        source="Yu et al. (2005); value chosen: more raises the first torque",
    )
    k2: float = param(
        100.0,
        unit="rad^(1-ρ)/s²",
        above=0.0,
        per_joint=True,
        doc="terminal reaching gain k2",
        source="Yu et al. (2005); value chosen: φ = 0.037 rad for D = 20",
    )
    rho: float = param(
        0.5,
        unit="-",
        above=0.0,
        below=1.0,
        per_joint=True,
        doc="reaching exponent ρ",
        source="Yu et al. (2005); value chosen: less ripples more",
    )

    @staticmethod
    def surface(p: ContinuousTSMC, e: float, de: float) -> float:
        """σ = e + β |ė|^γ sgn ė (rad)."""
        return e + p.beta * sig(de, p.gamma)

    @staticmethod
    def law(p: ContinuousTSMC, e: float, de: float, dt: float, s: Vector) -> tuple[float, Vector]:
        """-|ė|^(2-γ) sgn ė/(βγ) - k1 σ - k2 |σ|^ρ sgn σ."""
        sigma = ContinuousTSMC.surface(p, e, de)
        return -sig(de, 2.0 - p.gamma) / (p.beta * p.gamma) - p.k1 * sigma - p.k2 * sig(sigma, p.rho), s

    def settling_time_bound(self, e0: float, joint: int) -> float:
        """Time on σ = 0 from |e0| to zero: β^(1/γ) |e0|^(1-1/γ) γ/(γ-1), s."""
        p = self.for_joint(joint)
        return terminal_time(e0, p.beta, p.gamma)
