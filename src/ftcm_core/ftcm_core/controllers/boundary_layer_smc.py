# SPDX-License-Identifier: Apache-2.0
"""Sliding mode control with a boundary layer, a baseline."""

from __future__ import annotations

from typing import Any

from ftcm_core.controllers.smc import SMC
from ftcm_core.numeric import sat
from ftcm_core.params import param
from ftcm_core.registry import register
from ftcm_core.signals import Vector


@register("controller", "boundary_layer_smc")
class BoundaryLayerSMC(SMC):
    """SMC with a boundary layer: v = ẍ_r - c ė - (Σ + ξ) sat(σ/Φ), σ = ė + c e (Slotine and Sastry 1983).

    A continuous torque, at the price of exactness: with K = Σ + ξ, a disturbance of |d| <= D < K leaves
    |σ| <= Φ D/K and |e| <= Φ D/(c K), and a constant one leaves just that. Inside the layer σ decays at the
    rate K/Φ; held over ticks of dt this is stable for dt K/Φ < 2, and does not ring below 1.
    """

    layer: float = param(
        0.025,
        unit="rad/s",
        above=0.0,
        per_joint=True,
        doc="half-width Φ of the boundary layer",
        source="Slotine and Sastry (1983); value chosen: σ decays at 800 1/s, which 1 kHz can hold",
    )

    @staticmethod
    def law(p: Any, e: float, de: float, dt: float, s: Vector) -> tuple[float, Vector]:
        """-c ė - (Σ + ξ) sat(σ/Φ)."""
        return -p.c * de - (p.sigma_gain + p.xi) * sat(SMC.surface(p, e, de), p.layer), s
