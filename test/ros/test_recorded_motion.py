# SPDX-License-Identifier: Apache-2.0
"""Real time: the recorded motion follows from what is recorded, also where torques came late or were held."""

from __future__ import annotations

import os
import signal
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

pytest.importorskip("rclpy", reason="ROS 2 (rclpy) is not installed")

from sensor_msgs.msg import JointState

from ftcm_core.recording.trace import Array, Trace
from ftcm_core.registry import load_plugin
from ftcm_core.scenario import load
from ftcm_core.signals import Measurement, seconds
from ftcm_core.simulation import simulate
from ftcm_core.simulation.drive import drive_torque
from ftcm_core.simulation.stages import DetectorStage, InjectorStage, ObserverStage, robot_changes
from ftcm_ros.bags.reader import read_bag
from ftcm_ros.transport.plane import qos
from ftcm_ros.transport.topics import DETECTION, DISTURBANCE, ESTIMATE, JOINT_STATES, TORQUES, Topic
from node_processes import node_pids
from plugins import registry_kept

pytestmark = pytest.mark.ros

DELAY = 2
PLAIN = [
    "injection.faults.0.start=0.5",
    f"torque_delay={DELAY}",
    "torque_limits=[97.6, 186.4, 89.4]",
    "torque_rate_limits=[20000, 20000, 20000]",
]
HIDDEN = [
    *PLAIN[1:],
    "sensor={type: encoder, noise: 1e-5}",
    "injection.faults=[{type: loss_of_effectiveness, start: 0.5}, {type: payload_pickup, start: 1.0}]",
]


def moved_otherwise(trace: Trace, torque: Array) -> list[int]:
    """Ticks after which the robot is not where this torque on its joints, a row per tick, leaves it."""
    scenario = trace.scenario
    assert scenario is not None
    robot, coming = scenario.robot, list(robot_changes(scenario))
    q, v, tau = (list(map(tuple, a.tolist())) for a in (trace.position, trace.velocity, torque))
    plant, found = scenario.plant, []
    for k, time_ns in enumerate(trace.time_ns[:-1].tolist()):
        while coming and time_ns >= coming[0][0]:
            robot = coming.pop(0)[1]
        state = plant.step(robot, scenario.dt, tau[k + 1], plant.init(robot, q[k], v[k]))
        if plant.motion(state) != (q[k + 1], v[k + 1]):
            found.append(k)
    return found


def as_recorded(trace: Trace) -> Array:
    """The torque on the joints, if what is recorded of a tick had acted in it."""
    torque = trace.effort.copy()
    torque[1:] += trace.disturbance[:-1]
    return torque


def not_as_commanded(trace: Trace) -> int:
    """In how many ticks the drives did not apply what follows from the recorded commands."""
    assert trace.scenario is not None
    limits = trace.scenario.limits
    zeros = (0.0,) * len(trace.joint_names)
    commands = [zeros] * DELAY + list(map(tuple, trace.command.tolist()))
    efforts = list(map(tuple, trace.effort.tolist()))
    return sum(
        after != drive_torque(limits, before, wanted)
        for before, after, wanted in zip(efforts, efforts[1:], commands)
    )


@pytest.mark.parametrize(
    ("overrides", "stopped", "length"),
    [
        pytest.param(PLAIN, "injector", 0.3, id="injector", marks=pytest.mark.nightly),
        pytest.param(PLAIN, "controller", 0.3, id="controller"),  # long enough for a safe stop
        pytest.param(PLAIN, "plant", 0.3, id="plant", marks=pytest.mark.nightly),
        pytest.param(HIDDEN, "controller", 0.05, id="controller, hidden"),
    ],
)
def test_the_recorded_torques_give_the_recorded_motion(
    live: Callable[..., Any], tmp_path: Path, overrides: list[str], stopped: str, length: float
) -> None:
    arguments = (a for o in (*overrides, "duration=4") for a in ("--set", o))
    run = live("paper", "--controllers", "ftcm", "--mode", "real_time", "--no-composed", *arguments)
    run.first_tick(("controller", "ftcm"), ("observer", "do"))
    pid = node_pids(run.process.pid)[stopped]
    for _ in range(2):
        os.kill(pid, signal.SIGSTOP)
        time.sleep(length)
        os.kill(pid, signal.SIGCONT)
        time.sleep(0.2)
    run.end()
    bag = read_bag(tmp_path / "runs" / "test" / "bags" / "ftcm")
    trace, plant = bag.trace, bag.nodes["plant"]
    assert bag.missing == {}
    assert (trace.status, trace.ticks) == ("completed", 4001)
    late = int(plant["late_torque"]) + int(plant["late_disturbance"])
    if stopped == "plant":
        assert int(plant["plant_overrun"]) > 1000 * length
    else:
        assert late > 1000 * length
    if trace.joint_torque is None:
        assert late == 0
        assert moved_otherwise(trace, as_recorded(trace)) == []
    else:
        assert moved_otherwise(trace, trace.joint_torque) == []
    if stopped != "plant":  # what a node has said too late is recorded, but has not acted
        assert len(moved_otherwise(trace, as_recorded(trace))) > 300 * length
    if stopped == "controller":
        assert not_as_commanded(trace) > 300 * length
    assert not_as_commanded(trace) <= int(plant["late_torque"]) + DELAY * int(plant["safe_stops"])


def test_where_nothing_is_late_every_torque_is_that_of_its_tick() -> None:
    """By the same look at a run in process."""
    trace = simulate(load("paper", [*PLAIN, "duration=0.7"]))
    assert trace.joint_torque is None
    assert not_as_commanded(trace) == 0
    torque = as_recorded(trace)
    assert moved_otherwise(trace, torque) == []
    torque[300] += 1e-9
    assert moved_otherwise(trace, torque) == [299]


# Ticks that were skipped.

COUNTING = """
from ftcm_core.disturbances import Disturbance
from ftcm_core.params import param
from ftcm_core.registry import register


@register("disturbance", "counting")
class Counting(Disturbance):
    'A torque that grows with the time it is told.'

    rate: float = param(1.0, unit="N·m/s", doc="growth", source="chosen")

    def init(self, joints, key):
        return 0.0

    def step(self, t, dt, q, v, u, state):
        state += dt
        return (self.rate * state,) * len(q), state
"""
TICKS = (0, 1, 2, 12, 13, 40)
"""Those that a node is given; the others are skipped."""
U, TAU = (30.0, -20.0, 10.0), (50.0, -0.5, 11.0)
"""Command and estimate."""


def measured(tick: int) -> Measurement:
    """What is measured at a tick."""
    x = 0.001 * tick
    return Measurement((x, 0.2 - x, -0.1), (1.0, -1.0 + x, x), (5.0 + x, 2.0, -x))


@pytest.mark.parametrize("name", ["observer", "injector", "detector"])
def test_after_skipped_ticks_a_node_reckons_with_the_time_that_has_passed(
    start: Callable[..., Any], watcher: Any, tmp_path: Path, name: str
) -> None:
    (tmp_path / "counting.py").write_text(COUNTING, encoding="utf-8")
    overrides = [
        "injection={disturbances: [counting]}",
        "detector={type: residual_threshold, hold: 0.0125, threshold: 10}",
    ]
    with registry_kept():
        load_plugin(str(tmp_path / "counting.py"))
        scenario = load("paper", overrides)
        (tmp_path / "s.yaml").write_text(scenario.to_yaml(), encoding="utf-8")
    start(f"nodes.{name}", "--ros-args", "-p", "scenario:=s.yaml")
    answers: dict[int, JointState] = {}
    out = {"observer": ESTIMATE, "injector": DISTURBANCE, "detector": DETECTION}[name]
    watcher.node.create_subscription(
        JointState, out.name, lambda m: answers.setdefault(m.header.stamp.nanosec // 1_000_000, m), qos(out)
    )
    inputs = [t for t in (JOINT_STATES, ESTIMATE, TORQUES) if name in t.subscribers]
    publishers = [watcher.node.create_publisher(JointState, t.name, qos(t)) for t in inputs]
    watcher.spin_until(
        lambda: (
            all(p.get_subscription_count() for p in publishers) and watcher.node.count_publishers(out.name)
        ),
        f"the {name}",
    )

    def tell(topic: Topic, publisher: Any, tick: int) -> None:
        message = JointState(name=list(scenario.robot.joint_names))
        message.header.stamp.nanosec = tick * 1_000_000
        if topic is JOINT_STATES:
            message.position, message.velocity, message.effort = map(list, measured(tick))
        else:
            message.effort = list(U if topic is TORQUES else TAU)
        publisher.publish(message)

    def answered(tick: int) -> bool:
        for topic, publisher in zip(inputs, publishers):
            tell(topic, publisher, tick)
        return tick in answers

    observer = ObserverStage(scenario.observer, scenario.model, scenario.dt)
    injector, detector = InjectorStage(scenario), DetectorStage(scenario)
    for before, tick in zip((-1, *TICKS), TICKS):
        watcher.spin_until(lambda k=tick: answered(k), f"the answer to tick {tick}")
        y, passed, found = measured(tick), tick - before, answers[tick]
        if name == "observer":
            for _ in range(passed):  # once for each tick, with the newest measurement
                expected = observer.step(y)
            assert tuple(found.effort) == expected
        elif name == "injector":
            added = injector.step(tick * 1_000_000, y.position, y.velocity, U, passed).torque
            assert tuple(found.effort) == added
            assert list(found.effort) == pytest.approx([seconds(tick * 1_000_000) + scenario.dt] * 3)
        else:
            detection = detector.step(y, U, TAU, passed)
            assert (tuple(found.position), tuple(found.effort)) == (detection.alarm, TAU)
            # Above the threshold since tick 0: at tick 12 for 13 ms.
            assert tuple(found.position) == ((1.0, 0.0, 1.0) if tick >= 12 else (0.0, 0.0, 0.0))
