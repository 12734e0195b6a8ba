# SPDX-License-Identifier: Apache-2.0
"""Compare Armstrong's closed form with any rigid-body model of the PUMA 560, its coefficients refitted.

M and G are linear in the coefficients. A fit without residual shows that the closed form has the right
structure; with the fitted values its code must then give that model's torques, velocity terms included.
"""

from __future__ import annotations

from typing import Protocol

import numpy as np
import pytest
from numpy.testing import assert_allclose

import puma560_matrix
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


def basis(q: Vector) -> list[dict[str, float]]:
    """Factors of the constants of the ``puma560`` module in m11 m12 m13 m22 m23 m33, G1 G2 G3."""
    s2, c2, s3, c3 = np.sin(q[1]), np.cos(q[1]), np.sin(q[2]), np.cos(q[2])
    s23, c23 = np.sin(q[1] + q[2]), np.cos(q[1] + q[2])
    m11 = {"M11_CONSTANT": 1.0, "I3": c2**2, "P": s23**2, "Q": s23 * c23, "I11": s2 * c2}
    m13 = {"S": c23, "I13": s23}
    g3 = {"G35": s23, "G4": c23}
    return [
        m11 | {"R": 2 * c2 * s23, "I12": 2 * c2 * c23},
        m13 | {"I4": s2, "I9": c2},
        m13,
        {"M22_CONSTANT": 1.0, "R": 2 * s3, "I12": 2 * c3},
        {"M23_CONSTANT": 1.0, "R": s3, "I12": c3},
        {"M33": 1.0},
        {},
        g3 | {"G1": c2, "G3": s2},
        g3,
    ]


def refit(model: Model) -> tuple[dict[str, float], float]:
    """Least-squares constants of a model, by name, and the largest residual (kg·m², N·m)."""
    positions = np.random.default_rng(1).uniform(-np.pi, np.pi, (60, 3))
    names = sorted({name for row in basis(np.zeros(3)) for name in row})
    rows = np.array([[row.get(name, 0.0) for name in names] for q in positions for row in basis(q)])
    upper = np.triu_indices(3)
    values = np.concatenate([[*model.mass_matrix(q)[upper], *model.gravity(q)] for q in positions])
    solution, _, rank, _ = np.linalg.lstsq(rows, values)
    assert rank == len(names), "the positions determine every constant"
    return dict(zip(names, solution.tolist(), strict=True)), float(np.abs(rows @ solution - values).max())


def check(model: Model, monkeypatch: pytest.MonkeyPatch) -> None:
    """Assert that the matrix reference is the model, and that the refitted closed form is too."""
    constants, residual = refit(model)
    assert residual < 1e-12
    for name, value in constants.items():
        monkeypatch.setattr(puma560, name, value)
    robot = puma560.Puma560()
    scale = np.array([[np.pi], [5.0], [20.0]])  # rad, rad/s, rad/s²
    for sample in np.random.default_rng(7).uniform(-scale, scale, (100, 3, 3)):
        q, v, a = map(tuple, sample.tolist())
        torque = model.inverse_dynamics(*sample)
        h = model.inverse_dynamics(sample[0], sample[1], np.zeros(3)) - model.gravity(sample[0])
        assert_allclose(puma560_matrix.inverse_dynamics(*sample), torque, rtol=0, atol=1e-10)
        assert_allclose(robot.inverse_dynamics(q, v, a), torque, rtol=0, atol=1e-10)
        assert_allclose(robot.velocity_torque(q, v), h, rtol=0, atol=1e-10)
        assert_allclose(robot.forward_dynamics(q, v, tuple(torque.tolist())), a, rtol=0, atol=1e-10)
