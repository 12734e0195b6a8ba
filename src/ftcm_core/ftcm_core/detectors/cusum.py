# SPDX-License-Identifier: Apache-2.0
"""The cumulative sum (E. S. Page, "Continuous inspection schemes", Biometrika 41 (1954)), two-sided.

A residual that jumps to A > drift gives an alarm after threshold / (A - drift) seconds. The sums are held
at twice the threshold, so that an alarm ends at most threshold / drift seconds after the residual is back
at zero.
"""

from __future__ import annotations

from typing import Any, ClassVar

from ftcm_core.detectors.residual_detector import UNIT, ResidualDetector
from ftcm_core.params import param
from ftcm_core.registry import register
from ftcm_core.signals import Vector


@register("detector", "cusum")
class Cusum(ResidualDetector):
    """Two-sided CUSUM: g± = max(0, g± + (±r - drift) dt), alarm while max(g+, g-) > threshold."""

    threshold: float = param(
        0.1, unit="N·m·s or rad", above=0.0, per_joint=True, doc="largest sum of a healthy robot",
        source="chosen: 10 N·m above the drift for 10 ms",
    )  # fmt: skip
    drift: float = param(
        5.0, unit=UNIT, at_least=0.0, per_joint=True, doc="residual that is no fault yet",
        source="Page 1954: half of the change to be found; value chosen for the fault of eq 47",
    )  # fmt: skip

    initial: ClassVar[Vector] = (0.0, 0.0)

    @staticmethod
    def statistic(p: Any, dt: float, r: float, v: float, u: float, s: Vector) -> tuple[float, Vector]:
        """The larger of the sums for a rise and for a fall."""
        up, down = s
        up, down = summed(up, (r - p.drift) * dt), summed(down, (-r - p.drift) * dt)
        return max(up, down), (min(up, 2.0 * p.threshold), min(down, 2.0 * p.threshold))


def summed(before: float, more: float) -> float:
    """A sum that does not fall below zero."""
    return max(0.0, before + more)
