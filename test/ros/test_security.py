# SPDX-License-Identifier: Apache-2.0
"""SROS2: the policy fits what the nodes do, and a run with it where the middleware has security."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

pytest.importorskip("rclpy", reason="ROS 2 (rclpy) is not installed")

from ftcm_core.scenario import load
from ftcm_core.simulation import simulate
from ftcm_ros.bags.reader import read_bag
from ftcm_ros.parameters.node_parameters import ALL_NODES
from programs import program
from sros_policy import rules
from traces import same

pytestmark = pytest.mark.ros

Start = Callable[..., "subprocess.Popen[str]"]
ROOT = Path(__file__).resolve().parents[2]
POLICY = ROOT / "config" / "security" / "policy.xml"
WAIT_SECONDS = 60.0
"""Generous ceiling for what is to happen."""
ONLY_WITH_AN_IDEAL_SENSOR = "/joint_states"
"""What the injector subscribes in place of true_state."""
ONLY_WITH_A_REFERENCE_TOPIC = "/joint_trajectory"
ONLY_WITH_A_COMMAND_INTERFACE = "/effort_controller/commands"
"""What the controller publishes for a robot, and the plant subscribes in place of one."""


def test_the_policy_is_up_to_date() -> None:
    command = [*program("sros_policy.py"), "--check", str(POLICY.parent)]
    run = subprocess.run(command, capture_output=True, text=True, check=False)
    assert run.returncode == 0, run.stderr


def test_the_policy_allows_what_the_nodes_have_and_no_more(
    start: Start, watcher: Any, tmp_path: Path
) -> None:
    faults = (  # at every place, to be armed by hand
        "[{type: sensor_bias, trigger: hand}, {type: vo_kang_fault, trigger: hand}, "
        "{type: dropped_messages, topic: disturbance_estimate, trigger: hand}]"
    )
    more = ["detector=residual_threshold", f"injection.faults={faults}", "policies=[safe_stop]"]
    scenario = load("paper", ["sensor={type: encoder}", *more])
    (tmp_path / "every.yaml").write_text(scenario.to_yaml(), encoding="utf-8")
    for name in ALL_NODES:
        start(f"nodes.{name}", "--ros-args", "-p", "scenario:=every.yaml")

    def has(name: str) -> dict[tuple[str, str], list[str]]:
        asked = {
            ("topics", "publish"): watcher.node.get_publisher_names_and_types_by_node,
            ("topics", "subscribe"): watcher.node.get_subscriber_names_and_types_by_node,
            ("services", "reply"): watcher.node.get_service_names_and_types_by_node,
            ("services", "request"): watcher.node.get_client_names_and_types_by_node,
        }
        names = {what: [found for found, _ in ask(name, "/")] for what, ask in asked.items()}
        return {what: sorted({pattern(found) for found in them}) for what, them in names.items()}

    def pattern(name: str) -> str:
        return "/injector/faults/*" if name.startswith("/injector/faults/") else name

    expected = {name: rules(name) for name in ALL_NODES}
    expected["injector"]["topics", "subscribe"].remove(ONLY_WITH_AN_IDEAL_SENSOR)
    expected["controller"]["topics", "publish"].remove(ONLY_WITH_A_COMMAND_INTERFACE)
    expected["controller"]["topics", "subscribe"].remove(ONLY_WITH_A_REFERENCE_TOPIC)
    expected["plant"]["topics", "subscribe"].remove(ONLY_WITH_A_COMMAND_INTERFACE)
    end = time.monotonic() + WAIT_SECONDS
    while time.monotonic() < end:
        watcher.executor.spin_once(timeout_sec=0.05)
        present = set(ALL_NODES) <= set(watcher.node.get_node_names())
        if present and (found := {name: has(name) for name in ALL_NODES}) == expected:
            return
    assert present
    assert found == expected


@pytest.mark.parametrize("module", ["nodes.plant", "nodes.composed", "experiment"])
@pytest.mark.parametrize("keystore", ["missing", "empty"])
def test_security_that_cannot_be_had_is_one_line(
    start: Start, domain: int, monkeypatch: pytest.MonkeyPatch, tmp_path: Path, module: str, keystore: str
) -> None:
    (tmp_path / "empty" / "enclaves").mkdir(parents=True)
    monkeypatch.setenv("ROS_SECURITY_ENABLE", "true")
    monkeypatch.setenv("ROS_SECURITY_KEYSTORE", str(tmp_path / keystore))
    process = start(module)
    out, err = process.communicate(timeout=60)
    assert process.returncode == 2, err
    assert "Traceback" not in out + err
    (line,) = [x for x in err.splitlines() if "error" in x]
    assert "cannot join the ROS graph" in line
    assert "docs/security.md" in line


@pytest.fixture
def keystore(tmp_path: Path, domain: int, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A keystore made by the documented command, in force for what is started from here on."""
    probe = tmp_path / "probe"
    (probe / "enclaves").mkdir(parents=True)
    monkeypatch.setenv("ROS_SECURITY_ENABLE", "true")
    monkeypatch.setenv("ROS_SECURITY_STRATEGY", "Enforce")
    monkeypatch.setenv("ROS_SECURITY_KEYSTORE", str(probe))
    join = "import rclpy; rclpy.init(); rclpy.create_node('probe')"
    run = subprocess.run([sys.executable, "-c", join], capture_output=True, text=True, check=False)
    if "doesn't have the security libraries" in run.stderr:
        pytest.skip("the middleware here was built without security")
    if (
        shutil.which("ros2") is None
        or subprocess.run(["ros2", "security", "-h"], capture_output=True, check=False).returncode
    ):
        pytest.skip("no `ros2 security` here (package sros2)")
    store = tmp_path / "keystore"
    subprocess.run(
        ["ros2", "security", "generate_artifacts", "-k", str(store), "-p", str(POLICY)],
        check=True, env={k: v for k, v in os.environ.items() if not k.startswith("ROS_SECURITY")},
    )  # fmt: skip
    monkeypatch.setenv("ROS_SECURITY_KEYSTORE", str(store))
    return store


@pytest.mark.slow
def test_a_secured_run_equals_the_in_process_run(
    keystore: Path, domain: int, experiment: Any, tmp_path: Path
) -> None:
    run = experiment("paper", "--controllers", "ftcm", "--set", "duration=0.5", "--domain-id", str(domain))
    assert run.returncode == 0, run.stderr
    bag = read_bag(tmp_path / "runs" / "test" / "bags" / "ftcm")
    assert bag.missing == {}
    again = simulate(load("paper", ["duration=0.5"], controller="ftcm"))
    assert same(bag.trace, again)


INTRUDER = """
import sys, time
import rclpy
from sensor_msgs.msg import JointState
rclpy.init()
node = rclpy.create_node(sys.argv[1])
try:
    publisher = node.create_publisher(JointState, "joint_torques", 10)
except Exception:
    sys.exit("refused")
end = time.monotonic() + float(sys.argv[2])
while not publisher.get_subscription_count() and time.monotonic() < end:
    time.sleep(0.05)
print(publisher.get_subscription_count(), "subscribers", file=sys.stderr)
"""
"""Tries to publish torques under a node's name, for some seconds."""


@pytest.mark.slow
def test_who_has_no_right_to_cannot_publish_torques(keystore: Path, start: Start) -> None:
    start("nodes.plant", "--ros-args", "--enclave", "/ftcm/plant")

    def torques_from(name: str, seconds: float, **variables: str) -> str:
        run = subprocess.run(
            [sys.executable, "-c", INTRUDER, name, str(seconds), "--ros-args", "--enclave", f"/ftcm/{name}"],
            env={**os.environ, **variables}, capture_output=True, text=True, check=False, timeout=120,
        )  # fmt: skip
        return run.stderr.strip().splitlines()[-1]

    assert torques_from("controller", WAIT_SECONDS) == "1 subscribers"
    assert torques_from("controller", 5.0, ROS_SECURITY_ENABLE="false") == "0 subscribers"
    assert torques_from("observer", 5.0) == "refused"
