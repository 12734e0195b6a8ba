# SPDX-License-Identifier: Apache-2.0
"""The paper's surface with switching and no observer (eqs 19-21)."""

from __future__ import annotations

from ftcm_core.controllers.terminal_surface import TerminalSurfaceLaw
from ftcm_core.numeric import sgn
from ftcm_core.params import param
from ftcm_core.registry import register
from ftcm_core.signals import Vector


@register("controller", "ftsmc")
class FTSMC(TerminalSurfaceLaw):
    """Fast terminal SMC: v = ẍ_r - S(e, ė) - (Λ + ρ) sgn σ on the paper's surface (eqs 19-21)."""

    lambda_bound: float = param(
        20.0,
        unit="rad/s²",
        at_least=0.0,
        per_joint=True,
        doc="bound Λ of the lumped uncertainty Δ",
        source="eq 7; value chosen: the Σ of Table 1",
    )
    rho: float = param(
        0.01,
        unit="rad/s²",
        at_least=0.0,
        per_joint=True,
        doc="margin ρ on the switching gain",
        source="eq 21; value chosen: the ξ of Table 1",
    )

    @staticmethod
    def law(p: FTSMC, e: float, de: float, dt: float, s: Vector) -> tuple[float, Vector]:
        """-S(e, ė) - (Λ + ρ) sgn σ."""
        sigma, rate = p.surface_and_rate(p, e, de)
        return -rate - (p.lambda_bound + p.rho) * sgn(sigma), s
