# SPDX-License-Identifier: Apache-2.0
"""The drives: command delay, torque and rate limits, actuator faults, in this order.

This is the only place that knows what becomes of a command.
"""

from __future__ import annotations

from typing import NamedTuple

from ftcm_core.faults import ActuatorFault, FaultState
from ftcm_core.limits import Limits
from ftcm_core.signals import Vector, saturate
from ftcm_core.simulation.fault_chain import FaultChain


class DriveState(NamedTuple):
    """What the drives remember between ticks."""

    effort: Vector
    """Torque of the last tick as the drives report it, N·m."""
    waiting: tuple[Vector, ...]
    """Commands on their way, the oldest first, N·m."""
    faults: tuple[FaultState, ...]
    """State of each actuator fault."""


class Drive:
    """The drives of all joints; ``init`` once, then ``step`` or ``brake`` once per tick."""

    def __init__(self, limits: Limits, delay: int, faults: FaultChain[ActuatorFault], dt: float) -> None:
        """Say what they are.

        Args:
            limits: of torque and its rate.
            delay: the command of so many ticks before is applied; zeros until the first arrives.
            faults: of the actuators.
            dt: tick length, s.
        """
        self.limits = limits
        self.delay = delay
        self.chain = faults
        self.faults = faults.faults
        self.dt = dt

    def init(self, joints: int) -> DriveState:
        """Return the state before the first tick: no torque."""
        zeros = (0.0,) * joints
        return DriveState(zeros, (zeros,) * self.delay, self.chain.init(joints))

    def step(self, t: float, u: Vector, q: Vector, v: Vector, state: DriveState) -> tuple[Vector, DriveState]:
        """Apply the command of one tick.

        Args:
            t: time, s.
            u: command, N·m.
            q: true joint positions, rad.
            v: true joint velocities, rad/s.
            state: what the last step returned.

        Returns:
            Torque on the joints, N·m, and the next state, which has the torque that the drives report.
        """
        waiting = state.waiting
        if waiting:
            wanted, waiting = waiting[0], (*waiting[1:], u)
        else:
            wanted = u
        return self._apply(t, wanted, q, v, DriveState(state.effort, waiting, state.faults))

    def brake(
        self, t: float, damping: Vector, q: Vector, v: Vector, state: DriveState
    ) -> tuple[Vector, DriveState]:
        """Brake, in place of a command: torque -damping·velocity, at once and within the limits.

        No command from before comes out afterwards.

        Args:
            t: time, s.
            damping: N·m·s/rad per joint.
            q: true joint positions, rad.
            v: true joint velocities, rad/s.
            state: what the last step returned.

        Returns:
            As of :meth:`step`.
        """
        u = tuple([-c * x for c, x in zip(damping, v)])
        waiting = (*state.waiting[1:], u) if state.waiting else ()
        return self._apply(t, u, q, v, DriveState(state.effort, waiting, state.faults))

    def _apply(
        self, t: float, wanted: Vector, q: Vector, v: Vector, state: DriveState
    ) -> tuple[Vector, DriveState]:
        effort = torque = drive_torque(self.limits, state.effort, wanted)
        if not self.faults:
            return torque, DriveState(effort, state.waiting, ())
        following = []
        for fault, inner in zip(self.faults, state.faults):
            torque, inner = fault.step(t, self.dt, torque, q, v, inner, effort)
            following.append(inner)
        return torque, DriveState(effort, state.waiting, tuple(following))


def drive_torque(limits: Limits, previous: Vector, wanted: Vector) -> Vector:
    """Torque that the drives apply.

    Args:
        limits: of the robot.
        previous: torque applied in the tick before, N·m.
        wanted: torque asked for, N·m.

    Returns:
        The torque wanted, saturated, and then approached by no more than the largest step, N·m.
    """
    torque = saturate(wanted, limits.torque)
    if limits.torque_step is None:
        return torque
    return tuple([max(p - s, min(p + s, u)) for p, u, s in zip(previous, torque, limits.torque_step)])
