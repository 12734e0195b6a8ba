# SPDX-License-Identifier: Apache-2.0
"""RViz: the description of a robot, the markers, what ``viewer.launch.py`` starts, and a real run."""

from __future__ import annotations

import importlib.util
import math
import signal
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

pytest.importorskip("rclpy", reason="ROS 2 (rclpy) is not installed")

from builtin_interfaces.msg import Time
from sensor_msgs.msg import JointState
from visualization_msgs.msg import Marker, MarkerArray

from ftcm_core.errors import FtcmError
from ftcm_core.robots import Robot
from ftcm_core.robots.puma560 import Puma560
from ftcm_core.robots.serial_chain import frames, places
from ftcm_core.robots.urdf import Urdf
from ftcm_core.robots.urdf_file import parse_arm
from ftcm_ros.run.launching import RVIZ, VIEWER_ARGUMENTS, shown_default, viewer
from ftcm_ros.run.view import Sample, View
from ftcm_ros.transport.topics import DETECTION, JOINT_STATES, TORQUES
from ftcm_ros.viewer import tables
from ftcm_ros.viewer.description import BASE, MARKERS, REFERENCE_STATES, STATES, WORLD, description
from ftcm_ros.viewer.markers import ARROW, Marks, colour
from plugins import ROBOTS
from urdf_arms import arm_text

pytestmark = pytest.mark.ros

FOLDER = Path(__file__).resolve().parents[2] / "src" / "ftcm_ros" / "launch"
HANG_SECONDS = 120.0
"""Generous ceiling that catches hangs."""


def any_arm(folder: Path) -> Urdf:
    """One with joints of all kinds, about any axes."""
    text = arm_text(["revolute", "prismatic", "fixed", "revolute", "continuous"], 3)
    (folder / "arm.urdf").write_text(text, encoding="utf-8")
    return Urdf(file=str(folder / "arm.urdf"))


# What robot_state_publisher gets.


@pytest.mark.parametrize("make", [lambda folder: Puma560(), any_arm], ids=["puma560", "any arm"])
def test_the_description_moves_as_the_robot(make: Callable[[Path], Robot], tmp_path: Path) -> None:
    robot = make(tmp_path)
    seen = description(robot)
    arm = parse_arm(seen.text.encode(), None)
    assert tuple(joint.name for joint in arm.joints) == robot.joint_names
    assert arm.joints[0].parent == seen.root == BASE
    for q in np.random.default_rng(1).uniform(-2.0, 2.0, (5, robot.joints)).tolist():
        theirs = frames(places(arm.links, tuple(q)), arm.base_turn, (0.0, 0.0, 0.0))
        ours = robot.forward_kinematics(tuple(q))
        for one, other in zip(ours[:-1], theirs):
            assert one.origin == pytest.approx(other.origin, abs=1e-12)
            assert one.z == pytest.approx(other.z, abs=1e-12)


def test_a_file_that_has_something_to_see_is_shown_as_it_is(tmp_path: Path) -> None:
    text = arm_text(["revolute"], 3).replace("</inertial></link>", '</inertial><visual name="v"/></link>')
    (tmp_path / "arm.urdf").write_text(text, encoding="utf-8")
    assert description(Urdf(file=str(tmp_path / "arm.urdf"))) == (text, "base")


def test_a_robot_that_does_not_say_where_its_joints_are_is_refused() -> None:
    for make in (description, Marks):
        with pytest.raises(FtcmError, match="robot 'pendulum' cannot be drawn; expected"):
            make(ROBOTS["pendulum"])


# What is started.


def given(**values: str) -> dict[str, str]:
    """The arguments of ``viewer.launch.py``, some of them set."""
    return {**{a.name: shown_default(a) for a in VIEWER_ARGUMENTS}, **values}


def test_two_arms_and_rviz_are_started() -> None:
    started = {process.name or process.executable: process for process in viewer(given())}
    assert [*started] == [
        "markers", "robot_state_publisher_of_robot", "place_of_robot",
        "robot_state_publisher_of_reference", "place_of_reference", "rviz2",
    ]  # fmt: skip
    solid, ghost = (started[f"robot_state_publisher_of_{name}"] for name in ("robot", "reference"))
    assert dict(solid.remappings)["joint_states"] == STATES
    assert dict(ghost.remappings)["joint_states"] == REFERENCE_STATES
    for process, prefix in ((solid, ""), (ghost, "reference/")):
        (values,) = process.parameters
        assert values == {"robot_description": description(Puma560()).text, "frame_prefix": prefix}
    for name, child in (("robot", "base"), ("reference", "reference/base")):
        assert started[f"place_of_{name}"].arguments == ("--frame-id", WORLD, "--child-frame-id", child)
    assert "rviz2" not in [process.executable for process in viewer(given(rviz="false"))]
    with pytest.raises(FtcmError, match="papr"):
        viewer(given(scenario="papr"))


def test_the_launch_file_starts_them() -> None:
    pytest.importorskip("launch_ros", reason="launch_ros is not installed: the package index has none")
    from launch import LaunchContext

    spec = importlib.util.spec_from_file_location("viewer_launch", FOLDER / "viewer.launch.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    context = LaunchContext()
    context.launch_configurations.update(given(rviz="false"))
    found = [(action.node_package, action.node_executable) for action in module.begin(context)]
    assert found == [(process.package, process.executable) for process in viewer(given(rviz="false"))]


def test_rviz_shows_what_is_published() -> None:
    shown = yaml.safe_load(RVIZ.read_text("utf-8"))["Visualization Manager"]
    assert shown["Global Options"]["Fixed Frame"] == WORLD
    displays = {display["Name"]: display for display in shown["Displays"]}
    topics = [dict(process.remappings).get("robot_description") for process in viewer(given())]
    for name, prefix in (("robot", ""), ("reference", "reference")):
        assert displays[name]["Description Topic"]["Value"].removeprefix("/") in topics
        assert displays[name]["TF Prefix"] == prefix
    (markers,) = [display["Topic"]["Value"] for display in displays.values() if "Topic" in display]
    assert markers == f"/{MARKERS}"


# Markers.


def test_markers_say_torques_faults_and_alarms() -> None:
    names, robot, view = Puma560.joint_names, Puma560(), View()
    q = (0.3, -0.5, 0.9)
    view.hear_sample(JOINT_STATES.name, 10**9, Sample(names, q, (), ()))
    view.hear_sample(TORQUES.name, 10**9, Sample(names, (), (), (-10.0, 50.0, 0.0)))
    view.hear_sample(DETECTION.name, 10**9, Sample(names, (0.0, 0.0, 1.0), (0.0, 0.0, 2.0), ()))
    view.hear_fault("one_0", 0.5, 2.0, 1)
    marks = Marks(robot)
    found = {(mark.ns, mark.id): mark for mark in marks.of(view, Time(sec=7))}
    assert len(found) == 9
    assert {(mark.header.frame_id, mark.header.stamp.sec) for mark in found.values()} == {(WORLD, 7)}
    at = robot.forward_kinematics(q)
    for j, sign in ((0, -1.0), (1, 1.0)):
        arrow = found["torque", j]
        start, end = (np.array([p.x, p.y, p.z]) for p in arrow.points)
        assert start == pytest.approx(np.array(at[j].origin))
        assert (end - start) / (ARROW * marks._shape.reach) == pytest.approx(sign * np.array(at[j].z))
    assert found["torque", 2].action == Marker.DELETE, "there is no torque"
    assert [found["text", j].text for j in range(3)] == [
        "joint1: -10 N·m", "joint2: 50 N·m", "joint3: 0 N·m\nsensor",
    ]  # fmt: skip
    states = [found["state", j] for j in range(3)]
    assert [state.action for state in states] == [Marker.ADD, Marker.DELETE, Marker.ADD]
    for state, shade in ((states[0], tables.FAULT), (states[2], tables.ALARM)):
        assert (state.color.r, state.color.g, state.color.b) == pytest.approx(colour(shade)[:3], abs=1e-6)
    view.hear_sample(TORQUES.name, 2 * 10**9, Sample(names, (), (), (-5.0, 50.0, 0.0)))
    start, end = marks.of(view, Time())[0].points
    length = math.dist((start.x, start.y, start.z), (end.x, end.y, end.z))
    assert length == pytest.approx(0.5 * ARROW * marks._shape.reach), "half of the largest so far"


@pytest.mark.slow
def test_of_a_run_that_is_on(live: Callable[..., Any], start: Callable[..., Any]) -> None:
    run = live(
        "paper", "--controllers", "ftcm", "--set", "duration=600", "--set", "injection.faults.0.start=0.1"
    )
    run.first_tick(("controller", "ftcm"), ("observer", "do"))
    process = start("viewer.markers")
    heard: dict[str, Any] = {}
    node = run.watcher.node
    for kind, name in ((JointState, STATES), (JointState, REFERENCE_STATES), (MarkerArray, MARKERS)):
        node.create_subscription(kind, name, lambda message, name=name: heard.__setitem__(name, message), 10)
    run.until(lambda: len(heard) == 3 and heard[MARKERS].markers, "what RViz shows")
    states, reference = heard[STATES], heard[REFERENCE_STATES]
    assert tuple(states.name) == tuple(reference.name) == Puma560.joint_names
    assert list(states.position) == pytest.approx(list(reference.position), abs=0.6), (
        "eq 44 starts 0.5 rad off"
    )
    run.until(
        lambda: [m.action for m in heard[MARKERS].markers if m.ns == "state"] == [Marker.ADD] * 3,
        "the fault of all joints",
    )
    now = node.get_clock().now().nanoseconds / 1e9
    assert abs(states.header.stamp.sec - now) < HANG_SECONDS, "robot_state_publisher's clock"
    process.send_signal(signal.SIGINT)
    _, err = process.communicate(timeout=HANG_SECONDS)
    assert (process.returncode, err) == (0, "")
    run.interrupt()
