# SPDX-License-Identifier: Apache-2.0
"""Delay of the drives: their torque comes some ticks late."""

from __future__ import annotations

import math
from typing import Any, ClassVar

from ftcm_core.faults import ActuatorFault, Moment
from ftcm_core.numeric import select
from ftcm_core.params import param
from ftcm_core.registry import register
from ftcm_core.signals import Vector


@register("fault", "actuator_delay")
class ActuatorDelay(ActuatorFault):
    """Delay of the drives: torque on the joint = torque of the drive, ψ delay ticks ago.

    The number of ticks is rounded to a whole one. What is on its way is known from the first tick on: at the
    onset the joint gets once more what it got in the ticks before.
    """

    rank: ClassVar[int] = 10
    remembers: ClassVar[bool] = True

    delay: int = param(
        10, unit="ticks", at_least=1, at_most=100, doc="how late the torque is",
        source="chosen: 10 ms with ticks of 1 ms",
    )  # fmt: skip

    @staticmethod
    def act(
        p: Any, size: float, now: Moment, torque: float, q: float, v: float, s: Vector
    ) -> tuple[float, Vector]:
        """The torque of so many ticks ago; s has those before, the oldest first."""
        ticks, applied = whole(size * p.delay), torque
        for number in range(1, p.delay + 1):
            applied = select(equal(ticks, float(number)), s[-number], applied)
        return applied, (*s[1:], torque)

    def memory(self, joints: int) -> tuple[Vector, ...]:
        """Zero torque before the first tick."""
        return ((0.0,) * self.delay,) * joints

    def check(self) -> None:
        """No more than what is remembered."""
        ActuatorFault.check(self)
        self.check_share()


def whole(x: float) -> float:
    """Nearest whole number to x >= 0."""
    return float(math.floor(x + 0.5))


def equal(x: float, y: float) -> float:
    """1 if two numbers are equal, else 0."""
    return 1.0 if x == y else 0.0
