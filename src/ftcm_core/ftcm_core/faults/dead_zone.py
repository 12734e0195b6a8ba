# SPDX-License-Identifier: Apache-2.0
"""Dead zone of the drives: small torques do not reach the joints."""

from __future__ import annotations

from typing import Any, ClassVar

from ftcm_core.faults import ActuatorFault, Moment, scaled
from ftcm_core.numeric import clamp
from ftcm_core.params import param
from ftcm_core.registry import register
from ftcm_core.signals import Vector


@register("fault", "dead_zone")
class DeadZone(ActuatorFault):
    """Dead zone: torque on the joint = u - clip(u, ±ψ width), u the torque of the drive.

    The static model of Tao and Kokotović (1996), symmetric and of slope 1.
    """

    rank: ClassVar[int] = 20

    width: float = param(
        5.0, unit="N·m", at_least=0.0, per_joint=True, doc="largest torque that gets lost",
        source="model: Tao, Kokotović 1996; value chosen",
    )  # fmt: skip

    @staticmethod
    def act(
        p: Any, size: float, now: Moment, torque: float, q: float, v: float, s: Vector
    ) -> tuple[float, Vector]:
        """What is beyond the zone."""
        return beyond(torque, scaled(size, p.width)), s


def beyond(x: float, width: float) -> float:
    """Return x less its part within ±width; bit for bit x if that is 0."""
    return x if width == 0.0 else x - clamp(x, width)
