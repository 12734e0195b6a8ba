# SPDX-License-Identifier: Apache-2.0
"""The detector node: its topic, its diagnostics, its parameters, and its place in an experiment."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

pytest.importorskip("rclpy", reason="ROS 2 (rclpy) is not installed")

from sensor_msgs.msg import JointState

from ftcm_core.scenario import load
from ftcm_core.simulation import simulate
from ftcm_ros.bags.reader import read_bag
from ftcm_ros.parameters.node_parameters import ALL_NODES
from ftcm_ros.transport.plane import qos
from ftcm_ros.transport.topics import DETECTION
from node_processes import node_pids
from traces import same

pytestmark = pytest.mark.ros

OVERRIDES = [
    "injection.faults.0.start=0.3",
    "detector={type: residual_threshold, threshold: 12}",
]


@pytest.mark.parametrize("nodes", ["--composed", "--no-composed"])
def test_alarms_are_published_told_and_recorded_and_the_threshold_is_changed(
    live: Callable[..., Any], watcher: Any, tmp_path: Path, nodes: str
) -> None:
    overrides = [*OVERRIDES, "duration=600"]
    run = live("paper", "--controllers", "ftcm", nodes, *(a for o in overrides for a in ("--set", o)))
    heard: list[JointState] = []
    watcher.node.create_subscription(JointState, DETECTION.name, heard.append, qos(DETECTION))
    run.first_tick(("controller", "ftcm"), ("detector", "residual_threshold"), ("observer", "do"))
    processes = {"composed", "recorder"} if nodes == "--composed" else set(ALL_NODES)
    assert set(node_pids(run.process.pid)) == processes
    ((taken, reason),) = watcher.set("detector", residual_threshold__threshold=-1.0)
    assert not taken
    assert "residual_threshold.threshold: -1 is out of range" in reason
    told = run.until(
        lambda: run.health["detector"] if run.health.get("detector", {}).get("alarms") else None, "an alarm"
    )
    assert int(told["ticks_with_alarm"]) > 0
    assert set(told["alarms"].split(", ")) <= {"joint1", "joint2", "joint3"}
    assert f"alarm: {told['alarms']}" in told["message"]
    run.change("detector", residual_threshold__threshold=[1000.0, 1000.0, 1000.0])
    run.until(lambda: run.health["detector"]["alarms"] == "", "an end of the alarms")
    run.interrupt()
    bag = read_bag(tmp_path / "runs" / "test" / "bags" / "ftcm")
    assert set(bag.nodes) == set(ALL_NODES)
    ((tick, kind, component),) = ((c.tick, c.kind, c.component) for c in bag.trace.changes)
    assert (kind, component.threshold) == ("detector", (1000.0,) * 3)
    whole = bag.trace.ticks - 1  # a plant that is stopped may have served some of its last measurement only
    as_far = load("paper", [*overrides, f"duration={whole * 1e-3:g}"])
    assert same(bag.trace, simulate(as_far, bag.trace.changes), slice(whole))
    assert bag.trace.alarm is not None
    assert bag.trace.residual is not None
    assert bag.trace.alarm[:tick].any()
    assert not bag.trace.alarm[tick:whole].any()
    assert len(heard) > 100
    for message in heard[:: len(heard) // 50]:
        row = (message.header.stamp.sec * 10**9 + message.header.stamp.nanosec) // 1_000_000
        if row >= whole:
            continue
        assert list(message.position) == bag.trace.alarm[row].tolist()
        assert list(message.effort) == bag.trace.residual[row].tolist()
        assert list(message.velocity) == bag.trace.verdict[row].tolist()
