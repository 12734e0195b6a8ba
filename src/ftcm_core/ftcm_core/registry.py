# SPDX-License-Identifier: Apache-2.0
"""Every component is registered once, by its decorator, in its own file.

From that one file it is available to the simulation, the ROS parameters, scenario files, comparison
tables, the generated reference and the conformance tests.
"""

from __future__ import annotations

import dataclasses
import functools
import importlib
import pkgutil
from collections.abc import Callable
from typing import Any, ClassVar, TypeVar, cast

from ftcm_core.errors import FtcmError, suggestion
from ftcm_core.params import Parameterised, specs

KINDS = {
    "robot": "ftcm_core.robots",
    "reference": "ftcm_core.references",
    "controller": "ftcm_core.controllers",
    "observer": "ftcm_core.observers",
    "sensor": "ftcm_core.sensors",
    "disturbance": "ftcm_core.faults",
    "fault": "ftcm_core.faults",
}
"""Component kinds and the packages whose modules define them."""

_components: dict[str, dict[str, type[Component]]] = {kind: {} for kind in KINDS}
C = TypeVar("C", bound=type)


class Component(Parameterised):
    """Base of every component: a frozen record of parameters with pure step functions."""

    kind: ClassVar[str]
    type_name: ClassVar[str]

    def to_mapping(self) -> dict[str, Any]:
        """Return ``{type: ..., parameter: value, ...}`` with every default written out."""
        values = {k: list(v) if isinstance(v, tuple) else v for k, v in self.values.items()}
        return {"type": self.type_name, **values}


def register(kind: str, name: str) -> Callable[[C], C]:
    """Class decorator: make the class a frozen dataclass and register it as component ``name``.

    Args:
        kind: one of :data:`KINDS`.
        name: the ``type`` users write; lower case.

    Raises:
        FtcmError: the kind is unknown, the name is taken, or a field lacks its declaration.
    """
    if kind not in KINDS:
        raise FtcmError(f"no component kind {kind!r}; {suggestion(kind, KINDS)}")

    def decorate(cls: C) -> C:
        frozen: Any = dataclasses.dataclass(frozen=True, kw_only=True)(cls)
        if name in _components[kind]:
            raise FtcmError(f"{kind} {name!r} is registered twice: {_components[kind][name]} and {cls}")
        undeclared = {f.name for f in dataclasses.fields(frozen)} - set(specs(frozen))
        if undeclared:
            raise FtcmError(f"{kind} {name!r}: fields without param(...): {sorted(undeclared)}")
        frozen.kind, frozen.type_name = kind, name
        _components[kind][name] = frozen
        return cast(C, frozen)

    return decorate


@functools.cache
def _load(package: str) -> None:
    module = importlib.import_module(package)
    for info in pkgutil.iter_modules(module.__path__):
        importlib.import_module(f"{package}.{info.name}")


def components(kind: str) -> dict[str, type[Component]]:
    """Return the registered components of a kind, by name, sorted."""
    if kind not in KINDS:
        raise FtcmError(f"no component kind {kind!r}; {suggestion(kind, KINDS)}")
    _load(KINDS[kind])
    return dict(sorted(_components[kind].items()))


def find(kind: str, name: str) -> type[Component]:
    """Return the component class registered under a name.

    Raises:
        FtcmError: there is none; the message suggests the nearest name.
    """
    known = components(kind)
    if name not in known:
        raise FtcmError(f"no {kind} {name!r}; {suggestion(str(name), known)}")
    return known[name]
