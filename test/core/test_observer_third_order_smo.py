# SPDX-License-Identifier: Apache-2.0
"""The third-order sliding-mode observer: finite time from positions, and its errors in dt."""

from __future__ import annotations

import numpy as np
import pytest

from ftcm_core.observers.homogeneous import differentiate, differentiate_implicit
from ftcm_core.observers.third_order_smo import ThirdOrderSMO
from ftcm_core.robots import Robot
from observing import DT, PUSH, Array, estimates, held
from plugins import ROBOTS
from robot_matrices import mass_matrix

pytestmark = pytest.mark.pure

L = 200.0
FORMS = {"explicit": differentiate, "implicit": differentiate_implicit}
every_form = pytest.mark.parametrize("form", FORMS)


def errors(form: str, slope: float, dt: float, duration: float, start: float = 5.0) -> Array:
    """Errors of position, velocity and Δ̂ of one joint at every tick; a velocity of 1 rad/s is unknown to it.

    Δ goes up and down by that slope (rad/s³); the known acceleration is 3 rad/s².
    """
    x, v, chain = 0.0, 1.0, (0.0, 0.0, 0.0)
    t = dt * np.arange(round(duration / dt))
    found = []
    for delta in (start + slope * (0.05 - np.abs((t + 0.05) % 0.2 - 0.1))).tolist():
        x, v = x + dt * v + 0.5 * dt * dt * (3.0 - delta), v + dt * (3.0 - delta)
        chain = FORMS[form](L, *chain, 3.0, x, dt)
        found.append((chain[0] - x, chain[1] - v, -chain[2] - delta))
    return np.abs(np.array(found))


@every_form
@pytest.mark.parametrize("slope", [0.0, 100.0, -190.0])
def test_converges_in_finite_time_whatever_the_slope_below_l(form: str, slope: float) -> None:
    """All three estimates after 1 s, and for good: off by what the sampling leaves.

    Explicitly 32 L dt³/27, 4.5 L dt² and 3.5 L dt, the first being 4 (dt g0)³/27, the others as
    documented; implicitly Δ̂ is one tick behind.
    """
    late = errors(form, slope, DT, 4.0)[1000:].max(axis=0)
    if form == "explicit":
        assert (late < np.array([32.0 / 27.0 * L * DT**3, 4.5 * L * DT**2, 3.5 * L * DT])).all()
    else:
        assert late[2] == pytest.approx(abs(slope) * DT, abs=1e-5)


def test_the_errors_are_of_the_orders_3_2_and_1_in_dt() -> None:
    """Slope of the logarithms over ticks of 1 ms to 0.1 ms: as Livne and Levant (2014) have it."""
    ticks = np.array([1e-3, 5e-4, 2e-4, 1e-4])
    late = np.array([errors("explicit", 150.0, dt, 2.0)[round(1.0 / dt) :].max(axis=0) for dt in ticks])
    orders = np.polyfit(np.log(ticks), np.log(late), 1)[0]
    assert orders == pytest.approx([3.0, 2.0, 1.0], abs=0.15)


@every_form
def test_beyond_l_it_does_not_follow(form: str) -> None:
    """Δ̂ cannot change faster than 1.1 L: a ramp of 1.5 L runs away from it."""
    x, v, chain = 0.0, 0.0, (0.0, 0.0, 0.0)
    for k in range(1000):
        delta = 1.5 * L * k * DT
        x, v = x + DT * v - 0.5 * DT * DT * delta, v - DT * delta
        chain = FORMS[form](L, *chain, 0.0, x, DT)
    assert 1.5 * L * 0.999 + chain[2] == pytest.approx(0.4 * L, rel=0.02)


def test_the_implicit_form_is_exact_for_a_constant_disturbance() -> None:
    """To rounding; the explicit form goes on chattering."""
    assert errors("implicit", 0.0, DT, 1.5)[1000:, 2].max() < 1e-6
    assert errors("explicit", 0.0, DT, 1.5)[1000:, 2].max() > 0.5 * L * DT


@pytest.mark.parametrize("robot", ROBOTS.values(), ids=ROBOTS)
@every_form
def test_a_constant_torque_on_a_robot_at_rest_is_found(form: str, robot: Robot) -> None:
    """Explicitly to the chattering, 3.5 L dt at most in each joint's acceleration, implicitly to 1e-6."""
    n, lipschitz = robot.joints, 2000.0
    observer = ThirdOrderSMO(discretisation=form, lipschitz=lipschitz)
    error = estimates(observer, robot, [held(robot)] * 400)[-50:] + PUSH[:n]
    chattering = np.abs(mass_matrix(robot, held(robot).position)).sum(axis=1) * 3.5 * lipschitz * DT
    assert (np.abs(error).max(axis=0) < (1e-6 if form == "implicit" else chattering)).all()
