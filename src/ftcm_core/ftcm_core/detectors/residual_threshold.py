# SPDX-License-Identifier: Apache-2.0
"""The simplest test: a fixed threshold on the residual."""

from __future__ import annotations

from typing import Any

from ftcm_core.detectors.residual_detector import UNIT, ResidualDetector
from ftcm_core.params import param
from ftcm_core.registry import register
from ftcm_core.signals import Vector


@register("detector", "residual_threshold")
class ResidualThreshold(ResidualDetector):
    """Threshold on the residual: alarm once |r| > T, T = threshold, has lasted for `hold` seconds."""

    threshold: float = param(
        10.0, unit=UNIT, above=0.0, per_joint=True, doc="largest residual of a healthy robot",
        source="chosen: above the friction of eq 43, below the fault of eq 47",
    )  # fmt: skip
    hold: float = param(
        0.01, unit="s", at_least=0.0, per_joint=True, doc="how long the residual must stay above it",
        source="chosen: ten ticks",
    )  # fmt: skip

    @staticmethod
    def statistic(p: Any, dt: float, r: float, v: float, u: float, s: Vector) -> tuple[float, Vector]:
        """|r|."""
        return abs(r), s
