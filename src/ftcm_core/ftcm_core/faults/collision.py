# SPDX-License-Identifier: Apache-2.0
"""A collision: something hits the tip, or the tip hits something, once and for a short time."""

from __future__ import annotations

import math

from ftcm_core.faults import AdditiveFault
from ftcm_core.faults.tip_force import TipFault
from ftcm_core.params import param
from ftcm_core.registry import register
from ftcm_core.robots import Robot
from ftcm_core.signals import Vector

FEWEST_TICKS = 10
"""Of a contact; its impulse then is right within 1 %."""


@register("fault", "collision")
class Collision(TipFault):
    """Collision at the tip: ω = J(q)ᵀ F, F = impulse π/(2T) sin(π(t-T_f)/T) while they touch, for T.

    A half sine of given impulse: the force of two bodies that meet over a linear spring, whatever the arm
    does meanwhile. Held over ticks of dt, its impulse is wrong by up to (π dt/T)²/12 of it where T is a
    multiple of dt. On collisions of arms: Haddadin, De Luca, Albu-Schäffer (2017).
    """

    impulse_x: float = param(2.0, unit="N·s", doc="x component, in the base frame", source="chosen")
    impulse_y: float = param(0.0, unit="N·s", doc="y component, in the base frame", source="chosen")
    impulse_z: float = param(0.0, unit="N·s", doc="z component, in the base frame", source="chosen")
    contact_time: float = param(
        0.02, unit="s", above=0.0, doc="how long they touch, T", source="chosen: a hard body, thinly padded"
    )

    def omega(self, robot: Robot, t: float, q: Vector, v: Vector, u: Vector) -> Vector:
        """Joint torques of the impulse, N·m·s; :meth:`size` has its course in time."""
        return self.at_tip(robot, q, (self.impulse_x, self.impulse_y, self.impulse_z))

    def size(self, t: float, onset: float, end: float, key: float) -> float:
        """ψ times severity times the pulse, 1/s."""
        return AdditiveFault.size(self, t, onset, end, key) * half_sine(t - onset, self.contact_time)

    def too_coarse(self, robot: Robot, dt: float) -> str:
        """The ticks must show the pulse."""
        if self.contact_time >= (FEWEST_TICKS - 1e-9) * dt:
            return ""
        return (
            f"contact_time: {self.contact_time:g} s is less than {FEWEST_TICKS} ticks; "
            f"expected at least {FEWEST_TICKS * dt:g}"
        )


def half_sine(since: float, length: float) -> float:
    """Half a period of a sine of ``length`` (s), ``since`` (s) from its begin; its integral is 1."""
    if since <= 0.0 or since >= length:
        return 0.0
    return 0.5 * math.pi / length * math.sin(math.pi * since / length)
