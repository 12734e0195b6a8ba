# SPDX-License-Identifier: Apache-2.0
"""A joint sensor that is stuck at a value."""

from __future__ import annotations

from typing import Any, ClassVar

from ftcm_core.faults import Moment, SensorFault
from ftcm_core.faults.past import either
from ftcm_core.params import param
from ftcm_core.registry import register
from ftcm_core.signals import Vector


@register("fault", "frozen_sensor")
class FrozenSensor(SensorFault):
    """Frozen sensor: position = q(T_f), velocity = q̇(T_f), the last ones before the fault, while ψ > 0.

    How large ψ is does not matter.

    Source: Alwi, Edwards and Tan (2011), Fault Detection and Fault-Tolerant Control Using Sliding Modes;
    stuck-at in Ni et al. (2009), Sensor network data fault types, ACM TOSN 5(3).
    """

    rank: ClassVar[int] = 60
    remembers: ClassVar[bool] = True

    quantity: str = param(
        "both", unit="-", choices=("both", "position", "velocity"), doc="what is frozen",
        source="chosen: one encoder gives both",
    )  # fmt: skip

    @staticmethod
    def sense(
        p: Any, size: float, now: Moment, position: float, velocity: float, s: Vector
    ) -> tuple[float, float, Vector]:
        """What was measured last before the fault; while it does not act, that is what is measured."""
        held = either(size, s or (position, velocity), (position, velocity))
        return (
            held[0] if p.quantity != "velocity" else position,
            held[1] if p.quantity != "position" else velocity,
            held,
        )
