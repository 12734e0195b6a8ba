# SPDX-License-Identifier: Apache-2.0
"""Free joint: the drive has let go."""

from __future__ import annotations

from typing import Any, ClassVar

from ftcm_core.faults import ActuatorFault, Moment
from ftcm_core.faults.timing import mixed
from ftcm_core.registry import register
from ftcm_core.signals import Vector


@register("fault", "free_joint")
class FreeJoint(ActuatorFault):
    """Free joint: torque on the joint = (1 - ψ) torque of the drive, none at all when it is fully there.

    A free-swinging joint (English and Maciejewski 1998), or the float of an actuator (Ducard 2009): gravity,
    friction and the other joints move it. Whatever other faults of the drive add before is gone too.
    """

    rank: ClassVar[int] = 75

    @staticmethod
    def act(
        p: Any, size: float, now: Moment, torque: float, q: float, v: float, s: Vector
    ) -> tuple[float, Vector]:
        """What is left of the torque."""
        return mixed(size, torque, 0.0), s

    def check(self) -> None:
        """It takes away the torque."""
        ActuatorFault.check(self)
        self.check_share()
