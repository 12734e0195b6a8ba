# SPDX-License-Identifier: Apache-2.0
"""The motion goes on slower: less acceleration, less torque, less friction of speed."""

from __future__ import annotations

from ftcm_core.params import param
from ftcm_core.policies import Policy
from ftcm_core.registry import register


@register("policy", "derate")
class Derate(Policy):
    """The reference is followed along the same path at a fraction of its speed (time scaling).

    q_ref(s(t)) with ds/dt from 1 to `factor`, smoothly: Dahl and Nielsen (1990), Torque-limited path
    following by online trajectory time scaling, IEEE Trans. Robotics and Automation 6(5). Of two that are
    decided the slower one holds.
    """

    factor: float = param(
        0.5, unit="-", above=0.0, below=1.0, doc="speed along the path, of the planned one", source="chosen"
    )
    ramp: float = param(
        0.5, unit="s", above=0.0, doc="how long slowing down takes", source="chosen: within 3 rad/s² here"
    )

    @property
    def pace(self) -> tuple[float, float]:
        """The fraction, and how long coming to it takes, s."""
        return self.factor, self.ramp
