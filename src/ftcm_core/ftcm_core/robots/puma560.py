# SPDX-License-Identifier: Apache-2.0
"""PUMA 560, joints 1 to 3, joints 4 to 6 locked at zero: the explicit model of Armstrong et al.

Armstrong, Khatib, Burdick, "The explicit dynamic model and inertial parameters of the PUMA 560 arm",
ICRA 1986 (reference [65] of the paper). Joint 1 turns about the vertical, so gravity does not load it.
"""

from __future__ import annotations

from math import cos, sin
from typing import ClassVar

from ftcm_core.registry import register
from ftcm_core.robots import Robot
from ftcm_core.signals import Vector

# Armstrong's inertial constants, kg·m²; those that only concern joints 4 to 6 drop out.
I1, I2, I3, I4, I5, I6, I7, I8 = 1.43, 1.75, 1.38, 0.690, 0.372, 0.333, 0.298, -0.134
I9, I10, I11, I12, I13 = 0.0238, -0.0213, -0.0142, -0.0110, -0.00379
I15, I16, I18, I21, I22 = 0.00125, 0.00124, 0.000431, -0.0001, -0.000058
# Motor inertias seen at the joints, kg·m².
IM1, IM2, IM3 = 1.14, 4.71, 0.827
# Gravity constants, N·m.
G1, G2, G3, G4, G5 = -37.2, -8.44, 1.02, 0.249, -0.0282

P = I7 + I21 + 2.0 * I15
Q = I10 + 2.0 * I22
R = I5 + I16
S = I8 - I18
M11_CONSTANT = IM1 + I1
M22_CONSTANT = IM2 + I2 + I6 + 2.0 * I15
M23_CONSTANT = I6 + 2.0 * I15
M33 = IM3 + I6 + 2.0 * I15
G35 = G2 + G5


def inertia(s2: float, c2: float, s3: float, c3: float, s23: float, c23: float) -> tuple[float, ...]:
    """Independent entries of M(q), kg·m²: m11, m12, m13, m22, m23 (m33 is constant)."""
    m13 = S * c23 + I13 * s23
    half23 = R * s3 + I12 * c3
    return (
        M11_CONSTANT
        + I3 * c2 * c2
        + P * s23 * s23
        + Q * s23 * c23
        + I11 * s2 * c2
        + 2.0 * c2 * (R * s23 + I12 * c23),
        I4 * s2 + I9 * c2 + m13,
        m13,
        M22_CONSTANT + 2.0 * half23,
        M23_CONSTANT + half23,
    )


def christoffel(s2: float, c2: float, s3: float, c3: float, s23: float, c23: float) -> tuple[float, ...]:
    """Velocity coefficients b112, b113, b123, b223, c12 of Armstrong's model, kg·m²."""
    s223 = s2 * c23 + c2 * s23
    c223 = c2 * c23 - s2 * s23
    p = P * s23 * c23
    r = Q * (1.0 - 2.0 * s23 * s23)
    return (
        2.0 * (-I3 * s2 * c2 + R * c223 + p - I12 * s223) + r + I11 * (1.0 - 2.0 * s2 * s2),
        2.0 * (R * c2 * c23 + p - I12 * c2 * s23) + r,
        2.0 * (-S * s23 + I13 * c23),
        2.0 * (R * c3 - I12 * s3),
        I4 * c2 - S * s23 - I9 * s2 + I13 * c23,
    )


def bias(v: Vector, trig: tuple[float, ...]) -> Vector:
    """Velocity torque h(q, v) for the sines and cosines of q, N·m."""
    d1, d2, d3 = v
    b112, b113, b123, b223, c12 = christoffel(*trig)
    half223 = 0.5 * b223
    return (
        b112 * d1 * d2 + b113 * d1 * d3 + b123 * d2 * d3 + c12 * d2 * d2 + 0.5 * b123 * d3 * d3,
        -0.5 * b112 * d1 * d1 + b223 * d2 * d3 + half223 * d3 * d3,
        -0.5 * b113 * d1 * d1 - half223 * d2 * d2,
    )


def gravity_torque(trig: tuple[float, ...]) -> Vector:
    """Gravity torque G(q) for the sines and cosines of q, N·m."""
    s2, c2, _, _, s23, c23 = trig
    g3 = G35 * s23 + G4 * c23
    return 0.0, G1 * c2 + G3 * s2 + g3, g3


def trigonometry(q: Vector) -> tuple[float, ...]:
    """Sine and cosine of q2, q3 and q2 + q3."""
    _, q2, q3 = q
    s2, c2, s3, c3 = sin(q2), cos(q2), sin(q3), cos(q3)
    return s2, c2, s3, c3, s2 * c3 + c2 * s3, c2 * c3 - s2 * s3


def solve(m: tuple[float, ...], tau: Vector) -> Vector:
    """Solve M a = tau for the symmetric positive definite M, by its LDLᵀ factors."""
    m11, m12, m13, m22, m23 = m
    t1, t2, t3 = tau
    l21 = m12 / m11
    l31 = m13 / m11
    d2 = m22 - l21 * m12
    u23 = m23 - l21 * m13
    l32 = u23 / d2
    d3 = M33 - l31 * m13 - l32 * u23
    y2 = t2 - l21 * t1
    a3 = (t3 - l31 * t1 - l32 * y2) / d3
    a2 = y2 / d2 - l32 * a3
    return t1 / m11 - l21 * a2 - l31 * a3, a2, a3


def multiply(m: tuple[float, ...], a: Vector) -> Vector:
    """Product M a."""
    m11, m12, m13, m22, m23 = m
    a1, a2, a3 = a
    return m11 * a1 + m12 * a2 + m13 * a3, m12 * a1 + m22 * a2 + m23 * a3, m13 * a1 + m23 * a2 + M33 * a3


@register("robot", "puma560")
class Puma560(Robot):
    """PUMA 560, first three joints, explicit model of Armstrong, Khatib and Burdick (1986)."""

    joint_names: ClassVar[tuple[str, ...]] = ("joint1", "joint2", "joint3")

    def mass_matrix(self, q: Vector) -> tuple[Vector, ...]:
        """Inertia matrix M(q), kg·m²."""
        m11, m12, m13, m22, m23 = inertia(*trigonometry(q))
        return (m11, m12, m13), (m12, m22, m23), (m13, m23, M33)

    def coriolis_matrix(self, q: Vector, v: Vector) -> tuple[Vector, ...]:
        """Coriolis matrix C(q, v), N·m·s."""
        d1, d2, d3 = v
        b112, b113, b123, b223, c12 = christoffel(*trigonometry(q))
        return (
            (
                0.5 * (b112 * d2 + b113 * d3),
                0.5 * b112 * d1 + c12 * d2 + 0.5 * b123 * d3,
                0.5 * b113 * d1 + 0.5 * b123 * (d2 + d3),
            ),
            (-0.5 * b112 * d1, 0.5 * b223 * d3, 0.5 * b223 * (d2 + d3)),
            (-0.5 * b113 * d1, -0.5 * b223 * d2, 0.0),
        )

    def velocity_torque(self, q: Vector, v: Vector) -> Vector:
        """Coriolis and centrifugal torque h(q, v), N·m."""
        return bias(v, trigonometry(q))

    def gravity(self, q: Vector) -> Vector:
        """Gravity torque G(q), N·m."""
        return gravity_torque(trigonometry(q))

    def inertia_torque(self, q: Vector, a: Vector) -> Vector:
        """Torque M(q) a, N·m."""
        return multiply(inertia(*trigonometry(q)), a)

    def inverse_dynamics(self, q: Vector, v: Vector, a: Vector) -> Vector:
        """Torque M(q) a + h(q, v) + G(q), N·m."""
        trig = trigonometry(q)
        m1, m2, m3 = multiply(inertia(*trig), a)
        h1, h2, h3 = bias(v, trig)
        _, g2, g3 = gravity_torque(trig)
        return m1 + h1, m2 + h2 + g2, m3 + h3 + g3

    def forward_dynamics(self, q: Vector, v: Vector, tau: Vector) -> Vector:
        """Acceleration M(q)^-1 (tau - h(q, v) - G(q)), rad/s²."""
        trig = trigonometry(q)
        t1, t2, t3 = tau
        h1, h2, h3 = bias(v, trig)
        _, g2, g3 = gravity_torque(trig)
        return solve(inertia(*trig), (t1 - h1, t2 - h2 - g2, t3 - h3 - g3))

    def inertia_acceleration(self, q: Vector, tau: Vector) -> Vector:
        """Acceleration M(q)^-1 tau, rad/s²."""
        return solve(inertia(*trigonometry(q)), tau)
