# SPDX-License-Identifier: Apache-2.0
"""The super-twisting observer: finite time, the condition for it, its error in dt, both its forms."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from ftcm_core.observers.super_twisting import SuperTwisting, largest_return, twist, twist_implicit
from ftcm_core.robots import Robot
from ftcm_core.robots.puma560 import Puma560
from observing import DT, PUSH, Array, estimates, held
from plugins import ROBOTS
from robot_matrices import mass_matrix

pytestmark = pytest.mark.pure

ROBOT, L = Puma560(), 200.0
FORMS = {"explicit": twist, "implicit": twist_implicit}
every_form = pytest.mark.parametrize("form", FORMS)


def zigzag(t: Array, slope: float) -> Array:
    """A disturbance of that slope, up and down, rad/s²: 5 at first, so that the estimate has to go there."""
    return 5.0 + slope * (0.05 - np.abs((t + 0.05) % 0.2 - 0.1))


def errors(form: str, slope: float, dt: float, duration: float = 1.5) -> Array:
    """Δ̂ - Δ of one joint, Δ being that of the tick that has just ended, rad/s²."""
    step: Callable[..., tuple[float, float]] = FORMS[form]
    omega = delta_hat = v = 0.0
    found = []
    for delta in zigzag(dt * np.arange(round(duration / dt)), slope).tolist():
        v -= dt * delta
        omega, delta_hat = step(1.5, 1.1, L, omega, delta_hat, 0.0, v, dt)
        found.append(delta_hat - delta)
    return np.array(found)


def bound_of_the_time(first: float) -> float:
    """When Δ̂ has converged at the latest, s: each half-turn shrinks its error by the return's share.

    In a half-turn the error goes from y to at most -Ψ y, at (λ2 - 1) L at least.
    """
    share = largest_return(1.5, 1.1)
    return (1.0 + share) / (1.0 - share) * first / ((1.1 - 1.0) * L)


@every_form
def test_converges_in_finite_time_whatever_the_slope_below_l(form: str) -> None:
    """From an error of 5 rad/s²; then the explicit form stays within 2 L dt, the implicit one is exact."""
    late = bound_of_the_time(5.0)
    assert late < 0.9
    for slope in (0.0, 50.0, -150.0, 199.0):
        error = np.abs(errors(form, slope, DT))
        assert error[0] > 4.0
        assert error[round(late / DT) :].max() < (2.0 * L * DT if form == "explicit" else 1e-9)


def test_the_error_of_the_explicit_form_is_of_first_order_in_dt() -> None:
    """Slope of the logarithms over ticks of 1 ms to 0.1 ms."""
    ticks = np.array([1e-3, 5e-4, 2e-4, 1e-4])
    late = [np.abs(errors("explicit", 150.0, dt))[round(1.0 / dt) :].max() for dt in ticks.tolist()]
    assert np.polyfit(np.log(ticks), np.log(late), 1)[0] == pytest.approx(1.0, abs=0.1)


@every_form
def test_beyond_l_it_does_not_follow(form: str) -> None:
    """Δ̂ cannot change faster than 1.1 L: a ramp of 1.5 L runs away from it."""
    omega = delta_hat = v = 0.0
    for k in range(1000):
        v -= DT * 1.5 * L * k * DT
        omega, delta_hat = FORMS[form](1.5, 1.1, L, omega, delta_hat, 0.0, v, DT)
    assert 1.5 * L * 0.999 - delta_hat == pytest.approx(0.4 * L, rel=0.01)


@settings(deadline=None, max_examples=300)
@given(
    omega=st.floats(-1.0, 1.0), delta=st.floats(-30.0, 30.0), a=st.floats(-50.0, 50.0),
    v=st.one_of(st.floats(-1.0, 1.0), st.floats(-1e-6, 1e-6)), lipschitz=st.floats(1.0, 1e5),
)  # fmt: skip
def test_the_implicit_form_solves_its_inclusion(
    omega: float, delta: float, a: float, v: float, lipschitz: float
) -> None:
    """Backward Euler of both equations: with the error that is left, and a ξ within ±1 of its sign."""
    w, d = twist_implicit(1.5, 1.1, lipschitz, omega, delta, a, v, DT)
    z, xi = w - v, (d - delta) / (DT * 1.1 * lipschitz)
    power = math.copysign(math.sqrt(abs(z)), z)
    assert w == pytest.approx(omega + DT * (a - d - 1.5 * math.sqrt(lipschitz) * power), abs=1e-9)
    assert abs(xi) <= 1.0 + 1e-9
    if abs(z) > 1e-9:
        assert xi == pytest.approx(math.copysign(1.0, z), abs=1e-7)


def test_the_explicit_form_is_forward_euler_with_the_current_error() -> None:
    """By hand: s = 0.3 + 0.001 (2 - 4) - 0.2 = 0.098."""
    w, d = twist(1.5, 1.1, 100.0, 0.3, 4.0, 2.0, 0.2, DT)
    assert w == pytest.approx(0.298 - DT * 15.0 * math.sqrt(0.098), rel=1e-14)
    assert d == pytest.approx(4.0 + DT * 110.0, rel=1e-14)


def returned(lambda1: float, lambda2: float) -> float:
    """The return's share by brute force, L = 1: s and Δ̃ by small steps, Δ̇ at its worst."""
    s, y, dt = 0.0, 1.0, 2e-5
    while s >= 0.0:
        root = math.sqrt(s)
        worst = lambda2 - 1.0 if y > lambda1 * root else lambda2 + 1.0
        # Half a step ahead, as the root is steep at zero.
        middle = max(0.0, s + 0.5 * dt * (y - lambda1 * root))
        s += dt * (y - 0.5 * dt * worst - lambda1 * math.sqrt(middle))
        y -= dt * worst
    return abs(y)


@pytest.mark.parametrize(("lambda1", "lambda2"), [(1.5, 1.1), (1.0, 1.1), (0.5, 2.0), (2.5, 1.5), (1.5, 3.0)])
def test_largest_return_is_that_of_the_worst_disturbance(lambda1: float, lambda2: float) -> None:
    """Beside a simulation of it: the three cases of the first part, growing, are among them."""
    assert largest_return(lambda1, lambda2) == pytest.approx(returned(lambda1, lambda2), abs=2e-3)


def test_what_is_known_of_the_return() -> None:
    """The customary gains have a wide margin; L must be exceeded; with a large λ1 it does not oscillate."""
    assert largest_return(1.5, 1.1) == pytest.approx(0.5374, abs=1e-4)
    assert largest_return(1.5, 1.0) == math.inf
    assert largest_return(math.sqrt(8.0 * 2.1), 1.1) == 0.0
    near = [largest_return(math.sqrt(8.0 * 0.1) + x, 1.1) for x in (-1e-9, 0.0, 1e-9)]
    assert near == pytest.approx([near[1]] * 3, rel=1e-6), "where the first part ceases to oscillate"


def test_warnings() -> None:
    """Per joint where they differ; none for the gains that come with it."""
    assert SuperTwisting().warnings(ROBOT, DT) == []
    (line,) = SuperTwisting(lambda1=[1.5, 1.5, 0.5]).warnings(ROBOT, DT)
    assert line.startswith(
        "observer super_twisting, joint 3: with lambda1=0.5 and lambda2=1.1 an error of Δ̂ can"
    )
    (line,) = SuperTwisting(lambda2=0.9).warnings(ROBOT, DT)
    assert "all joints" in line
    assert "inf times as large; expected below 1" in line


@pytest.mark.parametrize("robot", ROBOTS.values(), ids=ROBOTS)
@every_form
def test_a_constant_torque_on_a_robot_at_rest_is_found(form: str, robot: Robot) -> None:
    """Explicitly to the chattering, 2 L dt at most in each joint's acceleration, implicitly to 1e-9."""
    n = robot.joints
    observer = SuperTwisting(discretisation=form, lipschitz=2000.0)
    error = estimates(observer, robot, [held(robot)] * 400)[-50:] + PUSH[:n]
    q = held(robot).position
    chattering = np.abs(mass_matrix(robot, q)).sum(axis=1) * 2.0 * 2000.0 * DT
    assert (np.abs(error).max(axis=0) < (1e-9 if form == "implicit" else chattering)).all()
