# SPDX-License-Identifier: Apache-2.0
"""Levant's differentiator, and the observer made of it: exactness and the order of its errors in dt."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from ftcm_core.observers.homogeneous import GAIN0, GAIN1, GAIN2, differentiate, differentiate_implicit
from ftcm_core.observers.levant import Levant
from ftcm_core.robots import Robot
from ftcm_core.robots.puma560 import Puma560
from observing import DT, PUSH, Array, estimates, held, moved
from plugins import ROBOTS
from robot_matrices import mass_matrix

pytestmark = pytest.mark.pure

ROBOT, L = Puma560(), 30.0
FORMS = {"explicit": differentiate, "implicit": differentiate_implicit}


def errors(form: str, dt: float, signal: str = "sine", duration: float = 4.0) -> Array:
    """Errors of the signal and its two derivatives at every tick; its third one is below L = 30."""
    t = dt * np.arange(1, round(duration / dt) + 1)
    zero = np.zeros_like(t)
    true = {
        "sine": (np.sin(3.0 * t), 3.0 * np.cos(3.0 * t), -9.0 * np.sin(3.0 * t)),
        "parabola": (1.0 - 2.0 * t + 3.0 * t * t, -2.0 + 6.0 * t, 6.0 + zero),
        "cubic": (t - 4.0 * t**3, 1.0 - 12.0 * t * t, -24.0 * t),
    }[signal]
    z, found = (0.0, 0.0, 0.0), []
    for q in true[0].tolist():
        z = FORMS[form](L, *z, 0.0, q, dt)
        found.append(z)
    return np.abs(np.array(found) - np.array(true).T)


@pytest.mark.parametrize("signal", ["sine", "cubic"])
def test_the_errors_are_of_the_orders_3_2_and_1_in_dt(signal: str) -> None:
    """Signal, first and second derivative: exact in the limit, in finite time; slopes of the logarithms."""
    ticks = np.array([1e-3, 5e-4, 2e-4, 1e-4])
    late = np.array([errors("explicit", dt, signal)[round(3.0 / dt) :].max(axis=0) for dt in ticks])
    orders = np.polyfit(np.log(ticks), np.log(late), 1)[0]
    assert orders == pytest.approx([3.0, 2.0, 1.0], abs=0.15)


def test_on_a_parabola_the_explicit_form_is_exact_up_to_its_chattering() -> None:
    """Of the order as above, but not smoothly: it depends on where steps of 1.1 L dt fall beside the value.

    A position that is corrected by dt g0 |s|^⅔ is off by 4 (dt g0)³/27 = 32 L dt³/27 at most; the other
    two factors are those documented, which no signal or tick exceeded that was tried.
    """
    for dt in (1e-3, 5e-4, 2e-4, 1e-4):
        late = errors("explicit", dt, "parabola")[round(3.0 / dt) :].max(axis=0)
        assert (late < np.array([32.0 / 27.0 * L * dt**3, 4.5 * L * dt**2, 3.5 * L * dt])).all()


def test_the_implicit_form_is_exact_on_a_parabola() -> None:
    """To rounding, 1e-16/dt² of what the signal has grown to."""
    late = errors("implicit", DT, "parabola")[3000:]
    assert late.max(axis=0) == pytest.approx([0.0, 0.0, 0.0], abs=1e-7)


def test_of_a_changing_acceleration_the_implicit_form_lags_by_half_a_tick() -> None:
    """Off by dt/2 times the third derivative, which is 27 at most."""
    late = errors("implicit", DT)[3000:, 2].max()
    assert late == pytest.approx(0.5 * 27.0 * DT, rel=0.01)
    assert errors("explicit", DT)[3000:, 2].max() > 1.5 * late


def test_beyond_l_it_does_not_follow() -> None:
    """A third derivative of 1.5 L: the second one cannot change faster than 1.1 L."""
    z = (0.0, 0.0, 0.0)
    for k in range(1, 2001):
        z = differentiate(L, *z, 0.0, 1.5 * L * (k * DT) ** 3 / 6.0, DT)
    assert 1.5 * L * 2.0 - z[2] == pytest.approx(0.4 * L * 2.0, rel=0.02)


small = st.one_of(st.floats(-1.0, 1.0), st.floats(-1e-6, 1e-6), st.floats(-1e-12, 1e-12))


@settings(deadline=None, max_examples=500)
@given(s=small, lipschitz=st.floats(0.1, 1e6), dt=st.sampled_from([1e-5, 1e-3, 0.1]))
def test_the_implicit_form_solves_its_inclusion(s: float, lipschitz: float, dt: float) -> None:
    """Backward Euler: z + dt g0 |z|^⅔ sgn z + dt² g1 |z|^⅓ sgn z + dt³ g2 ξ = s, to rounding."""
    z, change1, change2 = differentiate_implicit(lipschitz, s, 0.0, 0.0, 0.0, 0.0, dt)
    root = lipschitz ** (1.0 / 3.0)
    g0, g1, g2 = GAIN0 * root, GAIN1 * root * root, GAIN2 * lipschitz
    y, xi = math.copysign(abs(z) ** (1.0 / 3.0), z), -change2 / (dt * g2)
    left = z + dt * g0 * y * abs(y) + dt * dt * g1 * y + dt**3 * g2 * xi
    assert left == pytest.approx(s, rel=1e-9, abs=1e-300)
    assert -change1 == pytest.approx(dt * g1 * y + dt * dt * g2 * xi, rel=1e-9, abs=1e-300)
    assert abs(xi) <= 1.0 + 1e-12
    if z != 0.0:
        assert xi == pytest.approx(math.copysign(1.0, z))


@pytest.mark.parametrize("robot", ROBOTS.values(), ids=ROBOTS)
def test_a_constant_torque_on_a_robot_at_rest_is_found_as_its_low_pass_has_it(robot: Robot) -> None:
    """A robot at rest leaves nothing to differentiate: e^{-t/T}, to rounding."""
    n = robot.joints
    found = estimates(Levant(time_constant=0.05), robot, [held(robot)] * 200)
    t = DT * np.arange(200)
    assert found + PUSH[:n] == pytest.approx(np.outer(np.exp(-t / 0.05), PUSH[:n]), abs=1e-11)


def test_in_motion_a_constant_torque_is_found_from_positions() -> None:
    """With the implicit form to 1e-2 N·m; the explicit one is off by up to 3.5 L dt of each acceleration."""
    measured = moved(ROBOT, lambda k, q: PUSH[:3], 1.5)
    off = {}
    for form in FORMS:
        found = estimates(Levant(discretisation=form), ROBOT, measured)[800:]
        off[form] = np.abs(found + PUSH[:3]).max(axis=0)
    inertia = np.abs(mass_matrix(ROBOT, measured[-1].position)).sum(axis=1)
    assert (off["implicit"] < 1e-2).all()
    assert (off["explicit"] > 0.1).all()
    assert (off["explicit"] < 3.5 * 1000.0 * DT * inertia).all()
