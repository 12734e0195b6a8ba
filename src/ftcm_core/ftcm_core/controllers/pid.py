# SPDX-License-Identifier: Apache-2.0
"""PID with gravity compensation and anti-windup, a sanity baseline."""

from __future__ import annotations

from ftcm_core.controllers import FeedbackLaw
from ftcm_core.numeric import clamp
from ftcm_core.params import joint_parameters, param
from ftcm_core.registry import register
from ftcm_core.robots import Robot
from ftcm_core.signals import Measurement, ReferencePoint, State, Vector


@register("controller", "pid")
class PID(FeedbackLaw):
    """PID: u = G(q) - kp e - kd ė - ki ∫e, the integral torque clamped to integral_limit."""

    kp: float = param(
        (400.0, 700.0, 150.0),
        unit="N·m/rad",
        above=0.0,
        per_joint=True,
        doc="position gain",
        source="chosen: about 10 rad/s on the PUMA's joint inertias",
    )
    kd: float = param(
        (80.0, 140.0, 30.0),
        unit="N·m·s/rad",
        at_least=0.0,
        per_joint=True,
        doc="velocity gain",
        source="chosen: about critical damping",
    )
    ki: float = param(
        (400.0, 700.0, 150.0),
        unit="N·m/(rad·s)",
        at_least=0.0,
        per_joint=True,
        doc="integral gain",
        source="chosen: integral time 1 s",
    )
    integral_limit: float = param(
        30.0,
        unit="N·m",
        at_least=0.0,
        per_joint=True,
        doc="largest integral torque (anti-windup by clamping)",
        source="chosen: above the paper's disturbances",
    )

    def init(self, joints: int) -> State:
        """Zero integral torque."""
        return ((0.0,),) * joints

    def feedback(
        self, model: Robot, dt: float, y: Measurement, reference: ReferencePoint, state: State
    ) -> tuple[Vector, State]:
        """Gravity plus PID torque; the clamped integral advances by forward Euler."""
        u, following = [], []
        for p, g, q, v, qr, vr, (integral,) in zip(
            joint_parameters(self, model.joints),
            model.gravity(y.position),
            y.position,
            y.velocity,
            reference.position,
            reference.velocity,
            state,
        ):
            e = q - qr
            integral = clamp(integral, p.integral_limit)  # new limits hold at once
            u.append(g - p.kp * e - p.kd * (v - vr) - integral)
            following.append((integral + dt * p.ki * e,))
        return tuple(u), tuple(following)
