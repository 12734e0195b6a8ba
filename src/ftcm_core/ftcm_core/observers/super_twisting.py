# SPDX-License-Identifier: Apache-2.0
"""Super-twisting observer: Davila, Fridman and Levant (2005), the paper's [44], one derivative higher.

J. Davila, L. Fridman, A. Levant, "Second-order sliding-mode observer for mechanical systems", IEEE Trans.
Autom. Control 50 (2005) 1785-1789. It observes x2 of ẋ1 = x2, ẋ2 = f, |f| <= f⁺, from x1. There x1 is the
position. Here x1 is the velocity less what the model makes of it, so x2 is -Δ, and f⁺ the bound of its
rate: that is how the observer gives the disturbance itself, and not its average from a low-pass of the
switching term. So used it is the differentiator of A. Levant, "Robust exact differentiation via sliding
mode technique", Automatica 34 (1998) 379-384, from where the gains are.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from ftcm_core.numeric import sgn, sig
from ftcm_core.observers import Observer, middle
from ftcm_core.observers.homogeneous import discretisation
from ftcm_core.params import joint_parameters, param
from ftcm_core.registry import register
from ftcm_core.robots import Robot
from ftcm_core.signals import Measurement, Vector


class SuperTwistingState(NamedTuple):
    """State at t_k."""

    omega_hat: Vector
    """Estimate ω̂ of the joint velocity, rad/s."""
    delta_hat: Vector
    """Estimate Δ̂, rad/s²."""
    position: Vector
    """q_k, rad."""
    velocity: Vector
    """v_k, rad/s."""


@register("observer", "super_twisting")
class SuperTwisting(Observer):
    """Super-twisting: ω̂̇ = M⁻¹(u - h - G) - Δ̂ - λ1 L^½ |s|^½ sgn s, Δ̂̇ = λ2 L sgn s, s = ω̂ - q̇.

    Exact after a finite time where |Δ̇| <= L, up to the sampling: an error of Δ̂ of the order L dt.
    """

    lipschitz: float = param(
        200.0, unit="rad/s³", above=0.0, per_joint=True, doc="bound L of the rate of Δ",
        source="Davila et al. (2005), f⁺; value chosen: just above that of the paper's Δ but at the onset",
    )  # fmt: skip
    lambda1: float = param(
        1.5, unit="-", above=0.0, per_joint=True, doc="factor λ1 of the square root",
        source="Levant (1998): λ = 1.5 L^½",
    )  # fmt: skip
    lambda2: float = param(
        1.1, unit="-", above=0.0, per_joint=True, doc="factor λ2 of the sign",
        source="Levant (1998): α = 1.1 L",
    )  # fmt: skip
    discretisation: str = discretisation()

    def init(self, model: Robot, y: Measurement) -> SuperTwistingState:
        """ω̂ starts at the measured velocity, Δ̂ at zero."""
        return SuperTwistingState(y.velocity, (0.0,) * model.joints, y.position, y.velocity)

    def step(
        self, model: Robot, dt: float, y: Measurement, state: SuperTwistingState
    ) -> tuple[Vector, SuperTwistingState]:
        """Predict by the model, correct by the velocity; returns M(q_k) Δ̂."""
        acceleration = model.forward_dynamics(
            middle(state.position, y.position), middle(state.velocity, y.velocity), y.effort
        )
        correct = twist_implicit if self.discretisation == "implicit" else twist
        omega, delta = [], []
        for p, w, d, a, v in zip(
            joint_parameters(self, model.joints), state.omega_hat, state.delta_hat, acceleration, y.velocity
        ):
            w_next, d_next = correct(p.lambda1, p.lambda2, p.lipschitz, w, d, a, v, dt)
            omega.append(w_next)
            delta.append(d_next)
        delta_hat = tuple(delta)
        return (
            model.inertia_torque(y.position, delta_hat),
            SuperTwistingState(tuple(omega), delta_hat, y.position, y.velocity),
        )

    def warnings(self, model: Robot, dt: float) -> list[str]:
        """Factors for which Δ̂ need not converge."""
        return [
            f"{where}: with lambda1={p.lambda1:g} and lambda2={p.lambda2:g} an error of Δ̂ can come back "
            f"{back:.3g} times as large; expected below 1; raise lambda1, or lambda2 above 1"
            for where, p in self.each_joint()
            if (back := largest_return(p.lambda1, p.lambda2)) >= 1.0
        ]


def twist(
    lambda1: float, lambda2: float, lipschitz: float, omega_hat: float, delta_hat: float, a: float, v: float,
    dt: float,
) -> tuple[float, float]:  # fmt: skip
    """One tick of the observer for one joint: predict, then correct with the current measurement.

    Args:
        lambda1: factor λ1.
        lambda2: factor λ2.
        lipschitz: L, rad/s³.
        omega_hat: ω̂ at t_{k-1}, rad/s.
        delta_hat: Δ̂ at t_{k-1}, rad/s².
        a: acceleration by the model over the tick, rad/s².
        v: measured velocity at t_k, rad/s.
        dt: tick length, s.

    Returns:
        ω̂ (rad/s) and Δ̂ (rad/s²) at t_k.
    """
    predicted = omega_hat + dt * (a - delta_hat)
    s = predicted - v
    return (
        predicted - dt * lambda1 * math.sqrt(lipschitz) * sig(s, 0.5),
        delta_hat + dt * lambda2 * lipschitz * sgn(s),
    )


def twist_implicit(
    lambda1: float, lambda2: float, lipschitz: float, omega_hat: float, delta_hat: float, a: float, v: float,
    dt: float,
) -> tuple[float, float]:  # fmt: skip
    """As :func:`twist`, corrected by the error z that is left after the correction, by backward Euler.

    With s the predicted error, z + dt λ1 L^½ |z|^½ sgn z + dt² λ2 L ξ = s, ξ ∈ Sgn z: where |s| <= dt² λ2
    L nothing is left, and no sign chatters.

    Args:
        lambda1: see :func:`twist`.
        lambda2: see :func:`twist`.
        lipschitz: see :func:`twist`.
        omega_hat: see :func:`twist`.
        delta_hat: see :func:`twist`.
        a: see :func:`twist`.
        v: see :func:`twist`.
        dt: see :func:`twist`.

    Returns:
        ω̂ (rad/s) and Δ̂ (rad/s²) at t_k.
    """
    s = omega_hat + dt * (a - delta_hat) - v
    rest = abs(s) - dt * dt * lambda2 * lipschitz
    if rest <= 0.0:
        return v, delta_hat + s / dt
    half = 0.5 * dt * lambda1 * math.sqrt(lipschitz)
    root = rest / (half + math.sqrt(half * half + rest))  # |z|^½
    return v + root * root * sgn(s), delta_hat + dt * lambda2 * lipschitz * sgn(s)


def largest_return(lambda1: float, lambda2: float) -> float:
    """Largest |Δ̃| at a zero of s, as a share of the one at the zero before, over all |Δ̇| <= L; Levant (1998).

    With x = |s|^½ and y = Δ̃ in units of L, dx/dσ = y - λ1 x and dy/dσ = -2κ x, where κ = λ2 - 1 while
    |s| grows and κ = λ2 + 1 while it shrinks is the worst. W = (y² - λ1 x y + 2κ x²)^½ then shrinks by
    exp(-½ λ1 σ) in each part.

    Args:
        lambda1: factor λ1.
        lambda2: factor λ2.

    Returns:
        The share; Δ̂ converges in finite time if it is below 1.
    """
    if lambda2 <= 1.0:
        return math.inf
    grows, shrinks = 2.0 * (lambda2 - 1.0), 2.0 * (lambda2 + 1.0)
    half = 0.5 * lambda1
    if shrinks <= half * half:  # no oscillation at all
        return 0.0
    d = grows - half * half
    root = math.sqrt(abs(d))
    if d == 0.0:
        first = 1.0 / half
    else:
        first = (math.atan2(root, half) if d > 0.0 else math.log((half + root) / math.sqrt(grows))) / root
    root = math.sqrt(shrinks - half * half)
    second = (math.atan2(half, root) + 0.5 * math.pi) / root
    return math.sqrt(shrinks / grows) * math.exp(-half * (first + second))
