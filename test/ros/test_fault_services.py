# SPDX-License-Identifier: Apache-2.0
"""Faults armed and cleared while the graph runs, through the injector's services; ground truth in the bag."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

rclpy = pytest.importorskip("rclpy", reason="ROS 2 (rclpy) is not installed")

from std_srvs.srv import Trigger  # noqa: E402

from ftcm_core.faults.timing import NEVER  # noqa: E402
from ftcm_core.scenario import load, replace  # noqa: E402
from ftcm_core.simulation import simulate  # noqa: E402
from ftcm_ros.bags.reader import read_bag  # noqa: E402
from traces import same  # noqa: E402

pytestmark = pytest.mark.ros

FAULTS = [
    "{type: sensor_bias, trigger: hand, bias: 0.005, joint: 2}",
    "{type: vo_kang_fault, trigger: hand}",
    "{type: dropped_messages, trigger: hand, topic: disturbance_estimate, probability: 0.5}",
    "{type: loss_of_effectiveness, joint: 3, loss: 0.5, start: 0.05, trigger: condition, "
    "trigger_signal: speed, trigger_above: 0.3}",
    "{type: payload_pickup, start: 0.5, lifetime: until_cleared}",
]
LABELS = (
    "sensor_bias_0", "vo_kang_fault_0", "dropped_messages_0", "loss_of_effectiveness_0", "payload_pickup_0",
)  # fmt: skip


@pytest.mark.parametrize("nodes", ["--composed", "--no-composed"])
def test_faults_by_hand_over_the_graph(
    live: Callable[..., Any], watcher: Any, tmp_path: Path, nodes: str
) -> None:
    """At every place: the injector, the plant, the controller. The bag gives the run again, bit for bit."""
    scenario = load("paper", ["duration=500", f"injection.faults=[{', '.join(FAULTS)}]"])
    (tmp_path / "hand.yaml").write_text(scenario.to_yaml(), encoding="utf-8")

    def call(name: str) -> tuple[bool, str]:
        answer = watcher.call(Trigger, f"/injector/faults/{name}", Trigger.Request())
        return answer.success, answer.message

    def listed(label: str) -> str:
        lines = {line.partition(":")[0]: line for line in call("list")[1].splitlines()}
        assert tuple(lines) == LABELS
        return str(lines[label])

    run = live("hand.yaml", "--mode", "lockstep", "--controllers", "ftcm", nodes)
    run.until(lambda: int(run.health.get("plant", {}).get("tick", 0)) > 600, "ticks")
    assert (
        listed("sensor_bias_0") == "sensor_bias_0: sensor, joint 2; trigger hand, lifetime permanent; waits"
    )
    assert "acts from t = 0.5 s" in listed("payload_pickup_0")
    refused, reason = call("loss_of_effectiveness_0/clear")
    assert not refused
    assert (
        "trigger condition and lifetime permanent; expected trigger: hand or lifetime: until_cleared"
        in reason
    )
    assert call("payload_pickup_0/arm")[0], "one that has begun may be armed again"
    for label in LABELS[:3]:
        assert call(f"{label}/arm")[0]
        run.until(lambda label=label: "acts" in listed(label), f"{label} acts")  # type: ignore[misc]
    for label in ("payload_pickup_0", "sensor_bias_0"):
        assert call(f"{label}/clear")[0]
        run.until(lambda label=label: " to " in listed(label), f"{label} ends")  # type: ignore[misc]
    run.interrupt()
    bag = read_bag(tmp_path / "runs" / "test" / "bags" / "ftcm")
    assert [(c.kind, c.component.number, c.component.action) for c in bag.trace.changes] == [
        ("fault", 4, "arm"), ("fault", 0, "arm"), ("fault", 1, "arm"), ("fault", 2, "arm"),
        ("fault", 4, "clear"), ("fault", 0, "clear"),
    ]  # fmt: skip
    whole = slice(bag.trace.ticks - 2)  # the last tick may have been cut
    as_far = replace(scenario, duration=(bag.trace.ticks - 1) * scenario.dt)
    again = simulate(as_far, bag.trace.changes)
    assert same(again, bag.trace, whole)
    assert again.fault_intervals == bag.trace.fault_intervals
    ends = {i.number: i.end for i in bag.trace.fault_intervals}
    assert [ends[n] < NEVER for n in range(5)] == [True, False, False, False, True]
    assert not same(again, simulate(replace(as_far, faults=())), whole)


def test_a_run_without_faults_has_no_such_services(live: Callable[..., Any], watcher: Any) -> None:
    """Nor the topics of orders."""
    run = live("paper", "--controllers", "ftcm", "--set", "injection.faults=[]", "--set", "duration=20")
    run.until(lambda: int(run.health.get("plant", {}).get("tick", 0)), "ticks")
    names = [name for name, _ in watcher.node.get_service_names_and_types()]
    assert "/injector/get_parameters" in names
    assert not [name for name in names if "/faults/" in name]
    run.interrupt()
