# SPDX-License-Identifier: Apache-2.0
"""Sensor models, one per file: from the robot's true motion to what the drives report."""

from __future__ import annotations

from abc import abstractmethod
from typing import Any, ClassVar

from ftcm_core.registry import Component
from ftcm_core.signals import Vector


class Sensor(Component):
    """A sensor with explicit state: ``init`` once, then ``step`` exactly once per tick.

    ``exact`` says that it reports the true motion; then a trace needs no columns of its own for
    what was measured.
    """

    exact: ClassVar[bool] = False

    @abstractmethod
    def init(self, joints: int, seed: int) -> Any:
        """Return the state before the first measurement.

        Args:
            joints: number of joints.
            seed: the scenario's seed; noise is a stream of its own under it.
        """

    @abstractmethod
    def step(self, dt: float, position: Vector, velocity: Vector, state: Any) -> tuple[Vector, Vector, Any]:
        """Measure at t_k.

        Args:
            dt: tick length, s.
            position: true joint positions, rad.
            velocity: true joint velocities, rad/s.
            state: the state after t_{k-1}.

        Returns:
            Measured positions (rad) and velocities (rad/s), and the state after t_k.
        """
