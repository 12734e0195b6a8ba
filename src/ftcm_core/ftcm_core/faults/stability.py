# SPDX-License-Identifier: Apache-2.0
"""Whether a torque that answers to the motion, but is held over each tick, is stable on a robot.

Spring and damper K, D at the joints, M q̈ = -(K q + D q̇), the torque held over ticks of dt: eliminating the
velocity, and with the shift operator z = (1 + s) / (1 - s), the ticks obey

    4 (M - dt D / 2) s² + (2 dt D - dt² K) s + dt² K = 0.

That is stable if M - dt D / 2 and D - dt K / 2 are positive definite (constant M, diagonal K and D); for one
joint, only then. Faults are held to half of both limits.
"""

from __future__ import annotations

import functools
import math

from ftcm_core.random_streams import uniform
from ftcm_core.robots import Robot
from ftcm_core.signals import Vector

CONFIGURATIONS = 16
"""At how many joint positions the inertia is looked at: zero, and others drawn once for all."""


def steepness(robot: Robot, damping: Vector) -> float:
    """Bound of the eigenvalues of M(q)^-1 D, 1/s: its largest row sum; infinite where M is no inertia.

    Args:
        robot: the robot.
        damping: diagonal of D, N·m·s/rad.
    """
    return max(
        [sum([abs(x) * d for x, d in zip(row, damping)]) for m in inverse_inertias(robot) for row in m],
    )


@functools.lru_cache(maxsize=32)
def inverse_inertias(robot: Robot) -> tuple[tuple[Vector, ...], ...]:
    """Return M(q)^-1 at each of the joint positions, 1/(kg·m²)."""
    n = robot.joints
    found = []
    for k in range(CONFIGURATIONS):
        q = tuple(
            [0.0 if k == 0 else math.pi * (2.0 * uniform(0.0, float(k * n + j)) - 1.0) for j in range(n)]
        )
        try:
            columns = [
                robot.inertia_acceleration(q, tuple([float(i == j) for i in range(n)])) for j in range(n)
            ]
        except (ArithmeticError, ValueError):
            columns = [(math.inf,) * n] * n
        found.append(tuple(zip(*columns)))
    return tuple(found)
