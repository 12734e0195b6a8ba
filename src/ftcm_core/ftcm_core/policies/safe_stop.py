# SPDX-License-Identifier: Apache-2.0
"""The robot stops on its path and is held there."""

from __future__ import annotations

from ftcm_core.params import param
from ftcm_core.policies import Policy
from ftcm_core.registry import register


@register("policy", "safe_stop")
class SafeStop(Policy):
    """The reference slows down along its path to a standstill; the law holds the robot there.

    A stop of category 2 of IEC 60204-1 (2016): controlled, the drives powered. A law that the fault has made
    useless cannot do it; let a `switch` for the same verdict put in one that can.
    """

    ramp: float = param(0.5, unit="s", above=0.0, doc="how long stopping takes", source="chosen")

    @property
    def pace(self) -> tuple[float, float]:
        """To a standstill, and over how long, s."""
        return 0.0, self.ramp
