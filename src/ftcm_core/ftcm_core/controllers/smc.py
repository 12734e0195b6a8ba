# SPDX-License-Identifier: Apache-2.0
"""Conventional sliding mode control (eq 45)."""

from __future__ import annotations

from ftcm_core.controllers import AccelerationLaw
from ftcm_core.numeric import sgn
from ftcm_core.params import param
from ftcm_core.registry import register
from ftcm_core.signals import Vector


@register("controller", "smc")
class SMC(AccelerationLaw):
    """Conventional SMC: v = ẍ_r - c ė - (Σ + ξ) sgn(σ), σ = ė + c e (eq 45)."""

    c: float = param(
        2.0, unit="1/s", above=0.0, per_joint=True, doc="slope c of the linear surface", source="Table 1"
    )
    sigma_gain: float = param(
        20.0,
        unit="rad/s²",
        at_least=0.0,
        per_joint=True,
        doc="switching gain Σ, bound of Δ",
        source="Table 1",
    )
    xi: float = param(
        0.01,
        unit="rad/s²",
        at_least=0.0,
        per_joint=True,
        doc="margin ξ on the switching gain",
        source="Table 1",
    )

    @staticmethod
    def surface(p: SMC, e: float, de: float) -> float:
        """σ = ė + c e (rad/s)."""
        return de + p.c * e

    @staticmethod
    def law(p: SMC, e: float, de: float, dt: float, s: Vector) -> tuple[float, Vector]:
        """-c ė - (Σ + ξ) sgn σ."""
        return -p.c * de - (p.sigma_gain + p.xi) * sgn(SMC.surface(p, e, de)), s
