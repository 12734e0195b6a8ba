# SPDX-License-Identifier: Apache-2.0
"""No observer: the estimate is zero."""

from __future__ import annotations

from typing import Any, ClassVar

from ftcm_core.observers import Observer
from ftcm_core.registry import register
from ftcm_core.robots import Robot
from ftcm_core.signals import Measurement, Vector


@register("observer", "none")
class NoObserver(Observer):
    """No observer: tau_hat = 0."""

    needs_velocity: ClassVar[bool] = False

    def init(self, model: Robot, y: Measurement) -> Any:
        """Nothing to remember."""
        return ()

    def step(self, model: Robot, dt: float, y: Measurement, state: Any) -> tuple[Vector, Any]:
        """Return zeros."""
        return (0.0,) * model.joints, state
