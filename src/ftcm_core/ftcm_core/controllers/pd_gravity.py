# SPDX-License-Identifier: Apache-2.0
"""PD control with gravity compensation, a baseline."""

from __future__ import annotations

from ftcm_core.controllers import FeedbackLaw
from ftcm_core.params import joint_parameters, param
from ftcm_core.registry import register
from ftcm_core.robots import Robot
from ftcm_core.signals import Measurement, ReferencePoint, State, Vector


@register("controller", "pd_gravity")
class PDGravity(FeedbackLaw):
    """PD with gravity compensation: u = G(q) - kp e - kd ė (Takegaki and Arimoto 1981).

    With the true gravity and no disturbance a setpoint is reached from anywhere, for any positive gains. A
    torque that the model does not know leaves e = torque/kp at rest, and a moving reference is followed
    with an error.
    """

    kp: float = param(
        (400.0, 700.0, 150.0),
        unit="N·m/rad",
        above=0.0,
        per_joint=True,
        doc="position gain",
        source="chosen: as for pid",
    )
    kd: float = param(
        (80.0, 140.0, 30.0),
        unit="N·m·s/rad",
        above=0.0,
        per_joint=True,
        doc="velocity gain",
        source="chosen: as for pid",
    )

    def init(self, joints: int) -> State:
        """Nothing to remember."""
        return ((),) * joints

    def feedback(
        self, model: Robot, dt: float, y: Measurement, reference: ReferencePoint, state: State
    ) -> tuple[Vector, State]:
        """Gravity torque and PD."""
        u = [
            g - p.kp * (q - qr) - p.kd * (v - vr)
            for p, g, q, v, qr, vr in zip(
                joint_parameters(self, model.joints), model.gravity(y.position), *y[:2], *reference[:2]
            )
        ]
        return tuple(u), state
