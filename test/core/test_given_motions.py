# SPDX-License-Identifier: Apache-2.0
"""Motions that begin while a run is on: the gentle start, and trajectories through points."""

from __future__ import annotations

import math
from itertools import pairwise
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from ftcm_core.errors import FtcmError
from ftcm_core.limits import Limits
from ftcm_core.references.start_blend import StartBlend
from ftcm_core.references.trajectory import Trajectory, Waypoint, followed, held
from ftcm_core.scenario import load

NAMES = ("a", "b")
REST = (0.0, 0.0)
H = 1e-5
"""Step of difference quotients, s."""


def slope(motion: Any, t: float, order: int, joints: int) -> list[float]:
    """Difference quotient of position (0) or velocity (1)."""
    after, before = motion.at(t + H, joints)[order], motion.at(t - H, joints)[order]
    return [(a - b) / (2 * H) for a, b in zip(after, before)]


def test_the_reference_begins_with_the_measured_motion_and_comes_to_the_scenarios() -> None:
    reference, begin, ramp = load("paper").reference, 1.0, 0.5
    q, v = (0.3, -0.2, 0.1), (0.5, 0.0, -1.0)
    blend = StartBlend(reference, begin, ramp, q, v)
    at_first = blend.at(begin, 3)
    assert at_first.position == pytest.approx(q, abs=1e-15)
    assert at_first.velocity == pytest.approx(v, abs=1e-15)
    assert at_first.acceleration == pytest.approx((0.0, 0.0, 0.0), abs=1e-12)
    for t in (1.5, 1.7):
        assert blend.at(t, 3) == reference.at(t, 3)
    for t in (1.1, 1.3, 1.49, 1.5 - H):
        for order in (0, 1):
            assert slope(blend, t, order, 3) == pytest.approx(blend.at(t, 3)[order + 1], abs=1e-6)


numbers = st.floats(-3.0, 3.0)
vectors = st.tuples(numbers, numbers)


@given(st.lists(st.tuples(st.floats(0.1, 2.0), vectors, vectors), min_size=2, max_size=6), st.booleans())
def test_it_goes_through_the_points_and_velocity_and_acceleration_are_derivatives(
    drawn: list[tuple[float, Any, Any]], cubic: bool
) -> None:
    time, points = 0.0, []
    for length, position, velocity in drawn:
        time += length
        points.append(Waypoint(time, position, velocity if cubic else ()))
    motion = Trajectory(tuple(points))
    for a, b in pairwise(points):
        at_a, middle = motion.at(a.time, 2), a.time + 0.37 * (b.time - a.time)
        assert at_a.position == pytest.approx(a.position, abs=1e-12)
        assert not cubic or at_a.velocity == pytest.approx(a.velocity, abs=1e-12)
        assert slope(motion, middle, 0, 2) == pytest.approx(motion.at(middle, 2).velocity, abs=1e-5)
        assert slope(motion, middle, 1, 2) == pytest.approx(motion.at(middle, 2).acceleration, abs=1e-5)
        just_before = motion.at(b.time - 1e-9, 2)
        assert just_before.position == pytest.approx(b.position, abs=1e-6)
        if not cubic:
            share = [p + 0.37 * (q - p) for p, q in zip(a.position, b.position)]
            assert motion.at(middle, 2).position == pytest.approx(share, abs=1e-12)
    for t in (points[-1].time, points[-1].time + 1.0):
        assert motion.at(t, 2) == (points[-1].position, REST, REST)


def follow(*points: Waypoint, now: float = 2.0, begin: float = 2.0, before: Any = None, **limits: Any) -> Any:
    """Follow points from the position (1, 1) on, unless there is another motion before."""
    return followed(points, now, begin, before or held((1.0, 1.0)), NAMES, Limits(**limits))


def test_a_motion_begins_where_the_one_before_is_and_as_fast() -> None:
    first = follow(Waypoint(2.0, (3.0, -1.0), REST))
    assert first.at(3.0, 2).position == (2.0, 0.0)
    second = follow(Waypoint(1.0, (0.0, 0.0), REST), now=3.0, begin=3.0, before=first)
    for order in (0, 1):
        assert second.at(3.0, 2)[order] == pytest.approx(first.at(3.0, 2)[order], abs=1e-12)
    assert second.at(4.0, 2).position == (0.0, 0.0)


def test_one_that_began_in_the_past_is_met_at_its_next_point_and_one_of_the_future_waits() -> None:
    points = [Waypoint(0.0, (9.0, 9.0)), Waypoint(1.0, (8.0, 8.0)), Waypoint(3.0, (2.0, 2.0))]
    late = follow(*points, now=2.0, begin=0.5)
    assert [point.time for point in late.points] == [2.0, 3.5]
    assert late.at(2.0, 2).position == (1.0, 1.0)
    before = follow(Waypoint(4.0, (5.0, 5.0)))
    waiting = follow(Waypoint(1.0, (0.0, 0.0)), now=3.0, begin=5.0, before=before)
    assert waiting.at(4.0, 2) == before.at(4.0, 2)
    assert waiting.at(5.0, 2).position == before.at(5.0, 2).position
    again = follow(Waypoint(1.0, (0.0, 0.0)), now=5.5, begin=7.0, before=waiting)
    assert again.before.before is None  # what is past is forgotten


@pytest.mark.parametrize(
    ("points", "limits", "text"),
    [
        ([], {}, "there are no points"),
        ([Waypoint(-1.0, REST)], {}, "point 0: time_from_start is -1 s; expected 0 s or more"),
        (
            [Waypoint(1.0, REST), Waypoint(1.0, REST)],
            {},
            "point 1: time_from_start is 1 s; expected more than 1",
        ),
        ([Waypoint(math.nan, REST)], {}, "point 0: time_from_start is nan s"),
        ([Waypoint(1.0, (1.0,))], {}, "point 0: 1 positions; expected one per joint (2)"),
        ([Waypoint(1.0, ())], {}, "point 0: 0 positions; expected one per joint (2)"),
        ([Waypoint(1.0, REST, (1.0,))], {}, "point 0: 1 velocities; expected one per joint (2)"),
        ([Waypoint(1.0, (math.inf, 0.0))], {}, "point 0: positions [inf, 0.0] are not finite"),
        ([Waypoint(1.0, REST, (0.0, 0.1))], {}, "the last velocity is [0.0, 0.1]; expected zeros"),
        ([Waypoint(0.0, REST)], {}, "it ends at t = 2 s, but it is t = 2 s already"),
        ([Waypoint(1.0, (1.0, 2.5))], {"upper": (2.0, 2.0)}, "at t = 3 s: b: position 2.5 rad is above"),
        ([Waypoint(0.1, REST)], {"velocity": (5.0, 5.0)}, "at t = 2.1 s: a: velocity -10 rad/s is beyond"),
    ],
)
def test_what_cannot_be_followed_is_refused_in_one_line(
    points: list[Waypoint], limits: dict[str, Any], text: str
) -> None:
    with pytest.raises(FtcmError) as error:
        follow(*points, **limits)
    assert text in str(error.value)
    assert "\n" not in str(error.value)
