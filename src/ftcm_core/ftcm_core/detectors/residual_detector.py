# SPDX-License-Identifier: Apache-2.0
"""Detectors that test a residual: which residual is a parameter, the test is the class."""

from __future__ import annotations

from abc import abstractmethod
from dataclasses import dataclass
from typing import Any, ClassVar, NamedTuple

from ftcm_core.detectors import Detector
from ftcm_core.detectors.residuals import nothing_seen
from ftcm_core.detectors.residuals.estimate import estimate_residual
from ftcm_core.detectors.residuals.momentum import momentum_residual
from ftcm_core.detectors.residuals.motion import motion_residual
from ftcm_core.params import joint_parameters, param
from ftcm_core.robots import Robot
from ftcm_core.signals import Detection, Measurement, Vector

UNIT = "N·m or rad/s"
"""Unit of residuals: rad/s that of the motion, N·m the others."""


class DetectorState(NamedTuple):
    """What a detector of this kind remembers."""

    seen: Any
    """Of the residual."""
    memories: tuple[Vector, ...]
    """Of the test, one per joint."""
    above: Vector
    """For how long each statistic has been above its threshold, s."""


@dataclass(frozen=True, kw_only=True)
class ResidualDetector(Detector):
    """An alarm once a statistic of the residual has been above the threshold for longer than ``hold``.

    A subclass declares ``threshold`` and writes :meth:`statistic`.
    """

    residual: str = param(
        "estimate", unit="-", choices=("estimate", "momentum", "motion"),
        doc="estimate: tau_hat of the observer; momentum: r = K/(s + K) of the added torque; motion: "
        "positions against velocities, rad/s", source="De Luca and Mattone 2003; Isermann 2006, ch. 11",
    )  # fmt: skip
    gain: float = param(
        50.0, unit="1/s", above=0.0, per_joint=True, doc="pole K of the residual momentum or motion",
        source="chosen: 8 Hz, above the motion and below most of the noise",
    )  # fmt: skip
    hold: float = param(
        0.0, unit="s", at_least=0.0, per_joint=True,
        doc="how long the statistic must stay above the threshold", source="chosen: none",
    )  # fmt: skip

    initial: ClassVar[Vector] = ()
    """What the test remembers of a joint before the first tick."""

    @property
    def needs_observer(self) -> bool:
        """Only the residual ``estimate`` uses one."""
        return self.residual == "estimate"

    @staticmethod
    @abstractmethod
    def statistic(p: Any, dt: float, r: float, v: float, u: float, s: Vector) -> tuple[float, Vector]:
        """Return what is compared with the threshold of one joint, and what is remembered.

        Args:
            p: the detector, its parameters reduced to the joint.
            dt: tick length, s.
            r: residual, N·m or rad/s.
            v: measured velocity, rad/s.
            u: command, N·m.
            s: what was returned last.
        """

    def memory(self) -> Vector:
        """Return what the test remembers of a joint before the first tick."""
        return self.initial

    def init(self, joints: int) -> DetectorState:
        """Nothing seen yet."""
        seen = () if self.residual == "estimate" else nothing_seen(joints)
        return DetectorState(seen, (self.memory(),) * joints, (0.0,) * joints)

    def continues(self, before: Detector) -> bool:
        """The state is that of a residual, too."""
        return Detector.continues(self, before) and self.residual == getattr(before, "residual", None)

    def step(
        self,
        model: Robot,
        dt: float,
        y: Measurement,
        u: Vector,
        disturbance_estimate: Vector,
        state: DetectorState,
    ) -> tuple[Detection, DetectorState]:
        """Form the residuals, test each."""
        parameters, seen = joint_parameters(self, model.joints), state.seen
        if self.residual == "momentum":
            residual, seen = momentum_residual(parameters, model, dt, y, seen)
        elif self.residual == "motion":
            residual, seen = motion_residual(parameters, dt, y, seen)
        else:
            residual = estimate_residual(disturbance_estimate)
        found = [
            self.statistic(p, dt, r, v, torque, memory)
            for p, r, v, torque, memory in zip(parameters, residual, y.velocity, u, state.memories)
        ]
        above = tuple(
            [
                time_above(g, p.threshold, before, dt)
                for p, (g, _), before in zip(parameters, found, state.above)
            ]
        )
        alarms = tuple([lasting(s, p.hold) for p, s in zip(parameters, above)])
        return Detection(residual, alarms), DetectorState(seen, tuple([s for _, s in found]), above)


def time_above(statistic: float, threshold: float, before: float, dt: float) -> float:
    """For how long a statistic has been above its threshold, s.

    Args:
        statistic: of this tick.
        threshold: of the same unit.
        before: what this function returned in the tick before, s.
        dt: tick length, s.
    """
    return before + dt if statistic > threshold else 0.0


def lasting(above: float, hold: float) -> float:
    """1 if a statistic has been above its threshold for longer than ``hold`` (s), else 0."""
    return 1.0 if above > hold else 0.0
