# SPDX-License-Identifier: Apache-2.0
"""Non-singular fast terminal sliding mode control of the comparison (eq 46)."""

from __future__ import annotations

from ftcm_core.controllers import AccelerationLaw
from ftcm_core.errors import ParameterError
from ftcm_core.numeric import sgn, sig
from ftcm_core.params import param
from ftcm_core.registry import register
from ftcm_core.signals import Vector


@register("controller", "nftsmc")
class NFTSMC(AccelerationLaw):
    """NFTSMC: v = ẍ_r - ϖ(q/l)|ė|^(2-l/q) sgn ė - (Σ+ξ) sgn σ, σ = e + |ė|^(l/q) sgn(ė)/ϖ (eq 46)."""

    l: int = param(  # noqa: E741 (the paper's symbol)
        5, unit="-", at_least=1, at_most=999, doc="numerator l of the exponent l/q, odd", source="Table 1"
    )
    q: int = param(
        3, unit="-", at_least=1, at_most=999, doc="denominator q of the exponent l/q, odd", source="Table 1"
    )
    varpi: float = param(2.0, unit="-", above=0.0, per_joint=True, doc="surface gain ϖ", source="Table 1")
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

    def check(self) -> None:
        """The surface is non-singular for 1 < l/q < 2 only, l and q odd (Feng, Yu, Man 2002)."""
        if not 1 < self.l / self.q < 2:
            raise ParameterError(f"l: l/q = {self.l}/{self.q} is out of range; expected 1 < l/q < 2")
        for name in ("l", "q"):
            if getattr(self, name) % 2 == 0:
                raise ParameterError(f"{name}: {getattr(self, name)} is even; expected an odd whole number")

    @staticmethod
    def surface(p: NFTSMC, e: float, de: float) -> float:
        """σ = e + ϖ⁻¹ |ė|^(l/q) sgn ė."""
        return e + sig(de, p.l / p.q) / p.varpi

    @staticmethod
    def law(p: NFTSMC, e: float, de: float, dt: float, s: Vector) -> tuple[float, Vector]:
        """-ϖ(q/l)|ė|^(2-l/q) sgn ė - (Σ + ξ) sgn σ."""
        return (
            -p.varpi * (p.q / p.l) * sig(de, 2.0 - p.l / p.q)
            - (p.sigma_gain + p.xi) * sgn(NFTSMC.surface(p, e, de)),
            s,
        )
