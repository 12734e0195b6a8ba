# SPDX-License-Identifier: Apache-2.0
"""Single nodes as a user starts them: parameters, mistakes, lifecycle, foreign publishers."""

from __future__ import annotations

import signal
import subprocess
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

pytest.importorskip("rclpy", reason="ROS 2 (rclpy) is not installed")

from diagnostic_msgs.msg import DiagnosticArray
from lifecycle_msgs.msg import State
from lifecycle_msgs.srv import GetState
from sensor_msgs.msg import JointState

from ftcm_core.params import specs
from ftcm_core.registry import components
from ftcm_core.scenario import load
from ftcm_core.signals import Measurement
from ftcm_core.simulation.stages import ControllerStage
from ftcm_ros.bags.reader import read_bag
from ftcm_ros.parameters.node_parameters import ALL_NODES, SETTINGS
from ftcm_ros.transport.plane import qos
from ftcm_ros.transport.topics import ESTIMATE, JOINT_STATES, TORQUES
from programs import program

pytestmark = pytest.mark.ros

Start = Callable[..., "subprocess.Popen[str]"]
DOCS = Path(__file__).resolve().parents[2] / "docs"


def node(start: Start, name: str, **parameters: Any) -> subprocess.Popen[str]:
    """Start a node with parameters, as `ros2 run ftcm_ros NAME --ros-args -p ...` does."""
    arguments = [a for k, v in parameters.items() for a in ("-p", f"{k.replace('__', '.')}:={v}")]
    return start(f"nodes.{name}", "--ros-args", *arguments) if arguments else start(f"nodes.{name}")


def last_line(process: subprocess.Popen[str]) -> str:
    """Wait for a node that cannot start; return its one line of stderr."""
    out, err = process.communicate(timeout=60)
    assert process.returncode == 2, err
    assert "Traceback" not in out + err
    (line,) = [x for x in err.strip().splitlines() if "error" in x]
    return line


@pytest.mark.parametrize(
    ("name", "parameters", "text"),
    [
        ("plant", {"scenario": "papr"}, "did you mean 'paper'?"),
        ("plant", {"mode": "fast"}, "mode: no 'fast'"),
        ("plant", {"scenario": 5}, "scenario"),
        ("controller", {"controller": "scm"}, "did you mean 'smc'?"),
        ("controller", {"smc__c": -1.0}, "smc.c: -1 is out of range"),
        ("observer", {"do__k1": "high"}, "do.k1"),
        ("observer", {"data_path": "magic"}, "data_path: no 'magic'"),
        ("recorder", {"storage": "zip"}, "storage: no 'zip'"),
        ("recorder", {"bag": "/proc/bag"}, "'/proc/bag' cannot be made"),
        ("detector", {}, "the scenario has no detector"),
        ("observer", {"plugins": "nowhere.py"}, "plug-in 'nowhere.py': no such file"),
        ("plant", {"plugins": "no_such_module"}, "plug-in 'no_such_module' cannot be loaded"),
    ],
)
def test_a_mistake_at_start_is_one_line(
    start: Start, domain: int, name: str, parameters: dict[str, Any], text: str
) -> None:
    assert text in last_line(node(start, name, **parameters))


@pytest.fixture
def detected(tmp_path: Path) -> str:
    """File of the paper's scenario with a detector, without which there is no such node."""
    scenario = load("paper", ["detector=residual_threshold"])
    (tmp_path / "detected.yaml").write_text(scenario.to_yaml(), encoding="utf-8")
    return "detected.yaml"


@pytest.mark.parametrize(
    "kind", [pytest.param("controller", marks=pytest.mark.versions), "observer", "detector"]
)
def test_every_component_parameter_is_a_described_ros_parameter(
    start: Start, watcher: Any, detected: str, kind: str
) -> None:
    node(start, kind, scenario=detected)
    declared = [(name, spec) for name, cls in components(kind).items() for spec in specs(cls).values()]
    names = [f"{name}.{spec.name}" for name, spec in declared]
    assert {*names, kind, *(s.name for s in SETTINGS[kind])} <= set(watcher.list(kind))
    for descriptor, (_, spec) in zip(watcher.describe(kind, names), declared):
        assert spec.doc in descriptor.description
        assert f"[{spec.unit}]" in descriptor.description
        assert spec.source in descriptor.description
        assert spec.interval in descriptor.additional_constraints


@pytest.mark.versions
def test_bad_values_are_refused_whole_and_numbers_are_taken_as_meant(start: Start, watcher: Any) -> None:
    node(start, "controller")
    for values, reason in (
        ({"ftcm__gamma1": -1.0}, "ftcm.gamma1: -1 is out of range"),
        ({"ftcm__gamma1": float("nan")}, "ftcm.gamma1: nan is not finite"),
        ({"ftcm__gamma1": [1.0, 2.0]}, "expected one per joint (3)"),
        ({"ftcm__gamma1": "high"}, "ftcm.gamma1: 'high' is not a number"),
        ({"nftsmc__l": 4}, "nftsmc.l: 4 is even"),
        ({"nftsmc__l": 7}, "7/3 is out of range"),
    ):
        before = watcher.get("controller", next(iter(values)).replace("__", "."))
        ((successful, text),) = watcher.set("controller", **values)
        assert not successful
        assert reason in text
        assert watcher.get("controller", next(iter(values)).replace("__", ".")) == before
    assert watcher.set("controller", ftcm__gamma1=3, ftcm__upsilon1=[16.0, 17.0, 18.0]) == [
        (True, ""),
        (True, ""),
    ]
    assert watcher.get("controller", "ftcm.gamma1") == 3
    assert list(watcher.get("controller", "ftcm.upsilon1")) == [16.0, 17.0, 18.0]


@pytest.mark.parametrize("name", ALL_NODES)
def test_a_node_alone_is_active_and_stops_cleanly(
    start: Start, watcher: Any, detected: str, name: str
) -> None:
    process = node(start, name, scenario=detected)
    watcher.spin_until(
        lambda: (
            watcher.call(GetState, f"/{name}/get_state", GetState.Request()).current_state.id
            == State.PRIMARY_STATE_ACTIVE
        ),
        f"{name} active",
        30.0,
    )
    process.send_signal(signal.SIGINT)
    out, err = process.communicate(timeout=30)
    assert process.returncode == 0, err
    assert "Traceback" not in out + err


@pytest.mark.versions
def test_nodes_by_hand_run_in_real_time_and_are_recorded(start: Start, watcher: Any, tmp_path: Path) -> None:
    scenario = tmp_path / "short.yaml"
    text = "{robot: puma560, reference: vo_kang_cosine, controller: smc, observer: none, duration: 2}"
    scenario.write_text(text)
    states: list[str] = []

    def on_diagnostics(message: DiagnosticArray) -> None:
        for status in message.status:
            if status.name == "plant: tick":
                states.append(next(v.value for v in status.values if v.key == "state"))

    watcher.node.create_subscription(DiagnosticArray, "/diagnostics", on_diagnostics, 10)
    recorder = node(start, "recorder", bag="bag", scenario="short.yaml")
    for name in ("controller", "injector", "observer", "plant"):
        node(start, name, scenario="short.yaml", await_graph="true")
    watcher.spin_until(lambda: "completed" in states, "end of the run")
    recorder.send_signal(signal.SIGINT)
    recorder.communicate(timeout=30)
    bag = read_bag(tmp_path / "bag")
    assert bag.trace.ticks == 2001
    assert bag.trace.scenario is not None
    assert bag.trace.scenario.name == "short"
    assert bag.trace.status == "completed"


def test_messages_that_do_not_fit_are_refused_and_named(start: Start, watcher: Any) -> None:
    node(start, "observer")
    publisher = watcher.node.create_publisher(JointState, "/joint_states", 10)
    health: dict[str, str] = {}

    def on_diagnostics(message: DiagnosticArray) -> None:
        for status in message.status:
            health.update(name=status.name, message=status.message, **{v.key: v.value for v in status.values})

    watcher.node.create_subscription(DiagnosticArray, "/diagnostics", on_diagnostics, 10)
    watcher.spin_until(lambda: publisher.get_subscription_count() == 1 and health, "the observer")
    answers: list[JointState] = []
    watcher.node.create_subscription(JointState, "/disturbance_estimate", answers.append, 10)
    good = JointState(
        name=["joint3", "joint2", "joint1", "x"], position=[0.0] * 4, velocity=[0.0] * 4, effort=[0.0] * 4
    )
    publisher.publish(JointState(name=["a", "b", "c"], position=[0.0] * 3))
    publisher.publish(JointState(name=["joint1", "joint2", "joint3"], position=[0.0] * 3))
    # Asked again and again: the watcher is not told when the observer has found it.
    watcher.spin_until(lambda: publisher.publish(good) or answers, "an answer to the message that fits")
    assert list(answers[0].name) == ["joint1", "joint2", "joint3"]
    watcher.spin_until(lambda: health.get("refused") == "2", "the refusals in the diagnostics")
    assert "velocity is empty" in health["message"]


def test_a_node_that_was_kept_waiting_answers_every_tick(start: Start, watcher: Any) -> None:
    """Of a second of ticks at once, each is answered: as one who was kept from the processor finds them."""
    node(start, "controller", controller="ftcm")
    states = watcher.node.create_publisher(JointState, JOINT_STATES.name, qos(JOINT_STATES))
    estimates = watcher.node.create_publisher(JointState, ESTIMATE.name, qos(ESTIMATE))
    torques: dict[int, list[float]] = {}

    def on_torque(message: JointState) -> None:
        torques[message.header.stamp.nanosec] = list(message.effort)

    watcher.node.create_subscription(JointState, TORQUES.name, on_torque, qos(TORQUES))
    scenario = load("paper")
    stage = ControllerStage(scenario)
    zero = (0.0,) * 3
    expected: dict[int, list[float]] = {}
    state = JointState(name=list(scenario.robot.joint_names), velocity=zero, effort=zero)
    estimate = JointState(name=state.name)

    def measure(tick: int) -> None:
        state.header.stamp.nanosec = tick * scenario.dt_ns
        state.position = [0.001 * tick, 0.2, -0.1]
        states.publish(state)

    def observe(tick: int) -> None:
        estimate.header.stamp.nanosec = tick * scenario.dt_ns
        estimate.effort = [0.01 * tick, 1.0, -1.0]
        estimates.publish(estimate)

    def compute(tick: int) -> None:
        measured = Measurement((0.001 * tick, 0.2, -0.1), zero, zero)
        u, _ = stage.step(tick * scenario.dt_ns, measured, (0.01 * tick, 1.0, -1.0))
        expected[tick * scenario.dt_ns] = list(u)

    watcher.spin_until(lambda: (measure(0), observe(0)) and torques, "the torque of tick 0")
    for step in (measure, observe):
        for tick in range(1, 1000):
            step(tick)
    watcher.spin_until(lambda: len(torques) == 1000, "the torques of all ticks")
    for tick in range(1000):
        compute(tick)
    assert torques == expected


def test_a_late_estimate_that_nobody_waits_for_does_not_begin_a_new_run(start: Start, watcher: Any) -> None:
    node(start, "controller", controller="pid")
    states = watcher.node.create_publisher(JointState, "/joint_states", 10)
    estimates = watcher.node.create_publisher(JointState, "/disturbance_estimate", 10)
    torques: dict[int, list[float]] = {}
    watcher.node.create_subscription(
        JointState, "/joint_torques", lambda m: torques.update({m.header.stamp.nanosec: list(m.effort)}), 10
    )
    watcher.spin_until(
        lambda: (
            states.get_subscription_count() == estimates.get_subscription_count() == 1
            and watcher.node.count_publishers("/joint_torques")
        ),
        "the controller",
    )
    scenario = load("paper", controller="pid")
    stage = ControllerStage(scenario)
    message = JointState(name=list(scenario.robot.joint_names), velocity=[0.0] * 3, effort=[0.0] * 3)
    expected: dict[int, list[float]] = {}
    for tick in range(20):
        time_ns = tick * scenario.dt_ns
        message.position = [0.02 * tick, 0.2, -0.1]
        message.header.stamp.nanosec = time_ns
        measured = Measurement(tuple(message.position), (0.0,) * 3, (0.0,) * 3)
        expected[time_ns] = list(stage.step(time_ns, measured, (0.0,) * 3)[0])
        watcher.spin_until(lambda t=time_ns: states.publish(message) or t in torques, f"tick {tick}'s torque")
        if tick > 3:  # an observer that is slow to answer tick 0
            estimates.publish(JointState(name=message.name, effort=[1.0] * 3))
    assert torques == expected


def test_the_reference_pages_are_up_to_date() -> None:
    run = subprocess.run(
        [*program("topics_page.py"), "--check", str(DOCS)],
        capture_output=True,
        text=True,
        check=False,
    )
    assert run.returncode == 0, run.stderr
