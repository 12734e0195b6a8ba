# SPDX-License-Identifier: Apache-2.0
"""A reactive node whose component can be changed while it runs: controller, observer, detector."""

from __future__ import annotations

import json
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue

from ftcm_core.compiled.stage import StageProgram
from ftcm_core.errors import FtcmError
from ftcm_core.recording.trace import Decision
from ftcm_core.registry import Component, components
from ftcm_core.signals import NANOSECONDS, Vector
from ftcm_ros.nodes.reactive_node import ReactiveNode
from ftcm_ros.parameters.component_parameters import ComponentParameters
from ftcm_ros.transport.composed import Composition
from ftcm_ros.transport.topics import CHANGES


class ComponentNode(ReactiveNode):
    """Applies a changed component between two ticks and announces it with its first tick."""

    def __init__(self, kind: str, composition: Composition | None = None) -> None:
        """Declare the parameters of every component of the kind.

        Raises:
            FtcmError: the scenario has none of it, or a parameter is not valid.
        """
        super().__init__(kind, composition)
        self.kind = kind
        initial: Component | None = getattr(self.scenario, kind)
        if initial is None:
            raise FtcmError(
                f"the scenario has no {kind}; expected one, e.g. {kind}: {next(iter(components(kind)))}"
            )
        self._announce = self.plane.publisher(CHANGES)
        self._pending: tuple[Component, StageProgram | None] | None = None
        """A component to use from the next tick on, and its program where stages are compiled."""
        self._announced: Component | None = None
        self._output: Vector = ()
        self.changed_by = ""
        """Label of the policy that has put in the component in force; empty: a parameter has."""
        self.stage: Any = None
        self.parameters = ComponentParameters(
            self, kind, initial, self.scenario.robot.joints, self._on_change, self._ready
        )

    def _ready(self, component: Component) -> None:
        """Compile what a change needs, while the ticks go on."""
        if self.stages == "compiled":
            self.program(component)

    def _on_change(self, component: Component) -> None:
        self._pending = component, self.program(component) if self.stages == "compiled" else None
        for line in self.scenario.warnings_of(component):
            self.get_logger().warning(line)

    def use(self, component: Component) -> None:
        """Note that the stage uses this component from the next tick on."""

    def configure(self) -> None:
        """Begin afresh with the component that the parameters say."""
        super().configure()
        self._pending = self._announced = None
        self.changed_by = ""
        self._output = (0.0,) * self.scenario.robot.joints
        for line in self.scenario.warnings_of(self.parameters.component):
            self.get_logger().warning(line)

    def take(self, name: str, sample: Any) -> None:
        """Apply a pending change before the inputs of the next tick are looked at."""
        if self._pending is not None and (self.aligner.last is None or sample.time_ns > self.aligner.last):
            (component, program), self._pending = self._pending, None
            self.changed_by = ""
            self.stage.swap(*([component] if program is None else [component, program]))
            self.use(component)
        super().take(name, sample)

    def announce(self, time_ns: int, component: Component, output: Vector) -> None:
        """Tell which component gave this tick's output, if it is not the one of the tick before."""
        if component is not self._announced:
            step = tuple([new - old for new, old in zip(output, self._output)])
            tick = self.run_ns // self.scenario.dt_ns
            self._announce(change_message(self.kind, component, time_ns, tick, step, self.changed_by))
            if self._announced is not None:
                self.get_logger().info(
                    f"{self.kind} {component.type_name} from tick {tick} on; output step {list(step)} N·m"
                )
            self._announced = component
        self._output = output


def change_message(
    kind: str, component: Component, time_ns: int, tick: int, step: Vector, by: str = ""
) -> DiagnosticArray:
    """Describe a component that takes effect at a tick.

    Args:
        kind: ``controller``, ``observer`` or ``detector``.
        component: the component.
        time_ns: stamp of its first tick, ns.
        tick: number of its first tick.
        step: change of its output from the tick before, N·m per joint.
        by: label of the policy that has put it in, if one has.
    """
    mapping: dict[str, Any] = component.to_mapping()
    values = {"tick": tick, "output_step": [round(x, 12) for x in step], "component": mapping, "by": by}
    return _event(time_ns, DiagnosticStatus.OK, kind, component.type_name, values)


def decision_message(time_ns: int, label: str, decision: Decision) -> DiagnosticArray:
    """Describe what a policy has decided.

    Args:
        time_ns: stamp of the first tick in which it is in force, ns.
        label: of the policy.
        decision: what was decided.
    """
    return _event(time_ns, DiagnosticStatus.WARN, "policy", label, decision._asdict())


def _event(time_ns: int, level: bytes, name: str, message: str, values: dict[str, Any]) -> DiagnosticArray:
    pairs = [KeyValue(key=k, value=json.dumps(v)) for k, v in values.items()]
    array = DiagnosticArray(status=[DiagnosticStatus(level=level, name=name, message=message, values=pairs)])
    array.header.stamp.sec, array.header.stamp.nanosec = divmod(time_ns, NANOSECONDS)
    return array
