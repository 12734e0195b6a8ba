# SPDX-License-Identifier: Apache-2.0
"""NFTSMC with super-twisting and a fault estimate by time delay, a baseline."""

from __future__ import annotations

from ftcm_core.controllers import FeedbackLaw
from ftcm_core.controllers.continuous_tsmc import terminal_time
from ftcm_core.controllers.super_twisting import super_twisting
from ftcm_core.numeric import select, sig
from ftcm_core.params import joint_parameters, param
from ftcm_core.registry import register
from ftcm_core.robots import Robot
from ftcm_core.signals import Measurement, ReferencePoint, State, Vector


def fast_surface(e: float, de: float, k1: float, alpha: float, k2: float, beta: float) -> float:
    """σ = e + k1 |e|^α sgn e + k2 |ė|^β sgn ė, rad.

    Args:
        e: tracking error, rad.
        de: velocity error, rad/s.
        k1: gain far from zero, rad^(1-α).
        alpha: exponent α > β.
        k2: gain of the rate, rad·(s/rad)^β.
        beta: exponent β in (1, 2).
    """
    return e + k1 * sig(e, alpha) + k2 * sig(de, beta)


def fast_surface_feedback(e: float, de: float, k1: float, alpha: float, k2: float, beta: float) -> float:
    """Acceleration error that keeps σ where it is: -|ė|^(2-β) sgn ė (1 + k1 α |e|^(α-1))/(k2 β), rad/s².

    Arguments as of :func:`fast_surface`.
    """
    return -sig(de, 2.0 - beta) * float(1.0 + k1 * alpha * abs(e) ** (alpha - 1.0)) / (k2 * beta)


@register("controller", "tde_nftsmc")
class TDENFTSMC(FeedbackLaw):
    """TDE-NFTSMC: v = ẍ_r + a(e, ė) - Ψ̂ - k3 |σ|^½ sgn σ - η, η̇ = k4 sgn σ (Van, Ge, Ren 2017).

    σ = e + k1 |e|^α sgn e + k2 |ė|^β sgn ė, and a keeps σ where it is. Ψ̂ is what the acceleration over
    the tick before had beyond the model's: (v_k - v_{k-1})/dt - M⁻¹(u⁻ - h - G), u⁻ being the effort that
    the drives report for that tick. So a constant fault is cancelled from the second tick on, and one of
    slope L leaves L dt for the super-twisting term. The gains of the paper are not taken over: those here
    are chosen for this drive and tick.

    In the first tick Ψ̂ is zero. It is wrong where a tick was missed (real time), and has the noise of the
    velocity, times 1/dt. |ė|^(2-β) is infinitely steep at zero, so a torque that is held over the tick
    ripples there.
    """

    k1: float = param(
        0.5,
        unit="rad^(1-α)",
        at_least=0.0,
        per_joint=True,
        doc="surface gain k1, far from zero",
        source="Van, Ge, Ren (2017); value chosen",
    )
    alpha: float = param(
        2.0,
        unit="-",
        above=1.0,
        per_joint=True,
        doc="surface exponent α, above β",
        source="Van, Ge, Ren (2017); value chosen",
    )
    k2: float = param(
        0.5,
        unit="rad·(s/rad)^β",
        above=0.0,
        per_joint=True,
        doc="surface gain k2",
        source="Van, Ge, Ren (2017); value chosen: 1/ϖ of nftsmc, Table 1",
    )
    beta: float = param(
        5.0 / 3.0,
        unit="-",
        above=1.0,
        below=2.0,
        per_joint=True,
        doc="surface exponent β",
        source="Van, Ge, Ren (2017); value chosen: l/q of nftsmc, Table 1",
    )
    k3: float = param(
        16.0,
        unit="rad^½/s²",
        at_least=0.0,
        per_joint=True,
        doc="super-twisting gain k3",
        source="Van, Ge, Ren (2017); value chosen: Υ1 of Table 1",
    )
    k4: float = param(
        5.0,
        unit="rad/s³",
        at_least=0.0,
        per_joint=True,
        doc="super-twisting integral gain k4",
        source="Van, Ge, Ren (2017); value chosen: more makes σ cycle",
    )

    def init(self, joints: int) -> State:
        """Whether it has started, position and velocity of the last tick, and η."""
        return ((0.0, 0.0, 0.0, 0.0),) * joints

    def warnings(self) -> list[str]:
        """α > β, where the surface is as fast as its name says."""
        joints = max((len(v) for v in self.values.values() if isinstance(v, tuple)), default=1)
        every = [self.for_joint(j) for j in range(joints)] if joints > 1 else [self]
        return [
            f"controller tde_nftsmc, {'all joints' if joints == 1 else f'joint {j + 1}'}: alpha={p.alpha:g}, "
            f"beta={p.beta:g}; the surface of Van, Ge and Ren asks for alpha > beta"
            for j, p in enumerate(every)
            if not p.alpha > p.beta
        ]

    def sliding_variable(self, e: float, de: float, joint: int) -> float:
        """σ of one joint for its errors, rad."""
        p = self.for_joint(joint)
        return fast_surface(e, de, p.k1, p.alpha, p.k2, p.beta)

    def settling_time_bound(self, e0: float, joint: int) -> float:
        """Time on σ = 0 from |e0| to zero with k1 = 0; k1 makes it shorter, s."""
        p = self.for_joint(joint)
        return terminal_time(e0, p.k2, p.beta)

    def feedback(
        self, model: Robot, dt: float, y: Measurement, reference: ReferencePoint, state: State
    ) -> tuple[Vector, State]:
        """U = M(q) v + h + G."""
        _, last_position, last_velocity, _ = zip(*state)
        believed = model.forward_dynamics(last_position, last_velocity, y.effort)
        acceleration, following = [], []
        for p, b, q, v, qr, vr, ar, (started, _, before, eta) in zip(
            joint_parameters(self, model.joints), believed, *y[:2], *reference, state
        ):
            e, de = q - qr, v - vr
            psi = select(started, (v - before) / dt - b, 0.0)
            sigma = fast_surface(e, de, p.k1, p.alpha, p.k2, p.beta)
            kept = fast_surface_feedback(e, de, p.k1, p.alpha, p.k2, p.beta)
            u_r, eta = super_twisting(sigma, eta, p.k3, p.k4, dt)
            acceleration.append(ar + kept - psi - u_r)
            following.append((1.0, q, v, eta))
        return model.inverse_dynamics(y.position, y.velocity, tuple(acceleration)), tuple(following)
