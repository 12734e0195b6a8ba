# SPDX-License-Identifier: Apache-2.0
"""Robot models: rigid-body dynamics ``M(q) a + C(q, v) v + G(q) + F(v) = tau``, one robot per file.

Everything that couples joints is behind this interface; the laws are per joint. A robot need only say its
``joint_names`` and its inverse dynamics; the rest follows, more slowly than from closed forms.
"""

from __future__ import annotations

import dataclasses
import math
from abc import abstractmethod
from operator import add, sub
from typing import TYPE_CHECKING

from ftcm_core.params import specs
from ftcm_core.registry import Component
from ftcm_core.signals import Vector

if TYPE_CHECKING:
    from ftcm_core.robots.serial_chain import Chain, Frame

RATE_STEP = 1e-5
"""Step of the central differences of :meth:`Robot.inertia_rate_torque`, s."""


class Robot(Component):
    """A robot arm. Positions rad, velocities rad/s, accelerations rad/s², torques N·m."""

    @property
    @abstractmethod
    def joint_names(self) -> tuple[str, ...]:
        """Names of the joints, as in the messages; they may depend on the parameters."""

    @property
    def joints(self) -> int:
        """Number of joints."""
        return len(self.joint_names)

    @abstractmethod
    def inverse_dynamics(self, q: Vector, v: Vector, a: Vector) -> Vector:
        """Torque that gives the acceleration a: M(q) a + C(q, v) v + G(q) + F(v), N·m."""

    def forward_dynamics(self, q: Vector, v: Vector, tau: Vector) -> Vector:
        """Acceleration under a torque, rad/s²: M(q) by columns from the inverse dynamics, then solved."""
        rest = (0.0,) * len(q)
        bias = self.inverse_dynamics(q, v, rest)
        return solve(self._mass_matrix(q), tuple(map(sub, tau, bias)))

    def gravity(self, q: Vector) -> Vector:
        """Gravity torque G(q), N·m."""
        rest = (0.0,) * len(q)
        return self.inverse_dynamics(q, rest, rest)

    def inertia_torque(self, q: Vector, a: Vector) -> Vector:
        """Torque M(q) a, N·m."""
        rest = (0.0,) * len(q)
        return tuple(map(sub, self.inverse_dynamics(q, rest, a), self.gravity(q)))

    def inertia_acceleration(self, q: Vector, tau: Vector) -> Vector:
        """Acceleration M(q)^-1 tau of a torque by itself, rad/s²."""
        rest = (0.0,) * len(q)
        return self.forward_dynamics(q, rest, tuple(map(add, tau, self.gravity(q))))

    def tip_torque(self, q: Vector, force: Vector) -> Vector | None:
        """Joint torques J(q)ᵀ F of a force at the tip, N·m; None where the robot does not say where that is.

        Args:
            q: joint positions, rad.
            force: F, its three components in the frame of the base, N.
        """
        del q, force
        return None

    def forward_kinematics(self, q: Vector) -> tuple[Frame, ...] | None:
        """Where the joints' frames and the tip stand in that of the base; None where the robot does not say.

        Args:
            q: joint positions, rad.

        Returns:
            One frame per joint, which turns about its z axis or slides along it, and last that of the tip.
        """
        del q
        return None

    def inertia_rate_torque(self, q: Vector, v: Vector) -> Vector:
        """Torque Ṁ(q) v, Ṁ the rate of M(q) along v, N·m: by central differences of M(q) v over h = 1e-5 s.

        They are off by h²/6 times the third derivative of M v along v, and by about 1e-16 M v / h for
        rounding: together by 1e-9 N·m for arms of some kg·m² at some rad/s.
        """
        ahead = self.inertia_torque(tuple([x + RATE_STEP * d for x, d in zip(q, v)]), v)
        behind = self.inertia_torque(tuple([x - RATE_STEP * d for x, d in zip(q, v)]), v)
        return tuple([(a - b) / (2.0 * RATE_STEP) for a, b in zip(ahead, behind)])

    def _mass_matrix(self, q: Vector) -> tuple[Vector, ...]:
        """Columns of M(q), kg·m²."""
        n = len(q)
        units = [tuple([1.0 if i == j else 0.0 for i in range(n)]) for j in range(n)]
        return tuple([self.inertia_torque(q, unit) for unit in units])

    def chain(self) -> Chain | None:
        """The bodies and joints, for an engine of its own; None where the robot is its equations only."""
        return None

    def unloaded(self) -> Robot:
        """Return this robot without its payload; itself where it has no parameter ``payload_mass``."""
        if not getattr(self, "payload_mass", 0.0):
            return self
        return dataclasses.replace(self, payload_mass=0.0)  # type: ignore[type-var]

    def loaded(self, mass: float) -> Robot | None:
        """Return this robot with another payload (kg); None where it has no parameter ``payload_mass``."""
        if "payload_mass" not in specs(type(self)):
            return None
        return dataclasses.replace(self, payload_mass=mass)  # type: ignore[type-var]


def solve(m: tuple[Vector, ...], b: Vector) -> Vector:
    """Solve M x = b for a symmetric positive definite M, by its factors L D Lᵀ.

    Args:
        m: rows of M.
        b: right-hand side.

    Returns:
        x.
    """
    n = len(b)
    lower: list[list[float]] = []
    diagonal: list[float] = []
    for i in range(n):
        row: list[float] = []
        for j in range(i):
            x = m[i][j]
            for k in range(j):
                x = x - row[k] * diagonal[k] * lower[j][k]
            row.append(x / diagonal[j])
        d = m[i][i]
        for k in range(i):
            d = d - row[k] * row[k] * diagonal[k]
        lower.append(row)
        diagonal.append(d)
    y: list[float] = []
    for i in range(n):
        x = b[i]
        for k in range(i):
            x = x - lower[i][k] * y[k]
        y.append(x)
    solution = [y[i] / diagonal[i] for i in range(n)]
    for i in reversed(range(n)):
        for k in range(i + 1, n):
            solution[i] = solution[i] - lower[k][i] * solution[k]
    return tuple(solution)


def friction(v: float, viscous: float, coulomb: float, slip: float) -> float:
    """Torque F(v) against the motion of one joint: viscous v + coulomb tanh(v / slip), N·m.

    Args:
        v: joint velocity, rad/s.
        viscous: N·m·s/rad.
        coulomb: N·m.
        slip: velocity at which the Coulomb friction has grown to 76 %, rad/s: it is smooth there, as no
            integrator of fixed step follows a jump.
    """
    return viscous * v + coulomb * math.tanh(v / slip)
