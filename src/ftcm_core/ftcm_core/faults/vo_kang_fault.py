# SPDX-License-Identifier: Apache-2.0
"""The fault of the paper's experiment (eq 47): state-dependent faults and a loss of effectiveness."""

from __future__ import annotations

import math

from ftcm_core.disturbances import three_joints
from ftcm_core.faults import AdditiveFault
from ftcm_core.registry import register
from ftcm_core.robots import Robot
from ftcm_core.signals import Vector


@register("fault", "vo_kang_fault")
class VoKangFault(AdditiveFault):
    """ω of eq 47: state-dependent torques on joints 1 and 3, 0.3 sin(t) u2 on joint 2."""

    def omega(self, robot: Robot, t: float, q: Vector, v: Vector, u: Vector) -> Vector:
        """Fault torque ω(q, v, u), N·m, as eq 47 prints it; u is the control input, the command."""
        q1, q2, q3 = q
        v1, v2, v3 = v
        return (
            25.0 * math.sin(q1 * q2) + 1.5 * math.cos(v1 * q2) + 2.5 * math.cos(v1 * v2),
            0.3 * math.sin(t) * u[1],
            15.0 * math.sin(q3 * q1) + 1.2 * math.cos(v2 * q2) + 2.5 * math.cos(v2 * v3),
        )

    def unsuited(self, robot: Robot) -> str:
        """Three joints."""
        return three_joints("eq 47", robot.joints) or AdditiveFault.unsuited(self, robot)
