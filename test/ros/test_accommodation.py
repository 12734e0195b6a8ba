# SPDX-License-Identifier: Apache-2.0
"""Policies over the graph: decided from the detector's topic, and the run is that of the process."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

pytest.importorskip("rclpy", reason="ROS 2 (rclpy) is not installed")

from ftcm_core.recording.trace import Trace
from ftcm_core.references.vo_kang_cosine import VoKangCosine
from ftcm_core.scenario import Scenario, from_mapping, replace
from ftcm_core.simulation import simulate
from ftcm_ros.bags.reader import read_bag
from traces import same

pytestmark = pytest.mark.ros

SCENARIO = from_mapping(
    {
        "name": "accommodated", "robot": "puma560", "reference": "vo_kang_cosine", "controller": "ftcm",
        "observer": "do", "detector": "isolating", "duration": 2.5, "transient": 0.3,
        "initial_state": {"position": VoKangCosine().at(0.0, 3).position},
        "injection": {
            "disturbances": ["vo_kang_friction"],
            "faults": [
                {"type": "frozen_sensor", "start": 0.6, "joint": 2, "quantity": "position"},
                {"type": "loss_of_effectiveness", "start": 1.2, "joint": 3, "loss": 0.6},
            ],
        },
        "policies": [
            {"type": "replace_sensor", "verdict": "sensor"},
            {"type": "switch", "joint": 3, "observer": "eso",
             "controller": {"type": "ftcm", "upsilon1": 10.0}},
            {"type": "derate", "joint": 3, "hold": 0.1},
            {"type": "safe_stop", "joint": 3, "hold": 0.3, "ramp": 0.2},
        ],
    }
)  # fmt: skip


def recorded(experiment: Callable[..., Any], folder: Path, scenario: Scenario, *arguments: str) -> Trace:
    """Run it over the graph; return what the bag tells."""
    (folder / "active.yaml").write_text(scenario.to_yaml(), encoding="utf-8")
    run = experiment("active.yaml", *arguments)
    assert run.returncode == 0, run.stderr
    assert "| replace_sensor_0 " in run.stdout
    return read_bag(folder / "runs" / "test" / "bags" / "ftcm").trace


@pytest.mark.parametrize("nodes", ["--composed", "--no-composed"])
def test_every_policy_in_lockstep(experiment: Callable[..., Any], tmp_path: Path, nodes: str) -> None:
    """Decisions, changes and floats are those of the run in process; each policy makes a difference."""
    trace, expected = recorded(experiment, tmp_path, SCENARIO, nodes), simulate(SCENARIO)
    assert [d.number for d in expected.decisions] == [0, 1, 2, 3]
    assert trace.decisions == expected.decisions
    assert trace.changes == expected.changes
    assert [(c.kind, c.by) for c in trace.changes] == [("controller", "switch_0"), ("observer", "switch_0")]
    assert same(trace, expected)
    assert same(trace, simulate(SCENARIO, trace.changes)), "the policies do it again, once"
    for i in range(4):
        fewer = SCENARIO.policies[:i] + SCENARIO.policies[i + 1 :]
        assert not same(expected, simulate(replace(SCENARIO, policies=fewer)))
    (found,) = json.loads((tmp_path / "runs" / "test" / "summary.json").read_text())["results"]
    assert [d["tick"] for d in found["decisions"]] == [d.tick for d in expected.decisions]


def test_a_frozen_sensor_is_replaced_in_real_time(experiment: Callable[..., Any], tmp_path: Path) -> None:
    """Nothing waits for the detector there; a deadline missed more or less, the robot is not lost."""
    sensor_only = replace(SCENARIO, policies=SCENARIO.policies[:1], faults=SCENARIO.faults[:1], duration=4.0)
    trace = recorded(experiment, tmp_path, sensor_only, "--mode", "real_time")
    assert [(d.number, d.joint, d.verdict) for d in trace.decisions] == [(0, 2, "sensor")]
    passive = simulate(replace(sensor_only, policies=()))
    assert np.abs(trace.error[:, 1]).max() < 0.1 * np.abs(passive.error[:, 1]).max()
