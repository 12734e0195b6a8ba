# SPDX-License-Identifier: Apache-2.0
"""A parameter of the robot that changes at a time; the model does not know."""

from __future__ import annotations

import dataclasses
from typing import Any, ClassVar

from ftcm_core.errors import shown, suggestion
from ftcm_core.faults import Fault, RobotFault
from ftcm_core.params import param, per_joint, specs
from ftcm_core.registry import register
from ftcm_core.robots import Robot


@register("fault", "parameter_change")
class ParameterChange(RobotFault):
    """Change of a parameter: the true robot's = factor · what it was, while the fault acts."""

    rank: ClassVar[int] = 40

    parameter: str = param(
        "mass", unit="-", doc="name of a number among the robot's parameters", source="chosen"
    )
    factor: float = param(
        1.3, unit="-", above=0.0, doc="what it is multiplied by", source="chosen: heavier by 30 %"
    )
    joint: int = param(
        0, unit="-", at_least=0, at_most=100,
        doc="number of the joint whose entry changes, of a parameter per joint; 0: all", source="chosen",
    )  # fmt: skip

    def changed(self, robot: Robot) -> Robot:
        """Return the robot with the other value."""
        return dataclasses.replace(robot, **{self.parameter: self._value(robot)})  # type: ignore[type-var]

    def _value(self, robot: Robot) -> Any:
        value = getattr(robot, self.parameter)
        if self.joint:
            entries = list(per_joint(value, robot.joints))
            entries[self.joint - 1] *= self.factor
            return tuple(entries)
        return tuple([x * self.factor for x in value]) if isinstance(value, tuple) else value * self.factor

    def unsuited(self, robot: Robot) -> str:
        """The robot must have the parameter, and be one with its other value."""
        known = {name: spec for name, spec in specs(type(robot)).items() if spec.kind == "float"}
        name, spec = shown(self.parameter), known.get(self.parameter)
        if spec is None:
            return f"parameter: the robot has no number {name}; {suggestion(self.parameter, known)}"
        if self.joint and not spec.per_joint:
            return f"joint: {self.joint}, but {name} is no parameter per joint; expected 0"
        if self.joint > robot.joints:
            return f"joint: {self.joint} is out of range; expected 0 (all) to {robot.joints}"
        if getattr(robot, self.parameter) is None:
            return f"parameter: {name} of the robot is null; expected one that has a value"
        if self._value(robot) == getattr(robot, self.parameter) and self.factor != 1.0:
            return f"parameter: {name} of the robot is 0; expected one that a factor changes"
        return Fault.unsuited(self, robot)
