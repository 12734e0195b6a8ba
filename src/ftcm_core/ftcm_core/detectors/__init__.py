# SPDX-License-Identifier: Apache-2.0
"""Fault detectors, one per file: from measurement, command and estimate to residuals and alarms."""

from __future__ import annotations

from abc import abstractmethod
from typing import Any

from ftcm_core.registry import Component
from ftcm_core.robots import Robot
from ftcm_core.signals import Detection, Measurement, Vector

VERDICTS = ("none", "unknown", "sensor", "loss_of_effectiveness", "added_torque")
"""What a detector may say of a joint; the verdict is the place in this tuple."""


class Detector(Component):
    """A fault detector with explicit state: ``init`` once, then ``step`` once per tick.

    What it says in tick k can act from tick k + 1 on. ``needs_observer`` says whether it uses the disturbance
    estimate; one that does not neither waits for it nor sees it.
    """

    @property
    def needs_observer(self) -> bool:
        """Whether it uses the disturbance estimate; no, unless a class says otherwise."""
        return False

    def continues(self, before: Detector) -> bool:
        """Whether it can go on with the state of another detector; if not, it starts afresh."""
        return type(self) is type(before)

    @abstractmethod
    def init(self, joints: int) -> Any:
        """Return the state before the first tick."""

    @abstractmethod
    def step(
        self, model: Robot, dt: float, y: Measurement, u: Vector, disturbance_estimate: Vector, state: Any
    ) -> tuple[Detection, Any]:
        """Look at one tick.

        Args:
            model: what the detector believes of the robot.
            dt: tick length, s.
            y: measurement at t_k.
            u: command of this tick, N·m.
            disturbance_estimate: tau_hat at t_k, N·m; zeros for a detector that needs no observer.
            state: what the last step returned.

        Returns:
            Residuals, alarms and, where it can tell, verdicts; and the next state.
        """
