# SPDX-License-Identifier: Apache-2.0
"""Scalar helpers shared by the laws: plain floats in, plain floats out."""

from __future__ import annotations

import math


def sgn(x: float) -> float:
    """Sign of x: -1, 0 or 1."""
    if x > 0.0:
        return 1.0
    if x < 0.0:
        return -1.0
    return 0.0


def sig(x: float, a: float) -> float:
    """Signed power ``|x|^a sgn(x)`` for a > 0; zero at zero."""
    if x > 0.0:
        return float(x**a)
    if x < 0.0:
        return -float((-x) ** a)
    return 0.0


def logistic(x: float) -> float:
    """``1 / (1 + exp(-x))`` without overflow for any finite x."""
    if x >= 0.0:
        return 1.0 / (1.0 + math.exp(-x))
    z = math.exp(x)
    return z / (1.0 + z)


def clamp(x: float, bound: float) -> float:
    """Nearest number to x in [-bound, bound], for bound >= 0."""
    return max(-bound, min(bound, x))


def sat(x: float, width: float) -> float:
    """Sign of x, but x / width where that is within [-1, 1]; for a width of 0 the sign itself."""
    if width == 0.0:
        return sgn(x)
    return clamp(x / width, 1.0)


def select(condition: float, yes: float, no: float) -> float:
    """Return ``yes`` if the condition is not zero, else ``no``."""
    return yes if condition != 0.0 else no


def holds(condition: bool) -> bool:
    """Return the condition.

    A condition without which a run cannot go on is written so: a compiled tick checks it, and where it does
    not hold the tick is left to plain Python, which says why.
    """
    return condition
