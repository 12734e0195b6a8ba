# SPDX-License-Identifier: Apache-2.0
"""Scenario files: YAML to a typed, validated scenario, strictly.

Errors name the place (``paper.yaml:12: observer.k1``), the value, what was expected, and the nearest
name for a misspelt one. The same dotted paths address values on the command line (``--set``).
"""

from __future__ import annotations

import copy
import importlib.resources
import json
import re
import stat
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, cast

from ftcm_core.errors import FtcmError, ParameterError, ScenarioError, Unsuited, shown, suggestion
from ftcm_core.params import ParamSpec, specs
from ftcm_core.registry import Component, find, load_plugin, plugins
from ftcm_core.robots import Robot
from ftcm_core.robots.urdf_file import PACKAGE
from ftcm_core.scenario.definition import COMPONENTS, LISTS, InitialState, Scenario
from ftcm_core.scenario.yaml_text import parse_yaml

MAX_FILE_BYTES = 100_000
_OPTIONAL = {"sensor", "plant", "model", "detector"}
_DEFAULT_TYPE = {"plant": "rigid_body"}
"""Type of a component that is written without one."""


def shipped_scenarios() -> dict[str, Path]:
    """Return the scenario files that come with the package, by name."""
    folder = Path(str(importlib.resources.files("ftcm_core"))) / "config" / "scenarios"
    return {p.stem: p for p in sorted(folder.glob("*.yaml"))}


def read_mapping(source: str) -> tuple[dict[str, Any], dict[str, int], str]:
    """Read a scenario file, given as a path or as the name of a shipped scenario.

    Args:
        source: path or name.

    Returns:
        The plain data, the line of every dotted path, and the file's name for errors.

    Raises:
        ScenarioError: it cannot be read or is not a YAML mapping.
    """
    shipped = shipped_scenarios()
    path = shipped[source] if source in shipped and not Path(source).is_file() else Path(source)
    try:
        if not stat.S_ISREG(path.stat().st_mode):  # a pipe or a device may have no end
            raise ScenarioError(f"{shown(source)} cannot be read: not a regular file; expected a scenario")
        with path.open("rb") as file:
            raw = file.read(MAX_FILE_BYTES + 1)
        if len(raw) > MAX_FILE_BYTES:
            raise ScenarioError(f"{path}: larger than {MAX_FILE_BYTES} bytes; expected a scenario file")
        text = raw.decode()
    except FileNotFoundError:
        raise ScenarioError(
            f"no scenario file {shown(source)}; expected a path or the name of a shipped scenario; "
            f"{suggestion(source, shipped)}"
        ) from None
    except UnicodeDecodeError:
        raise ScenarioError(f"{path}: not a text file in UTF-8; expected a scenario in YAML") from None
    except (OSError, ValueError) as error:
        reason = getattr(error, "strerror", None) or str(error)
        raise ScenarioError(f"{shown(source)} cannot be read: {reason}; expected a scenario file") from None
    data, lines = parse_yaml(text, path.name)
    if not isinstance(data, dict):
        raise ScenarioError(f"{path.name}: expected a mapping with keys such as robot, controller, duration")
    data.setdefault("name", path.stem)
    _set_folder(data, path.parent)
    return data, lines, path.name


def _set_folder(data: dict[str, Any], folder: Path) -> None:
    """Make the files of robots and plants absolute, in place: what a scenario names is relative to it."""
    plant = data.get("plant")
    for part in (
        data.get("robot"),
        data.get("model"),
        plant,
        plant.get("robot") if isinstance(plant, dict) else None,
    ):
        if isinstance(part, dict) and isinstance(file := part.get("file"), str) and file:
            part["file"] = file if file.startswith(PACKAGE) else str(folder.absolute() / file)


def load(source: str, overrides: Sequence[str] = (), controller: str | None = None) -> Scenario:
    """Load a scenario file and apply ``path=value`` overrides.

    Args:
        source: path of a file or name of a shipped scenario.
        overrides: texts such as ``observer.k1=10000`` or ``injection.faults.0.start=5``.
        controller: use this controller; one of another type than the file's has its defaults.

    Raises:
        ScenarioError: anything wrong with the file or an override, in one line.
        FtcmError: a plug-in that the file names cannot be loaded.
    """
    data, lines, origin = read_mapping(source)
    data = with_plugins(data, source, origin)
    places: dict[str, str] = {path: f"{origin}:{line}" for path, line in lines.items()}
    if controller is not None:
        overrides = [f"controller.type={controller}", *overrides]
    for text in overrides:
        apply_override(data, text)
        path = text.partition("=")[0].strip()
        places = {k: v for k, v in places.items() if k != path and not k.startswith(path + ".")}
        places[path] = "--set"
        if path.partition(".")[0] not in places:
            places[path.partition(".")[0]] = "--set"
    return from_mapping(data, origin=origin, places=places)


def apply_override(data: dict[str, Any], text: str) -> None:
    """Apply one ``path=value`` override to a scenario's plain data, in place.

    Setting another ``type`` drops the other parameters of that component, which belong to the old type.

    Raises:
        ScenarioError: the text has no ``=`` or the path leads nowhere.
    """
    path, equals, value_text = text.partition("=")
    keys = path.strip().split(".")
    label = path if len(path) <= 80 else path[:77] + "..."
    if not equals or not all(keys):
        raise ScenarioError(f"--set {shown(text)}: expected path=value, e.g. observer.k1=10000")
    value, _ = parse_yaml(value_text, f"--set {label}")
    node: Any = data
    for depth, key in enumerate(keys):
        here = ".".join(keys[:depth])[:80] or "the scenario"
        index: Any = key
        if isinstance(node, list):
            if not (key.isascii() and key.isdecimal()) or len(key) > 6 or int(key) >= len(node):
                raise ScenarioError(
                    f"--set {label}: {here} has {len(node)} entries, numbered from 0; {shown(key)} is not one"
                )
            index = int(key)
        elif not isinstance(node, dict):
            raise ScenarioError(f"--set {label}: {here} is a single value; it has no {shown(key)} inside")
        if depth == len(keys) - 1:
            if key == "type" and node.get("type") != value:
                robot = {k: v for k, v in node.items() if k == "robot" and keys[0] == "plant"}
                node.clear()
                node.update(robot)  # whose robot it is, is no parameter of an engine
            node[index] = value
            return
        inner = node[index] if isinstance(node, list) else node.get(index, {})
        if inner is None:
            raise ScenarioError(
                f"--set {label}: {'.'.join(keys[: depth + 1])[:80]} is null; set it as a whole first"
            )
        # A copy, as an alias in the file may stand for the same thing elsewhere.
        node[index] = {"type": inner} if isinstance(inner, str) else copy.copy(inner)
        node = node[index]


def with_plugins(data: Mapping[str, Any], source: str, origin: str) -> dict[str, Any]:
    """Load the plug-ins that a scenario file names; paths are relative to the file.

    The mapping then names all that are loaded, those of the command line too: a record of the run tells them.

    Args:
        data: the mapping of the file.
        source: its path.
        origin: what to call it in errors.

    Returns:
        The mapping, with absolute paths.

    Raises:
        FtcmError: one cannot be loaded.
    """
    listed = data.get("plugins") or []
    if not isinstance(listed, list) or not all(isinstance(name, str) for name in listed):
        raise ScenarioError(f"{origin}: plugins: {shown(listed)} is not a list of Python files or modules")
    folder = Path(source).parent
    for name in listed:
        load_plugin(str(folder / name) if name.endswith(".py") else name)
    return {**data, "plugins": list(plugins())}


def from_mapping(
    data: Mapping[str, Any], *, origin: str = "scenario", places: Mapping[str, str] | None = None
) -> Scenario:
    """Build a scenario from plain data.

    Plug-ins that it names must have been loaded: that runs code, and is the caller's to decide.

    Args:
        data: the mapping of a scenario file.
        origin: what to call it in errors.
        places: where each dotted path was written, for errors.

    Raises:
        ScenarioError: in one line: place, value, what was expected, a suggestion.
    """
    if not isinstance(data, Mapping):
        raise ScenarioError(f"{origin}: {shown(data)} is not a mapping with keys such as robot, controller")
    return _Reader(origin, places or {}).scenario(data)


class _Reader:
    """Makes a scenario of plain data; knows where each value was written."""

    def __init__(self, origin: str, places: Mapping[str, str]) -> None:
        self._origin = origin
        self._places = places

    def fail(self, path: str, message: str) -> ScenarioError:
        known = path
        while known and known not in self._places:
            known = known.rpartition(".")[0]
        place = self._places[known] if known else self._origin
        return ScenarioError(f"{place}: {path}: {message}" if path else f"{place}: {message}")

    def check_keys(self, mapping: Mapping[Any, Any], path: str, known: Sequence[str]) -> None:
        for key in mapping:
            if key not in known:
                name = key if isinstance(key, str) and len(key) <= 60 else shown(key)
                inner = f"{path}.{name}" if path else name
                raise self.fail(inner, f"unknown key; {suggestion(name, known)}")

    def record(self, cls: type[Any], mapping: Mapping[str, Any], path: str, **more: Any) -> Any:
        try:
            return cls(**mapping, **more)
        except ParameterError as error:
            place, _, message = str(error).partition(": ")
            failure = self.fail(f"{path}.{place}" if path else place, message)
            failure.unsuited = isinstance(error, Unsuited)
            raise failure from None

    def component(self, value: Any, path: str, kind: str) -> Component:
        cls, parameters = self._split(value, path, kind)
        return cast(Component, self.record(cls, parameters, path))

    def components(self, entries: Any, path: str, kind: str) -> tuple[Component, ...]:
        """Components of a list, which may be left out."""
        entries = [] if entries is None else entries
        if not isinstance(entries, list):
            raise self.fail(path, f"{shown(entries)} is not a list of components")
        return tuple(self.component(v, f"{path}.{i}", kind) for i, v in enumerate(entries))

    def _split(self, value: Any, path: str, kind: str) -> tuple[type[Component], dict[str, Any]]:
        """Class and parameters of a component as written."""
        if isinstance(value, str):
            value = {"type": value}
        if not isinstance(value, dict):
            raise self.fail(
                path, f"{shown(value)} is not a component; expected a mapping with 'type' and its parameters"
            )
        if "type" not in value and path not in _DEFAULT_TYPE:
            raise self.fail(path, "has no 'type'; expected e.g. {type: " + _example(kind) + "}")
        name = value.get("type", _DEFAULT_TYPE.get(path))
        try:
            cls = find(kind, name) if isinstance(name, str) else None
        except FtcmError as error:
            raise self.fail(f"{path}.type", str(error)) from None
        if cls is None:
            raise self.fail(f"{path}.type", f"{shown(name)} is not a name; expected e.g. {_example(kind)}")
        parameters = {k: v for k, v in value.items() if k != "type"}
        self.check_keys(parameters, path, ["type", *specs(cls)])
        if kind == "policy":  # components inside it are kept as text
            inside = [k for k, v in parameters.items() if k in COMPONENTS and isinstance(v, dict)]
            parameters |= {k: json.dumps(parameters[k]) for k in inside}
        return cls, parameters

    def changed(self, robot: Robot, value: Any, path: str) -> Robot:
        """Return a robot that is another one but for what ``value`` says of it.

        A number is the new value; ``+10 %`` or ``-10%`` changes the value there is. With another ``type`` it
        is a robot of its own.
        """
        if value is None:
            return robot
        if not isinstance(value, dict) or value.get("type", robot.type_name) != robot.type_name:
            return cast(Robot, self.component(value, path, "robot"))
        declared = specs(type(robot))
        self.check_keys(value, path, ["type", *declared])
        changes = {
            key: self._number(new, getattr(robot, key), declared[key], f"{path}.{key}")
            for key, new in value.items()
            if key != "type"
        }
        return cast(Robot, self.record(type(robot), {**robot.values, **changes}, path))

    def _number(self, value: Any, nominal: Any, spec: ParamSpec, path: str) -> Any:
        """A parameter's value; percentages are of its nominal value."""
        if isinstance(value, list):
            before = nominal if isinstance(nominal, tuple) else (nominal,) * len(value)
            if len(before) != len(value):
                return value
            return [self._number(x, n, spec, path) for x, n in zip(value, before)]
        if not isinstance(value, str) or spec.kind != "float":
            return value
        match = re.fullmatch(r"\s*([-+]\s*\d+(?:\.\d*)?)\s*%\s*", value)
        if match is None or nominal is None:
            raise self.fail(path, f"{shown(value)} is not a number, nor a change in percent such as '+10 %'")
        factor = 1.0 + float(match[1].replace(" ", "")) / 100.0
        return [x * factor for x in nominal] if isinstance(nominal, tuple) else nominal * factor

    def scenario(self, data: Mapping[str, Any]) -> Scenario:
        rest = dict(data)
        self.check_keys(
            rest, "", ["plugins", *COMPONENTS, "initial_state", "injection", "policies", *specs(Scenario)]
        )
        parts: dict[str, Any] = {"plugins": tuple(rest.pop("plugins", None) or ())}
        robots = {key: rest.pop(key, None) for key in ("plant", "model")}
        for key, kind in COMPONENTS.items():
            if key in robots:
                continue
            if rest.get(key) is None and key in _OPTIONAL:
                rest.pop(key, None)
                continue
            if rest.get(key) is None:
                raise self.fail(key, "is missing; expected e.g. {type: " + _example(kind) + "}")
            parts[key] = self.component(rest.pop(key), key, kind)
        nominal = cast(Robot, parts["robot"])
        plant = robots["plant"]
        if isinstance(plant, dict) and "robot" in plant:
            plant = dict(plant)
            parts["robot"] = self.changed(nominal, plant.pop("robot"), "plant.robot")
        if plant is not None:
            parts["plant"] = self.component(plant, "plant", "plant")
        try:
            unloaded = nominal.unloaded()
        except ParameterError as error:
            raise self.fail("robot", f"its model starts from it without payload, and then {error}") from None
        parts["model"] = self.changed(unloaded, robots["model"], "model")
        injection = self._mapping_at(rest, "injection")
        self.check_keys(injection, "injection", list(LISTS))
        for key, kind in LISTS.items():
            parts[key] = self.components(injection.get(key), f"injection.{key}", kind)
        parts["policies"] = self.components(rest.pop("policies", None), "policies", "policy")
        start = self._mapping_at(rest, "initial_state")
        self.check_keys(start, "initial_state", list(specs(InitialState)))
        parts["initial_state"] = self.record(InitialState, start, "initial_state")
        return cast(Scenario, self.record(Scenario, rest, "", **parts))

    def _mapping_at(self, rest: dict[str, Any], key: str) -> dict[str, Any]:
        value = rest.pop(key, None)
        if value is None:
            return {}
        if not isinstance(value, dict):
            raise self.fail(key, f"{shown(value)} is not a mapping")
        return value


def _example(kind: str) -> str:
    examples = {"robot": "puma560", "plant": "rigid_body", "reference": "vo_kang_cosine",
                "controller": "ftcm", "observer": "do", "detector": "residual_threshold",
                "sensor": "encoder", "disturbance": "vo_kang_friction", "fault": "vo_kang_fault",
                "policy": "safe_stop"}  # fmt: skip
    return examples[kind]
