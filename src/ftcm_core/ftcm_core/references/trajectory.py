# SPDX-License-Identifier: Apache-2.0
"""A motion through points, given while a run is on: as a joint trajectory controller follows it."""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Sequence
from itertools import pairwise
from math import inf, isfinite
from typing import Any, NamedTuple

from ftcm_core.errors import FtcmError
from ftcm_core.limits import Limits, motion_beyond
from ftcm_core.signals import ReferencePoint, Vector


class Waypoint(NamedTuple):
    """Where the joints shall be at a time."""

    time: float
    """s"""
    position: Vector
    """rad"""
    velocity: Vector = ()
    """rad/s; empty: not said"""


class Trajectory(NamedTuple):
    """x_r(t) through points: cubic between two that have velocities, else linear; at rest after the last."""

    points: tuple[Waypoint, ...]
    """In the order of time, the first at the begin of the motion."""
    before: Any = None
    """The reference until then; None: there was nothing before."""

    def at(self, t: float, joints: int) -> ReferencePoint:
        """Desired position (rad), velocity (rad/s) and acceleration (rad/s²) at a time t (s)."""
        points = self.points
        if t < points[0].time and self.before is not None:
            point: ReferencePoint = self.before.at(t, joints)
            return point
        n = bisect_right(points, t, key=lambda point: point.time)
        if n == len(points) or n == 0:
            rest = (0.0,) * joints
            return ReferencePoint(points[n - 1 if n else 0].position, rest, rest)
        a, b = points[n - 1], points[n]
        length = b.time - a.time
        x = (t - a.time) / length
        if a.velocity and b.velocity:
            each = [cubic(x, length, *ends) for ends in zip(a.position, a.velocity, b.position, b.velocity)]
        else:
            each = [(p + x * (q - p), (q - p) / length, 0.0) for p, q in zip(a.position, b.position)]
        position, velocity, acceleration = zip(*each)
        return ReferencePoint(position, velocity, acceleration)


def cubic(x: float, length: float, p: float, v: float, q: float, w: float) -> tuple[float, float, float]:
    """Return position, velocity and acceleration of the cubic between two points of one joint.

    Args:
        x: share of the time that has gone, 0 to 1.
        length: time between the points, s.
        p: position of the first, rad.
        v: its velocity, rad/s.
        q: position of the second, rad.
        w: its velocity, rad/s.
    """
    d, v, w = q - p, v * length, w * length
    second, third = 3.0 * d - 2.0 * v - w, v + w - 2.0 * d
    return (
        p + x * (v + x * (second + x * third)),
        (v + x * (2.0 * second + 3.0 * x * third)) / length,
        (2.0 * second + 6.0 * x * third) / (length * length),
    )


def held(position: Vector) -> Trajectory:
    """Return the motion that stays at a position, rad."""
    return Trajectory((Waypoint(0.0, position),))


def followed(
    points: Sequence[Waypoint], now: float, begin: float, before: Any, names: Sequence[str], limits: Limits
) -> Trajectory:
    """Return the motion that goes on from another one through points.

    Args:
        points: with times from the begin on; those that are past already do not count.
        now: the present time, s.
        begin: when the motion begins, s; one that began in the past is met where it is by the next point.
        before: the reference until then.
        names: of the joints.
        limits: of the robot; no point, and no mean velocity from one to the next, may be beyond them.

    Raises:
        FtcmError: it cannot be followed; one line with the point and the value.
    """
    if not points:
        raise FtcmError("there are no points; expected at least one")
    last = -inf
    for n, point in enumerate(points):
        _check(n, point, last, len(names))
        last = point.time
    if any(points[-1].velocity):
        raise FtcmError(
            f"point {len(points) - 1}: the last velocity is {list(points[-1].velocity)}; expected zeros, as "
            "the motion ends there"
        )
    start = max(now, begin)
    to_come = [point._replace(time=begin + point.time) for point in points if begin + point.time > start]
    if not to_come:
        raise FtcmError(f"it ends at t = {begin + last:g} s, but it is t = {now:g} s already")
    at_first = before.at(start, len(names))
    whole = (Waypoint(start, at_first.position, at_first.velocity), *to_come)
    for a, b in pairwise(whole):
        mean = tuple([(q - p) / (b.time - a.time) for p, q in zip(a.position, b.position)])
        for velocity in (mean, b.velocity):
            if velocity and (beyond := motion_beyond(limits, names, b.position, velocity)):
                raise FtcmError(f"at t = {b.time:g} s: {beyond}")
    if start <= now:
        return Trajectory(whole)
    if isinstance(before, Trajectory) and now >= before.points[0].time:
        before = before._replace(before=None)
    return Trajectory(whole, before)


def _check(n: int, point: Waypoint, last: float, joints: int) -> None:
    if not (last < point.time and point.time >= 0.0):
        expected = f"more than {last:g} s" if n else "0 s or more"
        raise FtcmError(f"point {n}: time_from_start is {point.time:g} s; expected {expected}")
    for what, values in (("positions", point.position), ("velocities", point.velocity)):
        if len(values) != joints and (values or what == "positions"):
            raise FtcmError(f"point {n}: {len(values)} {what}; expected one per joint ({joints})")
        if not all(map(isfinite, values)):
            raise FtcmError(f"point {n}: {what} {list(values)} are not finite")
