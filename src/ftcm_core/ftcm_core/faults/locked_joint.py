# SPDX-License-Identifier: Apache-2.0
"""Locked joint: its brake has closed."""

from __future__ import annotations

from typing import Any, ClassVar

from ftcm_core.faults import ActuatorFault, Moment
from ftcm_core.faults.stability import steepness
from ftcm_core.numeric import clamp
from ftcm_core.params import param, per_joint
from ftcm_core.registry import register
from ftcm_core.robots import Robot
from ftcm_core.signals import Vector


@register("fault", "locked_joint")
class LockedJoint(ActuatorFault):
    """Locked joint: torque on the joint = torque of the drive - clip(k (q - z) + d q̇, ±ψ holding_torque).

    A stiff approximation of a brake by an elastic bristle (Haessig and Friedland 1991), not a constraint: z
    is where the joint was in the last tick before the brake closes. Under a load T the joint is off by T / k,
    0.14° for 50 N·m with the default values, and it stays there: it does not creep. Up to the holding torque
    nothing slips; beyond it the brake slips at that torque, and z is dragged along, ψ holding_torque / k
    behind.
    """

    rank: ClassVar[int] = 80
    initial: ClassVar[Vector] = (0.0,)
    remembers: ClassVar[bool] = True

    stiffness: float = param(
        20_000.0, unit="N·m/rad", above=0.0, per_joint=True, doc="stiffness k of the closed brake",
        source="model: Haessig, Friedland 1991; value chosen: stiff, and stable for ticks of 1 ms",
    )  # fmt: skip
    damping: float = param(
        100.0, unit="N·m·s/rad", above=0.0, per_joint=True, doc="damping d of the closed brake",
        source="chosen: it does not ring for long",
    )  # fmt: skip
    holding_torque: float = param(
        250.0, unit="N·m", above=0.0, per_joint=True, doc="torque at which the brake slips",
        source="chosen: more than a drive of the PUMA 560 has",
    )  # fmt: skip

    @staticmethod
    def act(
        p: Any, size: float, now: Moment, torque: float, q: float, v: float, s: Vector
    ) -> tuple[float, Vector]:
        """The torque of the brake comes with that of the drive; s is where the bristle is fixed, rad."""
        holding, (z,) = size * p.holding_torque, s
        z = fixed_at(z, q, holding, p.stiffness)
        return braked(torque, p.stiffness * (q - z) + p.damping * v, holding), (z,)

    def too_coarse(self, robot: Robot, dt: float) -> str:
        """Its torque is held over a tick; see :mod:`ftcm_core.faults.stability`."""
        n = robot.joints
        stiffness, damping = per_joint(self.stiffness, n), per_joint(self.damping, n)
        mine = self.of_joints(n)
        for j in mine:
            if stiffness[j] * dt > damping[j]:
                return (
                    f"damping: {damping[j]:g} N·m·s/rad is too little for a stiffness of {stiffness[j]:g} "
                    f"and ticks of {dt:g} s, the joint would shake; expected at least {stiffness[j] * dt:g}"
                )
        share = dt * steepness(robot, tuple([d if j in mine else 0.0 for j, d in enumerate(damping)]))
        if share <= 1.0:
            return ""
        largest = max(damping[j] for j in mine)
        return (
            f"damping: {largest:g} N·m·s/rad is too much for ticks of {dt:g} s, the joint would shake; "
            f"expected {largest / share:.2g} or less, or shorter ticks"
        )


def fixed_at(z: float, q: float, holding: float, stiffness: float) -> float:
    """Where the bristle is fixed after it has slipped as far as it must, rad; at q while the brake is open.

    Args:
        z: where it was, rad.
        q: position of the joint, rad.
        holding: torque at which it slips, N·m; 0: open.
        stiffness: of the bristle, N·m/rad.
    """
    if holding == 0.0:
        return q
    reach = holding / stiffness
    return max(q - reach, min(q + reach, z))


def braked(torque: float, brake: float, holding: float) -> float:
    """``torque`` less that of the brake, which is at most ``holding``, N·m; bit for bit if that is 0."""
    return torque if holding == 0.0 else torque - clamp(brake, holding)
