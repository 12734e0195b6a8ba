# SPDX-License-Identifier: Apache-2.0
"""The nonlinear disturbance observer: its error, the condition of its convergence, its limit in dt."""

from __future__ import annotations

import numpy as np
import pytest

from ftcm_core.observers.ndo import NDO, diagonal
from ftcm_core.robots import Robot
from ftcm_core.robots.puma560 import Puma560
from ftcm_core.scenario import load
from ftcm_core.simulation import simulate
from observing import DT, POSTURE, PUSH, estimates, held, moved
from plugins import ROBOTS
from robot_matrices import mass_matrix

pytestmark = pytest.mark.pure

ROBOT = Puma560()
every_robot = pytest.mark.parametrize("robot", ROBOTS.values(), ids=ROBOTS)


@every_robot
def test_the_error_obeys_its_equation(robot: Robot) -> None:
    """ė = -Y M⁻¹ e by forward Euler, Y the rates times the diagonal of M."""
    n = robot.joints
    rates = [50.0 + 10.0 * j for j in range(n)]
    found = estimates(NDO(rate=rates), robot, [held(robot)] * 100)
    m = mass_matrix(robot, POSTURE[:n])
    step = np.eye(n) - DT * np.diag(rates * np.diagonal(m)) @ np.linalg.inv(m)
    error = np.array(PUSH[:n])
    for estimate in found:
        assert estimate + PUSH[:n] == pytest.approx(error, abs=1e-9)
        error = step @ error


def test_on_one_joint_the_error_decays_as_exp_of_minus_rate_t() -> None:
    """Up to the forward Euler step: (1 - rate dt)^k, whose rate is off by the share rate dt / 2."""
    robot = ROBOTS["pendulum"]
    for dt in (1e-3, 1e-4):
        found = estimates(NDO(rate=100.0), robot, [held(robot)] * 51, dt)[:, 0]
        rate = -np.log((found[-1] + PUSH[0]) / PUSH[0]) / (50 * dt)
        assert rate == pytest.approx(100.0 * (1.0 + 0.5 * 100.0 * dt), rel=50.0 * dt * 100.0 * dt)


@every_robot
def test_a_constant_torque_on_a_robot_at_rest_is_found(robot: Robot) -> None:
    """To 1e-6 within 0.4 s on any of them, at its default rate."""
    found = estimates(NDO(), robot, [held(robot)] * 400)
    assert found[-1] == pytest.approx([-x for x in PUSH[: robot.joints]], abs=1e-6)


def test_in_motion_what_is_left_of_a_constant_torque_is_of_second_order_in_dt() -> None:
    """The model is evaluated in the middle of the tick: halving the tick leaves a quarter of the error."""
    left = []
    for dt in (4e-3, 2e-3, 1e-3):
        measured = moved(ROBOT, lambda k, q: PUSH[:3], 1.0, dt)
        left.append(np.abs(estimates(NDO(), ROBOT, measured, dt) + PUSH[:3])[-round(0.4 / dt) :].max())
    assert left[-1] < 1e-5
    assert left[:-1] == pytest.approx([4.0 * x for x in left[1:]], rel=0.1)


def test_the_condition_of_convergence_holds_in_the_papers_experiment() -> None:
    """2 Y > Ṁ with a wide margin: the arm would have to be some hundred times as fast."""
    trace = simulate(load("paper", ["observer=ndo", "duration=2", "injection.faults.0.start=1"]))
    y = np.diag(np.array(diagonal(ROBOT, trace.position[0].tolist())) * NDO().rate)
    worst = 0.0
    for q, v in zip(trace.position[::20], trace.velocity[::20]):
        step = 1e-6
        rate = (mass_matrix(ROBOT, q + step * v) - mass_matrix(ROBOT, q - step * v)) / (2.0 * step)
        worst = max(worst, float(np.linalg.eigvals(np.linalg.solve(2.0 * y, rate)).real.max()))
    assert 0.0 < worst < 0.01


def growth(rate: float) -> float:
    """By what the error of the pendulum at rest grows in 100 ticks."""
    robot = ROBOTS["pendulum"]
    found = estimates(NDO(rate=rate), robot, [held(robot)] * 101)[:, 0]
    return float(abs(found[-1] + PUSH[0]) / PUSH[0])


def test_warns_where_the_step_is_unstable() -> None:
    """One joint: at a rate of 2/dt. Several: below, where M is not diagonal or larger than at the start."""
    pendulum = ROBOTS["pendulum"]
    assert NDO(rate=1999.0).warnings(pendulum, DT) == []
    assert growth(1999.0) < 1.0
    (line,) = NDO(rate=2001.0).warnings(pendulum, DT)
    assert growth(2001.0) > 1.0
    assert line == (
        "observer ndo: unstable in some configuration with ticks of 0.001 s: the error's fastest rate is "
        "2001 1/s; expected below 2000; lower rate or dt"
    )
    assert NDO().warnings(ROBOT, DT) == []
    assert len(NDO(rate=1500.0).warnings(ROBOT, DT)) == 1
    assert len(NDO(rate=[125.0, 1900.0, 125.0]).warnings(ROBOT, DT)) == 1
