# SPDX-License-Identifier: Apache-2.0
"""The paper's proposed fault-tolerant control method (eqs 31-33)."""

from __future__ import annotations

from typing import ClassVar

from ftcm_core.controllers.implicit import implicit_law
from ftcm_core.controllers.super_twisting import gain_condition, largest_bound, least_upsilon2, super_twisting
from ftcm_core.controllers.terminal_surface import TerminalSurfaceLaw
from ftcm_core.params import param
from ftcm_core.registry import register
from ftcm_core.signals import Vector


@register("controller", "ftcm")
class FTCM(TerminalSurfaceLaw):
    """Proposed FTCM: v = ẍ_r - S(e, ė) + Δ̂ - Υ1 |σ|^½ sgn σ - η, η̇ = Υ2 sgn σ (eqs 31-33)."""

    upsilon1: float = param(
        16.0, unit="(rad/s)^½/s", above=0.0, per_joint=True, doc="super-twisting gain Υ1", source="Table 1"
    )
    upsilon2: float = param(
        20.0,
        unit="rad/s³",
        above=0.0,
        per_joint=True,
        doc="super-twisting integral gain Υ2",
        source="Table 1",
    )
    pi: float = param(
        0.4,
        unit="(rad/s)^½/s",
        at_least=0.0,
        per_joint=True,
        doc="assumed bound Π of the estimation error, |Δ̃| <= Π|σ|^½; used only to check eq 34",
        source="eq 34; value chosen: below the 0.46 that Table 1's gains allow",
    )
    discretisation: str = param(
        "explicit",
        unit="-",
        choices=("explicit", "implicit"),
        doc="explicit: the law as printed, held over the tick; implicit: by backward Euler",
        source="explicit: sec. IV; implicit: chosen, docs/discretisation.md",
    )
    horizon: float = param(
        1.5,
        unit="ticks",
        at_least=1.0,
        at_most=1000.0,
        per_joint=True,
        doc="step h of the implicit form; more for delay (4 per tick of it) or noise, less for accuracy",
        source="chosen: damps an input gain up to 1.8 times the model's",
    )

    needs_observer: ClassVar[bool] = True
    initial: ClassVar[Vector] = (0.0,)

    @staticmethod
    def law(p: FTCM, e: float, de: float, dt: float, s: Vector) -> tuple[float, Vector]:
        """-S(e, ė) - Υ1 |σ|^½ sgn σ - η, or its implicit form; Δ̂ enters as the torque tau_hat."""
        if p.discretisation == "implicit":
            return implicit_law(p, e, de, dt, s)
        sigma, rate = p.surface_and_rate(p, e, de)
        u_r, eta = super_twisting(sigma, s[0], p.upsilon1, p.upsilon2, dt)
        return -rate - u_r, (eta,)

    def warnings(self) -> list[str]:
        """Eq 34, per distinct set of gains."""
        found = []
        joints = max((len(v) for v in self.values.values() if isinstance(v, tuple)), default=1)
        for joint in range(joints):
            p = self.for_joint(joint) if joints > 1 else self
            if not gain_condition(p.upsilon1, p.upsilon2, p.pi):
                where = "all joints" if joints == 1 else f"joint {joint + 1}"
                found.append(
                    f"controller ftcm, {where}: the gain condition (eq 34) fails: "
                    f"upsilon1={p.upsilon1:g}, upsilon2={p.upsilon2:g}, pi={p.pi:g}; it needs "
                    f"upsilon1 > {2 * p.pi:g} and upsilon2 > {least_upsilon2(p.upsilon1, p.pi):.4g}; "
                    f"these gains allow pi < {largest_bound(p.upsilon1, p.upsilon2):.4g}"
                )
        return found
