# SPDX-License-Identifier: Apache-2.0
"""PUMA 560, joints 1 to 3, joints 4 to 6 locked at zero: the explicit model of Armstrong et al.

Armstrong, Khatib, Burdick, "The explicit dynamic model and inertial parameters of the PUMA 560 arm",
ICRA 1986 (reference [65] of the paper). Joint 1 turns about the vertical, so gravity does not load it.

The explicit model is linear in moments of the links' masses (:func:`link_terms`). At the default parameters
its coefficients are those that Armstrong prints; other masses, centres or inertias add the difference that
they make in :func:`link_terms`. (Armstrong's printed I1 and I3 differ from his own link data by 7.9 % and
13.9 %. The products of inertia of the locked wrist do not vary: they stand in the printed coefficients only,
and :func:`link_terms` lacks them in I13, P, Q and S.)
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property, lru_cache
from math import cos, sin
from typing import ClassVar, NamedTuple

from ftcm_core.errors import ParameterError
from ftcm_core.params import param, per_joint
from ftcm_core.registry import register
from ftcm_core.robots import Robot, friction, serial_chain
from ftcm_core.signals import Vector

# Armstrong's inertial constants, kg·m²; those that only concern joints 4 to 6 drop out.
I1, I2, I3, I4, I5, I6, I7, I8 = 1.43, 1.75, 1.38, 0.690, 0.372, 0.333, 0.298, -0.134
I9, I10, I11, I12, I13 = 0.0238, -0.0213, -0.0142, -0.0110, -0.00379
I15, I16, I18, I21, I22 = 0.00125, 0.00124, 0.000431, -0.0001, -0.000058
# Gravity constants, N·m.
G1, G2, G3, G4, G5 = -37.2, -8.44, 1.02, 0.249, -0.0282

# Modified Denavit-Hartenberg lengths, m.
A2, A3, D2, D3, D4 = 0.4318, -0.0203, 0.2435, -0.0934, 0.4331
GRAVITY = 9.81

_NO_BODY = serial_chain.Body(*(0.0,) * 10)
CHAIN = (
    serial_chain.Link(0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, _NO_BODY),
    serial_chain.Link(0, 0.0, 0.0, -1.0, 0.0, D2, 0.0, _NO_BODY),
    serial_chain.Link(0, 0.0, 1.0, 0.0, A2, 0.0, D3, _NO_BODY),
)
"""The joints' frames, in which the links of ``config/robots/puma560.urdf`` are given."""


class Terms(NamedTuple):
    """Coefficients of the explicit model, named as in Armstrong's paper or by what they multiply."""

    i1: float
    i2: float
    i3: float
    i4: float
    i6: float
    i9: float
    i11: float
    i12: float
    i13: float
    p: float
    q: float
    r: float
    s: float
    g1: float
    g3: float
    g4: float
    g35: float


PRINTED = Terms(
    I1, I2, I3, I4, I6, I9, I11, I12, I13,
    p=I7 + I21 + 2.0 * I15, q=I10 + 2.0 * I22, r=I5 + I16, s=I8 - I18, g1=G1, g3=G3, g4=G4, g35=G2 + G5,
)  # fmt: skip


class Link(NamedTuple):
    """Mass (kg), centre (m) and inertia about it (kg·m²) of one link, in its own frame."""

    mass: float
    centre: tuple[float, float, float]
    inertia: tuple[float, float, float]


def moments(link: Link, payload: float, at: tuple[float, float, float]) -> tuple[float, ...]:
    """First and second moments of a link's mass, and of a point mass on it, about the frame's origin.

    Args:
        link: the link.
        payload: the point mass, kg.
        at: where it is, m.

    Returns:
        Σm, Σmx, Σmy, Σmz (kg, kg·m); Σmx², Σmy², Σmz², Σmxy, Σmxz, Σmyz (kg·m²).
    """
    m, (x, y, z), (ixx, iyy, izz) = link
    n, (a, b, c) = payload, at
    half = 0.5 * (ixx + iyy + izz)
    return (
        m + n, m * x + n * a, m * y + n * b, m * z + n * c,
        half - ixx + m * x * x + n * a * a, half - iyy + m * y * y + n * b * b,
        half - izz + m * z * z + n * c * c,
        m * x * y + n * a * b, m * x * z + n * a * c, m * y * z + n * b * c,
    )  # fmt: skip


def link_terms(links: Sequence[Link], payload: float = 0.0, distance: float = 0.0) -> Terms:
    """Coefficients of the explicit model from the links.

    Args:
        links: links 1 to 3, the wrist locked on link 3.
        payload: point mass on the wrist's axis, kg.
        distance: how far beyond the centre of the wrist it is, m.
    """
    first, second, third = links
    m2, x2, y2, z2, xx2, yy2, zz2, xy2, xz2, yz2 = moments(second, 0.0, (0.0, 0.0, 0.0))
    m3, x3, y3, z3, xx3, yy3, zz3, xy3, xz3, yz3 = moments(third, payload, (A3, -D4 - distance, 0.0))
    d = D2 + D3
    return Terms(
        i1=first.inertia[2]
        + first.mass * (first.centre[0] ** 2 + first.centre[1] ** 2)
        + yy2
        + zz2
        + 2.0 * D2 * z2
        + D2 * D2 * m2
        + xx3
        + zz3
        + 2.0 * d * z3
        + d * d * m3,
        i2=xx2 + yy2 + A2 * A2 * m3,
        i3=xx2 - yy2 + A2 * A2 * m3,
        i4=D2 * x2 + xz2 + A2 * (d * m3 + z3),
        i6=xx3 + yy3 - 2.0 * I15,
        i9=D2 * y2 + yz2,
        i11=-2.0 * xy2,
        i12=A2 * x3,
        i13=d * x3 + xz3,
        p=yy3 - xx3,
        q=-2.0 * xy3,
        r=-A2 * y3,
        s=d * y3 + yz3,
        g1=-GRAVITY * (x2 + A2 * m3),
        g3=GRAVITY * y2,
        g4=-GRAVITY * x3,
        g35=GRAVITY * y3,
    )


def inertia(k: Vector, q: Vector) -> tuple[Vector, Vector]:
    """Inertia matrix of the explicit model.

    Args:
        k: coefficients, :attr:`Puma560.coefficients`.
        q: joint positions, rad.

    Returns:
        Entries m11, m12, m13, m22, m23, m33 of M(q), kg·m²; and the sines and cosines of q2, q3 and q2 + q3,
        for :func:`loads`.
    """
    i3, i4, i9, i11, i12, i13, p, q_, r, s, m11, m22, m23, m33, _, _, _, _ = k
    _, q2, q3 = q
    s2, c2, s3, c3 = sin(q2), cos(q2), sin(q3), cos(q3)
    s23, c23 = s2 * c3 + c2 * s3, c2 * c3 - s2 * s3
    m13 = s * c23 + i13 * s23
    half23 = r * s3 + i12 * c3
    return (
        m11
        + i3 * c2 * c2
        + p * s23 * s23
        + q_ * s23 * c23
        + i11 * s2 * c2
        + 2.0 * c2 * (r * s23 + i12 * c23),
        i4 * s2 + i9 * c2 + m13,
        m13,
        m22 + 2.0 * half23,
        m23 + half23,
        m33,
    ), (s2, c2, s3, c3, s23, c23)


@lru_cache(maxsize=16)
def indefinite(k: Vector) -> tuple[float, float] | None:
    """Where M(q) is not positive definite, of a grid of positions.

    Args:
        k: coefficients, as of :func:`inertia`. Of a campaign's runs most have the same.

    Returns:
        q2 and q3, rad; None if it is everywhere.
    """
    for j in range(-6, 7):
        for i in range(-6, 7):
            m11, m12, m13, m22, m23, m33 = inertia(k, (0.0, 0.5 * i, 0.5 * j))[0]
            minor = m22 - m12 * m12 / m11 if m11 > 0.0 else 0.0
            rest = m23 - m12 * m13 / m11 if m11 > 0.0 else 0.0
            if minor <= 0.0 or m33 - m13 * m13 / m11 - rest * rest / minor <= 0.0:
                return 0.5 * i, 0.5 * j
    return None


def inertia_rate(k: Vector, q: Vector, v: Vector) -> Vector:
    """Rate of the inertia matrix of the explicit model along v.

    Args:
        k: coefficients, as of :func:`inertia`.
        q: joint positions, rad.
        v: joint velocities, rad/s.

    Returns:
        Rates of the entries that :func:`inertia` returns, kg·m²/s.
    """
    i3, i4, i9, i11, i12, i13, p, q_, r, s, *_ = k
    _, q2, q3 = q
    _, d2, d3 = v
    s2, c2, s3, c3 = sin(q2), cos(q2), sin(q3), cos(q3)
    s23, c23 = s2 * c3 + c2 * s3, c2 * c3 - s2 * s3
    d23 = d2 + d3
    m13 = (i13 * c23 - s * s23) * d23
    half23 = (r * c3 - i12 * s3) * d3
    return (
        d2 * (i11 * (c2 * c2 - s2 * s2) - 2.0 * i3 * s2 * c2 - 2.0 * s2 * (r * s23 + i12 * c23))
        + d23 * (2.0 * p * s23 * c23 + q_ * (c23 * c23 - s23 * s23) + 2.0 * c2 * (r * c23 - i12 * s23)),
        (i4 * c2 - i9 * s2) * d2 + m13,
        m13,
        2.0 * half23,
        half23,
        0.0,
    )


def loads(k: Vector, v: Vector, trig: Vector) -> tuple[float, float, float, float, float]:
    """Velocity and gravity torques of the explicit model.

    Args:
        k: coefficients, as of :func:`inertia`.
        v: joint velocities, rad/s.
        trig: sines and cosines, as :func:`inertia` returns them.

    Returns:
        h1, h2, h3 of h(q, v) and G2, G3 of G(q), N·m; G1 is zero.
    """
    i3, i4, i9, i11, i12, i13, p, q_, r, s, _, _, _, _, k1, k3, k4, k35 = k
    d1, d2, d3 = v
    s2, c2, s3, c3, s23, c23 = trig
    s223 = s2 * c23 + c2 * s23
    c223 = c2 * c23 - s2 * s23
    ps = p * s23 * c23
    qs = q_ * (1.0 - 2.0 * s23 * s23)
    b112 = 2.0 * (-i3 * s2 * c2 + r * c223 + ps - i12 * s223) + qs + i11 * (1.0 - 2.0 * s2 * s2)
    b113 = 2.0 * (r * c2 * c23 + ps - i12 * c2 * s23) + qs
    b123 = 2.0 * (-s * s23 + i13 * c23)
    b223 = 2.0 * (r * c3 - i12 * s3)
    c12 = i4 * c2 - s * s23 - i9 * s2 + i13 * c23
    half223 = 0.5 * b223
    g3 = k35 * s23 + k4 * c23
    return (
        b112 * d1 * d2 + b113 * d1 * d3 + b123 * d2 * d3 + c12 * d2 * d2 + 0.5 * b123 * d3 * d3,
        -0.5 * b112 * d1 * d1 + b223 * d2 * d3 + half223 * d3 * d3,
        -0.5 * b113 * d1 * d1 - half223 * d2 * d2,
        k1 * c2 + k3 * s2 + g3,
        g3,
    )


def solve3(m: Vector, t1: float, t2: float, t3: float) -> Vector:
    """Solve M a = (t1, t2, t3) for the symmetric positive definite M, by its LDLᵀ factors."""
    m11, m12, m13, m22, m23, m33 = m
    l21 = m12 / m11
    l31 = m13 / m11
    d2 = m22 - l21 * m12
    u23 = m23 - l21 * m13
    l32 = u23 / d2
    d3 = m33 - l31 * m13 - l32 * u23
    y2 = t2 - l21 * t1
    a3 = (t3 - l31 * t1 - l32 * y2) / d3
    a2 = y2 / d2 - l32 * a3
    return t1 / m11 - l21 * a2 - l31 * a3, a2, a3


def multiply(m: Vector, a: Vector) -> Vector:
    """Product M a."""
    m11, m12, m13, m22, m23, m33 = m
    a1, a2, a3 = a
    return m11 * a1 + m12 * a2 + m13 * a3, m12 * a1 + m22 * a2 + m23 * a3, m13 * a1 + m23 * a2 + m33 * a3


REST = (0.0, 0.0, 0.0)
_DATA = "Armstrong 1986, tables 4 to 6; link 3 with the locked wrist: docs/equations.md"


@register("robot", "puma560")
class Puma560(Robot):
    """PUMA 560, first three joints, explicit model of Armstrong, Khatib and Burdick (1986)."""

    mass: tuple[float, ...] = param(
        (0.0, 17.4, 6.05), unit="kg", at_least=0.0, per_joint=True, doc="masses of the links", source=_DATA
    )
    centre_x: tuple[float, ...] = param(
        (0.0, 0.068, -0.004194), unit="m", at_least=-1.0, at_most=1.0, per_joint=True,
        doc="centres of mass in the links' frames, x", source=_DATA,
    )  # fmt: skip
    centre_y: tuple[float, ...] = param(
        (0.0, 0.006, -0.142921), unit="m", at_least=-1.0, at_most=1.0, per_joint=True,
        doc="centres of mass in the links' frames, y", source=_DATA,
    )  # fmt: skip
    centre_z: tuple[float, ...] = param(
        (0.0, -0.016, 0.011107), unit="m", at_least=-1.0, at_most=1.0, per_joint=True,
        doc="centres of mass in the links' frames, z", source=_DATA,
    )  # fmt: skip
    inertia_xx: tuple[float, ...] = param(
        (0.0, 0.13, 0.192241), unit="kg·m²", at_least=0.0, per_joint=True,
        doc="inertias about the centres of mass, about x", source=_DATA,
    )  # fmt: skip
    inertia_yy: tuple[float, ...] = param(
        (0.0, 0.524, 0.014743), unit="kg·m²", at_least=0.0, per_joint=True,
        doc="inertias about the centres of mass, about y", source=_DATA,
    )  # fmt: skip
    inertia_zz: tuple[float, ...] = param(
        (0.35, 0.539, 0.212555), unit="kg·m²", at_least=0.0, per_joint=True,
        doc="inertias about the centres of mass, about z", source=_DATA,
    )  # fmt: skip
    motor_inertia: tuple[float, ...] = param(
        (1.14, 4.71, 0.827), unit="kg·m²", at_least=0.0, per_joint=True,
        doc="motor inertias seen at the joints", source="Armstrong 1986, table 6",
    )  # fmt: skip
    gravity_acceleration: float = param(
        GRAVITY, unit="m/s²", at_least=0.0, doc="acceleration of gravity, downwards", source="chosen: Earth's"
    )
    payload_mass: float = param(
        0.0, unit="kg", at_least=0.0, doc="point mass at the tip", source="sec. IV: none"
    )
    payload_distance: float = param(
        0.056, unit="m", at_least=0.0, at_most=1.0, doc="from the centre of the wrist to the tip",
        source="chosen: the flange",
    )  # fmt: skip
    viscous_friction: float = param(
        0.0, unit="N·m·s/rad", at_least=0.0, per_joint=True, doc="viscous friction of the joints",
        source="sec. IV: none besides eq 43",
    )  # fmt: skip
    coulomb_friction: float = param(
        0.0, unit="N·m", at_least=0.0, per_joint=True, doc="Coulomb friction of the joints",
        source="sec. IV: none besides eq 43",
    )  # fmt: skip
    slip_velocity: float = param(
        0.01, unit="rad/s", above=0.0, per_joint=True,
        doc="velocity scale v_s of the Coulomb friction, which grows as tanh(v/v_s)",
        source="chosen: smooth for ticks of 1 ms",
    )  # fmt: skip

    joint_names: ClassVar[tuple[str, ...]] = ("joint1", "joint2", "joint3")

    def check(self) -> None:
        """The mass matrix must be positive definite wherever the arm is."""
        try:
            self.check_joints(3)
        except ParameterError:  # the scenario says so
            return
        where = indefinite(self.coefficients)
        if where:
            raise ParameterError(
                "mass: with these masses, centres and inertias the mass matrix is not positive "
                f"definite at q2 = {where[0]:g}, q3 = {where[1]:g} rad; expected a body that can exist"
            )

    @cached_property
    def terms(self) -> Terms:
        """Coefficients of the explicit model; those that Armstrong prints, at the default parameters."""
        mine = link_terms(links(self), self.payload_mass, self.payload_distance)
        found = Terms(*[a + (b - c) for a, b, c in zip(PRINTED, mine, DEFAULT)])
        share = self.gravity_acceleration / GRAVITY
        return found._replace(**{name: getattr(found, name) * share for name in ("g1", "g3", "g4", "g35")})

    @cached_property
    def coefficients(self) -> Vector:
        """Coefficients of :func:`inertia` and :func:`loads`, kg·m² and N·m."""
        t = self.terms
        im1, im2, im3 = per_joint(self.motor_inertia, 3)
        m22, m23, m33 = im2 + t.i2 + t.i6 + 2.0 * I15, t.i6 + 2.0 * I15, im3 + t.i6 + 2.0 * I15
        inertias = (t.i3, t.i4, t.i9, t.i11, t.i12, t.i13, t.p, t.q, t.r, t.s, im1 + t.i1, m22, m23, m33)
        return (*inertias, t.g1, t.g3, t.g4, t.g35)

    @cached_property
    def _friction(self) -> tuple[Vector, ...]:
        """Viscous and Coulomb friction and the scale of its growth, per joint; empty without friction."""
        found = [per_joint(x, 3) for x in (self.viscous_friction, self.coulomb_friction, self.slip_velocity)]
        return tuple(zip(*found)) if any(found[0] + found[1]) else ()

    def gravity(self, q: Vector) -> Vector:
        """Gravity torque G(q), N·m."""
        _, trig = inertia(self.coefficients, q)
        *_, g2, g3 = loads(self.coefficients, REST, trig)
        return 0.0, g2, g3

    def inertia_torque(self, q: Vector, a: Vector) -> Vector:
        """Torque M(q) a, N·m."""
        return multiply(inertia(self.coefficients, q)[0], a)

    def inertia_rate_torque(self, q: Vector, v: Vector) -> Vector:
        """Torque Ṁ(q) v, N·m."""
        return multiply(inertia_rate(self.coefficients, q, v), v)

    def inverse_dynamics(self, q: Vector, v: Vector, a: Vector) -> Vector:
        """Torque M(q) a + h(q, v) + G(q) + F(v), N·m."""
        m, trig = inertia(self.coefficients, q)
        h1, h2, h3, g2, g3 = loads(self.coefficients, v, trig)
        m1, m2, m3 = multiply(m, a)
        if self._friction:
            f1, f2, f3 = [friction(vi, *f) for vi, f in zip(v, self._friction)]
            return m1 + h1 + f1, m2 + h2 + g2 + f2, m3 + h3 + g3 + f3
        return m1 + h1, m2 + h2 + g2, m3 + h3 + g3

    def forward_dynamics(self, q: Vector, v: Vector, tau: Vector) -> Vector:
        """Acceleration M(q)^-1 (tau - h(q, v) - G(q) - F(v)), rad/s²."""
        t1, t2, t3 = tau
        if self._friction:
            t1, t2, t3 = [t - friction(vi, *f) for t, vi, f in zip(tau, v, self._friction)]
        m, trig = inertia(self.coefficients, q)
        h1, h2, h3, g2, g3 = loads(self.coefficients, v, trig)
        return solve3(m, t1 - h1, t2 - h2 - g2, t3 - h3 - g3)

    def inertia_acceleration(self, q: Vector, tau: Vector) -> Vector:
        """Acceleration M(q)^-1 tau, rad/s²."""
        return solve3(inertia(self.coefficients, q)[0], *tau)

    def tip_torque(self, q: Vector, force: Vector) -> Vector:
        """Joint torques J(q)ᵀ F of a force at the tip, N·m.

        The tip is where the payload is, on the wrist's axis. The base frame has its origin in the shoulder, z
        upwards; at q = 0 the upper arm points along x.

        Args:
            q: joint positions, rad.
            force: F in the base frame, N.
        """
        q1, q2, q3 = q
        fx, fy, fz = force
        c1, s1, c23, s23 = cos(q1), sin(q1), cos(q2 + q3), sin(q2 + q3)
        length, side = D4 + self.payload_distance, D2 + D3
        out3, up3 = A3 * c23 + length * s23, length * c23 - A3 * s23  # from the elbow to the tip
        out, up = A2 * cos(q2) + out3, up3 - A2 * sin(q2)  # from the shoulder, in the plane of the arm
        forwards, sideways = c1 * fx + s1 * fy, c1 * fy - s1 * fx
        return out * sideways - side * forwards, up * forwards - out * fz, up3 * forwards - out3 * fz

    def forward_kinematics(self, q: Vector) -> tuple[serial_chain.Frame, ...]:
        """Where the joints' frames, and last the tip, stand in that of :meth:`tip_torque`."""
        return serial_chain.frames(serial_chain.places(CHAIN, q), 0.0, (A3, -D4 - self.payload_distance, 0.0))


def links(robot: Puma560 | type[Puma560]) -> list[Link]:
    """Links of a robot, or those of the default parameters, of the class."""
    columns = (robot.mass, robot.centre_x, robot.centre_y, robot.centre_z,
               robot.inertia_xx, robot.inertia_yy, robot.inertia_zz)  # fmt: skip
    rows = zip(*(per_joint(column, 3) for column in columns))
    return [Link(m, (x, y, z), (xx, yy, zz)) for m, x, y, z, xx, yy, zz in rows]


DEFAULT = link_terms(links(Puma560))
"""Coefficients of the links at their default parameters."""
