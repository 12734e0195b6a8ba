# SPDX-License-Identifier: Apache-2.0
"""Another law, another observer, or other parameters of the same."""

from __future__ import annotations

import json
from typing import Any

from ftcm_core.errors import FtcmError, ParameterError, shown, suggestion
from ftcm_core.params import param, specs
from ftcm_core.policies import Policy
from ftcm_core.registry import Component, find, register

KINDS = ("controller", "observer")


@register("policy", "switch")
class Switch(Policy):
    """Another law or observer takes over; the same, retuned, keeps what it remembers.

    Projection-based active fault tolerance: Zhang and Jiang (2008), Bibliographical review on reconfigurable
    fault-tolerant control systems, Annual Reviews in Control 32.
    """

    controller: str = param(
        "", unit="-", doc="the law: a name, or a mapping with `type` and parameters; empty: as it is",
        source="chosen",
    )  # fmt: skip
    observer: str = param(
        "", unit="-", doc="the observer: a name, or a mapping; empty: as it is", source="chosen"
    )

    def check(self) -> None:
        """What takes over must exist; every default of it is written out."""
        super().check()
        for kind in KINDS:
            if text := getattr(self, kind):
                try:
                    component = _component(kind, text)
                except FtcmError as error:
                    raise ParameterError(f"{kind}: {error}") from None
                object.__setattr__(self, kind, json.dumps(component.to_mapping()))

    def components(self) -> dict[str, Component]:
        """Return the law and the observer that take over, where there are any."""
        return {kind: _component(kind, text) for kind in KINDS if (text := getattr(self, kind))}

    def to_mapping(self) -> dict[str, Any]:
        """Return it as a scenario has it, with every default of what takes over."""
        taken = {kind: component.to_mapping() for kind, component in self.components().items()}
        return {**super().to_mapping(), **taken}


def _component(kind: str, text: str) -> Component:
    """Make a component of its name, or of a mapping in JSON.

    Raises:
        FtcmError: there is none, or a parameter of it is not valid.
    """
    try:
        mapping = json.loads(text) if text.startswith("{") else {"type": text}
    except ValueError:
        raise ParameterError(f"{shown(text)} is neither a name nor a mapping") from None
    name = mapping.get("type")
    if not isinstance(name, str):
        raise ParameterError(f"{shown(mapping)} has no 'type'; expected the name of a {kind}")
    del mapping["type"]
    cls = find(kind, name)
    for key in mapping:
        if key not in specs(cls):
            raise ParameterError(f"{key}: unknown key; {suggestion(key, specs(cls))}")
    return cls(**mapping)
