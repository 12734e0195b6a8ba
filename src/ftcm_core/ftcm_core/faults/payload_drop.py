# SPDX-License-Identifier: Apache-2.0
"""A payload that gets lost at a time: the true robot is lighter from then on, the model does not know."""

from __future__ import annotations

from typing import ClassVar

from ftcm_core.faults import Fault, RobotFault
from ftcm_core.params import param
from ftcm_core.registry import register
from ftcm_core.robots import Robot


@register("fault", "payload_drop")
class PayloadDrop(RobotFault):
    """Payload dropped: payload mass = what it was - mass while the fault acts, at least 0, without impact.

    What it was is the robot's own payload and whatever ``payload_pickup`` has added. With no payload there is
    nothing to drop, and nothing changes.
    """

    rank: ClassVar[int] = 60

    mass: float | None = param(
        None, unit="kg", at_least=0.0, optional=True, kind="float",
        doc="mass that is dropped; null: all of it", source="chosen: all",
    )  # fmt: skip

    def changed(self, robot: Robot) -> Robot:
        """Return the lighter robot; itself where it has no payload."""
        payload = getattr(robot, "payload_mass", 0.0)
        return robot.loaded(0.0 if self.mass is None else max(0.0, payload - self.mass)) or robot

    def unsuited(self, robot: Robot) -> str:
        """A robot without the parameter ``payload_mass`` carries nothing."""
        if not robot.loaded(0.0):
            return "needs a robot with the parameter payload_mass"
        return Fault.unsuited(self, robot)
