# SPDX-License-Identifier: Apache-2.0
"""A payload picked up at a time: the true robot is heavier from then on, the model does not know."""

from __future__ import annotations

from ftcm_core.faults import Fault, RobotFault
from ftcm_core.params import param
from ftcm_core.registry import register
from ftcm_core.robots import Robot


@register("fault", "payload_pickup")
class PayloadPickup(RobotFault):
    """Payload picked up: payload mass = what it was + mass while it acts, without impact."""

    mass: float = param(
        2.0, unit="kg", at_least=0.0, doc="mass that is picked up", source="chosen: the PUMA lifts 2.5 kg"
    )

    def changed(self, robot: Robot) -> Robot:
        """Return the loaded robot; itself where it has no payload."""
        return robot.loaded(getattr(robot, "payload_mass", 0.0) + self.mass) or robot

    def unsuited(self, robot: Robot) -> str:
        """A robot without the parameter ``payload_mass`` cannot pick anything up."""
        if not robot.loaded(0.0):
            return "needs a robot with the parameter payload_mass"
        return Fault.unsuited(self, robot)
