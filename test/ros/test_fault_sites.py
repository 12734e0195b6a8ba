# SPDX-License-Identifier: Apache-2.0
"""A fault at every site, over the graph and in process."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

pytest.importorskip("rclpy", reason="ROS 2 (rclpy) is not installed")

from everything import EVERYTHING
from ftcm_core import compiled
from ftcm_core.scenario import Scenario, from_mapping, load
from ftcm_core.scenario.definition import replace
from ftcm_core.signals import COLUMNS
from ftcm_core.simulation import simulate
from ftcm_ros.bags.reader import read_bag
from traces import same

pytestmark = pytest.mark.ros

DROPPED = ("joint_torques", "joint_states", "disturbance_estimate", "disturbance")
FAULTS: list[dict[str, Any]] = [
    {"type": "vo_kang_fault", "start": 0.3},
    {"type": "loss_of_effectiveness", "start": 0.25, "loss": [0.0, 0.3, 0.2], "trigger": "condition",
     "trigger_signal": "torque", "trigger_joint": 2, "trigger_above": 50.0},
    {"type": "sensor_bias", "start": 0.2, "bias": 0.002, "joint": 2, "profile": "intermittent",
     "period": 0.01},
    {"type": "sensor_drift", "start": 0.2, "walk": 0.001, "drift": 0.001, "profile": "ramp"},
    {"type": "payload_pickup", "start": 0.5, "mass": 1.0, "lifetime": "timed", "duration": 0.1},
    *({"type": "dropped_messages", "start": 0.1, "topic": t, "probability": 0.05} for t in DROPPED),
]  # fmt: skip
FAULTY = {**EVERYTHING, "injection": {"disturbances": ["vo_kang_friction"], "faults": FAULTS}}


def over_the_graph(experiment: Callable[..., Any], folder: Path, scenario: Scenario, *arguments: str) -> Any:
    """Run it; return the bag."""
    (folder / "sites.yaml").write_text(scenario.to_yaml(), encoding="utf-8")
    run = experiment("sites.yaml", *arguments)
    assert run.returncode == 0, run.stderr
    bag = read_bag(folder / "runs" / "test" / "bags" / scenario.controller.type_name)
    assert bag.missing == {}
    assert bag.trace.scenario == scenario
    return bag


@pytest.mark.parametrize("nodes", ["--composed", "--no-composed"])
def test_a_fault_of_every_site_at_once(experiment: Callable[..., Any], tmp_path: Path, nodes: str) -> None:
    scenario = from_mapping(FAULTY)
    assert {fault.site for fault in scenario.faults} == {"actuator", "sensor", "dynamics", "communication"}
    bag = over_the_graph(experiment, tmp_path, scenario, nodes)
    expected = simulate(scenario)
    assert list(bag.trace.columns) == list(COLUMNS)
    assert same(bag.trace, expected)
    assert expected.alarm is not None
    assert 0 < expected.alarm.any(axis=1).sum() < expected.ticks
    summary = json.loads((tmp_path / "runs" / "test" / "summary.json").read_text())
    last = summary["timing"]["ftcm"]["nodes"]["detector"]  # the bag was closed before it
    assert int(last["ticks_with_alarm"]) == expected.alarm.any(axis=1).sum()
    assert int(last["ticks"]) == expected.ticks
    for i, fault in enumerate(scenario.faults):  # each of them has made a difference
        others = scenario.faults[:i] + scenario.faults[i + 1 :]
        assert not same(expected, simulate(replace(scenario, faults=others))), fault


def test_a_fault_of_every_site_in_real_time(experiment: Callable[..., Any], tmp_path: Path) -> None:
    """Composed, as is the default there: each acts when it is said to, whatever deadlines are missed."""
    faults = [
        {"type": "loss_of_effectiveness", "start": 0.25, "loss": 0.3},
        {"type": "sensor_bias", "start": 0.4, "bias": 0.05, "joint": 3},
        {"type": "vo_kang_fault", "start": 0.3},
        {"type": "dropped_messages", "start": 0.35, "topic": "disturbance_estimate", "probability": 0.5},
    ]
    scenario = from_mapping({**EVERYTHING, "sensor": "ideal", "injection": {"faults": faults}})
    assert {fault.site for fault in scenario.faults} == {"actuator", "sensor", "dynamics", "communication"}
    trace = over_the_graph(experiment, tmp_path, scenario, "--mode", "real_time").trace
    assert (trace.status, trace.ticks) == ("completed", scenario.last_tick + 1)
    assert trace.fault_intervals == simulate(scenario).fault_intervals
    assert trace.joint_torque is not None
    assert trace.measured_position is not None
    before, after = slice(None, 250), slice(402, None)
    assert (trace.joint_torque[before] == trace.effort[before]).all()
    assert (trace.joint_torque[after] != trace.effort[after]).any(axis=1).all()
    assert (trace.measured_position[:400] == trace.position[:400]).all()
    assert np.allclose(trace.measured_position[after] - trace.position[after], [0.0, 0.0, 0.05])
    assert not trace.disturbance[before].any()
    assert trace.disturbance[after].any()


@pytest.mark.slow
@pytest.mark.parametrize("nodes", ["--composed", pytest.param("--no-composed", marks=pytest.mark.nightly)])
def test_compiled_stages_give_the_compiled_run(
    experiment: Callable[..., Any], tmp_path: Path, nodes: str
) -> None:
    pytest.importorskip("numba")
    scenario = from_mapping(FAULTY)
    bag = over_the_graph(experiment, tmp_path, scenario, nodes, "--stages", "compiled", "--patience", "60")
    assert {bag.nodes[n]["stages"] for n in bag.nodes if n != "recorder"} == {"compiled"}
    assert same(bag.trace, compiled.simulate(scenario))


@pytest.mark.slow
@pytest.mark.parametrize(
    ("fault", "nodes"),
    [
        *(pytest.param(f, "--composed", id=f.get("topic", f["type"])) for f in FAULTS[1:]),
        *(
            pytest.param(f, "--no-composed", id=f"{f['type']}, processes")
            for f in FAULTS[1:]
            if f["type"] in ("loss_of_effectiveness", "payload_pickup") or f.get("topic") == "joint_torques"
        ),
    ],
)
def test_a_fault_by_itself(
    experiment: Callable[..., Any], tmp_path: Path, fault: dict[str, Any], nodes: str
) -> None:
    """With an ideal sensor and no detector, so that what the fault itself needs is not there by others."""
    scenario = from_mapping(
        {**FAULTY, "detector": None, "sensor": None, "injection": {"faults": [fault]}, "torque_delay": 0}
    )
    bag = over_the_graph(experiment, tmp_path, scenario, nodes)
    assert ("joint_torque" in bag.trace.columns) == (fault["type"] != "payload_pickup")
    assert same(bag.trace, simulate(scenario))
    assert not same(bag.trace, simulate(replace(scenario, faults=())))


def test_the_paper_shows_all_there_is_without_the_true_state(
    experiment: Callable[..., Any], tmp_path: Path
) -> None:
    scenario = load("paper", ["duration=0.2", "injection.faults.0.start=0.1"])
    bag = over_the_graph(experiment, tmp_path, scenario)
    assert set(bag.stamps) == {
        "joint_states", "disturbance_estimate", "joint_torques", "disturbance", "reference",
    }  # fmt: skip
    assert same(bag.trace, simulate(scenario))
