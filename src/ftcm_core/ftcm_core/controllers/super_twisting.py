# SPDX-License-Identifier: Apache-2.0
"""Super-twisting reaching law (eq 33) and its gain condition (eq 34)."""

from __future__ import annotations

import math

from ftcm_core.numeric import sgn, sig


def super_twisting(
    sigma: float, eta: float, upsilon1: float, upsilon2: float, dt: float
) -> tuple[float, float]:
    """u_r = Υ1 |σ|^½ sgn σ + η, η̇ = +Υ2 sgn σ (eq 33 with its sign corrected), forward Euler.

    Args:
        sigma: sliding variable σ, rad/s.
        eta: integral term η at t_k, rad/s².
        upsilon1: gain Υ1, (rad/s)^½/s.
        upsilon2: gain Υ2, rad/s³.
        dt: tick length, s.

    Returns:
        u_r at t_k, rad/s², to be subtracted from the commanded acceleration; and η at t_{k+1}.
    """
    return upsilon1 * sig(sigma, 0.5) + eta, eta + dt * upsilon2 * sgn(sigma)


def implicit_super_twisting(
    sigma: float, eta: float, upsilon1: float, upsilon2: float, dt: float, h: float
) -> tuple[float, float]:
    """u_r = Υ1 |z|^½ sgn z + 2 h Υ2 ξ + η, η⁺ = η + dt Υ2 ξ, z + h Υ1 |z|^½ sgn z + h² Υ2 ξ = σ, ξ ∈ Sgn z.

    Backward Euler of eq 33 in closed loop: with σ⁺ = σ + dt (w - u_r) and h = dt, z and ζ = w - η follow
    z⁺ = z + h (ζ⁺ - Υ1 |z⁺|^½ sgn z⁺), ζ⁺ = ζ + Δw - h Υ2 Sgn z⁺, and σ = z + h ζ.

    Args:
        sigma: sliding variable σ at t_k, rad/s.
        eta: integral term η at t_k, rad/s².
        upsilon1: gain Υ1, (rad/s)^½/s.
        upsilon2: gain Υ2, rad/s³.
        dt: tick length, s.
        h: step of the backward Euler method, s; at least dt.

    Returns:
        u_r, rad/s², to be subtracted from the commanded acceleration; and η at t_{k+1}.
    """
    rest = abs(sigma) - h * h * upsilon2
    if rest <= 0.0:  # z = 0: the set-valued sign takes whatever value is needed
        return eta + 2.0 * sigma / h, eta + dt * sigma / (h * h)
    # The positive root of z + h Υ1 z^½ = rest, for z^½.
    root = 2.0 * rest / (h * upsilon1 + math.sqrt(h * h * upsilon1 * upsilon1 + 4.0 * rest))
    sign = sgn(sigma)
    return (upsilon1 * root + 2.0 * h * upsilon2) * sign + eta, eta + dt * upsilon2 * sign


def least_upsilon2(upsilon1: float, pi: float) -> float:
    """Smallest Υ2 that eq 34 allows: Υ1 (5 Π Υ1 + 4 Π²) / (2 (Υ1 - 2 Π)); infinite unless Υ1 > 2 Π.

    Args:
        upsilon1: gain Υ1.
        pi: bound Π of the estimation error, |Δ̃| <= Π |σ|^½.
    """
    if upsilon1 <= 2.0 * pi:
        return math.inf
    return upsilon1 * (5.0 * pi * upsilon1 + 4.0 * pi * pi) / (2.0 * (upsilon1 - 2.0 * pi))


def gain_condition(upsilon1: float, upsilon2: float, pi: float) -> bool:
    """Whether the gains meet eq 34 for the bound Π: Υ1 > 2 Π and Υ2 > least_upsilon2."""
    return upsilon2 > least_upsilon2(upsilon1, pi)


def largest_bound(upsilon1: float, upsilon2: float) -> float:
    """Largest Π for which the gains meet eq 34, by solving it for Π.

    Args:
        upsilon1: gain Υ1 > 0.
        upsilon2: gain Υ2 > 0.
    """
    # 4 Υ1 Π² + (5 Υ1² + 4 Υ2) Π - 2 Υ1 Υ2 = 0, positive root.
    a, b, c = 4.0 * upsilon1, 5.0 * upsilon1 * upsilon1 + 4.0 * upsilon2, -2.0 * upsilon1 * upsilon2
    return 2.0 * -c / (b + math.sqrt(b * b - 4.0 * a * c))
