# SPDX-License-Identifier: Apache-2.0
"""Nodes of one process: what they hand over, and that they are the nodes that they are by themselves.

Whole runs with composed nodes are beside those with processes: faults of every site, a detector, swaps,
failing nodes, real time, and a node that stays outside.
"""

from __future__ import annotations

import signal
import subprocess
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

pytest.importorskip("rclpy", reason="ROS 2 (rclpy) is not installed")

from diagnostic_msgs.msg import DiagnosticArray
from lifecycle_msgs.msg import State, Transition
from lifecycle_msgs.srv import ChangeState, GetState
from sensor_msgs.msg import JointState

from ftcm_core.scenario import load
from ftcm_ros.parameters.node_parameters import NODES
from ftcm_ros.transport.codec import JointSample, JointStateCodec
from ftcm_ros.transport.composed import Composition, _Outlet
from ftcm_ros.transport.topics import DISTURBANCE, ESTIMATE, JOINT_STATES, REFERENCE, TORQUES, Topic

Start = Callable[..., "subprocess.Popen[str]"]
CODEC = JointStateCodec(("joint1", "joint2"))
LAYOUTS = {JOINT_STATES: CODEC.state, REFERENCE: CODEC.motion}


class Chain:
    """A tick of a composition without ROS: what happens, in order."""

    def __init__(self, *names: str) -> None:
        self.log: list[str] = []
        self.composition = Composition()
        self.composition.names.extend(names)
        self.published: dict[str, bytes] = {}

    def outlet(self, node: str, topic: Topic) -> _Outlet:
        def publish(data: bytes) -> None:
            self.log.append(f"{topic.name} published")
            self.published[topic.name] = data

        readers = tuple(name for name in topic.subscribers if name not in ("recorder", "detector"))
        return _Outlet(node, topic, readers, LAYOUTS.get(topic, CODEC.torque), publish)

    def relay(self, node: str, source: Topic, *targets: Topic) -> None:
        """A node that answers a message with others."""
        outlets = [self.outlet(node, target) for target in targets]

        def take(sample: JointSample) -> None:
            self.log.append(f"{node} takes {source.name}")
            for outlet in outlets:
                self.composition.send(outlet, outlet.layout.sample(sample.time_ns, *[(1.0, 2.0)] * 2))

        self.composition.read(node, source, take)

    def begin(self) -> None:
        """The plant sends a measurement."""
        sample = CODEC.state.sample(0, (0.5, -0.0), (1e-300, 3.0), (1.0, 2.0))
        self.composition.send(self.outlet("plant", JOINT_STATES), sample)


def test_a_tick_is_handed_over_in_its_order_and_published_after_it() -> None:
    chain = Chain("plant", "observer", "controller", "injector")
    chain.relay("observer", JOINT_STATES, ESTIMATE)
    chain.relay("injector", JOINT_STATES)
    chain.relay("controller", ESTIMATE, TORQUES, REFERENCE)
    chain.relay("injector", TORQUES, DISTURBANCE)
    chain.relay("plant", DISTURBANCE)
    chain.begin()
    assert chain.log == [
        "observer takes joint_states", "injector takes joint_states", "controller takes disturbance_estimate",
        "injector takes joint_torques", "plant takes disturbance",
        "joint_states published", "disturbance_estimate published", "joint_torques published",
        "reference published", "disturbance published",
    ]  # fmt: skip
    assert CODEC.decode(chain.published["joint_states"]) == (0, (0.5, -0.0), (1e-300, 3.0), (1.0, 2.0))
    assert CODEC.decode(chain.published["reference"]) == (0, (1.0, 2.0), (1.0, 2.0), ())
    assert CODEC.decode(chain.published["joint_torques"]) == (0, (), (), (1.0, 2.0))


def test_what_another_process_answers_is_published_first() -> None:
    chain = Chain("plant", "observer", "injector")
    chain.relay("observer", JOINT_STATES, ESTIMATE)
    chain.begin()
    assert chain.log == [
        "joint_states published", "observer takes joint_states", "disturbance_estimate published",
    ]  # fmt: skip


def test_a_node_that_fails_is_named_and_what_was_sent_is_published() -> None:
    chain = Chain("plant", "observer", "controller", "injector")
    chain.relay("observer", JOINT_STATES, ESTIMATE)

    def fail(sample: JointSample) -> None:
        raise RuntimeError("in the law")

    chain.composition.read("controller", ESTIMATE, fail)
    with pytest.raises(RuntimeError, match="in the law"):
        chain.begin()
    assert chain.composition.working == "controller"
    assert chain.log[1:] == ["joint_states published", "disturbance_estimate published"]


@pytest.mark.parametrize("layout", CODEC.layouts, ids=lambda layout: str(layout.filled))
def test_what_is_handed_over_is_what_a_message_would_decode_to(layout: Any) -> None:
    vectors = [(1.5, -2.5)] * sum(layout.filled)
    assert layout.sample(7, *vectors) == layout.decode(layout.encode(7, *vectors))


# Real processes.

TICK_NODES = tuple(name for name in NODES if name != "recorder")


def state_of(watcher: Any, name: str) -> int:
    """State of a managed node."""
    return int(watcher.call(GetState, f"/{name}/get_state", GetState.Request()).current_state.id)


@pytest.fixture
def health(watcher: Any) -> dict[str, dict[str, str]]:
    """The newest diagnostics of each node."""
    found: dict[str, dict[str, str]] = {}

    def keep(message: DiagnosticArray) -> None:
        for status in message.status:
            values = {v.key: v.value for v in status.values}
            found[status.name.partition(":")[0]] = {"message": status.message, **values}

    watcher.node.create_subscription(DiagnosticArray, "/diagnostics", keep, 100)
    return found


@pytest.mark.ros
def test_composed_nodes_are_nodes_with_their_own_topics_parameters_lifecycle_and_diagnostics(
    start: Start, watcher: Any, health: dict[str, dict[str, str]]
) -> None:
    process = start("nodes.composed")
    watcher.spin_until(lambda: set(TICK_NODES) <= set(health), "diagnostics of every node")
    watcher.spin_until(lambda: set(TICK_NODES) <= set(watcher.node.get_node_names()), "the nodes' names")
    assert "detector" not in watcher.node.get_node_names()
    assert [state_of(watcher, name) for name in TICK_NODES] == [State.PRIMARY_STATE_ACTIVE] * 4
    assert len({health[name]["process"] for name in TICK_NODES}) == 1
    heard: dict[str, list[JointState]] = {}
    for topic in (JOINT_STATES, ESTIMATE, TORQUES, DISTURBANCE, REFERENCE):
        heard[topic.name] = []
        watcher.node.create_subscription(JointState, topic.name, heard[topic.name].append, 100)

    def whole_ticks() -> int:
        """How many ticks all topics have been heard of."""
        stamps = [{(m.header.stamp.sec, m.header.stamp.nanosec) for m in found} for found in heard.values()]
        return len(set.intersection(*stamps))

    watcher.spin_until(lambda: whole_ticks() > 10, "messages of the same ticks on all topics")
    assert watcher.set("controller", controller="scm") == [
        (False, "no controller 'scm'; did you mean 'smc'?")
    ]
    assert watcher.set("controller", controller="smc") == [(True, "")]
    assert watcher.set("observer", do__k1=15000.0) == [(True, "")]
    # One that is shut down is missed, and the others go on.
    shutdown = ChangeState.Request(transition=Transition(id=Transition.TRANSITION_ACTIVE_SHUTDOWN))
    assert watcher.call(ChangeState, "/controller/change_state", shutdown).success
    watcher.spin_until(lambda: "safe stop" in health["plant"]["message"], "a safe stop of the plant")
    assert int(health["plant"]["late_torque"]) > 0
    process.send_signal(signal.SIGINT)
    out, err = process.communicate(timeout=30)
    assert process.returncode == 0, err
    assert "Traceback" not in out + err


@pytest.mark.ros
def test_ticks_that_never_wait_leave_time_for_services(
    start: Start, watcher: Any, health: dict[str, dict[str, str]], tmp_path: Path
) -> None:
    """In lockstep without a recorder, where the plant waits for nobody."""
    (tmp_path / "long.yaml").write_text(load("paper", ["duration=4000"]).to_yaml(), encoding="utf-8")
    process = start(
        "nodes.composed", "--ros-args", "-p", "plant:mode:=lockstep", "-p", "scenario:=long.yaml"
    )  # fmt: skip
    watcher.spin_until(lambda: int(health.get("plant", {}).get("ticks", 0)) > 1000, "ticks")
    end = ChangeState.Request(transition=Transition(id=Transition.TRANSITION_DEACTIVATE))
    assert watcher.call(ChangeState, "/plant/change_state", end).success
    watcher.spin_until(lambda: health["plant"]["state"] == "incomplete", "the end of the run")
    process.send_signal(signal.SIGINT)
    assert process.wait(30) == 0


@pytest.mark.ros
def test_a_stranger_s_messages_do_not_act_and_are_told(
    start: Start, watcher: Any, health: dict[str, dict[str, str]]
) -> None:
    start("nodes.composed")
    watcher.spin_until(lambda: "rate_hz" in health.get("plant", {}), "the plant")
    stranger = watcher.node.create_publisher(JointState, TORQUES.name, 100)
    heard: list[JointState] = []
    watcher.node.create_subscription(JointState, JOINT_STATES.name, heard.append, 1000)

    def told() -> bool:
        for tick in range(0, 60_000, 500):
            message = JointState(name=["joint1", "joint2", "joint3"], effort=[1e6, 1e6, 1e6])
            message.header.stamp.sec, message.header.stamp.nanosec = divmod(tick * 10**6, 10**9)
            stranger.publish(message)
        return all("has 2 publishers" in health[n]["message"] for n in ("plant", "injector"))

    watcher.spin_until(told, "the rival on /joint_torques")
    assert max(abs(x) for message in heard for x in message.position) < 10.0
    assert health["plant"]["refused"] == "0"


@pytest.mark.ros
@pytest.mark.parametrize(
    ("arguments", "status", "text"),
    [
        (["--nodes", "recorder"], 2, "invalid choice: 'recorder'"),
        (["--ros-args", "-p", "scenario:=papr"], 2, "did you mean 'paper'?"),
        (["--ros-args", "-p", "controller:scenario:=papr"], 2, "did you mean 'paper'?"),
        (["--ros-args", "-p", "controller:smc.c:=-1.0"], 2, "smc.c: -1 is out of range"),
        (["--nodes", "plant", "detector"], 2, "the scenario has no detector"),
    ],
)
def test_a_mistake_at_start_is_one_line(
    start: Start, domain: int, arguments: list[str], status: int, text: str
) -> None:
    process = start("nodes.composed", *arguments)
    out, err = process.communicate(timeout=60)
    assert process.returncode == status, err
    assert "Traceback" not in out + err
    (line,) = [line for line in err.splitlines() if "error" in line]
    assert text in line
