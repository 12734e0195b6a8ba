# SPDX-License-Identifier: Apache-2.0
"""The references: eq 44 in its three printed forms, and hand-computed points of the others."""

from __future__ import annotations

import math

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from ftcm_core.references.constant import Constant
from ftcm_core.references.quintic import Quintic
from ftcm_core.references.sine import Sine
from ftcm_core.references.vo_kang_cosine import VoKangCosine


@given(st.floats(0.0, 100.0))
def test_eq_44_is_one_cosine_three_times(t: float) -> None:
    """The three lines, printed differently, are the same motion."""
    s = t / (5 * math.pi)
    printed = (0.5 + math.cos(s) - 1, -0.5 + math.sin(s + math.pi / 2), 0.5 + math.sin(s + math.pi / 2) - 1)
    assert VoKangCosine().at(t, 3).position == pytest.approx(printed, abs=1e-14)


def test_eq_44_starts_half_a_radian_away() -> None:
    """x_r(0) = 0.5 rad at rest; e(0) = -0.5 for a robot at zero."""
    position, velocity, acceleration = VoKangCosine().at(0.0, 3)
    assert position == (0.5,) * 3
    assert velocity == (0.0,) * 3
    assert acceleration == pytest.approx((-1 / (25 * math.pi**2),) * 3, rel=1e-14)


def test_constant() -> None:
    """The set-point, at rest, per joint or the same for all."""
    assert Constant(position=[1, 2, 3]).at(7.0, 3) == ((1.0, 2.0, 3.0), (0.0,) * 3, (0.0,) * 3)
    assert Constant(position=0.5).at(0.0, 2).position == (0.5, 0.5)


def test_sine() -> None:
    """1 + 2 sin(2π·0.25 t): at t = 1 s at its top; a phase of a quarter turn moves the top to t = 0."""
    sine = Sine(amplitude=2, frequency=0.25, offset=[1, 0], phase=[0, math.pi / 2])
    w = math.pi / 2
    for t, joint in ((1.0, 0), (0.0, 1)):
        position, velocity, acceleration = sine.at(t, 2)
        assert position[joint] - (1.0, 0.0)[joint] == pytest.approx(2.0, rel=1e-14)
        assert velocity[joint] == pytest.approx(0.0, abs=1e-15)
        assert acceleration[joint] == pytest.approx(-2.0 * w * w, rel=1e-14)
    assert sine.at(0.0, 2).velocity[0] == pytest.approx(2.0 * w, rel=1e-14)
    assert Sine(frequency=0).at(3.0, 1) == ((0.0,), (0.0,), (0.0,))


@settings(deadline=None)
@given(
    start=st.floats(-3.0, 3.0),
    goal=st.floats(-3.0, 3.0),
    begin=st.floats(0.0, 5.0),
    duration=st.floats(0.1, 10.0),
)
def test_quintic(start: float, goal: float, begin: float, duration: float) -> None:
    """At rest before and after; half way at half time with 15/8 of the mean speed; symmetric."""
    quintic, step = Quintic(start=start, goal=goal, begin=begin, duration=duration), goal - start
    assert quintic.at(0.0, 1) == ((start,), (0.0,), (0.0,))
    after = quintic.at(begin + 2 * duration, 1)
    assert after.position[0] == pytest.approx(goal, abs=1e-15)
    assert (after.velocity, after.acceleration) == ((0.0,), (0.0,))
    middle = quintic.at(begin + duration / 2, 1)
    assert middle.position[0] == pytest.approx(start + step / 2, abs=1e-13)
    assert middle.velocity[0] == pytest.approx(1.875 * step / duration, rel=1e-12)
    quarter, last = (quintic.at(begin + x * duration, 1) for x in (0.25, 0.75))
    assert quarter.position[0] - start == pytest.approx(53 / 512 * step, abs=1e-12)
    assert quarter.position[0] - start == pytest.approx(goal - last.position[0], abs=1e-12)
    assert quarter.acceleration[0] == pytest.approx(5.625 * step / duration**2, rel=1e-11)
    assert quarter.acceleration[0] == pytest.approx(-last.acceleration[0], rel=1e-11)
