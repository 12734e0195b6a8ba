# SPDX-License-Identifier: Apache-2.0
"""The robot model itself as the plant, integrated with a fixed step."""

from __future__ import annotations

import math

from ftcm_core.params import param
from ftcm_core.plants import Plant
from ftcm_core.registry import register
from ftcm_core.robots import Robot
from ftcm_core.signals import Vector

STABLE = {"rk4": 2.78, "semi_implicit_euler": 2.0}
"""Up to which decay per step an integrator is stable (Hairer, Wanner 1996, section IV.2)."""
Motion = tuple[Vector, Vector]
"""Positions, rad, and velocities, rad/s."""


@register("plant", "rigid_body")
class RigidBody(Plant):
    """Rigid bodies: q̈ = forward_dynamics(q, q̇, tau) of the robot, integrated with fixed steps."""

    integrator: str = param(
        "rk4", unit="-", choices=("rk4", "semi_implicit_euler"),
        doc="rk4: classical Runge-Kutta; semi_implicit_euler: velocity first, then position with it",
        source="chosen: rk4, its error at 1 kHz is far below that of holding the torque",
    )  # fmt: skip
    substeps: int = param(
        1, unit="-", at_least=1, at_most=1000, doc="steps of the integrator per tick", source="chosen"
    )

    def warnings(self, robot: Robot, position: Vector, dt: float) -> list[str]:
        """Joints whose friction is too stiff for the step: the integrator makes a motion of its own then."""
        limit, found = STABLE[self.integrator], []
        for joint, name in enumerate(robot.joint_names):
            rate = damping_rate(robot, position, joint) * dt / self.substeps
            if rate > limit:
                steps = math.ceil(rate / limit * self.substeps)
                found.append(
                    f"plant: friction of joint {name!r} is too stiff for the step: {self.integrator} follows "
                    f"a decay of up to {limit:g} per step, near standstill it is {rate:.3g}; raise its "
                    f"slip_velocity, or plant.substeps to {steps} or more"
                )
        return found

    def init(self, robot: Robot, position: Vector, velocity: Vector) -> Motion:
        """The motion is all there is."""
        return position, velocity

    def step(self, robot: Robot, dt: float, torque: Vector, state: Motion) -> Motion:
        """Integrate one tick, the torque held."""
        advance = rk4 if self.integrator == "rk4" else semi_implicit_euler
        if self.substeps == 1:
            return advance(robot, dt, *state, torque)
        for _ in range(self.substeps):
            state = advance(robot, dt / self.substeps, *state, torque)
        return state

    def motion(self, state: Motion) -> Motion:
        """The state as it is."""
        return state


def damping_rate(robot: Robot, q: Vector, joint: int) -> float:
    """How fast friction makes the velocity of a joint decay near standstill, 1/s.

    Args:
        robot: the model.
        q: positions, rad.
        joint: its number, from 0.

    Returns:
        -∂q̈/∂q̇ of the joint, at a velocity that is small against any slip velocity.
    """
    still, n = (0.0,) * len(q), len(q)
    step = 1e-6
    ahead, behind = (
        robot.forward_dynamics(q, tuple([s * step if j == joint else 0.0 for j in range(n)]), still)
        for s in (1.0, -1.0)
    )
    return (behind[joint] - ahead[joint]) / (2.0 * step)


def rk4(robot: Robot, dt: float, q: Vector, v: Vector, tau: Vector) -> Motion:
    """One classical Runge-Kutta step of q̈ = forward_dynamics(q, q̇, tau), tau held.

    Args:
        robot: the model.
        dt: step, s.
        q: positions, rad.
        v: velocities, rad/s.
        tau: total joint torque, N·m.

    Returns:
        Positions and velocities after the step.
    """
    acceleration = robot.forward_dynamics
    h = 0.5 * dt
    a1 = acceleration(q, v, tau)
    v2 = tuple([x + h * a for x, a in zip(v, a1)])
    a2 = acceleration(tuple([x + h * d for x, d in zip(q, v)]), v2, tau)
    v3 = tuple([x + h * a for x, a in zip(v, a2)])
    a3 = acceleration(tuple([x + h * d for x, d in zip(q, v2)]), v3, tau)
    v4 = tuple([x + dt * a for x, a in zip(v, a3)])
    a4 = acceleration(tuple([x + dt * d for x, d in zip(q, v3)]), v4, tau)
    w = dt / 6.0
    return (
        tuple([x + w * (d1 + 2.0 * (d2 + d3) + d4) for x, d1, d2, d3, d4 in zip(q, v, v2, v3, v4)]),
        tuple([x + w * (b1 + 2.0 * (b2 + b3) + b4) for x, b1, b2, b3, b4 in zip(v, a1, a2, a3, a4)]),
    )


def semi_implicit_euler(robot: Robot, dt: float, q: Vector, v: Vector, tau: Vector) -> Motion:
    """One step v⁺ = v + dt q̈(q, v), q⁺ = q + dt v⁺, tau held; arguments as of :func:`rk4`."""
    v = tuple([x + dt * a for x, a in zip(v, robot.forward_dynamics(q, v, tau))])
    return tuple([x + dt * d for x, d in zip(q, v)]), v
