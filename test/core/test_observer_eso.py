# SPDX-License-Identifier: Apache-2.0
"""The linear extended state observer: three poles at its bandwidth, in discrete time, and what follows."""

from __future__ import annotations

import math

import numpy as np
import pytest

from ftcm_core.observers.eso import ESO, eso_step
from ftcm_core.robots import Robot
from ftcm_core.robots.puma560 import Puma560
from observing import DT, PUSH, estimates, held, moved
from plugins import ROBOTS

pytestmark = pytest.mark.pure

ROBOT = Puma560()
every_robot = pytest.mark.parametrize("robot", ROBOTS.values(), ids=ROBOTS)


@pytest.mark.parametrize("bandwidth", [1.0, 300.0, 5000.0])
@pytest.mark.parametrize("dt", [1e-4, 1e-3, 1e-2])
def test_all_three_poles_are_at_the_bandwidth(bandwidth: float, dt: float) -> None:
    """Characteristic polynomial (z - e^{-ω dt})³ of the error, of which the step is the matrix.

    In units of dt, so that all entries are alike; three equal eigenvalues would be known to 1e-5 only.
    """
    units = np.diag([1.0, dt, dt * dt])
    columns = [
        eso_step(bandwidth, *(x / u for x, u in zip(e, np.diag(units))), 0.0, 0.0, dt) for e in np.eye(3)
    ]
    matrix = units @ np.array(columns).T
    pole = math.exp(-bandwidth * dt)
    assert np.poly(matrix) == pytest.approx([1.0, -3.0 * pole, 3.0 * pole**2, -(pole**3)], abs=1e-12)


def test_in_continuous_time_they_are_the_gains_of_gao() -> None:
    """3ω, 3ω² and ω³, reached with the tick going to zero."""
    for dt, near in ((1e-5, 1e-2), (1e-6, 1e-3)):
        gains = np.array(eso_step(300.0, 0.0, 0.0, 0.0, 0.0, 1.0, dt)) / dt
        assert gains == pytest.approx([900.0, 270_000.0, 27e6], rel=near)


@every_robot
def test_a_constant_torque_on_a_robot_at_rest_is_found(robot: Robot) -> None:
    """To 1e-8 within 0.2 s, 60 time constants, on any of them."""
    found = estimates(ESO(), robot, [held(robot)] * 200)
    assert found[-1] == pytest.approx([-x for x in PUSH[: robot.joints]], abs=1e-8)


def test_step_response() -> None:
    """Of three equal poles: 1 - (1 + ωt + (ωt)²/2) e^{-ωt}, as of the middle of the tick."""
    x1, x2, v = (0.0, 0.0, 0.0), 0.0, 0.0
    for k in range(1, 61):
        x2 += DT * v - 0.5 * DT * DT
        v -= DT  # Δ = 1 from t = 0 on
        x1 = eso_step(100.0, *x1, 0.0, x2, DT)
        t = 100.0 * (k + 0.5) * DT
        assert -x1[2] == pytest.approx(1.0 - (1.0 + t + 0.5 * t * t) * math.exp(-t), abs=2e-3)


@pytest.mark.parametrize("rate", [1.0, -3.0])
def test_lag_behind_a_ramp(rate: float) -> None:
    """Δ - Δ̂ → Δ̇ (3/ω - dt/2), half a tick being what the correction of the current measurement saves."""
    estimate, dt = (0.0, 0.0, 0.0), 1e-4
    for k in range(1, 5001):
        estimate = eso_step(300.0, *estimate, 0.0, -rate * (k * dt) ** 3 / 6.0, dt)
    assert rate * 0.5 + estimate[2] == pytest.approx(rate * (3.0 / 300.0 - 0.5 * dt), rel=1e-4)


def test_any_bandwidth_is_stable() -> None:
    """With one far above 1/dt it is the second difference of the positions."""
    found = estimates(ESO(bandwidth=1e6), ROBOT, [held(ROBOT)] * 10)
    assert found[-1] == pytest.approx([-x for x in PUSH[:3]], abs=1e-6)
    assert ESO(bandwidth=1e6).warnings(ROBOT, DT) == []


def test_in_motion_it_lags_behind_the_acceleration_that_a_constant_torque_makes() -> None:
    """Δ = M⁻¹ torque varies with the posture: behind by its rate times the lag, from positions alone.

    To 10 %: the rest is the model's acceleration, taken with the velocity at the start of the tick.
    """
    measured = moved(ROBOT, lambda k, q: PUSH[:3], 1.5)
    found = estimates(ESO(), ROBOT, measured)[600:] + PUSH[:3]
    torque = tuple(-x for x in PUSH[:3])
    delta = np.array([ROBOT.inertia_acceleration(y.position, torque) for y in measured])
    behind = -(3.0 / 300.0 - 0.5 * DT) * np.gradient(delta, DT, axis=0)[600:]
    expected = np.array([ROBOT.inertia_torque(y.position, tuple(x)) for y, x in zip(measured[600:], behind)])
    assert np.abs(found).max() > 1e-3
    assert np.abs(found - expected).max() < 0.1 * np.abs(found).max()
