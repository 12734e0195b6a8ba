# SPDX-License-Identifier: Apache-2.0
"""Residuals, one per file: what a healthy robot would keep near zero.

Each file has a function that takes what is seen in a tick and returns one number per joint. Which test then
looks at it is another question, see :mod:`ftcm_core.detectors.residual_detector`.
"""

from __future__ import annotations

from typing import NamedTuple

from ftcm_core.signals import Vector


class Seen(NamedTuple):
    """What a residual remembers of the tick before."""

    started: float
    """0 before the first measurement, then 1."""
    position: Vector
    """Measured positions, rad."""
    velocity: Vector
    """Measured velocities, rad/s."""
    residual: Vector
    """The residual."""


def nothing_seen(joints: int) -> Seen:
    """Return what is remembered before the first tick."""
    zero = (0.0,) * joints
    return Seen(0.0, zero, zero, zero)


def halfway(one: Vector, other: Vector) -> Vector:
    """Mean of two vectors."""
    return tuple([0.5 * (a + b) for a, b in zip(one, other)])
