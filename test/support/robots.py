# SPDX-License-Identifier: Apache-2.0
"""Robots of 1, 2 and 6 joints, for tests: a plug-in file as a user writes one (``--plugin robots.py``).

The third says no more than its inverse dynamics. See :mod:`plugins` for how tests have them without the rest
of the tests noticing.
"""

from __future__ import annotations

import math
from typing import ClassVar

from ftcm_core.params import param, per_joint
from ftcm_core.registry import register
from ftcm_core.robots import Robot
from ftcm_core.signals import Vector

GRAVITY = 9.81


@register("robot", "pendulum")
class Pendulum(Robot):
    """Pendulum: m l² a + b v + m g l sin q = tau, the payload at its tip too."""

    mass: float = param(2.0, unit="kg", above=0.0, per_joint=True, doc="mass at the tip", source="chosen")
    length: float = param(0.5, unit="m", above=0.0, per_joint=True, doc="length", source="chosen")
    damping: float = param(
        0.0, unit="N·m·s/rad", at_least=0.0, per_joint=True, doc="viscous friction", source="chosen"
    )
    payload_mass: float = param(0.0, unit="kg", at_least=0.0, doc="mass beside it", source="chosen")

    joint_names: ClassVar[tuple[str, ...]] = ("swing",)

    def _inertia(self) -> float:
        (m,), (length,) = per_joint(self.mass, 1), per_joint(self.length, 1)
        return (m + self.payload_mass) * length * length

    def _weight(self) -> float:
        (m,), (length,) = per_joint(self.mass, 1), per_joint(self.length, 1)
        return (m + self.payload_mass) * length * GRAVITY

    def gravity(self, q: Vector) -> Vector:
        """M g l sin q, N·m."""
        return (self._weight() * math.sin(q[0]),)

    def inertia_torque(self, q: Vector, a: Vector) -> Vector:
        """M l² a, N·m."""
        return (self._inertia() * a[0],)

    def inverse_dynamics(self, q: Vector, v: Vector, a: Vector) -> Vector:
        """Torque of the acceleration a, N·m."""
        (b,) = per_joint(self.damping, 1)
        return (self._inertia() * a[0] + b * v[0] + self._weight() * math.sin(q[0]),)

    def forward_dynamics(self, q: Vector, v: Vector, tau: Vector) -> Vector:
        """Acceleration under a torque, rad/s²."""
        (b,) = per_joint(self.damping, 1)
        return ((tau[0] - b * v[0] - self._weight() * math.sin(q[0])) / self._inertia(),)

    def inertia_acceleration(self, q: Vector, tau: Vector) -> Vector:
        """Acceleration of a torque by itself, rad/s²."""
        return (tau[0] / self._inertia(),)

    def tip_torque(self, q: Vector, force: Vector) -> Vector:
        """Jᵀ F, N·m: it hangs along -z at q = 0 and swings towards x."""
        (length,) = per_joint(self.length, 1)
        return (length * (math.cos(q[0]) * force[0] + math.sin(q[0]) * force[2]),)


@register("robot", "planar_arm")
class PlanarArm(Robot):
    """Two links in a vertical plane, masses at their ends, M a + h + G = tau in closed form."""

    mass: tuple[float, ...] = param(
        (3.0, 2.0), unit="kg", above=0.0, per_joint=True, doc="masses at the ends", source="chosen"
    )
    length: tuple[float, ...] = param(
        (0.5, 0.4), unit="m", above=0.0, per_joint=True, doc="lengths of the links", source="chosen"
    )
    motor_inertia: float = param(
        0.1, unit="kg·m²", above=0.0, per_joint=True, doc="motor inertias at the joints", source="chosen"
    )
    payload_mass: float = param(0.0, unit="kg", at_least=0.0, doc="mass at the tip", source="chosen")

    joint_names: ClassVar[tuple[str, ...]] = ("shoulder", "elbow")

    def _terms(self, q: Vector) -> tuple[Vector, float, Vector]:
        """M (m11, m12, m22), the factor of h, and G."""
        (m1, m2), (l1, l2) = per_joint(self.mass, 2), per_joint(self.length, 2)
        i1, i2 = per_joint(self.motor_inertia, 2)
        m2 = m2 + self.payload_mass
        c2, s2 = math.cos(q[1]), math.sin(q[1])
        a, b = m2 * l1 * l2, m2 * l2 * l2
        outer = GRAVITY * m2 * l2 * math.cos(q[0] + q[1])
        return (
            (i1 + (m1 + m2) * l1 * l1 + b + 2.0 * a * c2, b + a * c2, i2 + b),
            a * s2,
            (GRAVITY * (m1 + m2) * l1 * math.cos(q[0]) + outer, outer),
        )

    def inverse_dynamics(self, q: Vector, v: Vector, a: Vector) -> Vector:
        """Torque of the acceleration a, N·m."""
        (m11, m12, m22), s, (g1, g2) = self._terms(q)
        return (
            m11 * a[0] + m12 * a[1] - s * v[1] * (2.0 * v[0] + v[1]) + g1,
            m12 * a[0] + m22 * a[1] + s * v[0] * v[0] + g2,
        )

    def forward_dynamics(self, q: Vector, v: Vector, tau: Vector) -> Vector:
        """Acceleration under a torque, rad/s²."""
        (m11, m12, m22), s, (g1, g2) = self._terms(q)
        t1 = tau[0] + s * v[1] * (2.0 * v[0] + v[1]) - g1
        t2 = tau[1] - s * v[0] * v[0] - g2
        determinant = m11 * m22 - m12 * m12
        return (m22 * t1 - m12 * t2) / determinant, (m11 * t2 - m12 * t1) / determinant

    def tip_torque(self, q: Vector, force: Vector) -> Vector:
        """Jᵀ F, N·m: it lies along x at q = 0, z is upwards."""
        l1, l2 = per_joint(self.length, 2)
        outer = l2 * (math.cos(q[0] + q[1]) * force[2] - math.sin(q[0] + q[1]) * force[0])
        return l1 * (math.cos(q[0]) * force[2] - math.sin(q[0]) * force[0]) + outer, outer


ALPHA = (0.0, -math.pi / 2, 0.0, math.pi / 2, -math.pi / 2, math.pi / 2)
TURNS = tuple([(round(math.cos(x), 12), round(math.sin(x), 12)) for x in ALPHA])
A = (0.0, 0.0, 0.43, -0.02, 0.0, 0.0)
D = (0.0, 0.24, -0.09, 0.43, 0.0, 0.06)
CENTRE = (
    (0.0, 0.02, 0.1), (0.2, 0.01, 0.05), (0.0, -0.1, 0.01), (0.0, 0.02, -0.03), (0.0, 0.01, 0.01),
    (0.01, 0.0, 0.03),
)  # fmt: skip
INERTIA = (
    (0.2, 0.2, 0.3), (0.1, 0.5, 0.5), (0.1, 0.05, 0.1), (0.01, 0.01, 0.008), (0.005, 0.005, 0.005),
    (0.002, 0.002, 0.001),
)  # fmt: skip


@register("robot", "serial_arm")
class SerialArm(Robot):
    """Six revolute joints in modified Denavit-Hartenberg frames, recursive Newton-Euler (Craig, 1986)."""

    mass: tuple[float, ...] = param(
        (9.0, 12.0, 4.0, 1.0, 0.6, 0.3), unit="kg", above=0.0, per_joint=True, doc="masses of the links",
        source="chosen",
    )  # fmt: skip
    motor_inertia: tuple[float, ...] = param(
        (1.1, 4.0, 0.8, 0.2, 0.2, 0.2), unit="kg·m²", at_least=0.0, per_joint=True,
        doc="motor inertias seen at the joints", source="chosen",
    )  # fmt: skip

    joint_names: ClassVar[tuple[str, ...]] = tuple([f"axis{j + 1}" for j in range(6)])

    def inverse_dynamics(self, q: Vector, v: Vector, a: Vector) -> Vector:
        """Torque of the acceleration a, N·m: velocities outwards, then forces inwards."""
        masses, rotors = per_joint(self.mass, 6), per_joint(self.motor_inertia, 6)
        zero = (0.0, 0.0, 0.0)
        w, dw, dv = zero, zero, (0.0, 0.0, GRAVITY)
        frames, forces, moments = [], [], []
        for j in range(6):
            ca, sa = TURNS[j]
            frame = (math.cos(q[j]), math.sin(q[j]), ca, sa)
            offset = (A[j], -sa * D[j], ca * D[j])
            dv = inwards(frame, plus(dv, plus(cross(dw, offset), cross(w, cross(w, offset)))))
            w, dw = inwards(frame, w), inwards(frame, dw)
            dw = (dw[0] + w[1] * v[j], dw[1] - w[0] * v[j], dw[2] + a[j])
            w = (w[0], w[1], w[2] + v[j])
            at_centre = plus(dv, plus(cross(dw, CENTRE[j]), cross(w, cross(w, CENTRE[j]))))
            force = tuple([masses[j] * x for x in at_centre])
            spin = tuple([i * x for i, x in zip(INERTIA[j], w)])
            moment = plus(tuple([i * x for i, x in zip(INERTIA[j], dw)]), cross(w, spin))
            frames.append((frame, offset))
            forces.append(force)
            moments.append(plus(moment, cross(CENTRE[j], force)))
        tau: list[float] = []
        f, n = zero, zero
        for j in reversed(range(6)):
            f, n = plus(forces[j], f), plus(moments[j], n)
            tau.insert(0, n[2] + rotors[j] * a[j])
            frame, offset = frames[j]
            f = outwards(frame, f)
            n = plus(outwards(frame, n), cross(offset, f))
        return tuple(tau)


def plus(x: Vector, y: Vector) -> Vector:
    """Sum of two vectors."""
    return x[0] + y[0], x[1] + y[1], x[2] + y[2]


def cross(x: Vector, y: Vector) -> Vector:
    """Vector product."""
    return x[1] * y[2] - x[2] * y[1], x[2] * y[0] - x[0] * y[2], x[0] * y[1] - x[1] * y[0]


def outwards(frame: Vector, x: Vector) -> Vector:
    """A vector of a link's frame in the frame before it: turned by q about z, then by alpha about x."""
    c, s, ca, sa = frame
    x1, x2 = c * x[0] - s * x[1], s * x[0] + c * x[1]
    return x1, ca * x2 - sa * x[2], sa * x2 + ca * x[2]


def inwards(frame: Vector, x: Vector) -> Vector:
    """The inverse of :func:`outwards`."""
    c, s, ca, sa = frame
    x2, x3 = ca * x[1] + sa * x[2], ca * x[2] - sa * x[1]
    return c * x[0] + s * x2, c * x2 - s * x[0], x3
