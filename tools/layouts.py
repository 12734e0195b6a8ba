# SPDX-License-Identifier: Apache-2.0
"""Writes layouts of PlotJuggler and Foxglove for the suite's topics, from their declarations.

``python tools/layouts.py config/layouts/``; ``--scenario FILE`` for another robot's joints.
"""

from __future__ import annotations

import argparse
import json
import sys
import xml.etree.ElementTree as ET
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

from ftcm_core.scenario import load
from ftcm_ros.parameters.node_parameters import ALL_NODES
from ftcm_ros.transport.topics import (
    DETECTION,
    DIAGNOSTICS,
    DISTURBANCE,
    ESTIMATE,
    FAULTS,
    JOINT_STATES,
    REFERENCE,
    TORQUES,
    Topic,
)

PLOTJUGGLER, FOXGLOVE = "plotjuggler.xml", "foxglove.json"
COLOURS = ("#1f77b4", "#d62728", "#2ca02c", "#9467bd")


class Curve(NamedTuple):
    """One signal of a joint: an array of a topic, or one less another; or with the other sign."""

    label: str
    topic: Topic
    array: str
    less: tuple[Topic, str] | None = None
    negative: bool = False

    @property
    def computed(self) -> bool:
        """Whether it is no array of a topic as it is."""
        return self.less is not None or self.negative


class View(NamedTuple):
    """What is looked at together: a plot per joint, with the same curves."""

    title: str
    curves: tuple[Curve, ...]


VIEWS = (
    View(
        "Tracking error",
        (Curve("tracking error, rad", JOINT_STATES, "position", less=(REFERENCE, "position")),),
    ),
    View(
        "Motion",
        (
            Curve("desired position, rad", REFERENCE, "position"),
            Curve("measured position, rad", JOINT_STATES, "position"),
        ),
    ),
    View(
        "Torque",
        (
            Curve("command, N·m", TORQUES, "effort"),
            Curve("drives, N·m", JOINT_STATES, "effort"),
        ),
    ),
    View(
        "Disturbance",
        (
            Curve("disturbance, N·m", DISTURBANCE, "effort"),
            Curve("minus the estimate, N·m", ESTIMATE, "effort", negative=True),
        ),
    ),
    View(
        "Detection",
        (
            Curve("residual", DETECTION, "effort"),
            Curve("alarm", DETECTION, "position"),
            Curve("verdict", DETECTION, "velocity"),
        ),
    ),
)
"""The estimate is one of minus the disturbance."""
STATES = ("alarm", "verdict")
"""Curves with few values."""
HEALTH = ("rate_hz", "missed_deadlines", "latency_p99_us")
"""Values of the plant's diagnostics."""


def absolute(topic: Topic) -> str:
    """Name of a topic with its slash, as the tools show it."""
    return "/" + topic.name.removeprefix("/")


# PlotJuggler.


def series(topic: Topic, joint: str, array: str) -> str:
    """Name that PlotJuggler gives an array of a JointState, for one joint."""
    return f"{absolute(topic)}/{joint}/{array}"


def diagnostic_series(robot: str, node: str, key: str) -> str:
    """Name that PlotJuggler gives a value of a node's diagnostics."""
    return f"{absolute(DIAGNOSTICS)}/{robot}/{node}: tick/{key}"


def plotjuggler(robot: str, joints: Sequence[str], end: float) -> str:
    """Return a layout of PlotJuggler: a tab for each view, in it a plot for each joint.

    Args:
        robot: name of the robot.
        joints: names of its joints.
        end: of the time axis, s.
    """
    root = ET.Element("root")
    tabs = ET.SubElement(root, "tabbed_widget", {"parent": "main_window", "name": "Main Window"})
    equations = ET.Element("customMathEquations")
    for view in VIEWS:
        plots = []
        for joint in joints:
            names = [_name(curve, joint) for curve in view.curves]
            plots.append((joint, names))
            for curve, name in zip(view.curves, names):
                if curve.computed:
                    equations.append(_equation(curve, joint, name))
        _tab(tabs, view.title, plots, end)
    health = [("levels: 0 ok, 1 warn, 2 error", [diagnostic_series(robot, n, "level") for n in ALL_NODES])]
    health += [(key, [diagnostic_series(robot, "plant", key)]) for key in HEALTH]
    _tab(tabs, "Health", health, end)
    ET.SubElement(tabs, "currentTabIndex", index="0")
    ET.SubElement(root, "use_relative_time_offset", enabled="1")
    ET.SubElement(root, "streaming_buffer_size", value="60")
    ET.SubElement(root, "Plugins")
    root.append(equations)
    ET.indent(root, " ")
    return "<?xml version='1.0' encoding='UTF-8'?>\n" + ET.tostring(root, encoding="unicode") + "\n"


def _name(curve: Curve, joint: str) -> str:
    return f"{curve.label}, {joint}" if curve.computed else series(curve.topic, joint, curve.array)


def _tab(parent: ET.Element, title: str, plots: Sequence[tuple[str, list[str]]], end: float) -> None:
    tab = ET.SubElement(parent, "Tab", tab_name=title, containers="1")
    sizes = ";".join([f"{1 / len(plots):.6f}"] * len(plots))
    container = ET.SubElement(tab, "Container")
    splitter = ET.SubElement(container, "DockSplitter", orientation="-", count=str(len(plots)), sizes=sizes)
    for name, curves in plots:
        area = ET.SubElement(splitter, "DockArea", name=name)
        plot = ET.SubElement(
            area, "plot", mode="TimeSeries", style="Lines", line_width="1.0", flip_x="false", flip_y="false"
        )
        ET.SubElement(plot, "range", left="0.000000", right=f"{end:.6f}", bottom="-1.000000", top="1.000000")
        ET.SubElement(plot, "limitY")
        for k, curve in enumerate(curves):
            ET.SubElement(plot, "curve", name=curve, color=COLOURS[k % len(COLOURS)])


def _equation(curve: Curve, joint: str, name: str) -> ET.Element:
    """A curve that PlotJuggler computes from others."""
    snippet = ET.Element("snippet", name=name, language="lua")
    ET.SubElement(snippet, "global")
    ET.SubElement(snippet, "function").text = "return value - v1" if curve.less else "return -value"
    ET.SubElement(snippet, "linked_source").text = series(curve.topic, joint, curve.array)
    if curve.less:
        topic, array = curve.less
        ET.SubElement(ET.SubElement(snippet, "additional_sources"), "v1").text = series(topic, joint, array)
    return snippet


# Foxglove.


def message_path(topic: Topic, array: str, joint: int) -> str:
    """Foxglove's path of an array's entry."""
    return f"{absolute(topic)}.{array}[{joint}]"


def foxglove(joints: Sequence[str]) -> str:
    """Return a layout of Foxglove: a tab for each joint, with plots and alarms; diagnostics beside them.

    It cannot take one topic from another, nor turn a sign: position and desired position are in one plot,
    and the estimate is that of minus the disturbance.
    """
    panels: dict[str, Any] = {}
    tabs = []
    for k, joint in enumerate(joints):
        rows = []
        for view in VIEWS:
            curves = [curve for curve in view.curves if curve.less is None]
            drawn = [curve for curve in curves if curve.label not in STATES]
            if drawn:
                rows.append(_plot(panels, f"Plot!{view.title.lower()}{k + 1}", view.title, joint, k, drawn))
            if states := [curve for curve in curves if curve.label in STATES]:
                rows.append(f"StateTransitions!{view.title.lower()}{k + 1}")
                paths = [_path(curve, k) for curve in states]
                panels[rows[-1]] = {"paths": paths, "isSynced": True, "foxglovePanelTitle": f"Alarm, {joint}"}
        tabs.append({"title": joint, "layout": _split(rows, "column")})
    panels["Tab!joints"] = {"activeTabIdx": 0, "tabs": tabs}
    panels["DiagnosticSummary!health"] = {
        "topicToRender": absolute(DIAGNOSTICS),
        "minLevel": 0,
        "pinnedIds": [],
        "hardwareIdFilter": "",
        "sortByLevel": True,
    }
    panels["DiagnosticStatusPanel!node"] = {"topicToRender": absolute(DIAGNOSTICS)}
    panels["RawMessages!faults"] = {
        "topicPath": absolute(FAULTS),
        "diffEnabled": False,
        "diffMethod": "custom",
        "diffTopicPath": "",
        "showFullMessageForDiff": False,
    }
    beside = ["DiagnosticSummary!health", "DiagnosticStatusPanel!node", "RawMessages!faults"]
    layout = {
        "direction": "row",
        "first": "Tab!joints",
        "second": _split(beside, "column"),
        "splitPercentage": 70,
    }
    found = {
        "configById": panels,
        "globalVariables": {},
        "userNodes": {},
        "playbackConfig": {"speed": 1},
        "layout": layout,
    }
    return json.dumps(found, indent=1, ensure_ascii=False) + "\n"


def _path(curve: Curve, joint: int) -> dict[str, Any]:
    """By the time it was received: the stamps of a run begin at zero, far from the time of the recording."""
    return {
        "value": message_path(curve.topic, curve.array, joint),
        "label": f"estimate of {curve.label}" if curve.negative else curve.label,
        "enabled": True,
        "timestampMethod": "receiveTime",
    }


def _plot(
    panels: dict[str, Any], name: str, title: str, joint: str, number: int, curves: Sequence[Curve]
) -> str:
    panels[name] = {
        "paths": [_path(curve, number) for curve in curves],
        "showXAxisLabels": True,
        "showYAxisLabels": True,
        "showLegend": True,
        "legendDisplay": "floating",
        "showPlotValuesInLegend": True,
        "isSynced": True,
        "xAxisVal": "timestamp",
        "sidebarDimension": 240,
        "foxglovePanelTitle": f"{title}, {joint}",
    }
    return name


def _split(names: Sequence[str], direction: str) -> Any:
    """Panels beside each other, each of the same size."""
    if len(names) == 1:
        return names[0]
    rest = _split(names[1:], direction)
    return {"direction": direction, "first": names[0], "second": rest, "splitPercentage": 100 / len(names)}


def layouts(source: str = "paper") -> dict[str, str]:
    """Return the files: name and text.

    Args:
        source: scenario file, or name of a shipped scenario: its robot and its duration.
    """
    scenario = load(source)
    robot = scenario.robot
    return {
        PLOTJUGGLER: plotjuggler(robot.type_name, robot.joint_names, scenario.duration),
        FOXGLOVE: foxglove(robot.joint_names),
    }


def main() -> int:
    """Write or check the files."""
    parser = argparse.ArgumentParser(prog="tools/layouts.py", description=__doc__)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--scenario", default="paper", help="file or name; default: paper")
    parser.add_argument("--check", action="store_true", help="only tell whether the files are up to date")
    options = parser.parse_args()
    for name, text in layouts(options.scenario).items():
        file = options.folder / name
        if not options.check:
            file.parent.mkdir(parents=True, exist_ok=True)
            file.write_text(text, encoding="utf-8")
        elif not file.is_file() or file.read_text(encoding="utf-8") != text:
            print(f"{file} is out of date; run: python tools/layouts.py {options.folder}", file=sys.stderr)
            return 1
    return 0


if __name__ == "__main__":
    sys.exit(main())
