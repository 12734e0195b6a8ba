# SPDX-License-Identifier: Apache-2.0
"""Observer by differentiation: velocity and acceleration by Levant (2003), then the model."""

from __future__ import annotations

from typing import ClassVar, NamedTuple

from ftcm_core.numeric import select
from ftcm_core.observers import Observer, relaxed
from ftcm_core.observers.homogeneous import differentiate, differentiate_implicit, discretisation
from ftcm_core.params import joint_parameters, param
from ftcm_core.registry import register
from ftcm_core.robots import Robot
from ftcm_core.signals import Measurement, Vector


class LevantState(NamedTuple):
    """State at t_k."""

    estimate: Vector
    """tau_hat, N·m."""
    chains: tuple[Vector, ...]
    """Per joint: ẑ0 (rad), ẑ1 (rad/s), ẑ2 (rad/s²)."""
    begun: float
    """0 at the first measurement, then 1."""


@register("observer", "levant")
class Levant(Observer):
    """Levant's differentiator: T dτ̂/dt = u - M(q) ẑ2 - h(q, ẑ1) - G(q) - τ̂, with ẑ1 → q̇ and ẑ2 → q̈.

    Of second order: exact after a finite time where the jerk |d³q/dt³| <= L, up to the sampling: errors
    of ẑ1 of the order L dt², of ẑ2 of the order L dt. It needs no model to differentiate; therefore L
    bounds all of the jerk, and not only what the model does not know. The low-pass is needed wherever a
    law adds the estimate to its torque: u is in the estimate at once, the acceleration that it makes only
    when ẑ2 has found it.
    """

    lipschitz: float = param(
        1000.0,
        unit="rad/s³",
        above=0.0,
        per_joint=True,
        doc="bound L of the jerk",
        source="Levant (2003); value chosen: above that of the paper's experiment but in its first 0.2 s",
    )
    time_constant: float = param(
        0.02,
        unit="s",
        above=0.0,
        per_joint=True,
        doc="time constant T of the low-pass of the estimate",
        source="chosen: with half of it the paper's law and this observer are unstable together",
    )
    discretisation: str = discretisation()

    needs_velocity: ClassVar[bool] = False

    def init(self, model: Robot, y: Measurement) -> LevantState:
        """No joint's velocity is known yet."""
        return LevantState((0.0,) * model.joints, tuple([(q, 0.0, 0.0) for q in y.position]), 0.0)

    def step(self, model: Robot, dt: float, y: Measurement, state: LevantState) -> tuple[Vector, LevantState]:
        """Differentiate, ask the model which torque such a motion takes, low-pass the rest."""
        parameters = joint_parameters(self, model.joints)
        advance = differentiate_implicit if self.discretisation == "implicit" else differentiate
        chains = tuple(
            [
                advance(p.lipschitz, z0, select(state.begun, z1, (q - z0) / dt), z2, 0.0, q, dt)
                for p, (z0, z1, z2), q in zip(parameters, state.chains, y.position)
            ]
        )
        velocity, acceleration = tuple([z[1] for z in chains]), tuple([z[2] for z in chains])
        needed = model.inverse_dynamics(y.position, velocity, acceleration)
        estimate = tuple(
            [
                relaxed(1.0 / p.time_constant, tau, u - x, dt)
                for p, tau, u, x in zip(parameters, state.estimate, y.effort, needed)
            ]
        )
        return estimate, LevantState(estimate, chains, 1.0)
