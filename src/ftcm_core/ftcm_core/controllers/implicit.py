# SPDX-License-Identifier: Apache-2.0
"""The proposed law in discrete time, by backward Euler; derived in docs/discretisation.md."""

from __future__ import annotations

from typing import Any

from ftcm_core.controllers.super_twisting import implicit_super_twisting
from ftcm_core.numeric import logistic
from ftcm_core.signals import Vector

ITERATIONS = 60
"""Most steps of the solver, enough to bisect down to a float; Newton needs about 5."""
ROUNDING = 2.0**-51
"""Relative residual at which an equation counts as solved."""


def implicit_law(p: Any, e: float, de: float, dt: float, s: Vector) -> tuple[float, Vector]:
    """A = -(g_h(x) - g_h(x⁻))/dt - u_r with x = e + dt ė/2, x⁻ = e - dt ė/2 and u_r of s = ė + g_h(x⁻).

    With a and the disturbance w held over the tick, x and s follow exactly
    x_{k+1} = x_k + dt (s_{k+1} - g_h(x_k)) and s_{k+1} = s_k + dt (w_k - u_r).

    Args:
        p: parameters of one joint.
        e: tracking error at t_k, rad.
        de: velocity error at t_k, rad/s.
        dt: tick length, s.
        s: the integral term η, rad/s².

    Returns:
        Feedback acceleration, rad/s², and η at t_{k+1}.
    """
    h = p.horizon * dt
    half = 0.5 * dt * de
    _, g = resolvent(e + half, h, p.gamma1, p.gamma2, p.mu1, p.mu2, p.alpha, p.phi)
    _, g_before = resolvent(e - half, h, p.gamma1, p.gamma2, p.mu1, p.mu2, p.alpha, p.phi)
    u_r, eta = implicit_super_twisting(de + g_before, s[0], p.upsilon1, p.upsilon2, dt, h)
    return -(g - g_before) / dt - u_r, (eta,)


def resolvent(
    x: float, h: float, gamma1: float, gamma2: float, mu1: float, mu2: float, alpha: float, phi: float
) -> tuple[float, float]:
    """Solve y + h g(y) = x, where g(e) = σ - ė of eq 8; then g_h(x) = g(y) has slope below 1/h everywhere.

    Args:
        x: position error, rad.
        h: step of the backward Euler method, s.
        gamma1: linear gain γ1, 1/s.
        gamma2: terminal gain γ2, rad^(1-α)/s.
        mu1: sharpness μ1 of the linear term's weight, 1/rad.
        mu2: sharpness μ2 of the terminal term's weight, 1/rad.
        alpha: terminal exponent α in (0, 1).
        phi: error φ at which the two terms change roles, rad.

    Returns:
        y (rad) and g(y) (rad/s), both of the sign of x.
    """
    b = abs(x)
    # In s = |y|^α, f(s) = y + h g(y) - b is smooth at zero too; f(0) < 0 < f(b^α). Newton, else bisection.
    low, high = 0.0, float(b**alpha)
    s = min(high, b / (2.0 * h * gamma2 * logistic(mu2 * phi)))
    y = g = 0.0
    for _ in range(ITERATIONS):
        if alpha * s == 0.0:  # x is zero, or so small that s is
            break
        y = float(s ** (1.0 / alpha))
        w1 = logistic(mu1 * (y - phi))
        w2 = logistic(-mu2 * (y - phi))
        g = 2.0 * gamma1 * w1 * y + 2.0 * gamma2 * w2 * s
        f = y + h * g - b
        if abs(f) <= ROUNDING * b:
            break
        if f > 0.0:
            high = s
        else:
            low = s
        rate = 2.0 * gamma1 * w1 * (1.0 + mu1 * (1.0 - w1) * y) - 2.0 * gamma2 * mu2 * w2 * (1.0 - w2) * s
        following = s - f / ((1.0 + h * rate) * y / (alpha * s) + 2.0 * h * gamma2 * w2)
        if following == s:  # as near as floats come
            break
        s = following if low <= following <= high else 0.5 * (low + high)
    return (y, g) if x > 0.0 else (-y, -g)
