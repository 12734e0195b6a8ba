# SPDX-License-Identifier: Apache-2.0
"""What must not reach the robot: bad messages, other publishers, silence, jumps of the clocks."""

from __future__ import annotations

import math
import os
import re
import signal
import subprocess
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from ftcm_core.scenario import load
from ftcm_core.simulation import simulate
from ftcm_ros.bags.reader import read_bag
from ftcm_ros.bags.writer import Recording
from ftcm_ros.timing.clocks import ClockWatch
from ftcm_ros.transport.codec import JointStateCodec
from ftcm_ros.transport.publisher_identity import SILENCE_NS, PublisherIdentity
from ftcm_ros.transport.topics import data_topics
from traces import same

Start = Callable[..., "subprocess.Popen[str]"]
SOURCES = Path(__file__).resolve().parents[2] / "src" / "ftcm_ros" / "ftcm_ros"
NAMES = ["joint1", "joint2", "joint3"]


# Whose messages count.


class Line:
    """A topic with publishers that number their messages, and a clock."""

    def __init__(self) -> None:
        self.now, self.publishers = 0, 1
        self.strangers = True
        self.identity = PublisherIdentity(lambda: self.publishers, lambda: self.strangers, lambda: self.now)

    def send(self, number: int | None, after_ns: int = 1_000_000) -> bool:
        self.now += after_ns
        return self.identity.admits(number)


@settings(deadline=None)
@given(st.integers(2, 40), st.lists(st.booleans(), min_size=1, max_size=200))
def test_messages_of_another_publisher_never_count(start: int, sent: list[bool]) -> None:
    """Those of the first all count until the other has as many; then none does until one is left."""
    line = Line()
    assert line.send(start)
    line.publishers = 2
    mine, other, met = start, 0, False
    for stranger in sent:
        if stranger:
            other += 1
            assert not line.send(other)
        else:
            mine += 1
            assert line.send(mine) == (not met)
        met = met or other == mine
    line.publishers = 1
    assert line.send(mine + 1)
    assert line.send(mine + 2)


def test_lost_messages_and_a_publisher_that_begins_anew_are_taken_if_it_is_alone() -> None:
    line = Line()
    assert all(line.send(n) for n in (1, 2, 3, 10, 11, 1, 2))
    line.publishers = 2
    assert not line.send(7)
    assert line.send(3)


def test_a_node_started_again_takes_over_when_its_predecessor_has_fallen_silent() -> None:
    """Both are shown for a while; a stranger never takes over while there is another."""
    line = Line()
    assert line.send(100)
    line.publishers = 2
    assert not line.send(1, SILENCE_NS)
    line.strangers = False
    assert line.send(2, 1)
    assert not line.send(101, SILENCE_NS - 1)


def test_without_numbers_everything_counts() -> None:
    line = Line()
    assert line.send(5)
    line.publishers = 2
    assert all(line.send(None) for _ in range(3))


# Clocks.


def test_steps_of_the_system_time_and_suspension_are_told_apart() -> None:
    times = [5 * 10**18, 10**12, 10**12]
    watch = ClockWatch(lambda: tuple(times))
    nothing = {"clock_steps": 0, "clock_stepped_seconds": 0.0, "suspended_seconds": 0.0}
    assert watch.look() == nothing
    for i in range(3):
        times[i] += 10**9
    times[0] += 10**6  # slewed, not set
    assert watch.look() == nothing
    times[0] -= 3600 * 10**9
    assert watch.look() == {**nothing, "clock_steps": 1, "clock_stepped_seconds": -3599.999}
    times[0] += 60 * 10**9  # suspended for a minute
    times[2] += 60 * 10**9
    found = watch.look()
    assert found == {"clock_steps": 1, "clock_stepped_seconds": -3599.999, "suspended_seconds": 60.0}


def test_no_module_but_the_watch_reads_the_system_time() -> None:
    """Pacing, patience and timeouts go by the steady clock; ROS time is that of the system."""
    uses = re.compile(r"time\.time\(|time\.time_ns\(|CLOCK_REALTIME|datetime|get_clock\(\)|perf_counter")
    found = {
        f"{file.name}: {line.strip()}"
        for file in SOURCES.rglob("*.py")
        for line in file.read_text(encoding="utf-8").splitlines()
        if uses.search(line) and file.name != "clocks.py"
    }
    assert found == {
        "suite_node.py: array.header.stamp = self.get_clock().now().to_msg()",
        "plant.py: self._stamped_from = self.get_clock().now().nanoseconds",  # with stamps: free
        "markers.py: stamp = self._node.get_clock().now().to_msg()",  # what RViz shows
        'listener.py: fresh = 0 <= time.time_ns() - taken[1]["source_timestamp"] < FRESH_NS',  # ages only
        "domain.py: return time.time() - stat.st_mtime < SETTLED_SECONDS",  # as files do
        "writer.py: time.time_ns(),",  # bags are in system time
    }


@pytest.mark.parametrize("storage", ["mcap", "sqlite3"])
@pytest.mark.parametrize("jump", [-3600 * 10**9, 3600 * 10**9])
def test_a_bag_is_whole_when_the_system_time_is_set_while_it_is_written(
    tmp_path: Path, storage: str, jump: int
) -> None:
    scenario = load("paper", ["duration=0.2"])
    trace, codec = simulate(scenario), JointStateCodec(scenario.robot.joint_names)
    recording = Recording(tmp_path / "bag", storage, scenario)
    layouts = {"joint_states": (codec.state, "position", "velocity", "effort"),
               "disturbance_estimate": (codec.torque, "disturbance_estimate"),
               "joint_torques": (codec.torque, "command"), "disturbance": (codec.torque, "disturbance"),
               "reference": (codec.motion, "reference_position", "reference_velocity")}  # fmt: skip
    for k, time_ns in enumerate(trace.time_ns.tolist()):
        for i, topic in enumerate(data_topics(scenario)):
            layout, *columns = layouts[topic.name]
            vectors = [tuple(getattr(trace, c)[k].tolist()) for c in columns]
            published = 10**18 + time_ns + 100_000 * i + (jump if k >= 100 else 0)
            recording.write(topic, published, layout.encode(time_ns, *vectors))
    recording.close()
    bag = read_bag(tmp_path / "bag")
    assert (bag.missing, bag.runs, bag.trace.status) == ({}, 1, "completed")
    assert same(bag.trace, trace)
    hops = bag.published["disturbance"] - bag.published["joint_states"]
    assert (np.delete(hops, [99, 100]) == 300_000).all(), "latencies are known on both sides of the jump"


# Real processes.

rclpy = pytest.importorskip("rclpy", reason="ROS 2 (rclpy) is not installed")

from diagnostic_msgs.msg import DiagnosticArray  # noqa: E402
from lifecycle_msgs.msg import Transition  # noqa: E402
from lifecycle_msgs.srv import ChangeState  # noqa: E402
from sensor_msgs.msg import JointState  # noqa: E402


def stamped(time_ns: int, **arrays: list[float]) -> JointState:
    message = JointState(name=NAMES, **arrays)
    message.header.stamp.sec, message.header.stamp.nanosec = divmod(time_ns, 10**9)
    return message


class Graph:
    """Nodes under test, their diagnostics, and a hand that plays the others."""

    def __init__(self, watcher: Any, start: Start) -> None:
        self.watcher, self.node, self._start = watcher, watcher.node, start
        self.health: dict[str, dict[str, str]] = {}
        self.heard: dict[str, list[JointState]] = {}
        self.node.create_subscription(DiagnosticArray, "/diagnostics", self._on_diagnostics, 100)

    def _on_diagnostics(self, message: DiagnosticArray) -> None:
        for status in message.status:
            self.health[status.name.partition(":")[0]] = {
                "message": status.message, "level": str(status.level[0]),
                **{v.key: v.value for v in status.values},
            }  # fmt: skip

    def start(self, name: str, **parameters: Any) -> subprocess.Popen[str]:
        arguments = [a for k, v in parameters.items() for a in ("-p", f"{k.replace('__', '.')}:={v}")]
        return self._start(f"nodes.{name}", "--ros-args", *arguments)

    def listen(self, topic: str) -> list[JointState]:
        self.heard[topic] = []
        self.node.create_subscription(JointState, topic, self.heard[topic].append, 4000)
        return self.heard[topic]

    def publisher(self, topic: str) -> Any:
        made = self.node.create_publisher(JointState, topic, 4000)
        self.watcher.spin_until(lambda: made.get_subscription_count(), f"a subscriber of {topic}")
        return made

    def until(self, node: str, key: str, holds: Callable[[str], bool]) -> dict[str, str]:
        """Wait for a value in a node's diagnostics."""
        return dict(
            self.watcher.spin_until(
                lambda: self.health[node] if holds(self.health.get(node, {}).get(key, "")) else None,
                f"{key} of {node}; last {self.health.get(node)}",
            )
        )


@pytest.fixture
def graph(watcher: Any, start: Start) -> Graph:
    return Graph(watcher, start)


@pytest.mark.ros
def test_the_plant_uses_the_right_messages_only_and_names_the_others(graph: Graph, tmp_path: Path) -> None:
    """A bad one of every kind before the right one, in lockstep: the run is as if there were none."""
    (tmp_path / "s.yaml").write_text(load("paper", ["duration=0.02"], "ctc").to_yaml(), encoding="utf-8")
    states = graph.listen("/joint_states")
    graph.start("plant", mode="lockstep", scenario="s.yaml", autostart="true")
    torque, disturbance = graph.publisher("/joint_torques"), graph.publisher("/disturbance")
    graph.watcher.spin_until(lambda: states, "the first measurement")
    trace = simulate(load("paper", ["duration=0.02"], "ctc"))
    bad = [math.nan, math.inf, -math.inf]
    for k in range(20):
        t, u, d = k * 1_000_000, trace.command[k].tolist(), trace.disturbance[k].tolist()
        torque.publish(stamped(t + 1_000_000, effort=bad))  # future
        torque.publish(stamped(t + 1, effort=bad))  # between two ticks
        torque.publish(stamped(10**15, effort=bad))  # after the end
        torque.publish(stamped(-(10**9), effort=bad))
        torque.publish(JointState(name=["a", "b", "c"], effort=bad))
        torque.publish(JointState(name=["joint1", "joint1", "joint2", "joint3"], effort=[1.0, *bad]))
        torque.publish(JointState(name=NAMES, effort=[1.0, 2.0]))
        torque.publish(JointState(name=NAMES))
        right = stamped(t, effort=u[::-1])
        right.name = NAMES[::-1]
        torque.publish(right)
        torque.publish(right)
        torque.publish(stamped(t, effort=bad))  # duplicated, another value
        if k:
            torque.publish(stamped(t - 1_000_000, effort=bad))  # reordered
        graph.watcher.spin_until(lambda: graph.node.count_subscribers("/joint_torques"), "the plant")
        time.sleep(0.01)  # the torques first: the disturbance ends the tick
        disturbance.publish(stamped(t, effort=d))
        graph.watcher.spin_until(lambda k=k: len(states) > k + 1, f"the measurement of tick {k + 1}")
    found = np.array([list(m.position) + list(m.velocity) + list(m.effort) for m in states])
    expected = np.hstack([trace.position, trace.velocity, trace.effort])
    assert np.array_equal(found, expected)
    health = graph.until("plant", "refused_malformed", lambda v: v == "80")
    assert (health["refused_future"], health["refused_stamp"]) == ("20", "60")
    assert (health["refused_stale"], health["refused_conflicting"], health["repeated"]) == ("19", "20", "20")
    assert health["refused"] == str(80 + 20 + 60 + 19 + 20)
    assert health["level"] == "2"
    assert "messages refused, last: joint_torques: " in health["message"]
    torque.publish(stamped(20_000_000, effort=trace.command[20].tolist()))
    disturbance.publish(stamped(20_000_000, effort=[0.0] * 3))
    graph.until("plant", "state", lambda v: v == "completed")


@pytest.mark.ros
@pytest.mark.parametrize("number", [math.nan, math.inf])
@pytest.mark.parametrize("what", ["command", "disturbance"])
def test_a_torque_that_is_no_number_ends_the_run_before_the_robot(
    graph: Graph, what: str, number: float
) -> None:
    states = graph.listen("/joint_states")
    graph.start("plant", mode="lockstep")
    torque, disturbance = graph.publisher("/joint_torques"), graph.publisher("/disturbance")
    graph.watcher.spin_until(lambda: states, "the first measurement")
    efforts = {"command": [1.0] * 3, "disturbance": [1.0] * 3, what: [1.0, number, 1.0]}
    torque.publish(stamped(0, effort=efforts["command"]))
    disturbance.publish(stamped(0, effort=efforts["disturbance"]))
    health = graph.until("plant", "state", lambda v: v == "diverged")
    assert health["detail"].startswith("at t = 0.001 s: torque is not finite: command [1.0, ")
    assert f"{what} [1.0, {number}, 1.0]" in health["detail"]
    assert len(states) == 1


@pytest.mark.ros
def test_in_lockstep_the_plant_asks_again_for_what_is_missing(graph: Graph) -> None:
    """Each answer is given once only, after the plant has asked twice."""
    states = graph.listen("/joint_states")
    graph.start("plant", mode="lockstep")
    torque, disturbance = graph.publisher("/joint_torques"), graph.publisher("/disturbance")
    graph.watcher.spin_until(lambda: len(states) >= 3, "the measurement, asked for twice again")
    assert {m.header.stamp.nanosec for m in states} == {0}
    asked = int(graph.until("plant", "asked_again", lambda v: v.isdecimal() and int(v) >= 2)["asked_again"])
    assert asked >= len(states) - 1
    torque.publish(stamped(0, effort=[0.0] * 3))
    disturbance.publish(stamped(0, effort=[0.0] * 3))
    graph.watcher.spin_until(lambda: states[-1].header.stamp.nanosec == 1_000_000, "the next tick")


@pytest.mark.ros
@pytest.mark.parametrize("number", [math.nan, -math.inf])
def test_nobody_answers_a_measurement_that_is_no_number(graph: Graph, number: float) -> None:
    estimates = graph.listen("/disturbance_estimate")
    graph.start("observer")
    state = graph.publisher("/joint_states")
    graph.watcher.spin_until(
        lambda: graph.node.count_publishers("/disturbance_estimate"), "the observer's publisher"
    )
    zeros = [0.0] * 3
    state.publish(stamped(0, position=zeros, velocity=[0.0, number, 0.0], effort=zeros))
    graph.until("observer", "refused_not_finite", lambda v: v == "1")
    assert estimates == []
    state.publish(stamped(0, position=zeros, velocity=zeros, effort=zeros))
    graph.watcher.spin_until(lambda: estimates, "the answer to the one that is")


@pytest.mark.ros
def test_strangers_neither_answer_nor_reset_and_are_named(
    start: Start, watcher: Any, tmp_path: Path, domain: int
) -> None:
    """Second publishers on every data topic of a lockstep run: it equals the run without them."""
    overrides = ["duration=6"]
    most = 80
    process = start("experiment", "paper", "--controllers", "ftcm", "--name", "test", "--no-figures",
                    "--domain-id", str(domain), "--set", *overrides)  # fmt: skip
    graph = Graph(watcher, start)
    states = graph.listen("/joint_states")
    watcher.spin_until(lambda: len(states) > 200 or process.poll() is not None, "the run")
    assert process.poll() is None, (len(states), process.communicate())
    node = rclpy.create_node("stranger", context=watcher.context)
    topics = ("joint_states", "disturbance_estimate", "joint_torques", "disturbance", "reference")
    publishers = [node.create_publisher(JointState, name, 10) for name in topics]
    readers = (5, 2, 3, 2, 1)  # of the suite, and the watcher
    watcher.spin_until(
        lambda: all(p.get_subscription_count() >= n for p, n in zip(publishers, readers)), "the readers"
    )
    sent = 0
    while process.poll() is None and sent < most:
        watcher.executor.spin_once(timeout_sec=0.02)
        newest = states[-1].header.stamp.sec * 10**9 + states[-1].header.stamp.nanosec
        for t in (0, newest, newest + 1_000_000):
            for publisher in publishers:
                publisher.publish(stamped(t, position=[1.0] * 3, velocity=[1.0] * 3, effort=[50.0] * 3))
            sent += 1
        time.sleep(0.01)
    _, err = process.communicate(timeout=60)
    node.destroy_node()
    assert process.returncode == 0, err
    bag = read_bag(tmp_path / "runs" / "test" / "bags" / "ftcm")
    again = simulate(load("paper", overrides))
    assert (bag.missing, bag.runs, bag.trace.status) == ({}, 1, "completed")
    assert sent >= most
    assert same(bag.trace, again)
    for name in ("plant", "observer", "controller", "injector"):
        assert int(bag.nodes[name]["refused_other_publisher"]) > 0
        assert re.search(r"has 2 publishers: \w+, stranger", bag.nodes[name]["message"]), bag.nodes[name]


@pytest.mark.ros
def test_limits_over_the_graph_equal_those_in_process(experiment: Callable[..., Any], tmp_path: Path) -> None:
    overrides = ["torque_limits=[60, 90, 40]", "torque_rate_limits=[4000, 2000, 1000]", "duration=1"]
    overrides += ["velocity_limits=[9, 9, 9]", "position_upper_limits=[9, 0.1, 9]", "torque_delay=1"]
    run = experiment("paper", "--controllers", "ftcm", *(a for o in overrides for a in ("--set", o)))
    assert run.returncode == 0, run.stderr
    bag = read_bag(tmp_path / "runs" / "test" / "bags" / "ftcm")
    again = simulate(load("paper", overrides))
    assert again.status == "limit_exceeded"
    assert (bag.trace.status, bag.trace.detail) == (again.status, again.detail)
    assert same(bag.trace, again)
    assert int(bag.nodes["controller"]["beyond_limits"]) > 10
    assert "beyond the limits, last: t = 0." in bag.nodes["controller"]["message"]


@pytest.mark.ros
def test_without_torque_the_drives_brake_until_it_comes_again(graph: Graph, tmp_path: Path) -> None:
    """Real time, 100 Hz: hold, safe stop with the torque it reports, back to normal, safe stop again."""
    overrides = ["dt=0.01", "duration=600", "initial_state.velocity=[1, -1, 1]", "stop_damping=[90, 100, 60]"]
    scenario = load("paper", overrides)
    (tmp_path / "s.yaml").write_text(scenario.to_yaml(), encoding="utf-8")
    states = graph.listen("/joint_states")
    graph.start("plant", mode="real_time", scenario="s.yaml", torque_timeout=20)
    health = graph.until("plant", "safety", lambda v: v == "safe_stop")
    assert (health["safe_stops"], health["level"]) == ("1", "2")
    assert "no fresh torque" in health["message"]
    assert len(states) > 10
    for before, after in zip(states[-10:], states[-9:]):
        assert list(after.effort) == [-c * v for c, v in zip((90.0, 100.0, 60.0), before.velocity)]
    torque = graph.publisher("/joint_torques")
    end = time.monotonic() + 60.0
    while graph.health["plant"]["safety"] != "normal" and time.monotonic() < end:
        graph.watcher.executor.spin_once(timeout_sec=0.02)
        newest = states[-1].header.stamp
        time_ns = newest.sec * 10**9 + newest.nanosec
        torque.publish(stamped(time_ns, effort=[time_ns / 1e7, 0.25, 0.25]))
    stops = int(graph.until("plant", "safety", lambda v: v == "normal")["safe_stops"])
    graph.until("plant", "safe_stops", lambda v: int(v) > stops)
    held = {m.effort[0]: m.header.stamp.sec * 100 + m.header.stamp.nanosec / 1e7
            for m in states if m.effort[1] == 0.25}  # fmt: skip
    assert max(last - tick for tick, last in held.items()) == pytest.approx(1 + 20), "its tick, and the held"


@pytest.mark.ros
def test_misses_are_counted_exactly_and_by_their_cause(graph: Graph, tmp_path: Path) -> None:
    """Real time, 10 Hz: the hand that plays the other nodes withholds what it is told to."""
    (tmp_path / "s.yaml").write_text(load("paper", ["dt=0.1", "duration=3"]).to_yaml(), encoding="utf-8")
    no_torque, no_disturbance, neither = {4, 5, 9}, {7, 12}, {15, 16}
    states = graph.listen("/joint_states")
    graph.start("plant", mode="real_time", scenario="s.yaml", autostart="false")
    client = graph.node.create_client(ChangeState, "/plant/change_state")
    graph.watcher.spin_until(client.service_is_ready, "the plant's lifecycle")

    def change(transition: int) -> None:
        answer = client.call_async(ChangeState.Request(transition=Transition(id=transition)))
        graph.watcher.spin_until(answer.done, "the plant's transition")
        assert answer.result().success

    change(Transition.TRANSITION_CONFIGURE)
    torque, disturbance = graph.publisher("/joint_torques"), graph.publisher("/disturbance")
    change(Transition.TRANSITION_ACTIVATE)
    answered = 0
    while answered < 31:
        graph.watcher.spin_until(lambda n=answered: len(states) > n, f"the measurement of tick {answered}")
        for k in range(answered, len(states)):
            if k not in no_torque | neither:
                torque.publish(stamped(k * 10**8, effort=[0.0] * 3))
            if k not in no_disturbance | neither:
                disturbance.publish(stamped(k * 10**8, effort=[0.0] * 3))
        answered = len(states)
    health = graph.until("plant", "state", lambda v: v == "completed")
    counts = [int(health[c]) for c in ("late_torque", "late_disturbance", "plant_overrun")]
    assert counts == [len(no_torque | neither), len(no_disturbance), 0]
    assert int(health["missed_deadlines"]) == sum(counts)


@pytest.mark.ros
def test_a_publisher_that_has_gone_leaves_misses(graph: Graph, tmp_path: Path) -> None:
    """A topic that never had a publisher is not waited for; one that had is, for the rest of the run."""
    (tmp_path / "s.yaml").write_text(load("paper", ["dt=0.02", "duration=600"]).to_yaml(), encoding="utf-8")
    states = graph.listen("/joint_states")
    graph.start("plant", mode="real_time", scenario="s.yaml")
    graph.watcher.spin_until(lambda: len(states) > 20, "ticks")
    assert graph.until("plant", "tick", lambda v: v.isdecimal() and int(v) > 20)["late_torque"] == "0"
    torque = graph.publisher("/joint_torques")
    heard = len(states)
    graph.watcher.spin_until(lambda: len(states) > heard, "a tick")
    newest = states[-1].header.stamp
    torque.publish(stamped(newest.sec * 10**9 + newest.nanosec, effort=[0.0] * 3))
    graph.until("plant", "late_torque", lambda v: int(v) > 0)
    graph.node.destroy_publisher(torque)
    before = int(graph.until("plant", "late_torque", lambda v: int(v) > 50)["late_torque"])
    health = graph.until("plant", "late_torque", lambda v: int(v) > before + 50)
    assert health["late_disturbance"] == "0"


@pytest.mark.ros
def test_a_suspended_plant_does_not_catch_up_in_a_burst(graph: Graph, tmp_path: Path) -> None:
    """Ticks and skipped ticks add up to the time that passed."""
    (tmp_path / "s.yaml").write_text(load("paper", ["dt=0.01", "duration=600"]).to_yaml(), encoding="utf-8")
    process = graph.start("plant", mode="real_time", scenario="s.yaml")
    graph.until("plant", "tick", lambda v: v.isdecimal() and int(v) > 10)
    os.kill(process.pid, signal.SIGSTOP)
    time.sleep(1.5)
    os.kill(process.pid, signal.SIGCONT)
    graph.until("plant", "plant_overrun", lambda v: v.isdecimal() and int(v) >= 149)
    before = graph.health["plant"]
    health = graph.until("plant", "tick", lambda v: int(v) > int(before["tick"]) + 50)
    ticks = int(health["tick"]) + int(health["plant_overrun"])
    # A burst would be 150 more; what the report says of ticks and of time is of two moments.
    assert ticks == pytest.approx(float(health["elapsed_seconds"]) / 0.01, abs=30)
    assert int(health["tick"]) * 0.01 < float(health["elapsed_seconds"]) - 1.45
    assert health["state"] == "running"
