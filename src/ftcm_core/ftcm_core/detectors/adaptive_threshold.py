# SPDX-License-Identifier: Apache-2.0
"""A threshold that grows with what makes the model less exact: speed and torque.

The errors of a model, and with them the residuals of a healthy robot, grow with the motion. A threshold
that follows them may be low at rest (threshold selector: Emami-Naeini, Akhter and Rock, IEEE TAC 33 (1988);
of robots: Visinsky, Cavallaro and Walker, IEEE Trans. Robotics and Automation 11 (1995)).
"""

from __future__ import annotations

from typing import Any

from ftcm_core.detectors.residual_detector import UNIT, ResidualDetector
from ftcm_core.params import param
from ftcm_core.registry import register
from ftcm_core.signals import Vector


@register("detector", "adaptive_threshold")
class AdaptiveThreshold(ResidualDetector):
    """Adaptive threshold: alarm once |r| > T for `hold`, T = threshold + per_speed |q̇| + per_torque |u|."""

    threshold: float = param(
        5.0, unit=UNIT, above=0.0, per_joint=True, doc="threshold at rest and without torque",
        source="chosen: half of the fixed one",
    )  # fmt: skip
    per_speed: float = param(
        5.0, unit="N·m·s/rad or -", at_least=0.0, per_joint=True, doc="growth with the measured speed",
        source="chosen: of the size of the friction of eq 43",
    )  # fmt: skip
    per_torque: float = param(
        0.05, unit="- or rad/(N·m·s)", at_least=0.0, per_joint=True, doc="growth with the commanded torque",
        source="chosen: a model that is 5 % wrong",
    )  # fmt: skip
    hold: float = param(
        0.01, unit="s", at_least=0.0, per_joint=True, doc="how long the residual must stay above it",
        source="chosen: ten ticks",
    )  # fmt: skip

    @staticmethod
    def statistic(p: Any, dt: float, r: float, v: float, u: float, s: Vector) -> tuple[float, Vector]:
        """|r| less what the motion excuses, to be compared with the threshold at rest."""
        return abs(r) - p.per_speed * abs(v) - p.per_torque * abs(u), s
