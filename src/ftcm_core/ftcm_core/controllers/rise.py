# SPDX-License-Identifier: Apache-2.0
"""Robust integral of the sign of the error, a baseline."""

from __future__ import annotations

from typing import ClassVar

from ftcm_core.controllers import AccelerationLaw
from ftcm_core.numeric import select, sgn
from ftcm_core.params import param
from ftcm_core.registry import register
from ftcm_core.signals import Vector


def rise(
    e2: float, started: float, integral: float, k: float, alpha2: float, beta: float, dt: float
) -> tuple[float, float]:
    """Compute k e2(t) - k e2(0) + ∫(k α2 e2 + β sgn e2), its integral by forward Euler.

    Args:
        e2: filtered error at t_k, rad/s.
        started: 0 in the first tick, else 1.
        integral: the integral less k e2(0) at t_k, rad/s².
        k: gain k_s + 1, 1/s.
        alpha2: gain α2, 1/s.
        beta: gain β of the sign, rad/s³.
        dt: tick length, s.

    Returns:
        The feedback at t_k, rad/s², to be subtracted from the acceleration; and the integral at t_{k+1}.
    """
    integral = select(started, integral, -k * e2)
    return k * e2 + integral, integral + dt * (k * alpha2 * e2 + beta * sgn(e2))


@register("controller", "rise")
class RISE(AccelerationLaw):
    """RISE: v = ẍ_r - (ks + 1)(e2 - e2(0)) - ∫((ks + 1) α2 e2 + β sgn e2) (Xian et al. 2004).

    e2 = ė + α1 e. The torque is continuous, and yet the error vanishes asymptotically under any
    disturbance d that is smooth enough: the proof asks for β > sup|ḋ| + sup|d̈|/α2, α1 > 1/2, α2 > 1, and
    a ks that is large for a large initial error. An abrupt fault is no smooth disturbance; it is a new
    start. Held over ticks, the sign makes the acceleration step by β dt a tick, and an error of the order
    of dt is left.
    """

    alpha1: float = param(
        5.0,
        unit="1/s",
        above=0.0,
        per_joint=True,
        doc="gain α1 of the filtered error e2",
        source="Xian et al. (2004); value chosen",
    )
    alpha2: float = param(
        5.0,
        unit="1/s",
        above=0.0,
        per_joint=True,
        doc="gain α2 of the integral",
        source="Xian et al. (2004); value chosen",
    )
    ks: float = param(
        80.0,
        unit="1/s",
        at_least=0.0,
        per_joint=True,
        doc="feedback gain ks",
        source="Xian et al. (2004); value chosen",
    )
    beta: float = param(
        5.0,
        unit="rad/s³",
        at_least=0.0,
        per_joint=True,
        doc="gain β of the sign",
        source="Xian et al. (2004); value chosen: enough before the paper's fault, where |ḋ| < 0.15",
    )

    initial: ClassVar[Vector] = (0.0, 0.0)
    """Whether it has started, and the integral, rad/s²."""

    @staticmethod
    def law(p: RISE, e: float, de: float, dt: float, s: Vector) -> tuple[float, Vector]:
        """-(ks + 1)(e2 - e2(0)) - ∫((ks + 1) α2 e2 + β sgn e2)."""
        feedback, integral = rise(de + p.alpha1 * e, s[0], s[1], p.ks + 1.0, p.alpha2, p.beta, dt)
        return -feedback, (1.0, integral)

    def warnings(self) -> list[str]:
        """α1 > 1/2 and α2 > 1."""
        least = {"alpha1": 0.5, "alpha2": 1.0}
        found = []
        for name, bound in least.items():
            value = getattr(self, name)
            if min(value if isinstance(value, tuple) else (value,)) <= bound:
                found.append(
                    f"controller rise: {name}={value}; the proof of Xian et al. asks for more than {bound:g}"
                )
        return found
