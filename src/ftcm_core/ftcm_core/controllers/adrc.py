# SPDX-License-Identifier: Apache-2.0
"""Linear active disturbance rejection control, a baseline that needs no model but an input gain."""

from __future__ import annotations

import math

from ftcm_core.controllers import FeedbackLaw
from ftcm_core.numeric import select
from ftcm_core.params import joint_parameters, param
from ftcm_core.registry import register
from ftcm_core.robots import Robot
from ftcm_core.signals import Measurement, ReferencePoint, State, Vector


def extended_state(
    z1: float, z2: float, z3: float, input_acceleration: float, position: float, omega: float, dt: float
) -> tuple[float, float, float]:
    """One tick of the extended state observer of ẍ = b0 u + f, ḟ = 0, exact for u held over the tick.

    The "current" form: predict to t_k, then correct with the measurement at t_k (Miklosovic, Radke, Gao
    2006). Its three poles lie at exp(-ω dt).

    Args:
        z1: estimate of the position at t_{k-1}, rad.
        z2: estimate of the velocity, rad/s.
        z3: estimate of f, all that accelerates the joint besides the input, rad/s².
        input_acceleration: b0 u over the tick, rad/s².
        position: measured position at t_k, rad.
        omega: bandwidth ω of the observer, 1/s.
        dt: tick length, s.

    Returns:
        The three estimates at t_k.
    """
    a = input_acceleration + z3
    z1 = z1 + dt * z2 + 0.5 * dt * dt * a
    z2 = z2 + dt * a
    pole = math.exp(-omega * dt)
    gap = 1.0 - pole
    innovation = position - z1
    return (
        z1 + (1.0 - pole * pole * pole) * innovation,
        z2 + 1.5 * gap * gap * (1.0 + pole) / dt * innovation,
        z3 + gap * gap * gap / (dt * dt) * innovation,
    )


@register("controller", "adrc")
class ADRC(FeedbackLaw):
    """Linear ADRC: u = (ẍ_r - 2ωc (ẑ2 - ẋ_r) - ωc² (ẑ1 - x_r) - ẑ3)/b0, ẑ by its own ESO (Gao 2003).

    The extended state observer (ESO) is fed the measured position and the effort that the drives report.
    Of the robot it knows b0 only: coupling, gravity, friction and faults are all estimated as ẑ3. A
    constant disturbance is cancelled; one of slope L leaves an estimation error of 3 L/ωo. b0 need not be
    exact: at 1 kHz and the default bandwidths one joint is stable with a true gain of 0.07 b0 to 6 b0.

    The measured velocity, and the gravity torque of the model, are used in the first tick only, as the
    first state of the ESO. A tick that was missed (real time) disturbs the estimate.
    """

    b0: float = param(
        (0.25, 0.14, 0.86),
        unit="1/(kg·m²)",
        above=0.0,
        per_joint=True,
        doc="input gain b0, acceleration per torque",
        source="Gao (2003); value chosen: the inverse of the diagonal of the PUMA's M(q)",
    )
    omega_c: float = param(
        10.0,
        unit="1/s",
        above=0.0,
        per_joint=True,
        doc="bandwidth ωc of the control loop",
        source="Gao (2003); value chosen: as for ctc",
    )
    omega_o: float = param(
        200.0,
        unit="1/s",
        above=0.0,
        per_joint=True,
        doc="bandwidth ωo of the ESO",
        source="Gao (2003); value chosen: 20 ωc, well below 1 kHz",
    )

    def init(self, joints: int) -> State:
        """Whether it has started, and the three estimates."""
        return ((0.0, 0.0, 0.0, 0.0),) * joints

    def feedback(
        self, model: Robot, dt: float, y: Measurement, reference: ReferencePoint, state: State
    ) -> tuple[Vector, State]:
        """Advance the ESO to t_k, then feed its estimates back."""
        u, following = [], []
        for p, g, q, v, effort, qr, vr, ar, (started, o1, o2, o3) in zip(
            joint_parameters(self, model.joints), model.gravity(y.position), *y, *reference, state
        ):
            found = extended_state(o1, o2, o3, p.b0 * effort, q, p.omega_o, dt)
            z1, z2, z3 = [select(started, a, b) for a, b in zip(found, (q, v, -p.b0 * g))]
            u.append((ar - 2.0 * p.omega_c * (z2 - vr) - p.omega_c * p.omega_c * (z1 - qr) - z3) / p.b0)
            following.append((1.0, z1, z2, z3))
        return tuple(u), tuple(following)
