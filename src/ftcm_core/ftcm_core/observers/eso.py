# SPDX-License-Identifier: Apache-2.0
"""Linear extended state observer: Han (2009) with the bandwidth as its only parameter, Gao (2003).

J. Han, "From PID to active disturbance rejection control", IEEE Trans. Ind. Electron. 56 (2009) 900-906;
Z. Gao, "Scaling and bandwidth-parameterization based controller tuning", ACC 2003, 4989-4996. In discrete
time: R. Miklosovic, A. Radke, Z. Gao, "Discrete implementation and generalization of the extended state
observer", ACC 2006.
"""

from __future__ import annotations

import math

from ftcm_core.observers.position_observer import PositionObserver, predict
from ftcm_core.params import param
from ftcm_core.registry import register
from ftcm_core.signals import Vector


@register("observer", "eso")
class ESO(PositionObserver):
    """Linear ESO: x̂̇1 = x̂2 + 3ω ε, x̂̇2 = M⁻¹(u - h - G) + x̂3 + 3ω² ε, x̂̇3 = ω³ ε, ε = q - x̂1, Δ̂ = -x̂3.

    In discrete time by zero-order hold, with the correction of the measurement just made; the three poles of
    the error are e^{-ω dt}, so that it is stable for every ω and dt.
    """

    bandwidth: float = param(
        300.0,
        unit="1/s",
        above=0.0,
        per_joint=True,
        doc="bandwidth ω: the three poles of the error are at -ω",
        source="Gao (2003); value chosen: 90 % of a step as soon as the paper's observer",
    )

    @staticmethod
    def advance(p: ESO, chain: Vector, a: float, q: float, dt: float) -> Vector:
        """Predict, then correct with the current measurement."""
        x1, x2, x3 = chain
        return eso_step(p.bandwidth, x1, x2, x3, a, q, dt)


def eso_step(
    bandwidth: float, x1: float, x2: float, x3: float, a: float, q: float, dt: float
) -> tuple[float, float, float]:
    """One tick of the observer for one joint.

    Args:
        bandwidth: ω, 1/s.
        x1: position estimate at t_{k-1}, rad.
        x2: velocity estimate, rad/s.
        x3: estimate of -Δ, rad/s².
        a: acceleration by the model over the tick, rad/s².
        q: measured position at t_k, rad.
        dt: tick length, s.

    Returns:
        The three estimates at t_k.
    """
    pole = math.exp(-bandwidth * dt)
    short = -math.expm1(-bandwidth * dt)  # 1 - pole
    x1, x2 = predict(x1, x2, x3, a, dt)
    error = q - x1
    return (
        x1 + short * (1.0 + pole + pole * pole) * error,
        x2 + 1.5 * short * short * (1.0 + pole) / dt * error,
        x3 + short * short * short / (dt * dt) * error,
    )
