# SPDX-License-Identifier: Apache-2.0
"""Scenario files: YAML to a typed, validated scenario and back, strict in both directions.

Errors name the place (``paper.yaml:12: observer.k1``), the value, what was expected, and the nearest
name for a misspelt one. The same dotted paths address values on the command line (``--set``).
"""

from __future__ import annotations

import copy
import dataclasses
import importlib.resources
import re
import stat
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, cast

import yaml

from ftcm_core.controllers import Controller
from ftcm_core.errors import FtcmError, ParameterError, ScenarioError, shown, suggestion
from ftcm_core.faults import Disturbance, Fault
from ftcm_core.limits import Limits, motion_beyond
from ftcm_core.observers import Observer
from ftcm_core.params import Parameterised, param, per_joint, specs
from ftcm_core.references import Reference
from ftcm_core.registry import Component, find
from ftcm_core.robots import Robot
from ftcm_core.sensors import Sensor
from ftcm_core.sensors.ideal import Ideal
from ftcm_core.signals import NANOSECONDS, Vector
from ftcm_core.stages import SPEED_LIMIT, ControllerStage, InjectorStage, ObserverStage, PlantStage

MAX_TICKS = 10_000_000
MAX_FILE_BYTES = 100_000
MAX_MERGED = 10_000
"""Entries that the merge keys (``<<``) of one file may bring in."""
_COMPONENTS = {
    "robot": "robot", "reference": "reference", "controller": "controller", "observer": "observer",
    "sensor": "sensor",
}  # fmt: skip
_OPTIONAL = {"sensor"}
IDEAL = Ideal()
_LISTS = {"disturbances": "disturbance", "faults": "fault"}


@dataclasses.dataclass(frozen=True, kw_only=True)
class InitialState(Parameterised):
    """Motion of the robot at t = 0."""

    position: float = param(0.0, unit="rad", at_least=-100.0, at_most=100.0, per_joint=True,
                            doc="joint positions at t = 0", source="sec. IV: zero")  # fmt: skip
    velocity: float = param(0.0, unit="rad/s", above=-SPEED_LIMIT, below=SPEED_LIMIT, per_joint=True,
                            doc="joint velocities at t = 0", source="sec. IV: zero")  # fmt: skip


@dataclasses.dataclass(frozen=True, kw_only=True)
class Scenario(Parameterised):
    """Everything that determines a run."""

    name: str = param(
        "unnamed", unit="-", doc="name of the scenario; the file's name unless given", source="chosen"
    )
    dt: float = param(1e-3, unit="s", at_least=1e-5, at_most=0.1, doc="tick length", source="sec. IV: 1 kHz")
    duration: float = param(
        40.0, unit="s", above=0.0, at_most=100_000.0, doc="length of the run", source="sec. IV"
    )
    transient: float = param(
        1.0,
        unit="s",
        at_least=0.0,
        doc="end of the transient window of the metrics",
        source="chosen: settled by then",
    )
    torque_limits: float | None = param(
        None, unit="N·m", above=0.0, per_joint=True, optional=True, kind="float",
        doc="largest torque of each drive; null: no limit", source="sec. IV: none",
    )  # fmt: skip
    torque_rate_limits: float | None = param(
        None, unit="N·m/s", above=0.0, per_joint=True, optional=True, kind="float",
        doc="fastest change of each drive's torque; null: no limit", source="sec. IV: none",
    )  # fmt: skip
    velocity_limits: float | None = param(
        None, unit="rad/s", above=0.0, per_joint=True, optional=True, kind="float",
        doc="speed beyond which the run ends; null: no limit", source="sec. IV: none",
    )  # fmt: skip
    position_lower_limits: float | None = param(
        None, unit="rad", per_joint=True, optional=True, kind="float",
        doc="position below which the run ends; null: no limit", source="sec. IV: none",
    )  # fmt: skip
    position_upper_limits: float | None = param(
        None, unit="rad", per_joint=True, optional=True, kind="float",
        doc="position above which the run ends; null: no limit", source="sec. IV: none",
    )  # fmt: skip
    stop_damping: float = param(
        100.0, unit="N·m·s/rad", at_least=0.0, per_joint=True,
        doc="damping of the drives in a safe stop, which the plant node makes when no torque comes",
        source="chosen: the PUMA 560 sinks at under 0.4 rad/s; stable for ticks of up to 20 ms",
    )  # fmt: skip
    torque_delay: int = param(
        0, unit="ticks", at_least=0, at_most=1000,
        doc="the drive applies the command of so many ticks before; zero torque until the first arrives",
        source="sec. IV: none",
    )  # fmt: skip
    seed: int = param(
        0, unit="-", at_least=0, at_most=2**63 - 1, doc="seed of all random streams", source="chosen"
    )
    robot: Robot
    reference: Reference
    controller: Controller
    observer: Observer
    sensor: Sensor = IDEAL
    initial_state: InitialState = InitialState()
    disturbances: tuple[Disturbance, ...] = ()
    faults: tuple[Fault, ...] = ()

    def check(self) -> None:
        """Check what one value cannot tell: whole ticks, joint counts, an observer where one is needed."""
        ns = self.dt * NANOSECONDS
        if abs(ns - round(ns)) > 1e-6:
            raise ParameterError(
                f"dt: {self.dt!r} s is not a whole number of nanoseconds; choose e.g. {round(ns)}e-9"
            )
        count = self.duration / self.dt
        if abs(count - round(count)) > 1e-6 or round(count) < 1:
            raise ParameterError(
                f"duration: {self.duration:g} s is not a whole number of ticks of {self.dt:g} s; "
                f"choose e.g. {max(1, round(count)) * round(ns) / NANOSECONDS!r}"
            )
        if count > MAX_TICKS:
            raise ParameterError(
                f"duration: {count:.3g} ticks; expected at most {MAX_TICKS}; raise dt or shorten it"
            )
        if self.controller.needs_observer and self.observer.type_name == "none":
            raise ParameterError(
                f"observer: none, but controller {self.controller.type_name!r} uses the disturbance "
                "estimate; choose an observer, e.g. do, or a controller that needs none, e.g. ftsmc"
            )
        joints = self.robot.joints
        self.check_joints(joints)
        for place, part in self.parts():
            try:
                part.check_joints(joints)
                needs = part.supports(joints) if isinstance(part, Disturbance) else None
            except ParameterError as error:
                raise ParameterError(f"{place}.{error}") from None
            if needs:
                raise ParameterError(f"{place}: {needs}; robot {self.robot.type_name!r} has {joints}")
        limits, start = self.limits, self.initial_state
        if limits.lower is not None and limits.upper is not None:
            for low, high in zip(limits.lower, limits.upper):
                if low >= high:
                    raise ParameterError(
                        f"position_lower_limits: {low:g} is not below position_upper_limits {high:g}"
                    )
        position, velocity = per_joint(start.position, joints), per_joint(start.velocity, joints)
        beyond = motion_beyond(limits, self.robot.joint_names, position, velocity)
        if beyond:
            raise ParameterError(f"initial_state: {beyond}; expected a start within the limits")

    def parts(self) -> list[tuple[str, Parameterised]]:
        """Return the parameter records inside this scenario with their paths."""
        return [
            ("robot", self.robot),
            ("reference", self.reference),
            ("controller", self.controller),
            ("observer", self.observer),
            ("sensor", self.sensor),
            ("initial_state", self.initial_state),
            *((f"injection.disturbances.{i}", d) for i, d in enumerate(self.disturbances)),
            *((f"injection.faults.{i}", f) for i, f in enumerate(self.faults)),
        ]

    @property
    def dt_ns(self) -> int:
        """Tick length, integer ns."""
        return round(self.dt * NANOSECONDS)

    @property
    def last_tick(self) -> int:
        """Number N of the last tick; a run has the N + 1 ticks 0 ... N."""
        return round(self.duration / self.dt)

    @property
    def limits(self) -> Limits:
        """What drives and joints allow."""

        def each(value: float | None, factor: float = 1.0) -> Vector | None:
            if value is None:
                return None
            return tuple([x * factor for x in per_joint(value, self.robot.joints)])

        return Limits(
            torque=each(self.torque_limits),
            torque_step=each(self.torque_rate_limits, self.dt),
            velocity=each(self.velocity_limits),
            lower=each(self.position_lower_limits),
            upper=each(self.position_upper_limits),
        )

    @property
    def first_fault(self) -> float | None:
        """Earliest onset of a fault, s; None without faults."""
        return min((f.start for f in self.faults), default=None)

    def plant_stage(self) -> PlantStage:
        """Return the plant at its initial state."""
        n = self.robot.joints
        start = self.initial_state
        return PlantStage(
            self.robot,
            self.dt,
            per_joint(start.position, n),
            per_joint(start.velocity, n),
            self.limits,
            self.sensor,
            self.seed,
            self.torque_delay,
            per_joint(self.stop_damping, n),
        )

    def observer_stage(self) -> ObserverStage:
        """Return the observer before its first measurement."""
        return ObserverStage(self.observer, self.robot, self.dt)

    def controller_stage(self) -> ControllerStage:
        """Return the controller in its initial state."""
        return ControllerStage(self.controller, self.reference, self.robot, self.dt)

    def injector_stage(self) -> InjectorStage:
        """Return the disturbances and faults."""
        sources = (*self.disturbances, *self.faults)
        return InjectorStage(sources, self.robot.joints, self.limits, self.torque_delay)

    def with_controller(self, name: str) -> Scenario:
        """Return this scenario with another controller at its defaults; unchanged if it is the same."""
        if name == self.controller.type_name:
            return self
        return replace(self, controller=cast(Controller, find("controller", name)()))

    def to_mapping(self) -> dict[str, Any]:
        """Return the complete scenario, every default written out, as plain data."""
        scalars = {k: list(v) if isinstance(v, tuple) else v for k, v in self.values.items()}
        return {
            "name": scalars.pop("name"),
            **{key: getattr(self, key).to_mapping() for key in _COMPONENTS},
            "initial_state": {
                k: list(v) if isinstance(v, tuple) else v for k, v in self.initial_state.values.items()
            },
            "injection": {key: [c.to_mapping() for c in getattr(self, key)] for key in _LISTS},
            **scalars,
        }

    def to_yaml(self) -> str:
        """Return the complete scenario as a file that reads back to an equal scenario."""
        return yaml.dump(
            self.to_mapping(),
            Dumper=_Dumper,
            sort_keys=False,
            allow_unicode=self.name.isprintable(),
            default_flow_style=None,
        )


def replace(scenario: Scenario, **changes: Any) -> Scenario:
    """Return a copy with some fields changed, validated as a whole.

    Raises:
        ScenarioError: the result is not a valid scenario.
    """
    try:
        return dataclasses.replace(scenario, **changes)
    except ParameterError as error:
        raise ScenarioError(str(error)) from None


class _Loader(yaml.SafeLoader):
    """Safe YAML; reads ``1e4`` as a number (YAML 1.2).

    Refuses a key given twice, numbers that YAML 1.1 and 1.2 read differently, and merge keys that multiply.
    """

    merged = 0

    def construct_mapping(self, node: yaml.MappingNode, deep: bool = False) -> dict[Any, Any]:
        seen = set()
        for key, _ in node.value:
            if isinstance(key, yaml.ScalarNode) and key.value in seen:
                raise yaml.constructor.ConstructorError(
                    None, None, f"the key {key.value!r} is given twice", key.start_mark
                )
            seen.add(key.value if isinstance(key, yaml.ScalarNode) else id(key))
        return super().construct_mapping(node, deep)

    def flatten_mapping(self, node: yaml.MappingNode) -> None:
        merges = [value for key, value in node.value if key.tag == "tag:yaml.org,2002:merge"]
        for merge in merges:
            for part in merge.value if isinstance(merge, yaml.SequenceNode) else [merge]:
                if isinstance(part, yaml.MappingNode):
                    self.flatten_mapping(part)
                    self.merged += len(part.value)
                if self.merged > MAX_MERGED:
                    raise yaml.constructor.ConstructorError(
                        None, None, f"merge keys bring in more than {MAX_MERGED} entries", node.start_mark
                    )
        super().flatten_mapping(node)

    def construct_number(self, node: yaml.ScalarNode) -> int | float:
        text = node.value.lstrip("+-")
        if ":" in text or re.fullmatch("0[0-7_]+", text):
            raise yaml.constructor.ConstructorError(
                None, None, f"{shown(node.value)} is a number in base {60 if ':' in text else 8} to some; "
                "write it in base 10", node.start_mark,
            )  # fmt: skip
        whole = node.tag.endswith(":int")
        return self.construct_yaml_int(node) if whole else self.construct_yaml_float(node)


for _tag in ("int", "float"):
    _Loader.add_constructor(f"tag:yaml.org,2002:{_tag}", _Loader.construct_number)


class _Dumper(yaml.SafeDumper):
    """Writes what :class:`_Loader` reads back: a text such as ``1e4`` in quotes."""


for _class in (_Loader, _Dumper):
    _class.add_implicit_resolver(
        "tag:yaml.org,2002:float",
        re.compile(r"^[-+]?(?:[0-9]+(?:\.[0-9]*)?|\.[0-9]+)[eE][-+]?[0-9]+$"),
        list("-+0123456789."),
    )


def parse_yaml(text: str, origin: str) -> tuple[Any, dict[str, int]]:
    """Parse YAML safely.

    Args:
        text: the document.
        origin: what to call it in errors.

    Returns:
        The plain data and the line of every dotted path.

    Raises:
        ScenarioError: not YAML, with the line.
    """
    lines: dict[str, int] = {}
    visited: set[int] = set()

    def walk(node: yaml.Node, path: str, depth: int) -> None:
        if path in lines or depth > 8:
            return
        lines[path] = node.start_mark.line + 1
        if id(node) in visited:  # an alias
            return
        visited.add(id(node))
        if isinstance(node, yaml.MappingNode):
            for key, value in node.value:
                inner = f"{path}.{key.value}" if path else str(key.value)
                walk(value, inner, depth + 1)
                lines[inner] = key.start_mark.line + 1
        elif isinstance(node, yaml.SequenceNode):
            for i, value in enumerate(node.value[:1000]):
                walk(value, f"{path}.{i}", depth + 1)

    try:
        loader = _Loader(text)
        node = loader.get_single_node()
        if node is None:
            return None, lines
        walk(node, "", 0)
        return loader.construct_document(node), lines
    except yaml.MarkedYAMLError as error:
        mark = error.problem_mark or error.context_mark
        place = f"{origin}:{mark.line + 1}" if mark else origin
        raise ScenarioError(f"{place}: not valid YAML: {error.problem or error.context}") from None
    except (
        yaml.YAMLError,
        RecursionError,
        ValueError,
        TypeError,
        ArithmeticError,
        LookupError,
        AttributeError,
    ) as error:
        # The library's own constructors raise all of these for values that do not fit an explicit tag.
        first = str(error).splitlines()[0] if str(error) else type(error).__name__
        raise ScenarioError(f"{origin}: not valid YAML: {first[:120]}") from None


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
    return data, lines, path.name


def load(source: str, overrides: Sequence[str] = (), controller: str | None = None) -> Scenario:
    """Load a scenario file and apply ``path=value`` overrides.

    Args:
        source: path of a file or name of a shipped scenario.
        overrides: texts such as ``observer.k1=10000`` or ``injection.faults.0.start=5``.
        controller: use this controller; one of another type than the file's has its defaults.

    Raises:
        ScenarioError: anything wrong with the file or an override, in one line.
    """
    data, lines, origin = read_mapping(source)
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
                node.clear()
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


def from_mapping(
    data: Mapping[str, Any], *, origin: str = "scenario", places: Mapping[str, str] | None = None
) -> Scenario:
    """Build a scenario from plain data.

    Args:
        data: the mapping of a scenario file.
        origin: what to call it in errors.
        places: where each dotted path was written, for errors.

    Raises:
        ScenarioError: in one line: place, value, what was expected, a suggestion.
    """
    if not isinstance(data, Mapping):
        raise ScenarioError(f"{origin}: {shown(data)} is not a mapping with keys such as robot, controller")
    rest = dict(data)
    places = places or {}

    def fail(path: str, message: str) -> ScenarioError:
        known = path
        while known and known not in places:
            known = known.rpartition(".")[0]
        place = places[known] if known else origin
        return ScenarioError(f"{place}: {path}: {message}" if path else f"{place}: {message}")

    def check_keys(mapping: Mapping[Any, Any], path: str, known: Sequence[str]) -> None:
        for key in mapping:
            if key not in known:
                name = key if isinstance(key, str) and len(key) <= 60 else shown(key)
                inner = f"{path}.{name}" if path else name
                raise fail(inner, f"unknown key; {suggestion(name, known)}")

    def record(cls: type[Any], mapping: Mapping[str, Any], path: str, **more: Any) -> Any:
        try:
            return cls(**mapping, **more)
        except ParameterError as error:
            place, _, message = str(error).partition(": ")
            raise fail(f"{path}.{place}" if path else place, message) from None

    def component(value: Any, path: str, kind: str) -> Component:
        if isinstance(value, str):
            value = {"type": value}
        if not isinstance(value, dict):
            raise fail(
                path, f"{shown(value)} is not a component; expected a mapping with 'type' and its parameters"
            )
        if "type" not in value:
            raise fail(path, "has no 'type'; expected e.g. {type: " + _example(kind) + "}")
        try:
            cls = find(kind, value["type"]) if isinstance(value["type"], str) else None
        except FtcmError as error:
            raise fail(f"{path}.type", str(error)) from None
        if cls is None:
            raise fail(
                f"{path}.type", f"{shown(value['type'])} is not a name; expected e.g. {_example(kind)}"
            )
        parameters = {k: v for k, v in value.items() if k != "type"}
        check_keys(parameters, path, ["type", *specs(cls)])
        return cast(Component, record(cls, parameters, path))

    def mapping_at(key: str) -> dict[str, Any]:
        value = rest.pop(key, None)
        if value is None:
            return {}
        if not isinstance(value, dict):
            raise fail(key, f"{shown(value)} is not a mapping")
        return value

    check_keys(rest, "", [*_COMPONENTS, "initial_state", "injection", *specs(Scenario)])
    parts: dict[str, Any] = {}
    for key, kind in _COMPONENTS.items():
        if rest.get(key) is None and key in _OPTIONAL:
            rest.pop(key, None)
            continue
        if rest.get(key) is None:
            raise fail(key, "is missing; expected e.g. {type: " + _example(kind) + "}")
        parts[key] = component(rest.pop(key), key, kind)
    injection = mapping_at("injection")
    check_keys(injection, "injection", list(_LISTS))
    for key, kind in _LISTS.items():
        entries = injection.get(key)
        entries = [] if entries is None else entries
        if not isinstance(entries, list):
            raise fail(f"injection.{key}", f"{shown(entries)} is not a list of components")
        parts[key] = tuple(component(v, f"injection.{key}.{i}", kind) for i, v in enumerate(entries))
    start = mapping_at("initial_state")
    check_keys(start, "initial_state", list(specs(InitialState)))
    parts["initial_state"] = record(InitialState, start, "initial_state")
    return cast(Scenario, record(Scenario, rest, "", **parts))


def _example(kind: str) -> str:
    examples = {"robot": "puma560", "reference": "vo_kang_cosine", "controller": "ftcm", "observer": "do",
                "sensor": "encoder", "disturbance": "vo_kang_friction", "fault": "vo_kang_fault"}  # fmt: skip
    return examples[kind]
