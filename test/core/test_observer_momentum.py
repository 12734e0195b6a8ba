# SPDX-License-Identifier: Apache-2.0
"""The generalised momentum observer: its decoupled error, and what it needs of a robot."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from ftcm_core.observers.momentum import Momentum, momentum_and_load
from ftcm_core.robots import Robot
from ftcm_core.robots.puma560 import Puma560
from ftcm_core.signals import Measurement, Vector
from observing import DT, PUSH, estimates, held, moved
from plugins import ROBOTS
from robot_matrices import coriolis_matrix, mass_matrix

pytestmark = pytest.mark.pure

every_robot = pytest.mark.parametrize("robot", ROBOTS.values(), ids=ROBOTS)
ROBOT = Puma560()


@every_robot
def test_the_error_of_each_joint_decays_by_itself_as_exp_of_minus_k_t(robot: Robot) -> None:
    """A constant torque on a robot at rest, another gain for each joint: e^{-K t} to rounding."""
    n = robot.joints
    gains = [50.0 * (j + 1) for j in range(n)]
    found = estimates(Momentum(gain=gains), robot, [held(robot)] * 200)
    t = DT * np.arange(200)
    error = found + np.array(PUSH[:n])
    assert error == pytest.approx(np.array(PUSH[:n]) * np.exp(-np.outer(t, gains)), abs=1e-12)


def test_any_gain_is_stable() -> None:
    """The faster the decay within a tick, the more it is the difference quotient of the momentum."""
    found = estimates(Momentum(gain=1e9), ROBOT, [held(ROBOT)] * 3)
    assert found[1:] == pytest.approx(np.array([PUSH[:3]] * 2) * -1.0, abs=1e-12)
    assert Momentum(gain=1e9).warnings(ROBOT, DT) == []


def test_in_motion_what_is_left_of_a_constant_torque_is_of_second_order_in_dt() -> None:
    """The trapezoidal rule for β: halving the tick leaves a quarter of the error."""
    left = []
    for dt in (4e-3, 2e-3, 1e-3):
        measured = moved(ROBOT, lambda k, q: PUSH[:3], 1.0, dt)
        left.append(np.abs(estimates(Momentum(), ROBOT, measured, dt) + PUSH[:3])[-round(0.4 / dt) :].max())
    assert left[-1] < 1e-5
    assert left[:-1] == pytest.approx([4.0 * x for x in left[1:]], rel=0.05)


vectors = st.tuples(*[st.floats(-3.0, 3.0)] * 6)


@every_robot
@settings(deadline=None, max_examples=20)
@given(q=vectors, v=vectors)
def test_load_is_gravity_less_the_transposed_coriolis_torque(robot: Robot, q: Vector, v: Vector) -> None:
    """Of the C of the Christoffel symbols; for robots without a rate of M of their own to 1e-7 N·m."""
    n = robot.joints
    q, v = q[:n], v[:n]
    momentum, load = momentum_and_load(robot, Measurement(q, v, (0.0,) * n))
    exact = type(robot).inertia_rate_torque is not Robot.inertia_rate_torque
    assert load == pytest.approx(
        robot.gravity(q) - coriolis_matrix(robot, q, v).T @ v, abs=1e-11 if exact else 1e-7
    )
    assert momentum == pytest.approx(mass_matrix(robot, q) @ v, abs=1e-11)


@settings(deadline=None, max_examples=50)
@given(q=vectors, v=vectors)
def test_central_differences_are_as_good_as_they_say(q: Vector, v: Vector) -> None:
    """Beside the PUMA's own rate of M, which is exact: 1e-9 N·m for each (rad/s)² of the velocities."""
    q, v = q[:3], v[:3]
    expected = ROBOT.inertia_rate_torque(q, v)
    scale = max(1.0, float(np.dot(v, v)))
    assert Robot.inertia_rate_torque(ROBOT, q, v) == pytest.approx(expected, abs=1e-9 * scale)


def test_friction_that_the_model_knows_is_no_disturbance() -> None:
    """It stands in β with gravity."""
    robot = Puma560(viscous_friction=5.0, coulomb_friction=(3.0, 4.0, 1.5), slip_velocity=0.5)
    found = estimates(Momentum(), robot, moved(robot, lambda k, q: (0.0, 0.0, 0.0), 1.0))
    assert np.abs(found[500:]).max() < 1e-4
