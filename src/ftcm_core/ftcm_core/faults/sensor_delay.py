# SPDX-License-Identifier: Apache-2.0
"""Joint sensors that report late."""

from __future__ import annotations

from typing import Any, ClassVar

from ftcm_core.faults import Moment, SensorFault
from ftcm_core.faults.past import past, remembered, whole_ticks
from ftcm_core.params import param
from ftcm_core.registry import register


@register("fault", "sensor_delay")
class SensorDelay(SensorFault):
    """Delay of a sensor: position = q(t - d dt), velocity = q̇(t - d dt), d = ψ delay, rounded to whole ticks.

    Before the first sample there was what the first is.

    Source: Nilsson (1998), Real-time control systems with delays, Lund.
    """

    rank: ClassVar[int] = 80
    remembers: ClassVar[bool] = True

    delay: int = param(
        10, unit="ticks", at_least=0, at_most=100, doc="how late it reports", source="chosen: 10 ms"
    )

    @staticmethod
    def sense(
        p: Any, size: float, now: Moment, position: float, velocity: float, s: Any
    ) -> tuple[float, float, Any]:
        """The sample of some ticks ago."""
        samples = remembered((position, velocity), s, p.delay)
        late = past(samples, whole_ticks(size, float(p.delay)))
        return late[0], late[1], samples[:-1]

    def check(self) -> None:
        """No longer delay than what is remembered."""
        SensorFault.check(self)
        self.check_share()
