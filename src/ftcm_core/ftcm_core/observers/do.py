# SPDX-License-Identifier: Apache-2.0
"""The paper's disturbance observer (eq 27)."""

from __future__ import annotations

from typing import NamedTuple

from ftcm_core.observers import Observer
from ftcm_core.params import joint_parameters, param
from ftcm_core.registry import register
from ftcm_core.robots import Robot
from ftcm_core.signals import Measurement, Vector


class DOState(NamedTuple):
    """Observer state at t_k and the measurement it will be advanced with."""

    omega_hat: Vector
    """Estimate ω̂ of the joint velocity, rad/s."""
    delta_hat: Vector
    """Estimate Δ̂ of the lumped uncertainty, rad/s²."""
    position: Vector
    """q_k, rad."""
    velocity: Vector
    """v_k, rad/s."""


@register("observer", "do")
class DO(Observer):
    """Disturbance observer: ω̂̇ = M⁻¹(u - h - G) - Δ̂ - k2(ω̂ - x2), Δ̂̇ = k1(ω̂ - x2) (eq 27), forward Euler."""

    k1: float = param(
        20000.0, unit="1/s²", above=0.0, per_joint=True, doc="disturbance gain k1", source="Table 1"
    )
    k2: float = param(200.0, unit="1/s", above=0.0, per_joint=True, doc="velocity gain k2", source="Table 1")

    def init(self, model: Robot, y: Measurement) -> DOState:
        """ω̂ starts at the measured velocity, Δ̂ at zero."""
        return DOState(y.velocity, (0.0,) * model.joints, y.position, y.velocity)

    def step(self, model: Robot, dt: float, y: Measurement, state: DOState) -> tuple[Vector, DOState]:
        """One forward-Euler step with y_{k-1} and the torque applied since; returns M(q_k) Δ̂."""
        acceleration = model.forward_dynamics(state.position, state.velocity, y.effort)
        omega, delta = [], []
        for p, w, d, v, a in zip(
            joint_parameters(self, model.joints),
            state.omega_hat,
            state.delta_hat,
            state.velocity,
            acceleration,
        ):
            w_next, d_next = observer_step(p.k1, p.k2, w, d, v, a, dt)
            omega.append(w_next)
            delta.append(d_next)
        delta_hat = tuple(delta)
        return (
            model.inertia_torque(y.position, delta_hat),
            DOState(tuple(omega), delta_hat, y.position, y.velocity),
        )

    def warnings(self, model: Robot, dt: float) -> list[str]:
        """Gains for which the forward Euler step is unstable."""
        return [
            f"{where}: k1={p.k1:g} and k2={p.k2:g} are unstable with ticks of {dt:g} s; expected k1 dt < k2 "
            "and k2 dt < 2 + k1 dt²/2; lower the gains or dt"
            for where, p in self.each_joint()
            if not (p.k1 * dt < p.k2 and p.k2 * dt < 2.0 + 0.5 * p.k1 * dt * dt)
        ]


def observer_step(
    k1: float, k2: float, omega_hat: float, delta_hat: float, velocity: float, acceleration: float, dt: float
) -> tuple[float, float]:
    """Eq 27 for one joint over one tick.

    Args:
        k1: disturbance gain, 1/s².
        k2: velocity gain, 1/s.
        omega_hat: ω̂, rad/s.
        delta_hat: Δ̂, rad/s².
        velocity: measured velocity x2, rad/s.
        acceleration: model acceleration q u - H, rad/s².
        dt: tick length, s.

    Returns:
        ω̂ (rad/s) and Δ̂ (rad/s²) one tick later.
    """
    innovation = omega_hat - velocity
    return (
        omega_hat + dt * (acceleration - delta_hat - k2 * innovation),
        delta_hat + dt * k1 * innovation,
    )
