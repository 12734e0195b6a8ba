# SPDX-License-Identifier: Apache-2.0
"""Time-delay control, a baseline that needs no model but a constant inertia."""

from __future__ import annotations

from ftcm_core.controllers import FeedbackLaw
from ftcm_core.numeric import select
from ftcm_core.params import joint_parameters, param
from ftcm_core.registry import register
from ftcm_core.robots import Robot
from ftcm_core.signals import Measurement, ReferencePoint, State, Vector


@register("controller", "tdc")
class TDC(FeedbackLaw):
    """Time-delay control: u = u⁻ - M̄ ẍ⁻ + M̄ (ẍ_r - kd ė - kp e) (Hsia and Gao 1990).

    Also Youcef-Toumi and Ito (1990). All that the torque does besides M̄ ẍ is taken to be what it was in
    the tick before: u⁻ is the effort that the drives report for that tick, ẍ⁻ the difference of the
    measured velocities over it. On an inertia M what is left of a disturbance shrinks by (1 - M̄/M) a tick:
    for M̄ = M a constant one is cancelled from the second tick on, and one of slope L leaves L dt. The proof
    asks that all eigenvalues of I - M(q)⁻¹ M̄ lie within the unit circle, which for one joint is M̄ < 2 M.

    In the first tick, which has none before it, the gravity torque of the model stands in. ẍ⁻ is twice too
    large where a tick was missed (real time), and has the noise of the velocity, times 1/dt; with a delay of
    the torque besides, the law is of no use (docs/laws.md).
    """

    m_bar: float = param(
        1.0,
        unit="kg·m²",
        above=0.0,
        per_joint=True,
        doc="constant inertia M̄",
        source="Hsia and Gao (1990); value chosen: below the smallest eigenvalue of the PUMA's M(q), 1.08",
    )
    kp: float = param(
        100.0,
        unit="1/s²",
        above=0.0,
        per_joint=True,
        doc="position gain",
        source="chosen: as for ctc",
    )
    kd: float = param(
        20.0, unit="1/s", at_least=0.0, per_joint=True, doc="velocity gain", source="chosen: as for ctc"
    )

    def init(self, joints: int) -> State:
        """Whether it has started, and the velocity of the last tick."""
        return ((0.0, 0.0),) * joints

    def feedback(
        self, model: Robot, dt: float, y: Measurement, reference: ReferencePoint, state: State
    ) -> tuple[Vector, State]:
        """The torque of the last tick, corrected by M̄ times what the acceleration lacks."""
        u = []
        for p, g, q, v, effort, qr, vr, ar, (started, before) in zip(
            joint_parameters(self, model.joints), model.gravity(y.position), *y, *reference, state
        ):
            wanted = ar - p.kd * (v - vr) - p.kp * (q - qr)
            rest = select(started, effort - p.m_bar * (v - before) / dt, g)
            u.append(rest + p.m_bar * wanted)
        return tuple(u), tuple([(1.0, v) for v in y.velocity])
