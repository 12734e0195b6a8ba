# SPDX-License-Identifier: Apache-2.0
"""The layouts of PlotJuggler and Foxglove name what there is, and have the structure that these tools write.

Neither tool is run here.
"""

from __future__ import annotations

import json
import re
import subprocess
import xml.etree.ElementTree as ET
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
import yaml

pytest.importorskip("rclpy", reason="ROS 2 (rclpy) is not installed")

import layouts
from ftcm_core.robots import Robot
from ftcm_core.scenario import load
from ftcm_core.signals import CHANNELS
from ftcm_ros.parameters.node_parameters import ALL_NODES
from ftcm_ros.transport.topics import TOPICS
from plugins import robots_known, scenario_mapping
from programs import program

FOLDER = Path(__file__).resolve().parents[2] / "config" / "layouts"
ARRAYS = ("position", "velocity", "effort")
FILLED = {
    (f"/{channel.topic}", array)
    for channel in CHANNELS
    for array, column in zip(ARRAYS, channel.columns)
    if column
}
"""Topic and array of every signal that is declared."""
ROBOT: Robot = load("paper").robot


def test_the_files_are_what_the_declarations_say() -> None:
    done = subprocess.run([*program("layouts.py"), "--check", str(FOLDER)], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    assert {path.name for path in FOLDER.iterdir()} == {*layouts.layouts()}


def test_a_file_that_is_not_is_noticed(tmp_path: Path) -> None:
    command = [*program("layouts.py"), str(tmp_path)]
    assert subprocess.run(command).returncode == 0
    (tmp_path / layouts.FOXGLOVE).write_text("{}\n", encoding="utf-8")
    done = subprocess.run([*command, "--check"], capture_output=True, text=True)
    assert done.returncode == 1
    assert "foxglove.json is out of date" in done.stderr


# PlotJuggler.


@pytest.fixture(scope="module")
def root() -> ET.Element:
    return ET.parse(FOLDER / layouts.PLOTJUGGLER).getroot()


def snippets(root: ET.Element) -> dict[str, ET.Element]:
    """Computed curves by name."""
    found = root.find("customMathEquations")
    assert found is not None
    return {one.attrib["name"]: one for one in found}


def sources(root: ET.Element) -> Iterator[str]:
    """Every series of the data that is drawn, or computed with."""
    computed = snippets(root)
    for curve in root.iter("curve"):
        if curve.attrib["name"] not in computed:
            yield curve.attrib["name"]
    for snippet in computed.values():
        yield snippet.findtext("linked_source") or ""
        for more in snippet.iterfind("additional_sources/*"):
            yield more.text or ""


def test_every_series_is_an_array_that_is_declared_or_a_value_of_the_diagnostics(root: ET.Element) -> None:
    seen = set()
    for name in sources(root):
        if name.startswith("/diagnostics/"):
            ((robot, node, key),) = re.findall(r"^/diagnostics/(\w+)/(\w+): tick/(\w+)$", name)
            assert (robot, node in ALL_NODES) == (ROBOT.type_name, True)
            assert key == "level" or (node == "plant" and key in layouts.HEALTH)
            continue
        topic, joint, array = name.rsplit("/", 2)
        assert (topic, array) in FILLED
        assert joint in ROBOT.joint_names
        seen.add(topic)
    assert seen == {
        "/joint_states", "/reference", "/joint_torques", "/disturbance", "/disturbance_estimate", "/detection"
    }  # fmt: skip


def test_every_computed_curve_is_drawn_and_has_what_plotjuggler_reads_of_it(root: ET.Element) -> None:
    drawn = {curve.attrib["name"] for curve in root.iter("curve")}
    computed = snippets(root)
    assert {*computed} <= drawn
    for snippet in computed.values():
        assert {"global", "function", "linked_source"} <= {one.tag for one in snippet}
        inputs = [one.tag for one in snippet.iterfind("additional_sources/*")]
        assert inputs == [f"v{k + 1}" for k in range(len(inputs))]
        used = re.findall(r"\bv\d\b", snippet.findtext("function") or "")
        assert sorted(used) == inputs, "the function takes what it is given"


def test_a_tracking_error_for_each_joint(root: ET.Element) -> None:
    for joint in ROBOT.joint_names:
        one = snippets(root)[f"tracking error, rad, {joint}"]
        assert one.findtext("linked_source") == f"/joint_states/{joint}/position"
        assert one.findtext("additional_sources/v1") == f"/reference/{joint}/position"
        assert one.findtext("function") == "return value - v1"


def test_tabs_containers_splitters_areas_and_plots_as_plotjuggler_nests_them(root: ET.Element) -> None:
    assert root.tag == "root"
    assert [one.tag for one in root] == [
        "tabbed_widget", "use_relative_time_offset", "streaming_buffer_size", "Plugins", "customMathEquations"
    ]  # fmt: skip
    (window,) = root.iterfind("tabbed_widget")
    assert window.attrib == {"parent": "main_window", "name": "Main Window"}
    *tabs, current = window
    assert (current.tag, current.attrib) == ("currentTabIndex", {"index": "0"})
    for tab in tabs:
        (container,) = tab
        (splitter,) = container
        tags = [one.tag for one in (tab, container, splitter)]
        assert tags == ["Tab", "Container", "DockSplitter"]
        assert tab.attrib["containers"] == "1"
        assert splitter.attrib["orientation"] in "|-"
        sizes = [float(size) for size in splitter.attrib["sizes"].split(";")]
        assert int(splitter.attrib["count"]) == len(sizes) == len(splitter)
        assert sum(sizes) == pytest.approx(1.0, abs=1e-5)
        for area in splitter:
            (plot,) = area
            assert (area.tag, plot.tag) == ("DockArea", "plot")
            assert plot.attrib["mode"] == "TimeSeries"
            assert [one.tag for one in plot][:2] == ["range", "limitY"]
            assert all(re.fullmatch("#[0-9a-f]{6}", one.attrib["color"]) for one in plot.iterfind("curve"))


# Foxglove.


@pytest.fixture(scope="module")
def layout() -> dict[str, Any]:
    found: dict[str, Any] = json.loads((FOLDER / layouts.FOXGLOVE).read_text("utf-8"))
    return found


def leaves(node: Any) -> Iterator[str]:
    """Panels of a tree of splits."""
    if isinstance(node, str):
        yield node
        return
    assert node["direction"] in ("row", "column")
    assert 0.0 < node["splitPercentage"] < 100.0
    yield from leaves(node["first"])
    yield from leaves(node["second"])


def test_every_panel_is_shown_once_and_has_its_settings(layout: dict[str, Any]) -> None:
    assert {*layout} == {"configById", "globalVariables", "userNodes", "playbackConfig", "layout"}
    panels = layout["configById"]
    shown = [*leaves(layout["layout"])]
    for tab in panels["Tab!joints"]["tabs"]:
        shown += leaves(tab["layout"])
    assert sorted(shown) == sorted(panels)
    kinds = {name.partition("!")[0] for name in panels}
    assert kinds == {
        "Plot", "StateTransitions", "Tab", "DiagnosticSummary", "DiagnosticStatusPanel", "RawMessages"
    }  # fmt: skip


def test_every_message_path_is_an_array_that_is_declared(layout: dict[str, Any]) -> None:
    names = {"/" + topic.name.removeprefix("/"): topic for topic in TOPICS}
    seen = set()
    for name, panel in layout["configById"].items():
        for path in panel.get("paths", []):
            ((topic, array, number),) = re.findall(r"^(/\w+)\.(\w+)\[(\d+)\]$", path["value"])
            assert (topic, array) in FILLED
            assert int(number) < len(ROBOT.joint_names)
            assert panel["foxglovePanelTitle"].endswith(ROBOT.joint_names[int(number)])
            seen.add((topic, array))
        for key in ("topicToRender", "topicPath"):
            if key in panel:
                assert names[panel[key]].type == "diagnostic_msgs/msg/DiagnosticArray", name
    drawn = {(layouts.absolute(c.topic), c.array) for v in layouts.VIEWS for c in v.curves if not c.less}
    assert seen == drawn


def test_times_are_those_of_the_recording(layout: dict[str, Any]) -> None:
    """A stamp of a run is some seconds; Foxglove would draw it decades before the recording began."""
    methods = {p["timestampMethod"] for c in layout["configById"].values() for p in c.get("paths", [])}
    assert methods == {"receiveTime"}


# Both.


def test_another_robot_has_layouts_of_its_own(tmp_path: Path) -> None:
    (tmp_path / "six.yaml").write_text(yaml.safe_dump(scenario_mapping("serial_arm")), encoding="utf-8")
    with robots_known():
        made = layouts.layouts(str(tmp_path / "six.yaml"))
    joints = [f"axis{k}" for k in range(1, 7)]
    assert made[layouts.PLOTJUGGLER].count("<snippet ") == 2 * len(joints)
    tabs = json.loads(made[layouts.FOXGLOVE])["configById"]["Tab!joints"]["tabs"]
    assert [tab["title"] for tab in tabs] == joints
