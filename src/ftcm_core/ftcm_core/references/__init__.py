# SPDX-License-Identifier: Apache-2.0
"""Desired motions, one per file."""

from __future__ import annotations

from abc import abstractmethod

from ftcm_core.registry import Component
from ftcm_core.signals import ReferencePoint


class Reference(Component):
    """A desired joint motion, a pure function of time."""

    @abstractmethod
    def at(self, t: float, joints: int) -> ReferencePoint:
        """Desired position (rad), velocity (rad/s) and acceleration (rad/s²) at time t (s)."""
