# SPDX-License-Identifier: Apache-2.0
"""The paper's fast terminal sliding surface: σ (eq 8), its rate (eq 17), its settling time (eqs 13-15)."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from typing import Any

from ftcm_core.controllers import AccelerationLaw
from ftcm_core.numeric import logistic, sgn
from ftcm_core.params import param


def surface_and_rate(
    e: float,
    de: float,
    gamma1: float,
    gamma2: float,
    mu1: float,
    mu2: float,
    alpha: float,
    phi: float,
    epsilon: float,
) -> tuple[float, float]:
    """σ = ė + 2γ1/(1+E^(-μ1(|e|-φ))) e + 2γ2/(1+E^(μ2(|e|-φ))) |e|^α sgn e (eq 8), and S = σ̇ - ë (eq 17).

    The paper's S is singular at e = 0: there |e|^(α-1) is taken at max(|e|, ε), which removes that.

    Args:
        e: tracking error, rad.
        de: velocity error, rad/s.
        gamma1: linear gain γ1, 1/s.
        gamma2: terminal gain γ2, rad^(1-α)/s.
        mu1: sharpness μ1 of the linear term's weight, 1/rad.
        mu2: sharpness μ2 of the terminal term's weight, 1/rad.
        alpha: terminal exponent α in (0, 1).
        phi: error φ at which the two terms change roles, rad.
        epsilon: smallest |e| at which the terminal slope is evaluated, rad.

    Returns:
        Sliding variable σ, rad/s, and its rate without the acceleration error, S(e, ė), rad/s².
    """
    z = abs(e)
    w1 = logistic(mu1 * (z - phi))
    w2 = logistic(-mu2 * (z - phi))
    power = float(z**alpha)
    slope = (
        2.0 * gamma1 * w1
        + 2.0 * gamma1 * mu1 * w1 * (1.0 - w1) * z
        + 2.0 * gamma2 * alpha * w2 * max(z, epsilon) ** (alpha - 1.0)
        - 2.0 * gamma2 * mu2 * w2 * (1.0 - w2) * power
    )
    return de + 2.0 * gamma1 * w1 * e + 2.0 * gamma2 * w2 * power * sgn(e), float(slope) * de


def switch_error(gamma1: float, gamma2: float, alpha: float) -> float:
    """φ = (γ2/γ1)^(1/(1-α)), rad (below eq 8); in logarithms, which no gains overflow."""
    exponent = (math.log(gamma2) - math.log(gamma1)) / (1.0 - alpha)
    return math.exp(max(-700.0, min(700.0, exponent)))


def settling_time_bound(e0: float, gamma1: float, gamma2: float, alpha: float) -> float:
    """T_s < (ln|e0| - ln φ)/γ1 + φ^(1-α)/(γ2(1-α)), the time on σ = 0 from e0 to zero (eqs 13-15).

    For |e0| <= φ only the second phase remains, from |e0| instead of φ.

    Args:
        e0: tracking error when the surface is reached, rad.
        gamma1: linear gain γ1, 1/s.
        gamma2: terminal gain γ2, rad^(1-α)/s.
        alpha: terminal exponent α.

    Returns:
        Upper bound, s. The time to reach the surface comes on top (T <= T_r + T_s).
    """
    phi = switch_error(gamma1, gamma2, alpha)
    z = abs(e0)
    rate = gamma2 * (1.0 - alpha)
    second = float(min(z, phi) ** (1.0 - alpha)) / rate if rate > 0.0 else math.inf
    return ((math.log(z) - math.log(phi)) / gamma1 if z > phi else 0.0) + second


@dataclass(frozen=True, kw_only=True)
class TerminalSurfaceLaw(AccelerationLaw):
    """The surface's parameters and σ, shared by the laws built on it."""

    gamma1: float = param(2.0, unit="1/s", above=0.0, per_joint=True, doc="linear gain γ1", source="Table 1")
    gamma2: float = param(
        2.0, unit="rad^(1-α)/s", above=0.0, per_joint=True, doc="terminal gain γ2", source="Table 1"
    )
    mu1: float = param(
        1.2,
        unit="1/rad",
        above=0.0,
        per_joint=True,
        doc="sharpness μ1 of the linear term's weight",
        source="Table 1",
    )
    mu2: float = param(
        1.4,
        unit="1/rad",
        above=0.0,
        per_joint=True,
        doc="sharpness μ2 of the terminal term's weight",
        source="Table 1",
    )
    alpha: float = param(
        0.6, unit="-", above=0.0, below=1.0, per_joint=True, doc="terminal exponent α", source="Table 1"
    )
    epsilon: float = param(
        1e-4,
        unit="rad",
        above=0.0,
        at_most=0.1,
        per_joint=True,
        doc="smallest |e| in the terminal slope |e|^(α-1)",
        source="chosen: eq 17 is singular at e = 0; only the torque variation depends on it",
    )

    @cached_property
    def phi(self) -> float:
        """φ = (γ2/γ1)^(1/(1-α)) of one joint, rad: derived, Table 1's φ = 1 follows from γ1 = γ2."""
        return switch_error(self.gamma1, self.gamma2, self.alpha)

    @staticmethod
    def surface_and_rate(p: Any, e: float, de: float) -> tuple[float, float]:
        """σ of eq 8 and S(e, ė) of eq 17."""
        return surface_and_rate(e, de, p.gamma1, p.gamma2, p.mu1, p.mu2, p.alpha, p.phi, p.epsilon)

    @staticmethod
    def surface(p: Any, e: float, de: float) -> float:
        """σ of eq 8."""
        return TerminalSurfaceLaw.surface_and_rate(p, e, de)[0]

    def settling_time_bound(self, e0: float, joint: int) -> float:
        """T_s of eq 15 for one joint, s."""
        p = self.for_joint(joint)
        return settling_time_bound(e0, p.gamma1, p.gamma2, p.alpha)
