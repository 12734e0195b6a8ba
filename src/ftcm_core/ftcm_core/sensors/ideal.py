# SPDX-License-Identifier: Apache-2.0
"""The ideal sensor: what the paper's simulations assume."""

from __future__ import annotations

from typing import Any, ClassVar

from ftcm_core.registry import register
from ftcm_core.sensors import Sensor
from ftcm_core.signals import Vector


@register("sensor", "ideal")
class Ideal(Sensor):
    """Ideal sensor: y = x."""

    exact: ClassVar[bool] = True

    def init(self, joints: int, seed: int) -> Any:
        """Nothing to remember."""
        return ()

    def step(self, dt: float, position: Vector, velocity: Vector, state: Any) -> tuple[Vector, Vector, Any]:
        """Return the true motion."""
        return position, velocity, state
