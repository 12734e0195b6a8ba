# SPDX-License-Identifier: Apache-2.0
"""What the launch files start: arguments, processes, parameters. Nothing of ``launch`` is imported here."""

from __future__ import annotations

import importlib.resources
import shlex
import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

import yaml

from ftcm_core.errors import FtcmError
from ftcm_core.registry import load_plugins, plugins
from ftcm_core.scenario import Scenario, load
from ftcm_ros.parameters.node_parameters import ALL_NODES, SETTINGS, Setting, setting
from ftcm_ros.run.external_nodes import write_parameters
from ftcm_ros.run.run_parameters import run_parameters
from ftcm_ros.viewer.description import REFERENCE_STATES, STATES, WORLD, description

PASSED_ON = ("stages", "data_path", "priority", "lock_memory", "processors")
"""Parameters of the nodes that ``experiment.launch.py`` passes on."""
EXPERIMENT_ARGUMENTS = (
    Setting("scenario", "paper", "scenario file, or the name of a shipped scenario"),
    Setting("controller", "", "use this controller; empty: the scenario's"),
    Setting("set", "", "changes of the scenario, separated by spaces, e.g. 'duration=5 observer.k1=10000'"),
    Setting("plugins", "", setting("plant", "plugins").description),
    Setting("mode", "lockstep", setting("plant", "mode").description, ("lockstep", "real_time")),
    Setting(
        "composed",
        "auto",
        "all nodes but the recorder in one process, or each in its own; auto: composed in real time",
        ("auto", "true", "false"),
    ),
    Setting("bag", "", setting("recorder", "bag").description),
    Setting("storage", "mcap", setting("recorder", "storage").description, ("mcap", "sqlite3")),
    *(setting("plant", name) for name in PASSED_ON),
)
"""Arguments of ``experiment.launch.py``."""
NODE_ARGUMENTS = (
    Setting("node", "", f"which node: {', '.join(ALL_NODES)}"),
    Setting("params_file", "", "file with parameters of the node, also those of its components"),
    *(
        Setting(s.name, "", s.description)
        for s in {s.name: s for settings in SETTINGS.values() for s in settings}.values()
    ),
)
"""Arguments of ``node.launch.py``: the nodes' own parameters; empty: the node's default."""
VIEWER_ARGUMENTS = (
    *(a for a in EXPERIMENT_ARGUMENTS if a.name in ("scenario", "set", "plugins")),
    Setting("rviz", True, "whether RViz is started"),
)
"""Arguments of ``viewer.launch.py``."""
RVIZ = Path(str(importlib.resources.files("ftcm_core"))) / "config" / "rviz" / "viewer.rviz"
"""What RViz shows."""
GHOST = "reference/"
"""Before the frames of the reference's arm."""


class Process(NamedTuple):
    """A process to start."""

    executable: str
    """As ``ros2 run`` knows it."""
    arguments: tuple[str, ...] = ()
    parameters: tuple[str | dict[str, Any], ...] = ()
    """Parameter files, or values."""
    package: str = "ftcm_ros"
    name: str | None = None
    """Of the node; None: its own."""
    remappings: tuple[tuple[str, str], ...] = ()


class Launched(NamedTuple):
    """A run to start: its nodes, who drives them, and where it is recorded."""

    scenario: Scenario
    bag: Path
    nodes: tuple[Process, ...]
    driver: Process


def shown_default(argument: Setting) -> str:
    """Default of a launch argument, which is a text."""
    return str(argument.default).lower() if isinstance(argument.default, bool) else str(argument.default)


def parsed(declared: Setting, text: str) -> Any:
    """Return what a launch argument's text says, of the kind of its default value.

    Raises:
        FtcmError: it is not of that kind, or none of the choices.
    """
    kind = declared.default
    if isinstance(kind, str):
        return declared.check(text)
    try:
        value = yaml.safe_load(text)
    except yaml.YAMLError:
        value = None
    if type(value) is not type(kind):
        expected = "true or false" if isinstance(kind, bool) else "a whole number"
        raise FtcmError(f"{declared.name}: {text!r}; expected {expected}")
    return declared.check(value)


def experiment(given: Mapping[str, str], folder: Path) -> Launched:
    """Return what ``experiment.launch.py`` starts, and write the files that it needs.

    Args:
        given: text of each of :data:`EXPERIMENT_ARGUMENTS`.
        folder: where scenario and parameters are written.

    Raises:
        FtcmError: an argument or the scenario is not valid.
    """
    values = {a.name: parsed(a, given[a.name]) for a in EXPERIMENT_ARGUMENTS}
    scenario = scenario_of(values)
    bag = Path(values["bag"] or time.strftime("ftcm-%Y%m%d-%H%M%S")).absolute()
    if bag.exists():
        raise FtcmError(f"bag: {str(bag)!r} exists already; choose another or remove it")
    file = folder / "scenario.yaml"
    folder.mkdir(parents=True, exist_ok=True)
    file.write_text(scenario.to_yaml(), encoding="utf-8")
    passed = {name: values[name] for name in ("mode", "storage", *PASSED_ON)}
    files = {}
    for node, parameters in run_parameters(scenario, file, bag, passed).items():
        files[node] = folder / f"{node}.yaml"
        write_parameters(files[node], node, parameters)
    composed = values["composed"] == "true" or (
        values["composed"] == "auto" and values["mode"] == "real_time"
    )
    together = tuple(node for node in files if node != "recorder") if composed else ()
    processes = [Process(node, (), (str(file),)) for node, file in files.items() if node not in together]
    if together:
        files_together = tuple(str(files[node]) for node in together)
        processes.insert(0, Process("composed", ("--nodes", *together), files_together))
    plugged = [word for name in plugins() for word in ("--plugin", name)]
    return Launched(scenario, bag, tuple(processes), Process("drive", (str(file), *plugged)))


def scenario_of(values: Mapping[str, Any]) -> Scenario:
    """Return the scenario that arguments name, after plug-ins were loaded.

    Raises:
        FtcmError: it, a change or a plug-in is not valid.
    """
    load_plugins(name.strip() for name in values["plugins"].split(",") if name.strip())
    try:
        changes = shlex.split(values["set"])
    except ValueError as error:
        raise FtcmError(f"set: {values['set']!r}: {error}; expected changes as a shell's words") from None
    return load(values["scenario"], changes, controller=values.get("controller") or None)


def viewer(given: Mapping[str, str]) -> tuple[Process, ...]:
    """Return what ``viewer.launch.py`` starts.

    Args:
        given: text of each of :data:`VIEWER_ARGUMENTS`.

    Raises:
        FtcmError: an argument or the scenario is not valid, or the robot cannot be drawn.
    """
    values = {a.name: parsed(a, given[a.name]) for a in VIEWER_ARGUMENTS}
    seen = description(scenario_of(values).robot)
    plugged = [word for name in plugins() for word in ("--plugin", name)]
    started = [Process("markers", tuple(plugged))]
    for name, prefix, states in (("robot", "", STATES), ("reference", GHOST, REFERENCE_STATES)):
        started += [
            Process(
                "robot_state_publisher",
                parameters=({"robot_description": seen.text, "frame_prefix": prefix},),
                package="robot_state_publisher",
                name=f"robot_state_publisher_of_{name}",
                remappings=(("joint_states", states), ("robot_description", f"viewer/{name}_description")),
            ),
            Process(
                "static_transform_publisher",
                ("--frame-id", WORLD, "--child-frame-id", prefix + seen.root),
                package="tf2_ros",
                name=f"place_of_{name}",
            ),
        ]
    if values["rviz"]:
        started.append(Process("rviz2", ("-d", str(RVIZ)), package="rviz2"))
    return tuple(started)


def single(given: Mapping[str, str]) -> Process:
    """Return what ``node.launch.py`` starts.

    Args:
        given: text of each of :data:`NODE_ARGUMENTS`.

    Raises:
        FtcmError: there is no such node, it has no such parameter, or not of such a value.
    """
    node = Setting("node", "", "", ALL_NODES).check(given["node"])
    own = {s.name: s for s in SETTINGS[node]}
    values = {}
    for name, text in given.items():
        if name in ("node", "params_file") or not text:
            continue
        if name not in own:
            raise FtcmError(f"{name}: node {node!r} has no such parameter; it has {', '.join(own)}")
        values[name] = parsed(own[name], text)
    if given["params_file"] and not Path(given["params_file"]).is_file():
        raise FtcmError(f"params_file: there is no file {given['params_file']!r}")
    files = (given["params_file"],) if given["params_file"] else ()
    return Process(node, (), (*files, *((values,) if values else ())))
