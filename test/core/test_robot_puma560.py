# SPDX-License-Identifier: Apache-2.0
"""PUMA 560: golden values, the mechanics every rigid-body model obeys, and a model from the link data."""

from __future__ import annotations

import math
import sys
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from ftcm_core.robots import puma560
from ftcm_core.signals import Vector

sys.path.insert(0, str(Path(__file__).parents[1] / "reference"))
import puma560_matrix
import puma560_refit

ROBOT = puma560.Puma560()
Q, V = (0.3, -0.4, 0.7), (0.5, -0.6, 0.8)

positions, velocities, accelerations = (
    st.tuples(*[st.floats(-bound, bound)] * 3) for bound in (2 * math.pi, 5.0, 20.0)
)


def test_golden_values() -> None:
    """M, h and G at one state, worked out once from the published constants."""
    m = ROBOT.mass_matrix(Q)
    assert (*m[0], *m[1][1:], m[2][2]) == pytest.approx(
        (3.94983693201, -0.376324265689, -0.129546861153, 7.25956909105, 0.567534545524, 1.1625), rel=1e-9
    )
    h = (-0.00228378896753, -0.327687419086, -0.207167254701)
    assert ROBOT.velocity_torque(Q, V) == pytest.approx(h, rel=1e-9)
    assert ROBOT.gravity(Q) == pytest.approx((0.0, -36.9253211143, -2.26464542826), rel=1e-9)


@given(positions)
def test_mass_matrix_is_symmetric_positive_definite(q: Vector) -> None:
    """Eigenvalues, kg·m²; over all configurations they span [1.08329, 7.75456]."""
    m = np.array(ROBOT.mass_matrix(q))
    assert np.array_equal(m, m.T)
    smallest, _, largest = np.linalg.eigvalsh(m)
    assert smallest > 1.083
    assert largest < 7.755


@given(positions, velocities)
def test_mass_rate_minus_twice_coriolis_is_skew(q: Vector, v: Vector) -> None:
    """Ṁ by central difference along v, which is good to 4e-9 (measured over 20,000 states)."""
    step = 1e-6
    ahead, behind = (ROBOT.mass_matrix(tuple(np.add(q, np.multiply(s, v)))) for s in (step, -step))
    difference = np.subtract(ahead, behind) / (2 * step) - 2 * np.array(ROBOT.coriolis_matrix(q, v))
    assert np.abs(difference + difference.T).max() < 2e-8


@given(positions, velocities, accelerations)
def test_inverse_dynamics_is_the_sum_of_its_terms(q: Vector, v: Vector, a: Vector) -> None:
    """M a + C v + G, each also from its own method."""
    inertial, h = np.array(ROBOT.mass_matrix(q)) @ a, np.array(ROBOT.coriolis_matrix(q, v)) @ v
    assert ROBOT.inertia_torque(q, a) == pytest.approx(inertial, abs=1e-12)
    assert ROBOT.velocity_torque(q, v) == pytest.approx(h, abs=1e-12)
    assert ROBOT.inverse_dynamics(q, v, a) == pytest.approx(inertial + h + ROBOT.gravity(q), abs=1e-12)


@given(positions, velocities, accelerations)
def test_forward_and_inverse_dynamics_undo_each_other(q: Vector, v: Vector, a: Vector) -> None:
    """So do inertia_acceleration and inertia_torque; M's condition number is 7.2 at most."""
    assert ROBOT.forward_dynamics(q, v, ROBOT.inverse_dynamics(q, v, a)) == pytest.approx(a, abs=1e-11)
    assert ROBOT.inertia_acceleration(q, ROBOT.inertia_torque(q, a)) == pytest.approx(a, abs=1e-12)


def energy(q: Vector, v: Vector) -> float:
    """Half vᵀ M v plus the potential whose slopes are G2 (by q2) and G3 (by q3), J."""
    s2, c2, _, _, s23, c23 = puma560.trigonometry(q)
    potential = puma560.G1 * s2 - puma560.G3 * c2 - puma560.G35 * c23 + puma560.G4 * s23
    return 0.5 * float(np.dot(v, ROBOT.inertia_torque(q, v))) + potential


@pytest.mark.parametrize("amplitude", [0.0, 40.0], ids=["passive", "driven"])
def test_energy_changes_by_the_work_done(amplitude: float) -> None:
    """Two seconds of RK4 at 1 kHz under random steps of torque (N·m), the work integrated with the motion."""
    torques, dt = np.random.default_rng(3).uniform(-amplitude, amplitude, (20, 3)), 1e-3

    def rate(x: np.ndarray, tau: np.ndarray) -> np.ndarray:
        return np.array(
            [*x[3:6], *ROBOT.forward_dynamics(tuple(x[:3]), tuple(x[3:6]), tuple(tau)), tau @ x[3:6]]
        )

    x = np.array([*Q, *V, 0.0])
    for tau in np.repeat(torques, 100, axis=0):
        k1 = rate(x, tau)
        k2 = rate(x + dt / 2 * k1, tau)
        k3 = rate(x + dt / 2 * k2, tau)
        k4 = rate(x + dt * k3, tau)
        x = x + dt / 6 * (k1 + 2 * k2 + 2 * k3 + k4)
    assert np.abs(x[:3] - Q).max() > 1.0, "it moved"
    assert energy(tuple(x[:3]), tuple(x[3:6])) - energy(Q, V) == pytest.approx(x[6], abs=1e-9)


def test_closed_form_is_that_of_the_link_data(monkeypatch: pytest.MonkeyPatch) -> None:
    """Same structure as the matrix reference; with the constants refitted, the same torques."""
    puma560_refit.check(puma560_matrix, monkeypatch)
