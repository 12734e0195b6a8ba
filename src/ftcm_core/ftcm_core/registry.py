# SPDX-License-Identifier: Apache-2.0
"""Every component is registered once, by its decorator, in its own file.

From that one file it is available to the simulation, the ROS parameters, scenario files, comparison
tables, the generated reference and the conformance tests. The file may be part of this package, of an
installed package that names it as an entry point of the group ``ftcm.components``, or a file that the
user names (:func:`load_plugin`).
"""

from __future__ import annotations

import dataclasses
import functools
import hashlib
import importlib
import importlib.util
import pkgutil
import sys
from collections.abc import Callable, Iterable
from importlib import metadata
from pathlib import Path
from typing import Any, ClassVar, TypeVar, cast

from ftcm_core.errors import FtcmError, suggestion
from ftcm_core.params import Parameterised, specs

KINDS = {
    "robot": "ftcm_core.robots",
    "plant": "ftcm_core.plants",
    "reference": "ftcm_core.references",
    "controller": "ftcm_core.controllers",
    "observer": "ftcm_core.observers",
    "detector": "ftcm_core.detectors",
    "sensor": "ftcm_core.sensors",
    "disturbance": "ftcm_core.disturbances",
    "fault": "ftcm_core.faults",
    "policy": "ftcm_core.policies",
}
"""Component kinds and the packages whose modules define them."""

GROUP = "ftcm.components"
"""Entry points of installed packages that bring components."""

_components: dict[str, dict[str, type[Component]]] = {kind: {} for kind in KINDS}
_plugins: dict[str, str] = {}
"""Plug-ins loaded so far, by what the user wrote: a file, absolute, or a module."""
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
            raise FtcmError(
                f"{kind} {name!r} is registered twice: by {_components[kind][name].__module__} and "
                f"{cls.__module__}; choose another name"
            )
        undeclared = {f.name for f in dataclasses.fields(frozen)} - set(specs(frozen))
        if undeclared:
            raise FtcmError(f"{kind} {name!r}: fields without param(...): {sorted(undeclared)}")
        frozen.kind, frozen.type_name = kind, name
        _components[kind][name] = frozen
        return cast(C, frozen)

    return decorate


@functools.cache
def _load_package(package: str) -> None:
    module = importlib.import_module(package)
    for info in pkgutil.iter_modules(module.__path__):
        importlib.import_module(f"{package}.{info.name}")


@functools.cache
def _load_installed() -> None:
    """Import what installed packages bring."""
    for entry in metadata.entry_points(group=GROUP):
        try:
            entry.load()
        except Exception as error:
            raise FtcmError(
                f"installed plug-in {entry.name!r} ({entry.value}) cannot be loaded: "
                f"{type(error).__name__}: {error}; mend or uninstall it"
            ) from None


def load_plugin(source: str) -> str:
    """Load components from a Python file or an importable module; this runs its code.

    Args:
        source: path of a ``.py`` file, or the name of a module.

    Returns:
        What to give to another process to load the same: the file's absolute path, or the module's name.

    Raises:
        FtcmError: it cannot be found or run.
    """
    is_file = source.endswith(".py")
    path = Path(source).resolve()
    known = str(path) if is_file else source
    if known in _plugins:
        return known
    if is_file and not path.is_file():
        raise FtcmError(f"plug-in {source!r}: no such file; expected a Python file with components")
    for package in KINDS.values():  # whose names a plug-in cannot take
        _load_package(package)
    before = {kind: dict(found) for kind, found in _components.items()}
    name = _module_name(path) if is_file else source
    try:
        if is_file:
            spec = importlib.util.spec_from_file_location(name, path)
            assert spec is not None
            assert spec.loader is not None
            module = importlib.util.module_from_spec(spec)
            sys.modules[name] = module
            spec.loader.exec_module(module)
        else:
            importlib.import_module(name)
    except FtcmError as error:
        _forget(name, before)
        raise FtcmError(f"plug-in {source!r}: {error}") from None
    except Exception as error:
        _forget(name, before)
        at = _line_in(path, error) if is_file else ""
        raise FtcmError(f"plug-in {source!r} cannot be loaded: {type(error).__name__}{at}: {error}") from None
    _plugins[known] = name
    return known


def plugins() -> tuple[str, ...]:
    """Return the plug-ins loaded so far, as of :func:`load_plugin`, for another process to load the same."""
    return tuple(_plugins)


def load_plugins(sources: Iterable[str]) -> None:
    """Load several plug-ins.

    Raises:
        FtcmError: as of :func:`load_plugin`.
    """
    for source in sources:
        load_plugin(source)


def _module_name(path: Path) -> str:
    """Name of a plug-in file's module: the same in every process, and no other module's."""
    return f"ftcm_plugin_{path.stem}_{hashlib.sha256(str(path).encode()).hexdigest()[:8]}"


def _forget(name: str, before: dict[str, dict[str, type[Component]]]) -> None:
    sys.modules.pop(name, None)
    for kind, found in before.items():
        _components[kind] = found


def _line_in(path: Path, error: BaseException) -> str:
    """Where in a plug-in's file an error arose."""
    if isinstance(error, SyntaxError):
        return f" in line {error.lineno}"
    line, trace = 0, error.__traceback__
    while trace is not None:
        if trace.tb_frame.f_code.co_filename == str(path):
            line = trace.tb_lineno
        trace = trace.tb_next
    return f" in line {line}" if line else ""


def components(kind: str) -> dict[str, type[Component]]:
    """Return the registered components of a kind, by name, sorted.

    Raises:
        FtcmError: the kind is unknown, or an installed plug-in cannot be loaded.
    """
    if kind not in KINDS:
        raise FtcmError(f"no component kind {kind!r}; {suggestion(kind, KINDS)}")
    _load_package(KINDS[kind])
    _load_installed()
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


def summary(cls: type) -> str:
    """Return the first line of a class's docstring."""
    return next(iter((cls.__doc__ or "").strip().splitlines()), "")
