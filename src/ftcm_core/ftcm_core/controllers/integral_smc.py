# SPDX-License-Identifier: Apache-2.0
"""Integral sliding mode control around computed torque, a baseline."""

from __future__ import annotations

from typing import Any, ClassVar

from ftcm_core.controllers.ctc import CTC
from ftcm_core.numeric import sat, select
from ftcm_core.params import param
from ftcm_core.registry import register
from ftcm_core.signals import Vector


@register("controller", "integral_smc")
class IntegralSMC(CTC):
    """Integral SMC: v = ẍ_r + a0 - (Σ + ξ) sat(σ/Φ), σ = ė - ė(0) - ∫a0 (Utkin and Shi 1996).

    a0 = -kd ė - kp e is the law of ctc. σ starts at zero, so there is no reaching phase: from the first
    tick on the motion is that of ctc without disturbance, whatever the initial error. As torques are held
    over the tick, σ_{k+1} = σ_k + dt (d_k - K sat(σ_k/Φ)), exactly, with K = Σ + ξ. So a disturbance of
    |d| <= D < K leaves |σ| <= Φ D/K at all times if dt K <= Φ, and |σ| <= dt (K + D) for Φ = 0; a constant
    one leaves no error in the end. σ depends on the past: it is no function of e and ė, and no report shows
    it.
    """

    sigma_gain: float = param(
        20.0,
        unit="rad/s²",
        at_least=0.0,
        per_joint=True,
        doc="switching gain Σ, bound of Δ",
        source="Utkin and Shi (1996); value chosen: as for smc",
    )
    xi: float = param(
        0.01,
        unit="rad/s²",
        at_least=0.0,
        per_joint=True,
        doc="margin ξ on the switching gain",
        source="chosen: as for smc",
    )
    layer: float = param(
        0.025,
        unit="rad/s",
        at_least=0.0,
        per_joint=True,
        doc="half-width Φ of a boundary layer; 0: the sign, as published",
        source="chosen: as for boundary_layer_smc; the sign itself chatters",
    )

    initial: ClassVar[Vector] = (0.0, 0.0)
    """Whether it has started, and z with σ = ė + z, rad/s."""

    @staticmethod
    def law(p: Any, e: float, de: float, dt: float, s: Vector) -> tuple[float, Vector]:
        """a0 - (Σ + ξ) sat(σ/Φ)."""
        nominal, _ = CTC.law(p, e, de, dt, ())
        z = select(s[0], s[1], -de)
        return nominal - (p.sigma_gain + p.xi) * sat(de + z, p.layer), (1.0, z - dt * nominal)
