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

from ftcm_core.errors import ParameterError
from ftcm_core.robots import Robot, puma560
from ftcm_core.robots.puma560 import Puma560
from ftcm_core.signals import Vector

sys.path.insert(0, str(Path(__file__).parents[1] / "reference"))
import puma560_matrix
import puma560_refit
from robot_matrices import coriolis_matrix, mass_matrix, velocity_torque

ROBOT = Puma560()
Q, V = (0.3, -0.4, 0.7), (0.5, -0.6, 0.8)
OTHERS = {
    "default": ROBOT,
    "heavier": Puma560(mass=[0, 21, 7], centre_x=[0, 0.1, 0.02], centre_y=[0, 0.02, -0.18]),
    "loaded": Puma560(payload_mass=2.5, payload_distance=0.2),
    "on the moon": Puma560(gravity_acceleration=1.62, motor_inertia=[2.0, 3.0, 1.0]),
}
"""Robots without friction."""
every_robot = pytest.mark.parametrize("robot", OTHERS.values(), ids=OTHERS)

positions, velocities, accelerations = (
    st.tuples(*[st.floats(-bound, bound)] * 3) for bound in (2 * math.pi, 5.0, 20.0)
)


def test_golden_values() -> None:
    """M, h and G at one state, worked out once from the published constants."""
    m = mass_matrix(ROBOT, Q)
    assert (*m[0], *m[1][1:], m[2][2]) == pytest.approx(
        (3.94983693201, -0.376324265689, -0.129546861153, 7.25956909105, 0.567534545524, 1.1625), rel=1e-9
    )
    h = (-0.00228378896753, -0.327687419086, -0.207167254701)
    assert velocity_torque(ROBOT, Q, V) == pytest.approx(h, rel=1e-9)
    assert ROBOT.gravity(Q) == pytest.approx((0.0, -36.9253211143, -2.26464542826), rel=1e-9)


@given(positions)
def test_mass_matrix_is_symmetric_positive_definite(q: Vector) -> None:
    """Eigenvalues, kg·m²; over all configurations they span [1.08329, 7.75456]."""
    m = np.array([ROBOT.inertia_torque(q, tuple(unit)) for unit in np.eye(3).tolist()])
    assert np.array_equal(m, m.T)
    assert mass_matrix(ROBOT, q) == pytest.approx(m, abs=1e-13)
    smallest, _, largest = np.linalg.eigvalsh(m)
    assert smallest > 1.083
    assert largest < 7.755


@every_robot
@given(q=positions, v=velocities)
def test_mass_rate_minus_twice_coriolis_is_skew(robot: Puma560, q: Vector, v: Vector) -> None:
    """Ṁ by central difference along v, which is good to 4e-9 (measured over 20,000 states)."""
    step = 1e-6
    ahead, behind = (mass_matrix(robot, tuple(np.add(q, np.multiply(s, v)).tolist())) for s in (step, -step))
    difference = np.subtract(ahead, behind) / (2 * step) - 2 * coriolis_matrix(robot, q, v)
    assert np.abs(difference + difference.T).max() < 4e-8


@every_robot
@given(q=positions, v=velocities, a=accelerations)
def test_inverse_dynamics_is_the_sum_of_its_terms(robot: Puma560, q: Vector, v: Vector, a: Vector) -> None:
    """M a + C v + G, each also from its own method; C v is h."""
    inertial, h = mass_matrix(robot, q) @ a, coriolis_matrix(robot, q, v) @ v
    assert robot.inertia_torque(q, a) == pytest.approx(inertial, abs=1e-11)
    assert velocity_torque(robot, q, v) == pytest.approx(h, abs=1e-11)
    assert robot.inverse_dynamics(q, v, a) == pytest.approx(inertial + h + robot.gravity(q), abs=1e-11)


@every_robot
@given(q=positions, v=velocities, a=accelerations)
def test_forward_and_inverse_dynamics_undo_each_other(
    robot: Puma560, q: Vector, v: Vector, a: Vector
) -> None:
    """So do inertia_acceleration and inertia_torque; M's condition number is 7.2 at most, 16 loaded."""
    assert robot.forward_dynamics(q, v, robot.inverse_dynamics(q, v, a)) == pytest.approx(a, abs=1e-11)
    assert robot.inertia_acceleration(q, robot.inertia_torque(q, a)) == pytest.approx(a, abs=1e-12)


@given(q=positions, v=velocities, a=accelerations)
def test_what_the_base_class_makes_of_the_inverse_dynamics_is_the_closed_form(
    q: Vector, v: Vector, a: Vector
) -> None:
    """A robot that defines no more than its inverse dynamics has the same forward dynamics and terms."""
    rubbing = Puma560(viscous_friction=2.0)
    for robot in (ROBOT, rubbing):
        tau = robot.inverse_dynamics(q, v, a)
        assert Robot.forward_dynamics(robot, q, v, tau) == pytest.approx(a, abs=1e-10)
        assert Robot.gravity(robot, q) == pytest.approx(robot.gravity(q), abs=1e-13)
        assert Robot.inertia_torque(robot, q, a) == pytest.approx(robot.inertia_torque(q, a), abs=1e-11)
        assert Robot.inertia_acceleration(robot, q, tau) == pytest.approx(
            robot.inertia_acceleration(q, tau), abs=1e-10
        )


def energy(robot: Puma560, q: Vector, v: Vector) -> float:
    """Half vᵀ M v plus the potential whose slopes are G2 (by q2) and G3 (by q3), J."""
    k, (_, q2, q3) = robot.terms, q
    potential = k.g1 * math.sin(q2) - k.g3 * math.cos(q2) - k.g35 * math.cos(q2 + q3)
    potential += k.g4 * math.sin(q2 + q3)
    return 0.5 * float(np.dot(v, robot.inertia_torque(q, v))) + potential


def gained(robot: Puma560, amplitude: float) -> tuple[float, float]:
    """Energy gained, and work done, in 2 s of RK4 at 1 kHz under random torques (N·m)."""
    torques, dt = np.random.default_rng(3).uniform(-amplitude, amplitude, (20, 3)), 1e-3

    def rate(x: np.ndarray, tau: np.ndarray) -> np.ndarray:
        q, v = tuple(x[:3].tolist()), tuple(x[3:6].tolist())
        return np.array([*v, *robot.forward_dynamics(q, v, tuple(tau.tolist())), tau @ x[3:6]])

    x = np.array([*Q, *V, 0.0])
    for tau in np.repeat(torques, 100, axis=0):
        k1 = rate(x, tau)
        k2 = rate(x + dt / 2 * k1, tau)
        k3 = rate(x + dt / 2 * k2, tau)
        k4 = rate(x + dt * k3, tau)
        x = x + dt / 6 * (k1 + 2 * k2 + 2 * k3 + k4)
    assert np.abs(x[:3] - Q).max() > 0.5, "it moved"
    return energy(robot, tuple(x[:3]), tuple(x[3:6])) - energy(robot, Q, V), float(x[6])


@every_robot
@pytest.mark.parametrize("amplitude", [0.0, 40.0], ids=["passive", "driven"])
def test_energy_changes_by_the_work_done(robot: Puma560, amplitude: float) -> None:
    """Whatever the links weigh, as long as nothing rubs."""
    energy_gained, work = gained(robot, amplitude)
    assert energy_gained == pytest.approx(work, abs=1e-8)


def test_friction_only_takes_energy() -> None:
    """In a passive robot; more of it takes more."""
    lost = [
        -gained(Puma560(viscous_friction=b, coulomb_friction=c), 0.0)[0]
        for b, c in ((0.0, 0.0), (0.5, 0.0), (0.5, 1.0))
    ]
    assert lost[0] == pytest.approx(0.0, abs=1e-8)
    assert 1.0 < lost[1] < lost[2]


def test_friction_is_viscous_and_coulomb_per_joint() -> None:
    """At full slip F = b v + c sgn v against the motion; at rest none; it adds to the rest of the torque."""
    robot = Puma560(viscous_friction=[1, 2, 3], coulomb_friction=[5, 6, 7], slip_velocity=[1e-3, 0.1, 1e-3])
    a = (0.3, 0.2, -0.1)
    added = np.subtract(robot.inverse_dynamics(Q, V, a), ROBOT.inverse_dynamics(Q, V, a))
    expected = (0.5 + 5.0, -1.2 - 6.0 * math.tanh(6.0), 2.4 + 7.0)
    assert added == pytest.approx(expected, rel=1e-12)
    assert robot.gravity(Q) == ROBOT.gravity(Q)
    assert robot.inverse_dynamics(Q, (0.0,) * 3, a) == ROBOT.inverse_dynamics(Q, (0.0,) * 3, a)
    assert robot.forward_dynamics(Q, V, robot.inverse_dynamics(Q, V, a)) == pytest.approx(a, abs=1e-12)


# Parameters: the printed coefficients, and what other links make of them.


def test_default_parameters_give_the_printed_coefficients_exactly() -> None:
    """Armstrong's numbers as printed: not one of them goes through the link data."""
    printed = {
        "i1": 1.43, "i2": 1.75, "i3": 1.38, "i4": 0.690, "i6": 0.333, "i9": 0.0238, "i11": -0.0142,
        "i12": -0.0110, "i13": -0.00379, "g1": -37.2, "g3": 1.02, "g4": 0.249,
    }  # fmt: skip
    found = ROBOT.terms._asdict()
    assert {name: found[name] for name in printed} == printed
    assert found["p"] == 0.298 - 0.0001 + 2 * 0.00125
    assert found["q"] == -0.0213 - 2 * 0.000058
    assert found["r"] == 0.372 + 0.00124
    assert found["s"] == -0.134 - 0.000431
    assert found["g35"] == -8.44 - 0.0282
    motors = dict(zip(puma560_refit.COEFFICIENTS, ROBOT.coefficients))
    assert motors["m11"] == 1.14 + 1.43
    assert motors["m33"] == 0.827 + 0.333 + 2 * 0.00125


def lumped() -> tuple[float, np.ndarray, np.ndarray]:
    """Mass, centre and inertia about it of link 3 with the wrist locked on it, from the link data."""
    chain = puma560_matrix.frames(np.zeros(3))
    third, origin = chain[2]
    masses = puma560_matrix.MASS[2:]
    centres = [
        third.T @ (p + r @ c - origin) for (r, p), c in zip(chain[2:], puma560_matrix.CENTRE[2:], strict=True)
    ]
    centre = np.average(centres, axis=0, weights=masses)
    inertia = np.zeros((3, 3))
    for (r, _), m, c, i in zip(chain[2:], masses, centres, puma560_matrix.INERTIA[2:], strict=True):
        turned, d = third.T @ r, c - centre
        inertia += turned @ np.diag(i) @ turned.T + m * (d @ d * np.eye(3) - np.outer(d, d))
    return float(masses.sum()), centre, inertia


def test_the_links_are_those_of_the_link_data() -> None:
    """Links 1 and 2 as they are tabulated, link 3 with the wrist locked on it, to the digits given."""
    mass, centre, inertia = lumped()
    assert ROBOT.mass[2] == pytest.approx(mass, abs=5e-7)
    assert (ROBOT.centre_x[2], ROBOT.centre_y[2], ROBOT.centre_z[2]) == pytest.approx(centre, abs=5.1e-7)
    found = (ROBOT.inertia_xx[2], ROBOT.inertia_yy[2], ROBOT.inertia_zz[2])
    assert found == pytest.approx(np.diag(inertia), abs=5.1e-7)
    for j in (0, 1):
        assert ROBOT.mass[j] == puma560_matrix.MASS[j]
        assert (ROBOT.centre_x[j], ROBOT.centre_y[j], ROBOT.centre_z[j]) == tuple(puma560_matrix.CENTRE[j])
        found = (ROBOT.inertia_xx[j], ROBOT.inertia_yy[j], ROBOT.inertia_zz[j])
        assert found == tuple(puma560_matrix.INERTIA[j])
    assert ROBOT.motor_inertia == tuple(puma560_matrix.MOTOR_INERTIA)


class _Links:
    """Stands for a robot whose coefficients are those of its links, nothing printed."""

    terms, motor_inertia = puma560.DEFAULT, ROBOT.motor_inertia


def test_the_links_coefficients_are_those_refitted_from_the_link_data() -> None:
    """But for the products of inertia of link 3, which have no parameters, to the digits given."""
    fitted, _ = puma560_refit.refit(puma560_matrix)
    own = dict(zip(puma560_refit.COEFFICIENTS, vars(Puma560)["coefficients"].func(_Links())))
    off = {name: own[name] - fitted[name] for name in fitted}
    _, _, inertia = lumped()
    assert off.pop("q") == pytest.approx(-2.0 * inertia[0, 1], abs=1e-6)
    assert off.pop("s") == pytest.approx(inertia[1, 2], abs=1e-6)
    assert off.pop("i13") == pytest.approx(inertia[0, 2], abs=1e-6)
    assert max(map(abs, off.values())) < 3e-5


def test_gravity_is_proportional_to_its_acceleration() -> None:
    """And nothing else is."""
    none, half = Puma560(gravity_acceleration=0.0), Puma560(gravity_acceleration=9.81 / 2)
    assert none.gravity(Q) == (0.0, 0.0, 0.0)
    assert half.gravity(Q) == pytest.approx(0.5 * np.array(ROBOT.gravity(Q)), rel=1e-14)
    assert half.inertia_torque(Q, V) == ROBOT.inertia_torque(Q, V)


@pytest.mark.parametrize(
    "given_values",
    [
        {"motor_inertia": 0.0, "mass": 0.0, "inertia_xx": 0.0, "inertia_yy": 0.0, "inertia_zz": 0.0},
        {"inertia_zz": [0.35, 0.539, 0.0], "motor_inertia": [1.14, 4.71, 0.0], "mass": [0, 17.4, 0.0]},
    ],
)
def test_a_body_that_cannot_exist_is_refused(given_values: dict[str, object]) -> None:
    """In one line that begins with a parameter."""
    with pytest.raises(ParameterError, match=r"^mass: .*not positive definite") as error:
        Puma560(**given_values)
    assert len(str(error.value).splitlines()) == 1


def test_loaded_and_unloaded() -> None:
    """The payload alone differs; unloading what has none gives the same robot back."""
    loaded = ROBOT.loaded(2.0)
    assert loaded == Puma560(payload_mass=2.0)
    assert loaded.unloaded() == ROBOT
    assert ROBOT.unloaded() is ROBOT
    assert ROBOT.inertia_torque(Q, V) != loaded.inertia_torque(Q, V)


def test_closed_form_is_that_of_the_link_data() -> None:
    """Same structure as the matrix reference; with the constants refitted, the same torques."""
    puma560_refit.check(puma560_matrix)
