# SPDX-License-Identifier: Apache-2.0
"""A torque on the joints from outside: a cable that drags, somebody who pushes a link."""

from __future__ import annotations

from ftcm_core.faults import AdditiveFault
from ftcm_core.params import param, per_joint
from ftcm_core.registry import register
from ftcm_core.robots import Robot
from ftcm_core.signals import Vector


@register("fault", "external_torque")
class ExternalTorque(AdditiveFault):
    """External torque: ω = torque, constant, or with a profile; one_shot is a push."""

    torque: float = param(
        10.0, unit="N·m", per_joint=True, doc="torque on the joint", source="chosen: as the paper's fault"
    )

    def omega(self, robot: Robot, t: float, q: Vector, v: Vector, u: Vector) -> Vector:
        """The torque, whatever the motion."""
        return per_joint(self.torque, len(q))
