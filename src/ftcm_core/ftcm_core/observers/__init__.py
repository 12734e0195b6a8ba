# SPDX-License-Identifier: Apache-2.0
"""Disturbance observers, one per file: from measurements to an estimate of the lumped uncertainty.

The estimate crosses as a torque tau_hat = M(q) Delta_hat, so that any kind of observer fits.
"""

from __future__ import annotations

import math
from abc import abstractmethod
from collections.abc import Iterator
from typing import Any, ClassVar

from ftcm_core.registry import Component
from ftcm_core.robots import Robot
from ftcm_core.signals import Measurement, Vector


class Observer(Component):
    """An observer with explicit state: ``init`` once, then ``step`` once per tick.

    It may use only what a drive reports: positions, velocities, and the torque applied over the
    tick that has just ended. ``needs_velocity`` says whether it looks at the measured velocities.
    """

    needs_velocity: ClassVar[bool] = True

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

    def warnings(self, model: Robot, dt: float) -> list[str]:
        """Conditions of its convergence that these parameters do not meet, one line each.

        Args:
            model: what the observer believes of the robot.
            dt: tick length, s.
        """
        del model, dt
        return []

    def each_joint(self) -> Iterator[tuple[str, Any]]:
        """Yield each joint's name in a warning and its parameters; once if they are the same for all."""
        joints = max((len(v) for v in self.values.values() if isinstance(v, tuple)), default=0)
        if not joints:
            yield f"observer {self.type_name}, all joints", self
        for joint in range(joints):
            yield f"observer {self.type_name}, joint {joint + 1}", self.for_joint(joint)


def middle(before: Vector, now: Vector) -> Vector:
    """Mean of a vector at the two ends of a tick."""
    return tuple([0.5 * (a + b) for a, b in zip(before, now)])


def relaxed(gain: float, r: float, d: float, dt: float) -> float:
    """Solution of ṙ = K(d - r) after a tick, d held.

    Args:
        gain: K, 1/s.
        r: at t_{k-1}.
        d: over the tick.
        dt: tick length, s.
    """
    return r - math.expm1(-gain * dt) * (d - r)
