# SPDX-License-Identifier: Apache-2.0
"""M, C and h of any robot, taken from its inverse dynamics: what the matrix forms of the tests are fed with.

Friction must be zero. h is quadratic in the velocity, so its polarisation is the symmetric bilinear form
whose matrix is C of the Christoffel symbols.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ftcm_core.robots import Robot
from ftcm_core.signals import Vector

Array = NDArray[np.float64]


def _vector(x: Array) -> Vector:
    return tuple(np.asarray(x, dtype=float).tolist())


def mass_matrix(robot: Robot, q: Vector) -> Array:
    """M(q), kg·m², by columns: torque of a unit acceleration at rest, less gravity."""
    n = len(q)
    rest, bias = (0.0,) * n, np.array(robot.gravity(q))
    return np.array([np.array(robot.inverse_dynamics(q, rest, _vector(e))) - bias for e in np.eye(n)]).T


def velocity_torque(robot: Robot, q: Vector, v: Vector) -> Array:
    """h(q, v) = C(q, v) v, N·m."""
    return np.array(robot.inverse_dynamics(q, v, (0.0,) * len(q))) - robot.gravity(q)


def coriolis_matrix(robot: Robot, q: Vector, v: Vector) -> Array:
    """C(q, v), N·m·s, by columns: (h(v + e) - h(v - e)) / 4."""
    columns = [
        velocity_torque(robot, q, _vector(v + e)) - velocity_torque(robot, q, _vector(v - e))
        for e in np.eye(len(q))
    ]
    return 0.25 * np.array(columns).T
