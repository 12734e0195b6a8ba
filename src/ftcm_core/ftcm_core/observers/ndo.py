# SPDX-License-Identifier: Apache-2.0
"""Nonlinear disturbance observer: Chen et al. (2000), for any number of joints Mohammadi et al. (2013).

W.-H. Chen, D. J. Ballance, P. J. Gawthrop, J. O'Reilly, "A nonlinear disturbance observer for robotic
manipulators", IEEE Trans. Ind. Electron. 47 (2000) 932-938; A. Mohammadi, M. Tavakoli, H. J. Marquez, F.
Hashemzadeh, "Nonlinear disturbance observer design for robotic manipulators", Control Eng. Practice 21
(2013) 253-267.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from ftcm_core.observers import Observer, middle
from ftcm_core.params import joint_parameters, param, per_joint
from ftcm_core.registry import register
from ftcm_core.robots import Robot
from ftcm_core.signals import Measurement, Vector

CONFIGURATIONS = 24
"""How many configurations a warning looks at, spread over all."""


class NDOState(NamedTuple):
    """State at t_k."""

    estimate: Vector
    """tau_hat = -d̂, N·m; the auxiliary variable of the papers is z = d̂ - Y q̇."""
    inertia: Vector
    """Diagonal of M where the observer started, kg·m²."""
    position: Vector
    """q_k, rad."""
    velocity: Vector
    """v_k, rad/s."""


@register("observer", "ndo")
class NDO(Observer):
    """Nonlinear DO: d̂ = z + Y q̇, ż = -L(z + Y q̇) + L(h + G - u), L = Y M⁻¹(q), tau_hat = -d̂.

    No acceleration is measured: Y M⁻¹ times the equation of motion leaves d(Y q̇)/dt. The error obeys ė =
    -Y M⁻¹(q) e for a constant disturbance, and goes to zero where 2 Y > Ṁ. Y is diagonal: `rate` times
    the diagonal of M where the observer starts, so that each joint's error decays about as e^{-rate t}.
    Forward Euler, the model evaluated in the middle of the tick: stable while the largest eigenvalue of Y
    M⁻¹ is below 2/dt.
    """

    rate: float = param(
        125.0,
        unit="1/s",
        above=0.0,
        per_joint=True,
        doc="rate at which the error decays where M is diagonal and as at the start",
        source="Mohammadi et al. (2013), X = Y⁻¹; chosen: 90 % of a step as soon as the paper's observer",
    )

    def init(self, model: Robot, y: Measurement) -> NDOState:
        """The gain is made for the configuration in which it starts."""
        return NDOState((0.0,) * model.joints, diagonal(model, y.position), y.position, y.velocity)

    def step(self, model: Robot, dt: float, y: Measurement, state: NDOState) -> tuple[Vector, NDOState]:
        """Compare the change of the velocity with what the model makes of the torque less the estimate."""
        acceleration = model.forward_dynamics(
            middle(state.position, y.position),
            middle(state.velocity, y.velocity),
            tuple([u - tau for u, tau in zip(y.effort, state.estimate)]),
        )
        estimate = tuple(
            [
                tau + p.rate * m * (dt * a - (v - v_before))
                for p, tau, m, a, v_before, v in zip(
                    joint_parameters(self, model.joints),
                    state.estimate,
                    state.inertia,
                    acceleration,
                    state.velocity,
                    y.velocity,
                )
            ]
        )
        return estimate, state._replace(estimate=estimate, position=y.position, velocity=y.velocity)

    def warnings(self, model: Robot, dt: float) -> list[str]:
        """Where the forward Euler step is unstable in some configuration, for some start."""
        fastest = fastest_rate(model, per_joint(self.rate, model.joints))
        if not fastest * dt >= 2.0:
            return []
        return [
            f"observer ndo: unstable in some configuration with ticks of {dt:g} s: the error's fastest rate "
            f"is {fastest:.4g} 1/s; expected below {2.0 / dt:g}; lower rate or dt"
        ]


def fastest_rate(model: Robot, rates: Vector) -> float:
    """Largest eigenvalue of Y M⁻¹ over configurations, Y made where M is largest, 1/s; NaN if it has none."""
    n, top = model.joints, max(rates)
    units = np.eye(n).tolist()
    matrices = [np.array([model.inertia_torque(q, tuple(unit)) for unit in units]) for q in configurations(n)]
    with np.errstate(all="ignore"):
        largest = np.max([np.diagonal(m) for m in matrices], axis=0)
        root = np.diag(np.sqrt(np.array(rates) / top * largest))
        try:
            return top * max(float(np.linalg.eigvalsh(root @ np.linalg.inv(m) @ root)[-1]) for m in matrices)
        except np.linalg.LinAlgError:  # M has no inverse in floats
            return math.nan


def diagonal(model: Robot, q: Vector) -> Vector:
    """Diagonal of M(q), kg·m²."""
    n = len(q)
    units = [tuple([1.0 if i == j else 0.0 for i in range(n)]) for j in range(n)]
    return tuple([model.inertia_torque(q, unit)[j] for j, unit in enumerate(units)])


def configurations(joints: int) -> list[Vector]:
    """Return positions (rad) spread over all configurations; the first is zero."""
    golden = 0.5 * (math.sqrt(5.0) - 1.0)
    return [
        tuple([2.0 * math.pi * math.remainder(i * golden ** (j + 1), 1.0) for j in range(joints)])
        for i in range(CONFIGURATIONS)
    ]
