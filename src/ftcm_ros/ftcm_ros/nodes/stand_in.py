# SPDX-License-Identifier: Apache-2.0
"""A robot under another controller: the plant and the disturbances in one place."""

from __future__ import annotations

from ftcm_core.scenario import Scenario
from ftcm_core.signals import TrueDisturbance, Vector
from ftcm_core.simulation.fault_chain import Phase
from ftcm_core.simulation.stages import InjectorStage, PlantStage


class StandIn(PlantStage):
    """The plant's stage that adds the injector's torques itself: nobody else knows which command acts."""

    def __init__(self, scenario: Scenario) -> None:
        """Start at the scenario's initial state."""
        super().__init__(scenario)
        self.injector = InjectorStage(scenario)

    def step(self, time_ns: int, u: Vector, d: TrueDisturbance) -> None:
        """As of the plant; what it is given as the disturbance does not count."""
        super().step(time_ns, u, self._added(time_ns, u))

    def safe_stop(self, time_ns: int, d: TrueDisturbance) -> None:
        """As of the plant."""
        super().safe_stop(time_ns, self._added(time_ns, (0.0,) * self.robot.joints))

    def _added(self, time_ns: int, u: Vector) -> TrueDisturbance:
        return self.injector.step(time_ns, *self.motion, u)

    def order(self, number: int, action: str, t: float) -> None:
        """As of the plant and of the injector."""
        super().order(number, action, t)
        self.injector.order(number, action, t)

    def phases(self) -> dict[int, Phase]:
        """As of the plant and of the injector."""
        return super().phases() | self.injector.phases()
