# SPDX-License-Identifier: Apache-2.0
"""Disturbance observers, one per file: from measurements to an estimate of the lumped uncertainty.

The estimate crosses as a torque tau_hat = M(q) Delta_hat, so that any kind of observer fits.
"""

from __future__ import annotations

from abc import abstractmethod
from typing import Any

from ftcm_core.registry import Component
from ftcm_core.robots import Robot
from ftcm_core.signals import Measurement, Vector


class Observer(Component):
    """An observer with explicit state: ``init`` once, then ``step`` once per tick.

    It may use only what a drive reports: positions, velocities, and the torque applied over the
    tick that has just ended.
    """

    @abstractmethod
    def init(self, model: Robot, y: Measurement) -> Any:
        """Return the state at the first measurement it sees; the estimate starts from zero."""

    @abstractmethod
    def step(self, model: Robot, dt: float, y: Measurement, state: Any) -> tuple[Vector, Any]:
        """Advance from the previous tick to this one.

        Where ticks were skipped (real time, a node that came late) it is called once for each, with the
        newest measurement, so that its time is the real one.

        Args:
            model: what the observer believes of the robot.
            dt: tick length, s.
            y: measurement at t_k; its effort is the torque applied over [t_{k-1}, t_k).
            state: the state at t_{k-1}.

        Returns:
            tau_hat at t_k, N·m, and the state at t_k.
        """
