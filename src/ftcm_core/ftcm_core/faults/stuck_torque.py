# SPDX-License-Identifier: Apache-2.0
"""Stuck torque: the drives go on with one torque, whatever they are told."""

from __future__ import annotations

from typing import Any, ClassVar

from ftcm_core.faults import ActuatorFault, Moment
from ftcm_core.faults.timing import mixed
from ftcm_core.numeric import select
from ftcm_core.params import param
from ftcm_core.registry import register
from ftcm_core.signals import Vector


@register("fault", "stuck_torque")
class StuckTorque(ActuatorFault):
    """Stuck torque: torque on the joint = (1 - ψ) torque of the drive + ψ stuck, that of the onset or given.

    Without ``level`` it is the last torque before ψ left zero. With a profile that comes back to zero it
    sticks anew each time.
    """

    rank: ClassVar[int] = 70
    initial: ClassVar[Vector] = (0.0,)
    remembers: ClassVar[bool] = True

    level: float | None = param(
        None, unit="N·m", per_joint=True, optional=True, kind="float",
        doc="torque at which it sticks; null: that of the onset",
        source="model: Tao, Chen, Tang, Joshi 2004, lock-in-place; value chosen",
    )  # fmt: skip

    @staticmethod
    def act(
        p: Any, size: float, now: Moment, torque: float, q: float, v: float, s: Vector
    ) -> tuple[float, Vector]:
        """What it sticks at, followed while the fault does not act."""
        held = select(size, s[0], torque)
        return mixed(size, torque, held if p.level is None else p.level), (held,)

    def check(self) -> None:
        """It takes the place of the torque."""
        ActuatorFault.check(self)
        self.check_share()
