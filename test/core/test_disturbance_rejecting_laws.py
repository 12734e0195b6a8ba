# SPDX-License-Identifier: Apache-2.0
"""ADRC, RISE, adaptive backstepping, PD with gravity compensation: what each claims."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from double_integrator import DoubleIntegrator, run
from ftcm_core.controllers.adrc import ADRC, extended_state
from ftcm_core.controllers.backstepping import Backstepping
from ftcm_core.controllers.ctc import CTC
from ftcm_core.controllers.rise import RISE, rise
from ftcm_core.robots.puma560 import Puma560
from ftcm_core.scenario import load
from ftcm_core.signals import Measurement, ReferencePoint, Vector
from ftcm_core.simulation import simulate
from robot_matrices import mass_matrix

pytestmark = pytest.mark.pure

ROBOT, DT = Puma560(), 1e-3
quick = settings(deadline=None, max_examples=200)
errors, rates = st.floats(-4.0, 4.0), st.floats(-5.0, 5.0)


# ADRC.


@pytest.mark.parametrize("omega", [20.0, 200.0, 2000.0])
def test_observer_poles_lie_where_the_bandwidth_says(omega: float) -> None:
    """A triple pole at exp(-ω dt): (z - p)³ is the characteristic polynomial."""
    columns = [extended_state(*unit, 0.0, 0.0, omega, DT) for unit in np.eye(3)]
    p = math.exp(-omega * DT)
    assert np.poly(np.array(columns).T) == pytest.approx([1.0, -3 * p, 3 * p * p, -(p**3)], abs=1e-9)


def test_observer_is_exact_for_held_torques() -> None:
    """Once it has the state and a constant f it stays there, to rounding, whatever the torque."""
    q, v, f = 0.3, -0.2, 7.0
    z: Vector = (q, v, f)
    for k in range(500):
        a = 50.0 * math.sin(k)
        q, v = q + DT * v + 0.5 * DT * DT * (a + f), v + DT * (a + f)
        z = extended_state(*z, a, q, 200.0, DT)
    assert z == pytest.approx((q, v, f), abs=1e-9)


@pytest.mark.parametrize("d", [0.0, 10.0, -300.0])
def test_adrc_cancels_a_constant_disturbance(d: float) -> None:
    """The error vanishes, and ẑ3 is the disturbance."""
    moved = run(ADRC(b0=1.0), 4.0, 0.3, disturbance=lambda t: d)
    assert abs(moved.e[-1]) < 1e-9 * (1.0 + abs(d))
    assert moved.state[-1][3] == pytest.approx(d, abs=1e-6 * (1.0 + abs(d)))


@pytest.mark.parametrize("omega", [100.0, 200.0, 400.0])
def test_adrc_leaves_of_a_slope_what_its_bandwidth_says(omega: float) -> None:
    """The estimate of a disturbance of slope L lags by 3 L/ωo, so e = 3 L/(ωo ωc²); to the order of dt."""
    law, slope = ADRC(b0=1.0, omega_o=omega), 10.0
    moved = run(law, 4.0, disturbance=lambda t: slope * t)
    lag = 3.0 * slope / omega
    assert slope * moved.t[-1] - moved.state[-1][3] == pytest.approx(lag, rel=omega * DT)
    assert moved.e[-1] == pytest.approx(lag / law.omega_c**2, rel=omega * DT + 2 * law.omega_c / omega)


@pytest.mark.parametrize(
    ("ratio", "stable"), [(0.05, False), (0.1, True), (0.5, True), (3.0, True), (6.0, True), (8.0, False)]
)
def test_adrc_bears_an_input_gain_that_is_wrong(ratio: float, stable: bool) -> None:
    """True gain by b0 from about 0.07 to 6, at the default bandwidths: as far as the docstring says."""
    moved = run(ADRC(b0=1.0), 20.0, 0.01, disturbance=lambda t: ratio, mass=1.0 / ratio)
    first, last = np.abs(moved.e[:1000]).max(), np.abs(moved.e[-1000:]).max()
    assert last < 1e-6 if stable else last > 10.0 * first


def test_adrc_settles_in_the_time_that_it_is_tuned_for() -> None:
    """Herbst (2013): ÿ + 2 ẏ + y = u, b0 = 1, ωc = 6/T, ωo = 10 ωc, T = 5 s to a band of 2 %."""
    asked, dt, law = 5.0, 1e-3, ADRC(b0=1.0, omega_c=6.0 / 5.0, omega_o=60.0 / 5.0)
    q, v, u, state, errors = 0.0, 0.0, 0.0, law.init(1), []
    goal, model = ReferencePoint((1.0,), (0.0,), (0.0,)), DoubleIntegrator()
    for _ in range(10_000):
        y = Measurement((q,), (v,), (u,))
        (u,), state = law.step(model, dt, y, goal, (0.0,), state, law.prepare(model, dt, y, goal, state))
        errors.append(abs(q - 1.0))
        a = u - 2.0 * v - q
        q, v = q + dt * v + 0.5 * dt * dt * a, v + dt * a
    settled = dt * np.flatnonzero(np.array(errors) > 0.02)[-1]
    assert settled == pytest.approx(asked, rel=0.02)


def test_adrc_sees_the_position_only_once_it_has_started() -> None:
    """Neither velocity nor model changes the torque after the first tick."""
    law, r = ADRC(), ReferencePoint(*((0.0,) * 3,) * 3)
    state = tuple([(1.0, 0.1 * j, 0.2, 0.3) for j in range(3)])
    u = []
    for velocity, model in ((0.0, ROBOT), (5.0, Puma560(payload_mass=10.0))):
        y = Measurement((0.1, 0.2, 0.3), (velocity,) * 3, (1.0, 2.0, 3.0))
        u.append(law.step(model, DT, y, r, (0.0,) * 3, state, law.prepare(model, DT, y, r, state)))
    assert u[0] == u[1]


# RISE.


def test_rise_step() -> None:
    """It starts from zero whatever the error; the integral grows with (k α2 e2 + β sgn e2)."""
    feedback, integral = rise(0.5, 0.0, 123.0, 40.0, 5.0, 10.0, 0.01)
    assert (feedback, integral) == (0.0, pytest.approx(-20.0 + 0.01 * (100.0 + 10.0)))
    assert rise(0.25, 1.0, integral, 40.0, 5.0, 10.0, 0.01) == (
        pytest.approx(10.0 + integral),
        pytest.approx(integral + 0.01 * (50.0 + 10.0)),
    )


def swing(t: float) -> float:
    """|ḋ| and |d̈| up to 3: β > 3 + 3/α2 is what the proof asks for, 3.6."""
    return 3.0 * math.sin(t)


def test_rise_removes_a_smooth_disturbance() -> None:
    """But for an error of the order of dt; without the sign, 1e-3 is left."""
    left = {}
    for beta, dt in ((5.0, 1e-3), (5.0, 1e-4), (0.0, 1e-3)):
        moved = run(RISE(beta=beta), 8.0, 0.1, disturbance=swing, dt=dt)
        left[beta, dt] = np.abs(moved.e[moved.t > 5.0]).max()
    assert left[5.0, 1e-3] < 0.02 * left[0.0, 1e-3]
    assert left[5.0, 1e-4] < 0.12 * left[5.0, 1e-3]


def test_rise_with_too_small_a_beta_does_not() -> None:
    """β = 1 is below the rate of the disturbance: most of the error without the sign is left."""
    left = [np.abs(run(RISE(beta=b), 8.0, 0.1, disturbance=swing).e[-3000:]).max() for b in (0.0, 1.0, 5.0)]
    assert left[2] < 0.05 * left[1]
    assert left[1] > 0.5 * left[0]


def test_rise_keeps_its_torque_continuous() -> None:
    """From tick to tick it changes with the error, and by β dt."""
    law = RISE()
    moved = run(law, 5.0, disturbance=swing)
    e2 = moved.de + law.alpha1 * moved.e
    k = law.ks + 1.0
    most = k * np.abs(np.diff(e2)) + DT * (k * law.alpha2 * np.abs(e2[:-1]) + law.beta)
    assert np.all(np.abs(np.diff(moved.u)) <= most + 1e-12)
    assert np.abs(np.diff(moved.u)).max() < 0.02


def test_rise_starts_anew_after_an_abrupt_fault() -> None:
    """A jump is no smooth disturbance: an error as of a new start, which vanishes again."""
    moved = run(RISE(), 10.0, disturbance=lambda t: 10.0 if t > 5.0 else 0.0)
    assert np.abs(moved.e[moved.t > 5.0]).max() > 1e-3
    assert np.abs(moved.e[moved.t > 9.0]).max() < 1e-5


def test_rise_warns_of_gains_that_the_proof_excludes() -> None:
    """One line for each."""
    assert RISE().warnings() == []
    assert RISE(alpha1=0.5).warnings() == [
        "controller rise: alpha1=0.5; the proof of Xian et al. asks for more than 0.5"
    ]
    assert len(RISE(alpha1=[1.0, 0.2, 1.0], alpha2=1.0).warnings()) == 2


# Backstepping.


@quick
@given(e=errors, de=rates, c1=st.floats(0.5, 20.0), c2=st.floats(0.5, 20.0))
def test_plain_backstepping_is_computed_torque(e: float, de: float, c1: float, c2: float) -> None:
    """With kp = 1 + c1 c2 and kd = c1 + c2."""
    law, same = Backstepping(c1=c1, c2=c2, gamma=0.0), CTC(kp=1.0 + c1 * c2, kd=c1 + c2)
    assert law.law(law, e, de, DT, (0.0,))[0] == pytest.approx(
        same.law(same, e, de, DT, ())[0], rel=1e-9, abs=1e-9
    )


def lyapunov(law: Backstepping, d: float, dt: float) -> tuple[np.ndarray, np.ndarray]:
    """V at every tick of a run, and the V̇ that the proof gives there."""
    moved = run(law, 2.0, 0.5, 1.0, disturbance=lambda t: d, dt=dt)
    z = moved.de + law.c1 * moved.e
    estimate = np.array([0.0, *[s[0] for s in moved.state[:-1]]])
    v = 0.5 * moved.e**2 + 0.5 * z**2 + (d - estimate) ** 2 / (2.0 * law.gamma)
    return v, -law.c1 * moved.e**2 - law.c2 * z**2


@pytest.mark.parametrize("d", [0.0, 10.0, -50.0])
def test_lyapunov_function_falls(d: float) -> None:
    """By dt V̇ a tick, but for a share of the order of dt²; so within every tenth of a second it is less."""
    shares = []
    for dt in (1e-3, 1e-4):
        v, rate = lyapunov(Backstepping(), d, dt)
        tenth = round(0.1 / dt)
        assert np.all(v[tenth:] < v[:-tenth])
        shares.append(np.abs((np.diff(v) - dt * rate[:-1]) / v[:-1]).max())
    assert shares[1] == pytest.approx(0.01 * shares[0], rel=0.05)
    assert v[-1] < 1e-4 * v[0]


def test_adaptation_finds_a_constant_disturbance_and_only_that() -> None:
    """The error vanishes with adaptation; without, d/(1 + c1 c2) is left; of a sine something always is."""
    with_, without = (run(Backstepping(gamma=g), 6.0, disturbance=lambda t: 10.0) for g in (400.0, 0.0))
    assert abs(with_.e[-1]) < 1e-9
    assert with_.state[-1][0] == pytest.approx(10.0, abs=1e-6)
    assert without.e[-1] == pytest.approx(10.0 / 101.0, rel=1e-6)
    sine = run(Backstepping(), 6.0, disturbance=lambda t: 10.0 * math.sin(t))
    assert 1e-4 < np.abs(sine.e[-3000:]).max() < 0.01


# PD with gravity compensation.


SETPOINT = [
    "reference={type: constant, position: [0.5, -0.8, 1.2]}",
    "injection={disturbances: [], faults: []}",
]


def test_pd_with_gravity_holds_a_setpoint() -> None:
    """At rest on it, the robot stays there: no error beyond rounding."""
    at = "initial_state={position: [0.5, -0.8, 1.2]}"
    trace = simulate(load("paper", [*SETPOINT, at, "duration=0.5"], "pd_gravity"))
    assert np.abs(trace.error).max() < 1e-12


@pytest.mark.parametrize("start", [[0.0, 0.0, 0.0], [3.0, -3.0, 2.0]])
def test_pd_with_gravity_reaches_a_setpoint_and_its_energy_falls(start: list[float]) -> None:
    """From anywhere; V = ½ vᵀ M v + ½ eᵀ kp e grows in no tick but by what holding the torque costs."""
    trace = simulate(
        load("paper", [*SETPOINT, f"initial_state={{position: {start}}}", "duration=5"], "pd_gravity")
    )
    assert np.abs(trace.error[-1]).max() < 1e-9
    law = trace.scenario.controller
    v = np.array(
        [
            0.5 * rate @ mass_matrix(ROBOT, tuple(q)) @ rate + 0.5 * np.array(law.kp) @ (e * e)
            for q, rate, e in zip(trace.position, trace.velocity, trace.error)
        ]
    )
    assert np.diff(v).max() < 1e-4 * v[0]
    assert v[-1] < 1e-12 * v[0]


def test_pd_with_gravity_leaves_what_its_stiffness_says_of_an_unknown_torque() -> None:
    """A payload that the model does not know: at rest e = -(its weight's torque)/kp, joint by joint."""
    trace = simulate(
        load("paper", [*SETPOINT, "plant={robot: {payload_mass: 3}}", "duration=6"], "pd_gravity")
    )
    q = tuple(trace.position[-1].tolist())
    weight = np.array(Puma560(payload_mass=3.0).gravity(q)) - ROBOT.gravity(q)
    assert np.abs(weight).max() > 10.0
    assert trace.error[-1] == pytest.approx(-weight / trace.scenario.controller.kp, abs=1e-9)
