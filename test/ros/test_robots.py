# SPDX-License-Identifier: Apache-2.0
"""Robots of one, two and six joints over the graph, from a plug-in file."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

pytest.importorskip("rclpy", reason="ROS 2 (rclpy) is not installed")

from ftcm_core.registry import components
from ftcm_core.scenario.definition import replace
from ftcm_core.simulation import simulate
from ftcm_ros.bags.reader import read_bag
from plugins import GAINS, ROBOTS, ROBOTS_FILE, robots_known, scenario_mapping
from traces import same
from urdf_arms import arm_text

pytestmark = pytest.mark.ros

PLUGIN = ("--plugin", str(ROBOTS_FILE))


def written(folder: Path, robot: str, **more: Any) -> str:
    """File with a scenario of a robot; JSON is YAML."""
    mapping = scenario_mapping(robot, name="robot", **more)
    (folder / "robot.yaml").write_text(json.dumps(mapping), encoding="utf-8")
    return "robot.yaml"


@pytest.mark.parametrize(("robot", "joints"), [("pendulum", 1), ("planar_arm", 2), ("serial_arm", 6)])
def test_any_number_of_joints_over_the_graph(
    experiment: Callable[..., Any], tmp_path: Path, robot: str, joints: int
) -> None:
    run = experiment(written(tmp_path, robot, duration=0.5), *PLUGIN)
    assert run.returncode == 0, run.stderr
    with robots_known():
        bag = read_bag(tmp_path / "runs" / "test" / "bags" / "ftcm")
        assert bag.missing == {}
        assert bag.trace.joint_names == ROBOTS[robot].joint_names
        assert bag.trace.position.shape == (501, joints)
        assert abs(bag.trace.disturbance_estimate[-1]).max() > 0.0
        assert same(bag.trace, simulate(bag.trace.scenario))


def test_an_arm_of_a_urdf_file_over_the_graph(experiment: Callable[..., Any], tmp_path: Path) -> None:
    file = tmp_path / "arms" / "arm.urdf"
    file.parent.mkdir()
    file.write_text(arm_text(["revolute", "prismatic", "continuous", "revolute"], 7), encoding="utf-8")
    robot = {"type": "urdf", "file": "arms/arm.urdf", "motor_inertia": 0.5}
    data = {**scenario_mapping("urdf", duration=0.5), "robot": robot}
    (tmp_path / "robot.yaml").write_text(json.dumps(data), encoding="utf-8")
    run = experiment("robot.yaml")
    assert run.returncode == 0, run.stderr
    bag = read_bag(tmp_path / "runs" / "test" / "bags" / "ftcm")
    assert bag.trace.joint_names == ("j1", "j2", "j3", "j4")
    assert f"robot {file}" in json.loads(bag.metadata["provenance"])
    assert same(bag.trace, simulate(bag.trace.scenario))


def test_every_law_and_observer_is_swapped_in_while_six_joints_move(
    live: Callable[..., Any], watcher: Any, tmp_path: Path
) -> None:
    run = live(written(tmp_path, "serial_arm", duration=600), *PLUGIN)
    run.first_tick(("controller", "ftcm"), ("observer", "do"))
    ((taken, reason),) = watcher.set("controller", controller="pid")
    assert not taken
    assert len(reason.splitlines()) == 1
    assert reason.startswith("pid.kp: ")
    assert reason.endswith("has 3 entries; expected one per joint (6)")
    for law, gains in GAINS.items():
        for name, value in gains.items():
            assert watcher.set("controller", **{f"{law}__{name}": value}) == [(True, "")]
    laws = [name for name in components("controller") if name != "ftcm"]
    assert "pid" in laws
    observers = [name for name in components("observer") if name != "do"]
    for law in laws:
        run.change("controller", controller=law)
    for observer in (*observers, "do"):
        run.change("observer", observer=observer)
    run.change("controller", controller="ftcm")
    run.interrupt()
    with robots_known():
        trace = read_bag(tmp_path / "runs" / "test" / "bags" / "ftcm").trace
        kinds = [(c.kind, c.component.type_name) for c in trace.changes]
        assert kinds == [
            *(("controller", law) for law in laws),
            *(("observer", name) for name in (*observers, "do")),
            ("controller", "ftcm"),
        ]
        assert all(0 < a.tick <= b.tick for a, b in zip(trace.changes, trace.changes[1:]))
        # A plant that is stopped may have served some of its last measurement only.
        whole = slice(trace.ticks - 1)
        assert trace.changes[-1].tick < trace.ticks - 1
        assert trace.scenario is not None
        as_far = replace(trace.scenario, duration=(trace.ticks - 1) * trace.dt)
        assert same(trace, simulate(as_far, trace.changes), whole)


@pytest.mark.parametrize("stages", ["plain", pytest.param("compiled", marks=pytest.mark.slow)])
def test_a_plant_of_another_library_over_the_graph(
    experiment: Callable[..., Any], tmp_path: Path, stages: str
) -> None:
    """MuJoCo moves the robot; the run is that in process, and proved by replay. The rest may be compiled."""
    pytest.importorskip("mujoco", reason="the plant is MuJoCo's (pip install mujoco)")
    run = experiment(
        "paper", "--controllers", "ftcm", "--replay", "--stages", stages, "--set", "duration=2",
        "--set", "plant.type=mujoco",
        "--set", "robot={type: urdf, motor_inertia: [1.14, 4.71, 0.83]}",
        "--set", "injection.faults.0.start=1",
    )  # fmt: skip
    assert run.returncode == 0, run.stderr
    bag = read_bag(tmp_path / "runs" / "test" / "bags" / "ftcm")
    assert bag.trace.scenario.plant.type_name == "mujoco"
    assert same(bag.trace, simulate(bag.trace.scenario)) or stages == "compiled"
    summary = json.loads((tmp_path / "runs" / "test" / "summary.json").read_text(encoding="utf-8"))
    nodes = summary["timing"]["ftcm"]["nodes"]
    assert nodes["plant"]["stages"] == "plain"
    assert nodes["observer"]["stages"] == stages
    assert "equal, float for float" in run.stdout
