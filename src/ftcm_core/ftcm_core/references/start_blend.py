# SPDX-License-Identifier: Apache-2.0
"""A gentle start: a reference that begins with the robot's present motion."""

from __future__ import annotations

from typing import NamedTuple

from ftcm_core.references import Reference
from ftcm_core.signals import ReferencePoint, Vector


class StartBlend(NamedTuple):
    """x = x_r + δ: from the motion at ``begin`` to the reference x_r, which it meets ``ramp`` seconds later.

    δ is a polynomial of degree five in time. At first it makes position and velocity those of the robot, and
    the acceleration zero; in the end δ and its first two derivatives are zero.
    """

    reference: Reference
    begin: float
    """s"""
    ramp: float
    """s; above 0"""
    position: Vector
    """Of the joints at ``begin``, rad."""
    velocity: Vector
    """rad/s"""

    def at(self, t: float, joints: int) -> ReferencePoint:
        """Desired motion at a time t (s), not before ``begin``."""
        goal = self.reference.at(t, joints)
        since = t - self.begin
        if since >= self.ramp:
            return goal
        at_first = self.reference.at(self.begin, joints)
        q, v, a = [], [], []
        for qr, vr, ar, q0, v0, q1, v1, a1 in zip(*goal, self.position, self.velocity, *at_first):
            d, dd, ddd = fading(since, self.ramp, q0 - q1, v0 - v1, -a1)
            q.append(qr + d)
            v.append(vr + dd)
            a.append(ar + ddd)
        return ReferencePoint(tuple(q), tuple(v), tuple(a))


def fading(t: float, ramp: float, d: float, dd: float, ddd: float) -> tuple[float, float, float]:
    """Return a polynomial of degree five, and its first two derivatives, that goes to zero.

    Args:
        t: time, s, from 0 to ramp.
        ramp: time at which all three are zero, s.
        d: its value at t = 0.
        dd: its first derivative there, 1/s.
        ddd: its second derivative there, 1/s².
    """
    x, w, c = t / ramp, dd * ramp, ddd * ramp * ramp
    y = 1.0 - x
    value = y**3 * (d * (1.0 + x * (3.0 + 6.0 * x)) + w * x * (1.0 + 3.0 * x) + 0.5 * c * x * x)
    slope = y * y * (
        -30.0 * d * x * x + w * (1.0 + x * (2.0 - 15.0 * x)) + 0.5 * c * x * (2.0 - 5.0 * x)
    )  # fmt: skip
    curve = y * (
        d * 60.0 * x * (2.0 * x - 1.0) + w * x * (60.0 * x - 36.0) + c * (1.0 + x * (10.0 * x - 8.0))
    )  # fmt: skip
    return value, slope / ramp, curve / (ramp * ramp)
