# SPDX-License-Identifier: Apache-2.0
"""The disturbance observer of eq 27: its step as printed, its poles, its lag, and what it is fed."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from ftcm_core.observers.do import DO, observer_step
from ftcm_core.robots import Robot
from ftcm_core.robots.puma560 import Puma560
from ftcm_core.scenario import load
from ftcm_core.signals import Measurement, Vector
from ftcm_core.simulation import simulate
from ftcm_core.simulation.stages import ObserverStage
from plugins import ROBOTS

sys.path.insert(0, str(Path(__file__).parents[1] / "reference"))
from robot_matrices import coriolis_matrix, mass_matrix

pytestmark = pytest.mark.pure

ROBOT, DT = Puma560(), 1e-3
REST = (0.0, 0.0, 0.0)
K1, K2 = 20000.0, 200.0
vectors = st.tuples(*[st.floats(-5.0, 5.0)] * 3)
measurements = st.builds(Measurement, vectors, vectors, st.tuples(*[st.floats(-100.0, 100.0)] * 3))


@settings(deadline=None)
@given(before=measurements, now=measurements, after=measurements)
def test_step_is_eq_27_by_forward_euler(before: Measurement, now: Measurement, after: Measurement) -> None:
    """In matrix form: x2 and H of the tick before, the torque applied since, M of the tick it is for."""
    observer = DO(k1=[20000, 15000, 10000], k2=[200, 150, 100])
    k1, k2 = np.diag(observer.k1), np.diag(observer.k2)
    state = observer.init(ROBOT, before)
    omega, delta = np.array(before.velocity), np.zeros(3)
    for earlier, y in ((before, now), (now, after)):
        tau_hat, state = observer.step(ROBOT, DT, y, state)
        c = coriolis_matrix(ROBOT, *earlier[:2])
        h = c @ earlier.velocity + ROBOT.gravity(earlier.position)
        q_u_minus_h = np.linalg.solve(mass_matrix(ROBOT, earlier.position), y.effort - h)
        innovation = omega - earlier.velocity
        omega, delta = omega + DT * (q_u_minus_h - delta - k2 @ innovation), delta + DT * k1 @ innovation
        expected = mass_matrix(ROBOT, y.position) @ delta
        assert tau_hat == pytest.approx(expected, rel=0, abs=1e-12 * max(100.0, np.abs(expected).max()))


def test_poles() -> None:
    """Table 1's gains: -100 ± 100j, damping 0.7; the step is linear, its matrix is I + dt A."""
    assert DO().values == {"k1": K1, "k2": K2}
    columns = [observer_step(K1, K2, w, d, 0.0, 0.0, DT) for w, d in ((1.0, 0.0), (0.0, 1.0))]
    poles = np.linalg.eigvals((np.array(columns).T - np.eye(2)) / DT)
    assert sorted(poles, key=np.imag) == pytest.approx([-100 - 100j, -100 + 100j], rel=1e-12)


@pytest.mark.parametrize("rate", [1.0, -3.0])
def test_lag_behind_a_slow_ramp(rate: float) -> None:
    """Δ - Δ̂ → Δ̇ k2/k1 = 0.01 s Δ̇, less half a tick for the forward Euler step, whatever the rate (rad/s³)."""
    omega = delta = 0.0
    for k in range(1000):
        velocity = -0.5 * rate * (k * DT) ** 2  # v̇ = -Δ, Δ = rate t
        omega, delta = observer_step(K1, K2, omega, delta, velocity, 0.0, DT)
    assert rate * 1.0 - delta == pytest.approx(rate * (K2 / K1 - DT / 2), abs=1e-9)


def test_step_response() -> None:
    """A step of Δ is found without error, after the overshoot of the discrete poles z = 0.9 ± 0.1j."""
    omega = delta = 0.0
    response = []
    for k in range(300):
        omega, delta = observer_step(K1, K2, omega, delta, -2.0 * k * DT, 0.0, DT)
        response.append(delta / 2.0)
    pole = np.log(0.9 + 0.1j) / DT
    assert max(response) == pytest.approx(1.0 + np.exp(np.pi * pole.real / pole.imag), abs=5e-4)
    assert np.argmax(response) * DT == pytest.approx(np.pi / pole.imag, abs=DT)
    assert response[-1] == pytest.approx(1.0, abs=1e-11)


@pytest.mark.parametrize("robot", ROBOTS.values(), ids=ROBOTS)
def test_a_constant_disturbance_is_found(robot: Robot) -> None:
    """A robot held at rest against a disturbance d: the estimate becomes -d within half a second, to 1e-9."""
    n = robot.joints
    q, d = (0.3, -0.4, 0.7, 0.2, -0.1, 0.5)[:n], (5.0, -8.0, 2.0, 1.0, -1.0, 0.5)[:n]
    y = Measurement(q, (0.0,) * n, tuple(g - x for g, x in zip(robot.gravity(q), d)))
    observer = DO()
    state = observer.init(robot, y)
    for _ in range(500):
        estimate, state = observer.step(robot, DT, y, state)
    assert estimate == pytest.approx(tuple(-x for x in d), abs=1e-9)


def test_it_estimates_against_its_model_not_the_robot() -> None:
    """Held at rest, a payload that the model does not have is a disturbance of its weight."""
    q, loaded = (0.3, -0.4, 0.7), Puma560(payload_mass=2.0)
    y, observer = Measurement(q, REST, loaded.gravity(q)), DO()
    state = observer.init(ROBOT, y)
    for _ in range(500):
        estimate, state = observer.step(ROBOT, DT, y, state)
    assert estimate == pytest.approx(np.subtract(loaded.gravity(q), ROBOT.gravity(q)), abs=1e-9)


def test_first_measurement_gives_zero() -> None:
    """The first step has no tick before it: ω̂ is the velocity measured, the estimate zero."""
    stage = ObserverStage(DO(), ROBOT, DT)
    y = Measurement((0.3, -0.4, 0.7), (0.5, -0.6, 0.8), (9.0, 9.0, 9.0))
    assert stage.step(y) == (0.0, 0.0, 0.0)
    assert stage.state == ((0.5, -0.6, 0.8), (0.0, 0.0, 0.0), y.position, y.velocity)


def test_observer_in_a_run_sees_only_what_the_drive_reports() -> None:
    """Its estimates follow from the recorded position, velocity and applied torque, bit for bit."""
    scenario = load("paper", ["duration=0.3", "torque_limits=[20, 60, 15]", "injection.faults.0.start=0.1"])
    trace = simulate(scenario)
    assert (trace.effort[1:] != trace.command[:-1]).any(), "the torque was limited"
    stage = ObserverStage(scenario.observer, scenario.model, scenario.dt)
    rows: list[Vector] = [
        stage.step(Measurement(tuple(q), tuple(v), tuple(u)))
        for q, v, u in zip(trace.position.tolist(), trace.velocity.tolist(), trace.effort.tolist())
    ]
    assert np.array_equal(trace.disturbance_estimate, rows)


def test_saturation_is_no_disturbance() -> None:
    """Fed the torque applied, the observer does not take what the limits cut off for a disturbance."""
    trace = simulate(load("paper", ["duration=1", "injection.faults=[]", "torque_limits=[20, 60, 15]"]))
    cut_off = np.abs(trace.effort[1:] - trace.command[:-1])[200:]
    error = np.abs(trace.lumped_uncertainty - trace.lumped_uncertainty_estimate)[200:]
    assert (cut_off.max(axis=0) > 20.0).all()
    assert error.max() < 0.3
