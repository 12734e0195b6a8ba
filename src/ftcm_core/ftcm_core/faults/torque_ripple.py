# SPDX-License-Identifier: Apache-2.0
"""Torque ripple: a torque that repeats itself as the joint turns."""

from __future__ import annotations

import math
from typing import Any, ClassVar

from ftcm_core.faults import ActuatorFault, Moment
from ftcm_core.faults.timing import shifted
from ftcm_core.params import param
from ftcm_core.registry import register
from ftcm_core.signals import Vector


@register("fault", "torque_ripple")
class TorqueRipple(ActuatorFault):
    """Torque ripple: torque on the joint = torque of the drive + ψ amplitude sin(cycles q + phase_angle).

    One harmonic of what a motor with unequal windings or magnets, or a gear with worn teeth, adds. More of
    them are more faults of this type.
    """

    rank: ClassVar[int] = 60

    amplitude: float = param(
        3.0, unit="N·m", per_joint=True, doc="amplitude A",
        source="model: Holtz, Springob 1996; value chosen",
    )  # fmt: skip
    cycles: float = param(
        24.0, unit="-", at_least=0.0, per_joint=True, doc="periods n in a turn of the joint",
        source="chosen: within the bandwidth of the paper's motion",
    )  # fmt: skip
    phase_angle: float = param(0.0, unit="rad", per_joint=True, doc="phase at q = 0", source="chosen")

    @staticmethod
    def act(
        p: Any, size: float, now: Moment, torque: float, q: float, v: float, s: Vector
    ) -> tuple[float, Vector]:
        """Add the ripple where the joint is."""
        return shifted(size, torque, p.amplitude * math.sin(p.cycles * q + p.phase_angle)), s
