# SPDX-License-Identifier: Apache-2.0
"""More friction: joints that run dry, or a gear that jams."""

from __future__ import annotations

import math

from ftcm_core.faults import AdditiveFault
from ftcm_core.faults.stability import steepness
from ftcm_core.params import joint_parameters, param
from ftcm_core.registry import register
from ftcm_core.robots import Robot, friction
from ftcm_core.signals import Vector


@register("fault", "friction_change")
class FrictionChange(AdditiveFault):
    """Friction added: ω = -(b q̇ + (F_c + F_s e^{-(q̇/v_s)²}) tanh(q̇/v_0)), beside what the robot has.

    Viscous, Coulomb and Stribeck friction (Armstrong-Hélouvry, Dupont, Canudas de Wit 1994). As in the robots
    themselves it is smooth at rest, so it lets a joint creep under a load instead of holding it.
    """

    viscous: float = param(
        2.0, unit="N·m·s/rad", at_least=0.0, per_joint=True, doc="viscous friction b", source="chosen"
    )
    coulomb: float = param(
        4.0, unit="N·m", at_least=0.0, per_joint=True, doc="Coulomb friction F_c", source="chosen"
    )
    stribeck: float = param(
        1.0, unit="N·m", at_least=0.0, per_joint=True, doc="what friction at rest has more, F_s",
        source="chosen",
    )  # fmt: skip
    stribeck_velocity: float = param(
        0.2,
        unit="rad/s",
        above=0.0,
        per_joint=True,
        doc="velocity v_s at which that has gone",
        source="chosen",
    )
    slip_velocity: float = param(
        0.05, unit="rad/s", above=0.0, per_joint=True,
        doc="velocity scale v_0 of the growth from rest, tanh(q̇/v_0)",
        source="chosen: smooth for ticks of 1 ms, on small joints too",
    )  # fmt: skip

    def omega(self, robot: Robot, t: float, q: Vector, v: Vector, u: Vector) -> Vector:
        """Friction against the motion of each joint, N·m."""
        return tuple(
            [
                -stribeck_friction(x, p.viscous, p.coulomb, p.stribeck, p.stribeck_velocity, p.slip_velocity)
                for p, x in zip(joint_parameters(self, len(q)), v)
            ]
        )

    def too_coarse(self, robot: Robot, dt: float) -> str:
        """At rest it is a damper of torque held over a tick; see :mod:`ftcm_core.faults.stability`."""
        mine, slopes = self.of_joints(robot.joints), [0.0] * robot.joints
        for j, p in enumerate(joint_parameters(self, robot.joints)):
            if j in mine:
                slopes[j] = self.severity * (p.viscous + (p.coulomb + p.stribeck) / p.slip_velocity)
        share = dt * steepness(robot, tuple(slopes))
        if share <= 1.0:
            return ""
        return (
            f"slip_velocity: friction that grows by {max(slopes):g} N·m·s/rad from rest is too steep "
            f"for ticks of {dt:g} s, the joint would shake; expected {max(slopes) / share:.2g} or less, or "
            "shorter ticks"
        )


def stribeck_friction(
    v: float, viscous: float, coulomb: float, stribeck: float, stribeck_velocity: float, slip: float
) -> float:
    """Torque against the motion of one joint, N·m.

    Args:
        v: joint velocity, rad/s.
        viscous: N·m·s/rad.
        coulomb: N·m.
        stribeck: how much more it is at rest, N·m.
        stribeck_velocity: where that has gone, rad/s.
        slip: where friction has grown to 76 %, rad/s.
    """
    x = v / stribeck_velocity
    return friction(v, viscous, coulomb + stribeck * math.exp(-x * x), slip)
