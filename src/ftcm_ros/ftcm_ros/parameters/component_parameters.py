# SPDX-License-Identifier: Apache-2.0
"""Declared component parameters as ROS parameters: descriptors, validation, atomic change.

Parameter ``NAME.PARAMETER`` belongs to component NAME of the node's kind (``ftcm.gamma1``,
``do.k1``); the parameter named like the kind (``controller``, ``observer``) chooses the component.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

from rcl_interfaces.msg import FloatingPointRange, ParameterDescriptor, ParameterType, SetParametersResult
from rclpy.node import Node
from rclpy.parameter import Parameter

from ftcm_core.errors import FtcmError
from ftcm_core.params import ParamSpec, specs
from ftcm_core.registry import Component, components, find

_TYPES = {
    "float": ParameterType.PARAMETER_DOUBLE,
    "int": ParameterType.PARAMETER_INTEGER,
    "bool": ParameterType.PARAMETER_BOOL,
    "str": ParameterType.PARAMETER_STRING,
}


def descriptor(spec: ParamSpec) -> ParameterDescriptor:
    """Descriptor with description, unit, bounds and source.

    Numbers are dynamically typed, so that ``10000`` is taken where ``10000.0`` is meant and a list
    where a parameter may differ per joint; our own validation follows in any case.
    """
    numeric = spec.kind in ("float", "int")
    closed = not (spec.lower_open or spec.upper_open)
    ranged = spec.kind == "float" and closed and max(abs(spec.lower), abs(spec.upper)) < float("inf")
    return ParameterDescriptor(
        type=_TYPES[spec.kind],
        description=f"{spec.doc} [{spec.unit}] ({spec.source})",
        additional_constraints=f"expected {spec.expected}",
        dynamic_typing=numeric,
        floating_point_range=[FloatingPointRange(from_value=spec.lower, to_value=spec.upper)]
        if ranged
        else [],
    )


class ComponentParameters:
    """The parameters of every registered component of one kind on a node, and which is chosen."""

    def __init__(
        self,
        node: Node,
        kind: str,
        initial: Component,
        joints: int,
        on_change: Callable[[Component], None],
        ready: Callable[[Component], object] = lambda component: None,
    ) -> None:
        """Declare them, with the initial component's values as defaults.

        Args:
            node: the node to declare on.
            kind: ``controller``, ``observer`` or ``detector``.
            initial: the scenario's component.
            joints: number of joints of the robot.
            on_change: called with the new component after a successful change.
            ready: called with it before; raises an FtcmError if the node cannot use it.

        Raises:
            FtcmError: a parameter override given at start is not valid.
        """
        self.kind = kind
        self._node = node
        self._joints = joints
        self._on_change = on_change
        self._ready = ready
        self._names: dict[str, str] = {kind: initial.type_name}
        self._specs: dict[str, tuple[str, ParamSpec]] = {}
        known = ", ".join(components(kind))
        node.declare_parameter(
            kind,
            initial.type_name,
            ParameterDescriptor(
                description=f"{kind} in use: one of {known}; a change takes effect at the next tick",
                additional_constraints=f"one of {known}",
            ),
        )
        for name, cls in components(kind).items():
            values = initial.values if isinstance(initial, cls) else {}
            for spec in specs(cls).values():
                key = f"{name}.{spec.name}"
                self._specs[key] = (name, spec)
                value = values.get(spec.name, spec.default)
                node.declare_parameter(
                    key, list(value) if isinstance(value, tuple) else value, descriptor(spec)
                )
        self.component = self._build({}, everything=True)
        node.add_on_set_parameters_callback(self._validate)
        node.add_post_set_parameters_callback(self._apply)

    def _build(self, changes: dict[str, Any], everything: bool = False) -> Component:
        """Build the components that the changes touch, or all, and return the chosen one."""

        def value(key: str) -> Any:
            found = changes.get(key, self._node.get_parameter(key).value)
            return (
                list(found) if not isinstance(found, (str, bool, int, float)) and found is not None else found
            )

        chosen = find(self.kind, value(self.kind)).type_name
        built: dict[str, Component] = {}
        touched = (
            set(components(self.kind)) if everything else {k.partition(".")[0] for k in changes if "." in k}
        )
        for name in touched | {chosen}:
            cls = find(self.kind, name)
            try:
                built[name] = cls(**{s.name: value(f"{name}.{s.name}") for s in specs(cls).values()})
                # A default may be for another number of joints: that matters once the component is chosen.
                given = {s for s in specs(cls) if f"{name}.{s}" in changes}
                built[name].check_joints(self._joints, None if name == chosen else given)
            except FtcmError as error:
                raise FtcmError(f"{name}.{error}") from None
        return built[chosen]

    def _mine(self, parameters: Sequence[Parameter]) -> dict[str, Any]:
        return {p.name: p.value for p in parameters if p.name == self.kind or p.name in self._specs}

    def _validate(self, parameters: Sequence[Parameter]) -> SetParametersResult:
        changes = self._mine(parameters)
        if changes:
            try:
                self._ready(self._build(changes))
            except FtcmError as error:
                return SetParametersResult(successful=False, reason=str(error))
        return SetParametersResult(successful=True)

    def _apply(self, parameters: Sequence[Parameter]) -> None:
        if self._mine(parameters):
            component = self._build({})
            if component != self.component or type(component) is not type(self.component):
                self.component = component
                self._on_change(component)
