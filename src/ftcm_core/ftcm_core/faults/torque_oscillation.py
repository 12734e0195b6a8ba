# SPDX-License-Identifier: Apache-2.0
"""Torque oscillation: the drives add a sine of the time."""

from __future__ import annotations

import math
from typing import Any, ClassVar

from ftcm_core.faults import ActuatorFault, Moment
from ftcm_core.faults.timing import shifted
from ftcm_core.params import param, per_joint
from ftcm_core.registry import register
from ftcm_core.robots import Robot
from ftcm_core.signals import Vector


@register("fault", "torque_oscillation")
class TorqueOscillation(ActuatorFault):
    """Torque oscillation: torque on the joint = torque of the drive + ψ A sin(2π f (t - T_f)).

    The *liquid* case of oscillatory failures, which add to the control. In the *solid* case they replace it
    (Goupil 2010): that is this fault together with ``loss_of_effectiveness`` of loss 1.
    """

    rank: ClassVar[int] = 60

    amplitude: float = param(
        5.0, unit="N·m", per_joint=True, doc="amplitude A", source="model: Goupil 2010; value chosen"
    )
    frequency: float = param(
        7.0, unit="Hz", above=0.0, per_joint=True, doc="frequency f",
        source="chosen: within those that Goupil 2010 looks at, up to 10 Hz",
    )  # fmt: skip

    @staticmethod
    def act(
        p: Any, size: float, now: Moment, torque: float, q: float, v: float, s: Vector
    ) -> tuple[float, Vector]:
        """Add the sine of this time."""
        return shifted(size, torque, p.amplitude * math.sin(2.0 * math.pi * p.frequency * now.since)), s

    def too_coarse(self, robot: Robot, dt: float) -> str:
        """A period needs more than two ticks, or it is another frequency."""
        highest = max(per_joint(self.frequency, robot.joints))
        if highest * dt < 0.5:
            return ""
        return f"frequency: {highest:g} Hz is too fast for ticks of {dt:g} s; expected less than {0.5 / dt:g}"
