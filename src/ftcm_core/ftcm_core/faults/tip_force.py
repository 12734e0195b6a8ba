# SPDX-License-Identifier: Apache-2.0
"""A force at the tip: somebody pulls, or the tool pushes against something."""

from __future__ import annotations

from dataclasses import dataclass

from ftcm_core.errors import ParameterError
from ftcm_core.faults import AdditiveFault
from ftcm_core.params import param
from ftcm_core.registry import register
from ftcm_core.robots import Robot
from ftcm_core.signals import Vector


@dataclass(frozen=True, kw_only=True)
class TipFault(AdditiveFault):
    """A force at the tip, which loads all joints."""

    def check(self) -> None:
        """The force is one; the joints share it."""
        AdditiveFault.check(self)
        if self.joint:
            raise ParameterError(
                f"joint: {self.joint}, but a force at the tip loads all joints; expected 0 (all)"
            )

    def unsuited(self, robot: Robot) -> str:
        """The robot must know where its tip is."""
        zero = (0.0, 0.0, 0.0)
        if robot.tip_torque((0.0,) * robot.joints, zero) is None:
            return "needs a robot that knows its tip (tip_torque)"
        return AdditiveFault.unsuited(self, robot)

    @staticmethod
    def at_tip(robot: Robot, q: Vector, force: Vector) -> Vector:
        """Joint torques of a force at the tip, N·m.

        Args:
            robot: the robot.
            q: joint positions, rad.
            force: in the frame of the base, N.
        """
        torque = robot.tip_torque(q, force)
        assert torque is not None, "unsuited() has refused the robot"
        return torque


@register("fault", "tip_force")
class TipForce(TipFault):
    """Force at the tip: ω = J(q)ᵀ F, F constant in the frame of the base."""

    force_x: float = param(0.0, unit="N", doc="x component of F, in the base frame", source="chosen")
    force_y: float = param(0.0, unit="N", doc="y component of F, in the base frame", source="chosen")
    force_z: float = param(
        -20.0, unit="N", doc="z component of F, in the base frame", source="chosen: the weight of 2 kg"
    )

    def omega(self, robot: Robot, t: float, q: Vector, v: Vector, u: Vector) -> Vector:
        """Joint torques of the force, N·m."""
        return self.at_tip(robot, q, (self.force_x, self.force_y, self.force_z))
