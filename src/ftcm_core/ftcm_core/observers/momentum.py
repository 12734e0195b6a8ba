# SPDX-License-Identifier: Apache-2.0
"""Generalised momentum observer: De Luca and Mattone (2003, 2005).

A. De Luca, R. Mattone, "Actuator failure detection and isolation using generalized momenta", ICRA 2003,
634-639; "Sensorless robot collision detection and hybrid force/motion control", ICRA 2005, 999-1004.
"""

from __future__ import annotations

from typing import NamedTuple

from ftcm_core.observers import Observer, relaxed
from ftcm_core.params import joint_parameters, param
from ftcm_core.registry import register
from ftcm_core.robots import Robot
from ftcm_core.signals import Measurement, Vector


class MomentumState(NamedTuple):
    """State at t_k."""

    estimate: Vector
    """tau_hat, N·m."""
    momentum: Vector
    """p = M(q) q̇, N·m·s."""
    load: Vector
    """β = G + F - Cᵀq̇, N·m."""


@register("observer", "momentum")
class Momentum(Observer):
    """Generalised momentum: r = K (p - p(0) - ∫(u + Cᵀq̇ - G - F + r) dt), p = M(q) q̇, tau_hat = -r.

    It needs neither accelerations nor the inverse of M. With d the added torque and β = G + F - Cᵀq̇ it is
    ṗ = u - β + d, so ṙ = K(d - r) for each joint by itself: a constant d is found with the error e^{-K t}.
    Over a tick that is solved exactly, d being held, and β is integrated by the trapezoidal rule; stable for
    every K and dt.
    """

    gain: float = param(
        125.0,
        unit="1/s",
        above=0.0,
        per_joint=True,
        doc="gain K: the rate at which the error decays",
        source="De Luca and Mattone (2003); value chosen: 90 % of a step as soon as the paper's observer",
    )

    def init(self, model: Robot, y: Measurement) -> MomentumState:
        """The momentum is the measured one."""
        return MomentumState((0.0,) * model.joints, *momentum_and_load(model, y))

    def step(
        self, model: Robot, dt: float, y: Measurement, state: MomentumState
    ) -> tuple[Vector, MomentumState]:
        """Low-pass what the change of the momentum leaves of the torque."""
        momentum, load = momentum_and_load(model, y)
        estimate = tuple(
            [
                relaxed(p.gain, r, u - 0.5 * (b_before + b) - (x - x_before) / dt, dt)
                for p, r, u, b_before, b, x_before, x in zip(
                    joint_parameters(self, model.joints),
                    state.estimate,
                    y.effort,
                    state.load,
                    load,
                    state.momentum,
                    momentum,
                )
            ]
        )
        return estimate, MomentumState(estimate, momentum, load)


def momentum_and_load(model: Robot, y: Measurement) -> tuple[Vector, Vector]:
    """Momentum M(q) q̇ (N·m·s), and β = C q̇ + G + F - Ṁ q̇ (N·m), which is G + F - Cᵀq̇ as Ṁ = C + Cᵀ."""
    q, v, _ = y
    bias = model.inverse_dynamics(q, v, (0.0,) * len(q))
    rate = model.inertia_rate_torque(q, v)
    return model.inertia_torque(q, v), tuple([b - r for b, r in zip(bias, rate)])
