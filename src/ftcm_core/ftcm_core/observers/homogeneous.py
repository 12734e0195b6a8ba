# SPDX-License-Identifier: Apache-2.0
"""The second-order differentiator of Levant (2003), by which two of the observers correct their estimates.

A. Levant, "Higher-order sliding modes, differentiation and output-feedback control", Int. J. Control 76
(2003) 924-941. Its gains, in the form without recursion, and the explicit discrete form with the terms of
Taylor's series: M. Livne, A. Levant, "Proper discretization of homogeneous differentiators", Automatica
50 (2014) 2007-2014. Implicit forms of such differentiators: M. R. Mojallizadeh, B. Brogliato, V. Acary,
"Time-discretizations of differentiators: design of implicit algorithms and comparative analysis", Int. J.
Robust Nonlinear Control 31 (2021) 7679-7723.
"""

from __future__ import annotations

from typing import Any

from ftcm_core.numeric import sgn, sig
from ftcm_core.observers.position_observer import predict
from ftcm_core.params import param

GAIN0, GAIN1, GAIN2 = 2.0, 2.12, 1.1
"""Factors of L^(1/3), L^(2/3) and L."""
ITERATIONS = 60
"""Most steps of Newton's method, which needs about 6."""


def discretisation() -> Any:
    """Declare the parameter that chooses between the two discrete forms of a sliding-mode observer."""
    return param(
        "explicit",
        unit="-",
        choices=("explicit", "implicit"),
        doc="explicit: the error of the tick corrects; implicit: the one that is left, by backward Euler",
        source="explicit: Livne and Levant (2014); implicit: docs/observers.md",
    )


def differentiate(
    lipschitz: float, x1: float, x2: float, x3: float, a: float, q: float, dt: float
) -> tuple[float, float, float]:
    """ẋ1 = x2 - 2 L^⅓ |s|^⅔ sgn s, ẋ2 = a + x3 - 2.12 L^⅔ |s|^⅓ sgn s, ẋ3 = -1.1 L sgn s, s = x1 - q.

    Explicit: what is known moves on exactly over a tick, then the current measurement corrects.

    Args:
        lipschitz: L, bound of the rate of the acceleration that is not a, rad/s³.
        x1: position at t_{k-1}, rad.
        x2: velocity, rad/s.
        x3: acceleration that is not a, rad/s².
        a: known acceleration over the tick, rad/s².
        q: measured position at t_k, rad.
        dt: tick length, s.

    Returns:
        The three estimates at t_k.
    """
    root = lipschitz ** (1.0 / 3.0)
    x1, x2 = predict(x1, x2, x3, a, dt)
    s = x1 - q
    return (
        x1 - dt * GAIN0 * root * sig(s, 2.0 / 3.0),
        x2 - dt * GAIN1 * root * root * sig(s, 1.0 / 3.0),
        x3 - dt * GAIN2 * lipschitz * sgn(s),
    )


def differentiate_implicit(
    lipschitz: float, x1: float, x2: float, x3: float, a: float, q: float, dt: float
) -> tuple[float, float, float]:
    """As :func:`differentiate`, corrected by the error z that the correction leaves: backward Euler.

    With s the predicted error, z + dt g0 |z|^⅔ sgn z + dt² g1 |z|^⅓ sgn z + dt³ g2 ξ = s, ξ ∈ Sgn z: where
    |s| <= dt³ g2 nothing is left, and no sign chatters.

    Args:
        lipschitz: see :func:`differentiate`.
        x1: see :func:`differentiate`.
        x2: see :func:`differentiate`.
        x3: see :func:`differentiate`.
        a: see :func:`differentiate`.
        q: see :func:`differentiate`.
        dt: see :func:`differentiate`.

    Returns:
        The three estimates at t_k.
    """
    root = lipschitz ** (1.0 / 3.0)
    g0, g1, g2 = GAIN0 * root, GAIN1 * root * root, GAIN2 * lipschitz
    x1, x2 = predict(x1, x2, x3, a, dt)
    s = x1 - q
    rest = abs(s) - dt * dt * dt * g2
    if rest <= 0.0:
        return q, x2 - s / dt, x3 - s / (dt * dt)
    y = rest ** (1.0 / 3.0)  # y = |z|^⅓: Newton from above, where the cubic is convex
    for _ in range(ITERATIONS):
        f = y * (y * (y + dt * g0) + dt * dt * g1) - rest
        following = y - f / (y * (3.0 * y + 2.0 * dt * g0) + dt * dt * g1)
        if not 0.0 < following < y:  # as near as floats come
            break
        y = following
    sign = sgn(s)
    return q + y * y * y * sign, x2 - dt * (g1 * y + dt * g2) * sign, x3 - dt * g2 * sign
