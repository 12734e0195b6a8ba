# SPDX-License-Identifier: Apache-2.0
"""Robot models: rigid-body dynamics ``M(q) a + C(q, v) v + G(q) = tau``, one robot per file.

Everything that couples joints is behind this interface; the laws are per joint.
"""

from __future__ import annotations

from abc import abstractmethod
from typing import ClassVar

from ftcm_core.registry import Component
from ftcm_core.signals import Vector


class Robot(Component):
    """A robot arm. Positions rad, velocities rad/s, accelerations rad/s², torques N·m."""

    joint_names: ClassVar[tuple[str, ...]]

    @property
    def joints(self) -> int:
        """Number of joints."""
        return len(self.joint_names)

    @abstractmethod
    def mass_matrix(self, q: Vector) -> tuple[Vector, ...]:
        """Inertia matrix M(q), kg·m², as rows."""

    @abstractmethod
    def coriolis_matrix(self, q: Vector, v: Vector) -> tuple[Vector, ...]:
        """Coriolis matrix C(q, v) of Christoffel symbols (Ṁ - 2C is skew), N·m·s, as rows."""

    @abstractmethod
    def velocity_torque(self, q: Vector, v: Vector) -> Vector:
        """Coriolis and centrifugal torque h = C(q, v) v, N·m."""

    @abstractmethod
    def gravity(self, q: Vector) -> Vector:
        """Gravity torque G(q), N·m."""

    @abstractmethod
    def inertia_torque(self, q: Vector, a: Vector) -> Vector:
        """Torque M(q) a, N·m."""

    @abstractmethod
    def inverse_dynamics(self, q: Vector, v: Vector, a: Vector) -> Vector:
        """Torque that gives the acceleration a: M(q) a + h(q, v) + G(q), N·m."""

    @abstractmethod
    def forward_dynamics(self, q: Vector, v: Vector, tau: Vector) -> Vector:
        """Acceleration under a torque: M(q)^-1 (tau - h(q, v) - G(q)), rad/s²."""

    @abstractmethod
    def inertia_acceleration(self, q: Vector, tau: Vector) -> Vector:
        """Acceleration M(q)^-1 tau of a torque by itself, rad/s²."""
