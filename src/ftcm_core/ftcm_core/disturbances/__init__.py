# SPDX-License-Identifier: Apache-2.0
"""Disturbances, one per file: torques that act on the joints all the time (friction, external forces)."""

from __future__ import annotations

from typing import Any

from ftcm_core.registry import Component
from ftcm_core.signals import Vector


class Disturbance(Component):
    """A torque added to that of the drives, with explicit state: ``init`` once, ``step`` once per tick.

    One without memory says :meth:`torque` only.
    """

    def init(self, joints: int, key: float) -> Any:
        """Return the state before the first tick.

        Args:
            joints: number of joints.
            key: its own stream of random numbers, see :mod:`ftcm_core.random_streams`.
        """
        del joints, key
        return ()

    def step(self, t: float, dt: float, q: Vector, v: Vector, u: Vector, state: Any) -> tuple[Vector, Any]:
        """Return the added torque of one tick, N·m, and the next state; arguments as of :meth:`torque`."""
        del dt
        return self.torque(t, q, v, u), state

    def torque(self, t: float, q: Vector, v: Vector, u: Vector) -> Vector:
        """Torque added to that of the drives, N·m.

        Args:
            t: time, s.
            q: true joint positions, rad.
            v: true joint velocities, rad/s.
            u: commanded torque, N·m.
        """
        raise NotImplementedError(f"{type(self).__name__} defines neither torque() nor step()")

    def supports(self, joints: int) -> str | None:
        """Return None if this component fits a robot with that many joints, else what it needs."""
        del joints
        return None


def three_joints(what: str, joints: int) -> str | None:
    """Shared answer of the components that the paper defines for three joints."""
    return None if joints == 3 else f"{what} is defined for 3 joints"
