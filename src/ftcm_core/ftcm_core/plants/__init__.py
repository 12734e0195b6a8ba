# SPDX-License-Identifier: Apache-2.0
"""Plants, one per file: engines that move the true robot under the torques on its joints."""

from __future__ import annotations

from abc import abstractmethod
from typing import Any, ClassVar

from ftcm_core.registry import Component
from ftcm_core.robots import Robot
from ftcm_core.signals import Vector


class Plant(Component):
    """An engine with explicit state: ``init`` once, then ``step`` once per tick.

    The state is what the engine likes: two vectors, or a handle to its own memory. Nothing else looks inside.
    """

    foreign: ClassVar[bool] = False
    """Whether another library moves the robot, which cannot be compiled with the rest."""

    def unsuited(self, robot: Robot, changes: bool) -> str:
        """Why this plant cannot move a robot; empty if it can.

        Args:
            robot: the true robot.
            changes: whether faults change it during the run.
        """
        del robot, changes
        return ""

    def warnings(self, robot: Robot, position: Vector, dt: float) -> list[str]:
        """What this engine does not do well, one line each.

        Args:
            robot: the true robot.
            position: where it starts, rad.
            dt: tick length, s.
        """
        del robot, position, dt
        return []

    @abstractmethod
    def init(self, robot: Robot, position: Vector, velocity: Vector) -> Any:
        """Return the state at the given motion (rad, rad/s)."""

    @abstractmethod
    def step(self, robot: Robot, dt: float, torque: Vector, state: Any) -> Any:
        """Return the state one tick later.

        Args:
            robot: the true robot, which may change from tick to tick (a payload picked up).
            dt: tick length, s.
            torque: torque on the joints, held over the tick, N·m.
            state: the state at the begin of the tick.
        """

    @abstractmethod
    def motion(self, state: Any) -> tuple[Vector, Vector]:
        """Return joint positions (rad) and velocities (rad/s)."""
