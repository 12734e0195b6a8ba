# SPDX-License-Identifier: Apache-2.0
"""Compare Armstrong's closed form with any rigid-body model of the PUMA 560, its coefficients refitted.

M and G are linear in the coefficients. A fit without residual shows that the closed form has the right
structure; with the fitted values its code must then give that model's torques, velocity terms included.
"""

from __future__ import annotations

from typing import Protocol

import numpy as np
from numpy.testing import assert_allclose

import puma560_matrix
import robot_matrices
from ftcm_core.robots import puma560

Vector = np.ndarray


class Model(Protocol):
    """A rigid-body model, for q (rad), v (rad/s) and a (rad/s²); a module can be one."""

    def mass_matrix(self, q: Vector) -> np.ndarray:
        """Inertia matrix, kg·m²."""

    def gravity(self, q: Vector) -> Vector:
        """Gravity torque, N·m."""

    def inverse_dynamics(self, q: Vector, v: Vector, a: Vector) -> Vector:
        """Torque M a + C v + G, N·m."""


COEFFICIENTS = (
    "i3", "i4", "i9", "i11", "i12", "i13", "p", "q", "r", "s", "m11", "m22", "m23", "m33",
    "g1", "g3", "g4", "g35",
)  # fmt: skip
"""Names of :attr:`Puma560.coefficients`, in order; m11 to m33 are the constant parts of M."""


def basis(q: Vector) -> list[dict[str, float]]:
    """Factors of the coefficients in m11 m12 m13 m22 m23 m33, G1 G2 G3."""
    s2, c2, s3, c3 = np.sin(q[1]), np.cos(q[1]), np.sin(q[2]), np.cos(q[2])
    s23, c23 = np.sin(q[1] + q[2]), np.cos(q[1] + q[2])
    m11 = {"m11": 1.0, "i3": c2**2, "p": s23**2, "q": s23 * c23, "i11": s2 * c2}
    m13 = {"s": c23, "i13": s23}
    g3 = {"g35": s23, "g4": c23}
    return [
        m11 | {"r": 2 * c2 * s23, "i12": 2 * c2 * c23},
        m13 | {"i4": s2, "i9": c2},
        m13,
        {"m22": 1.0, "r": 2 * s3, "i12": 2 * c3},
        {"m23": 1.0, "r": s3, "i12": c3},
        {"m33": 1.0},
        {},
        g3 | {"g1": c2, "g3": s2},
        g3,
    ]


def refit(model: Model) -> tuple[dict[str, float], float]:
    """Least-squares coefficients of a model, by name, and the largest residual (kg·m², N·m)."""
    positions = np.random.default_rng(1).uniform(-np.pi, np.pi, (60, 3))
    rows = np.array([[row.get(name, 0.0) for name in COEFFICIENTS] for q in positions for row in basis(q)])
    upper = np.triu_indices(3)
    values = np.concatenate([[*model.mass_matrix(q)[upper], *model.gravity(q)] for q in positions])
    solution, _, rank, _ = np.linalg.lstsq(rows, values)
    assert rank == len(COEFFICIENTS), "the positions determine every coefficient"
    found = dict(zip(COEFFICIENTS, solution.tolist(), strict=True))
    return found, float(np.abs(rows @ solution - values).max())


def robot_with(coefficients: dict[str, float]) -> puma560.Puma560:
    """A robot whose explicit model has these coefficients."""
    robot = puma560.Puma560()
    vars(robot)["coefficients"] = tuple(coefficients[name] for name in COEFFICIENTS)
    return robot


def check(model: Model) -> None:
    """Assert that the matrix reference is the model, and that the refitted closed form is too."""
    coefficients, residual = refit(model)
    assert residual < 1e-12
    robot = robot_with(coefficients)
    scale = np.array([[np.pi], [5.0], [20.0]])  # rad, rad/s, rad/s²
    for sample in np.random.default_rng(7).uniform(-scale, scale, (100, 3, 3)):
        q, v, a = map(tuple, sample.tolist())
        torque = model.inverse_dynamics(*sample)
        h = model.inverse_dynamics(sample[0], sample[1], np.zeros(3)) - model.gravity(sample[0])
        assert_allclose(puma560_matrix.inverse_dynamics(*sample), torque, rtol=0, atol=1e-10)
        assert_allclose(robot.inverse_dynamics(q, v, a), torque, rtol=0, atol=1e-10)
        assert_allclose(robot_matrices.velocity_torque(robot, q, v), h, rtol=0, atol=1e-10)
        assert_allclose(robot.gravity(q), model.gravity(sample[0]), rtol=0, atol=1e-10)
        assert_allclose(robot.forward_dynamics(q, v, tuple(torque.tolist())), a, rtol=0, atol=1e-10)
