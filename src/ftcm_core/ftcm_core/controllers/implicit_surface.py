# SPDX-License-Identifier: Apache-2.0
"""The surface of eq 8 in discrete time: its resolvent and the backward-Euler form of its terminal part."""

from __future__ import annotations

from ftcm_core.numeric import logistic

ITERATIONS = 30
"""Most steps of the solver; it needs about 6 (each halves the bracket at worst)."""


def resolvent(
    x: float, h: float, gamma1: float, gamma2: float, mu1: float, mu2: float, alpha: float, phi: float
) -> tuple[float, float]:
    """Solve y + h g(y) = x for y; g(e) = σ - ė of eq 8 is then g_h(x) = g(y).

    Args:
        x: position error, rad.
        h: step of the backward Euler method, s.
        gamma1: linear gain γ1, 1/s.
        gamma2: terminal gain γ2, rad^(1-α)/s.
        mu1: sharpness μ1, 1/rad.
        mu2: sharpness μ2, 1/rad.
        alpha: terminal exponent α in (0, 1).
        phi: error φ at which the two terms change roles, rad.

    Returns:
        y (rad) and g(y) (rad/s), both of the sign of x.
    """
    b = abs(x)
    if b == 0.0:
        return 0.0, 0.0
    # In s = |y|^α the equation is smooth at zero; its root lies in [low, high].
    r = 1.0 / alpha
    low, high = 0.0, float(b**alpha)
    s = min(high, b / (2.0 * h * gamma2 * logistic(mu2 * phi)))
    y = g = 0.0
    for _ in range(ITERATIONS):
        y = float(s**r)
        w1 = logistic(mu1 * (y - phi))
        w2 = logistic(-mu2 * (y - phi))
        g = 2.0 * gamma1 * w1 * y + 2.0 * gamma2 * w2 * s
        f = y + h * g - b
        if f > 0.0:
            high = s
        elif f < 0.0:
            low = s
        else:
            break
        dy = r * y / s
        slope = dy * (
            1.0
            + h
            * (
                2.0 * gamma1 * w1 * (1.0 + mu1 * (1.0 - w1) * y)
                - 2.0 * gamma2 * mu2 * w2 * (1.0 - w2) * s
            )
        ) + 2.0 * h * gamma2 * w2
        following = s - f / slope
        if not low <= following <= high:
            following = 0.5 * (low + high)
        if following == s:
            break
        s = following
    return (y, g) if x > 0.0 else (-y, -g)
