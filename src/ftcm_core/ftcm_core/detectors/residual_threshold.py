# SPDX-License-Identifier: Apache-2.0
"""The simplest detector: a fixed threshold on the observer's estimate."""

from __future__ import annotations

from typing import ClassVar

from ftcm_core.detectors import Detector
from ftcm_core.params import joint_parameters, param
from ftcm_core.registry import register
from ftcm_core.robots import Robot
from ftcm_core.signals import Detection, Measurement, Vector


@register("detector", "residual_threshold")
class ResidualThreshold(Detector):
    """Threshold on the estimate: r = tau_hat, alarm once |r| > threshold has lasted for `hold` seconds."""

    threshold: float = param(
        10.0, unit="N·m", above=0.0, per_joint=True, doc="largest estimate of a healthy robot",
        source="chosen: above the friction of eq 43, below the fault of eq 47",
    )  # fmt: skip
    hold: float = param(
        0.01, unit="s", at_least=0.0, per_joint=True, doc="how long the estimate must stay above it",
        source="chosen: ten ticks",
    )  # fmt: skip

    needs_observer: ClassVar[bool] = True

    def init(self, joints: int) -> Vector:
        """For how long each estimate has been above its threshold, s."""
        return (0.0,) * joints

    def step(
        self, model: Robot, dt: float, y: Measurement, u: Vector, disturbance_estimate: Vector, state: Vector
    ) -> tuple[Detection, Vector]:
        """Compare each joint's estimate with its threshold."""
        parameters = joint_parameters(self, model.joints)
        above = tuple(
            [time_above(r, p.threshold, s, dt) for p, r, s in zip(parameters, disturbance_estimate, state)]
        )
        alarms = tuple([lasting(s, p.hold) for p, s in zip(parameters, above)])
        return Detection(disturbance_estimate, alarms), above


def time_above(residual: float, threshold: float, before: float, dt: float) -> float:
    """For how long a residual (N·m) has been above its threshold (N·m), s.

    Args:
        residual: of this tick.
        threshold: compared with its absolute value.
        before: what this function returned in the tick before, s.
        dt: tick length, s.
    """
    return before + dt if abs(residual) > threshold else 0.0


def lasting(above: float, hold: float) -> float:
    """1 if a residual has been above its threshold for longer than ``hold`` (s), else 0."""
    return 1.0 if above > hold else 0.0
