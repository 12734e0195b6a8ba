# SPDX-License-Identifier: Apache-2.0
"""The generalised likelihood ratio for a jump of the mean, of unknown size and time.

In Gaussian white noise of deviation σ the log-likelihood ratio of a jump j ticks ago, at its most likely
size, is S_j² / (2 σ² j), S_j being the sum of the last j residuals (M. Basseville, I. Nikiforov, "Detection
of Abrupt Changes", 1993, sec. 2.4.3; with a window: Willsky and Jones 1976). A residual that is no white
noise gives another rate of false alarms than the formula says: find the threshold by calibration.
"""

from __future__ import annotations

from typing import Any

from ftcm_core.detectors import Detector
from ftcm_core.detectors.residual_detector import UNIT, ResidualDetector
from ftcm_core.params import param
from ftcm_core.registry import register
from ftcm_core.signals import Vector


@register("detector", "glr")
class GLR(ResidualDetector):
    """GLR of a jump of the mean: g = max over j of S_j² / (2 σ² j), S_j: sum of the last j r, g > T."""

    threshold: float = param(
        12.0, unit="-", above=0.0, per_joint=True, doc="largest log-likelihood ratio of a healthy robot",
        source="chosen: of a single tick of white noise, 1e-6 is above",
    )  # fmt: skip
    sigma: float = param(
        3.0, unit=UNIT, above=0.0, per_joint=True, doc="standard deviation σ of a healthy residual",
        source="chosen: of the size of the friction of eq 43",
    )  # fmt: skip
    window: int = param(
        30, unit="-", at_least=1, at_most=100, doc="ticks that are looked back", source="chosen: 30 ms"
    )

    def memory(self) -> Vector:
        """The residuals of a window, zero before the first tick."""
        return (0.0,) * self.window

    def continues(self, before: Detector) -> bool:
        """A window of another length starts afresh."""
        return ResidualDetector.continues(self, before) and self.window == getattr(before, "window", None)

    @staticmethod
    def statistic(p: Any, dt: float, r: float, v: float, u: float, s: Vector) -> tuple[float, Vector]:
        """The largest ratio over all times of the jump within the window."""
        recent = (r, *s[:-1])
        total, best = 0.0, 0.0
        for j, x in enumerate(recent):
            total = total + x
            best = max(best, total * total / (j + 1.0))
        return best / (2.0 * p.sigma * p.sigma), recent
