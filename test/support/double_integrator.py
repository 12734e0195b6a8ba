# SPDX-License-Identifier: Apache-2.0
"""The plant that the laws' proofs are about: one joint, ẍ = u/m + d, moved exactly under held torques."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, ClassVar, NamedTuple

import numpy as np

from ftcm_core.controllers import Controller
from ftcm_core.params import param
from ftcm_core.robots import Robot
from ftcm_core.signals import Measurement, ReferencePoint, Vector

REST = ReferencePoint((0.0,), (0.0,), (0.0,))


@dataclass(frozen=True, kw_only=True)
class DoubleIntegrator(Robot):
    """A mass that nothing else acts on: m a = torque."""

    mass: float = param(1.0, unit="kg", above=0.0, doc="mass", source="chosen")

    joint_names: ClassVar[tuple[str, ...]] = ("x",)

    def inverse_dynamics(self, q: Vector, v: Vector, a: Vector) -> Vector:
        """M a."""
        return (self.mass * a[0],)

    def forward_dynamics(self, q: Vector, v: Vector, tau: Vector) -> Vector:
        """Torque by mass."""
        return (tau[0] / self.mass,)

    def gravity(self, q: Vector) -> Vector:
        """None."""
        return (0.0,)


class Motion(NamedTuple):
    """A run: one entry per tick; ``state`` is the law's after the tick's step."""

    t: Any
    e: Any
    de: Any
    u: Any
    dde: Any
    """Acceleration error over the tick that begins here."""
    state: list[Vector]


def run(
    law: Controller,
    duration: float,
    e0: float = 0.0,
    v0: float = 0.0,
    disturbance: Callable[[float], float] = lambda t: 0.0,
    *,
    dt: float = 1e-3,
    mass: float = 1.0,
    model: Robot | None = None,
) -> Motion:
    """Hold a joint at zero.

    Args:
        law: the law.
        duration: s.
        e0: initial position, rad.
        v0: initial velocity, rad/s.
        disturbance: added acceleration d(t), held over the tick, rad/s².
        dt: tick, s.
        mass: true mass.
        model: what the law believes; a mass of 1 by default.
    """
    believed = model or DoubleIntegrator()
    q, v, effort, state, rows, states = e0, v0, 0.0, law.init(1), [], []
    for k in range(round(duration / dt) + 1):
        y = Measurement((q,), (v,), (effort,))
        prepared = law.prepare(believed, dt, y, REST, state)
        (effort,), state = law.step(believed, dt, y, REST, (0.0,), state, prepared)
        a = effort / mass + disturbance(k * dt)
        rows.append((k * dt, q, v, effort, a))
        states.append(state[0])
        q, v = q + dt * v + 0.5 * dt * dt * a, v + dt * a
    return Motion(*np.array(rows).T, states)


def variation(u: Any) -> float:
    """Sum of |u_{k+1} - u_k|."""
    return float(np.abs(np.diff(u)).sum())
