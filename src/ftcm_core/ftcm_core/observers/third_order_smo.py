# SPDX-License-Identifier: Apache-2.0
"""Third-order sliding-mode observer: Levant's (2003) differentiator around the model, Fraguela et al. (2012).

L. Fraguela, M. T. Angulo, J. A. Moreno, L. Fridman, "Design of a prescribed convergence time uniform
robust exact observer in the presence of measurement noise", CDC 2012, 6615-6620; here without the terms
that make the time of convergence uniform in the initial error.
"""

from __future__ import annotations

from ftcm_core.observers.homogeneous import differentiate, differentiate_implicit, discretisation
from ftcm_core.observers.position_observer import PositionObserver
from ftcm_core.params import param
from ftcm_core.registry import register
from ftcm_core.signals import Vector


@register("observer", "third_order_smo")
class ThirdOrderSMO(PositionObserver):
    """Third-order SMO: x̂̇1 = x̂2 - k0|s|^⅔ sgn s, x̂̇2 = M⁻¹(u - h - G) - Δ̂ - k1|s|^⅓ sgn s, Δ̂̇ = k2 sgn s.

    With s = x̂1 - q and k0 = 2 L^⅓, k1 = 2.12 L^⅔, k2 = 1.1 L. Exact after a finite time where |Δ̇| <= L,
    up to the sampling: an error of Δ̂ of the order L dt.
    """

    lipschitz: float = param(
        200.0,
        unit="rad/s³",
        above=0.0,
        per_joint=True,
        doc="bound L of the rate of Δ",
        source="Levant (2003); value chosen: just above that of the paper's Δ but at the onset",
    )
    discretisation: str = discretisation()

    @staticmethod
    def advance(p: ThirdOrderSMO, chain: Vector, a: float, q: float, dt: float) -> Vector:
        """Predict, then correct with the current measurement."""
        x1, x2, x3 = chain
        if p.discretisation == "implicit":
            return differentiate_implicit(p.lipschitz, x1, x2, x3, a, q, dt)
        return differentiate(p.lipschitz, x1, x2, x3, a, q, dt)
