# SPDX-License-Identifier: Apache-2.0
"""The nodes with a robot that is not ours, and our plant under a controller that is not ours."""

from __future__ import annotations

import itertools
import json
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

pytest.importorskip("rclpy", reason="ROS 2 (rclpy) is not installed")

from diagnostic_msgs.msg import DiagnosticArray
from lifecycle_msgs.msg import Transition
from lifecycle_msgs.srv import ChangeState
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray
from std_srvs.srv import Trigger
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

from foreign_robot import COMMANDS, order_of
from ftcm_core.errors import FtcmError
from ftcm_core.references.start_blend import StartBlend
from ftcm_core.references.trajectory import Trajectory, Waypoint
from ftcm_core.scenario import Scenario, load
from ftcm_core.signals import NANOSECONDS, Measurement
from ftcm_core.simulation.stages import ControllerStage, InjectorStage, ObserverStage, PlantStage
from ftcm_ros.nodes import command_output
from ftcm_ros.timing.free_ticks import FreeTicks
from ftcm_ros.transport.codec import CodecError
from ftcm_ros.transport.float_array import FloatArray

DT_NS = 1_000_000
NAMES = ("joint1", "joint2", "joint3")

# Which tick a measurement is.


def counted(stamps: list[int]) -> tuple[list[int], list[int]]:
    """Return number and step of each measurement."""
    ticks, steps, numbers = FreeTicks(DT_NS), [], []
    for stamp in stamps:
        steps.append(ticks.count(stamp))
        numbers.append(ticks.tick)
    return numbers, steps


@given(st.integers(0, 10**18), st.lists(st.integers(-499_000, 499_000), min_size=1, max_size=300))
def test_stamps_that_jitter_by_less_than_half_a_tick_count_one_by_one(first: int, jitter: list[int]) -> None:
    stamps = [first + 10**6 + k * DT_NS + j for k, j in enumerate(jitter)]
    assert counted(stamps) == ([*range(len(stamps))], [1] * len(stamps))


@given(st.lists(st.integers(1, 5 * DT_NS), min_size=1, max_size=300))
def test_the_number_keeps_to_the_stamp_to_within_a_tick(gaps: list[int]) -> None:
    """Whatever was lost or came too often; and observers go on by at least one tick."""
    stamps = np.cumsum([10**9, *gaps]).tolist()
    numbers, steps = counted(stamps)
    assert all(abs(s - stamps[0] - n * DT_NS) <= DT_NS for s, n in zip(stamps, numbers))
    assert numbers == sorted(numbers)
    assert min(steps) == 1


def test_lost_measurements_are_skipped_ticks_and_too_many_are_counted() -> None:
    assert counted([0, DT_NS, 5 * DT_NS, 6 * DT_NS]) == ([0, 1, 5, 6], [1, 1, 4, 1])
    ticks = FreeTicks(DT_NS)
    for k in range(2000):
        ticks.count(k * DT_NS // 2)
    assert ticks.tick == 1000
    assert ticks.early == 999


# Torques as numbers without names.


def test_the_numbers_are_in_the_order_of_the_joints_named() -> None:
    array = FloatArray(NAMES, ("joint3", "joint1", "joint2"))
    assert array.decode(array.encode((1.0, 2.0, 3.0))) == (1.0, 2.0, 3.0)
    assert FloatArray(NAMES).decode(array.encode((1.0, 2.0, 3.0))) == (3.0, 1.0, 2.0)


@pytest.mark.parametrize("order", [("joint1",), ("joint1", "joint1", "joint2"), (*NAMES, "joint4")])
def test_joints_that_are_not_the_robots_are_refused(order: tuple[str, ...]) -> None:
    with pytest.raises(FtcmError, match=r"command_joints: .*; expected each of joint1, joint2, joint3 once"):
        FloatArray(NAMES, order)


@given(st.binary(max_size=80))
def test_bytes_that_are_no_command_are_refused(data: bytes) -> None:
    array = FloatArray(NAMES)
    for bad in (data, array.encode((1.0, 2.0, 3.0))[:-1], FloatArray(("a", "b")).encode((1.0, 2.0))):
        try:
            assert len(array.decode(bad)) == 3
        except CodecError:
            continue


# What goes out, by a clock of the test's own.


@pytest.mark.parametrize("last", ["zero", "hold", "gravity"])
@pytest.mark.parametrize("answered", [True, False])
def test_the_torque_goes_to_the_last_one_in_a_line(
    monkeypatch: pytest.MonkeyPatch, last: str, answered: bool
) -> None:
    """Also where no measurement is answered any more."""
    now, sent, array = 10**9, [], FloatArray(NAMES)
    monkeypatch.setattr(command_output, "time", SimpleNamespace(monotonic_ns=lambda: now))
    scenario = load("paper")
    node = SimpleNamespace(
        scenario=scenario,
        composition=object(),
        plane=SimpleNamespace(publisher=lambda topic: lambda data: sent.append(array.decode(data))),
    )
    settings = {"command_topic": "/c", "command_joints": "", "dry_run": False, "measurement_timeout": 0.1,
                "stop_command": last, "stop_ramp": 0.5}  # fmt: skip
    output = command_output.CommandOutput(node, settings, lambda: "nothing")
    y, u = Measurement((0.5, 0.2, -0.1), (0.0,) * 3, (0.0,) * 3), (10.0, -20.0, 30.0)
    output.send(output.torque(y, u))
    output.begin_end()
    goal = {"zero": (0.0,) * 3, "hold": u, "gravity": scenario.model.gravity(y.position)}[last]
    for share in (0.0, 0.25, 0.5, 0.75):
        now = 10**9 + round(share * 0.5e9)
        assert not output.at_end()
        if answered:
            output.send(output.torque(y, u))
        else:
            output.coast()
        assert sent[-1] == pytest.approx([a + share * (b - a) for a, b in zip(u, goal)], abs=1e-12)
    now = 10**9 + 10**9 // 2
    assert output.at_end()
    output.end()
    assert sent[-1] == pytest.approx(sent[-2] if last == "hold" else goal, abs=1e-12)


ros = pytest.mark.ros
Start = Callable[..., "subprocess.Popen[str]"]
SUPPORT = Path(__file__).resolve().parents[1] / "support"
ROBOT = {"command_interface": "float64_multi_array", "command_joints": ",".join(order_of(NAMES))}
"""Parameters of a controller with a robot, and of a plant that is one."""
NEVER = {"measurement_timeout": 0}
"""For tests that are about something else: a machine may be slow."""


def node(start: Start, name: str, **parameters: Any) -> subprocess.Popen[str]:
    """Start a node with parameters; `composed` is the observer and the controller in one process."""
    which = ["--nodes", "observer", "controller"] if name == "composed" else []
    arguments = [a for k, v in parameters.items() for a in ("-p", f"{k}:={v}")]
    return start(f"nodes.{name}", *which, "--ros-args", *arguments)


def written(folder: Path, *changes: str, controller: str = "ftcm") -> Scenario:
    """Write the paper's scenario, changed, to scenario.yaml."""
    scenario = load("paper", [*changes], controller=controller)
    (folder / "scenario.yaml").write_text(scenario.to_yaml(), encoding="utf-8")
    return scenario


def in_process(scenario: Scenario, ticks: int, ramp: float) -> list[Measurement]:
    """What the robot measures in a run with a gentle start, without any message."""
    plant, injector = PlantStage(scenario), InjectorStage(scenario)
    controller = ControllerStage(scenario)
    observer = ObserverStage(scenario.observer, scenario.model, scenario.dt)
    first = plant.measure()
    controller.reference = StartBlend(scenario.reference, 0.0, ramp, first.position, first.velocity)
    measured = []
    for tick in range(ticks):
        time_ns, y = tick * scenario.dt_ns, plant.measure()
        measured.append(y)
        u, _ = controller.step(time_ns, y, observer.step(y))
        plant.step(time_ns, u, injector.step(time_ns, *plant.motion, u))
    return measured


@ros
@pytest.mark.slow
@pytest.mark.parametrize("composed", [False, True])
def test_a_foreign_robot_is_driven_as_in_process_float_for_float(
    start: Start, domain: int, tmp_path: Path, composed: bool
) -> None:
    """Other names' order, another joint, stamps of a clock that jitters; a fault at 0.6 s."""
    ticks, ramp = 1000, 0.3
    scenario = written(tmp_path, "injection.faults.0.start=0.6")
    parameters = {"scenario": "scenario.yaml", "stamps": "free"}
    output = {**ROBOT, **NEVER, "start_ramp": ramp}
    if composed:
        node(start, "composed", **parameters, **output)
    else:
        node(start, "observer", **parameters)
        node(start, "controller", **parameters, **output)
    robot = subprocess.Popen(
        [sys.executable, str(SUPPORT / "foreign_robot.py"), "scenario.yaml", str(ticks), "measured.json"],
        cwd=tmp_path,
    )
    try:
        assert robot.wait(120) == 0
    finally:
        robot.kill()
    measured = json.loads((tmp_path / "measured.json").read_text("utf-8"))
    expected = in_process(scenario, ticks, ramp)
    assert measured == [[list(values) for values in y] for y in expected]
    error = [
        abs(q - r)
        for tick in range(500, ticks)
        for q, r in zip(measured[tick][0], scenario.reference.at(tick * scenario.dt, 3).position)
    ]
    assert max(error) < 5e-4  # rad; 3.1e-4 at the fault's onset


class Robot:
    """Measurements by hand, and what comes for them."""

    def __init__(self, watcher: Any) -> None:
        self.watcher = watcher
        self.commands: list[list[float]] = []
        self.torques: dict[int, list[float]] = {}
        self.health: dict[str, str] = {}
        self.level = b""
        self.stamp = 1_700_000_000 * NANOSECONDS
        made = watcher.node
        self.states = made.create_publisher(JointState, "/joint_states", 10)
        made.create_subscription(Float64MultiArray, COMMANDS, self._on_command, 100)
        made.create_subscription(JointState, "/joint_torques", self._on_torque, 100)
        made.create_subscription(DiagnosticArray, "/diagnostics", self._on_diagnostics, 10)

    def _on_command(self, message: Float64MultiArray) -> None:
        by_name = dict(zip(order_of(NAMES), message.data))
        self.commands.append([by_name[name] for name in NAMES])

    def _on_torque(self, message: JointState) -> None:
        stamp = message.header.stamp.sec * NANOSECONDS + message.header.stamp.nanosec
        self.torques[stamp] = list(message.effort)

    def _on_diagnostics(self, message: DiagnosticArray) -> None:
        for status in message.status:
            self.level = status.level
            self.health = {"message": status.message, **{v.key: v.value for v in status.values}}

    def measure(self, position: list[float], velocity: list[float], effort: list[float]) -> list[float]:
        """Publish a measurement, a tick after the last, until it is answered; return the torque."""
        self.stamp += DT_NS
        message = JointState(name=list(NAMES), position=position, velocity=velocity, effort=effort)
        message.header.stamp.sec, message.header.stamp.nanosec = divmod(self.stamp, NANOSECONDS)

        def answered() -> bool:
            torque = self.torques.get(self.stamp)
            return torque is not None and (not self.has_commands or self.commands[-1:] == [torque])

        self.watcher.spin_until(lambda: self.states.publish(message) or answered(), "an answer")
        return self.torques[self.stamp]

    has_commands = True
    """Whether commands are expected."""

    def change(self, transition: int) -> None:
        """Have the controller make a transition."""
        request = ChangeState.Request(transition=Transition(id=transition))
        assert self.watcher.call(ChangeState, "/controller/change_state", request).success


@pytest.fixture
def robot(watcher: Any) -> Robot:
    """A robot of the test's own."""
    return Robot(watcher)


def controller(start: Start, **parameters: Any) -> None:
    """Start a controller of a robot, whose law needs no observer."""
    node(start, "controller", scenario="scenario.yaml", stamps="free", **ROBOT, **{**NEVER, **parameters})


REST = [0.0] * 3
AWAY = [1.0, -1.0, 1.0]
"""Far from the reference of the paper at its start, rad."""


@ros
def test_torques_keep_to_the_limits_from_the_measured_effort_on(
    start: Start, robot: Robot, tmp_path: Path
) -> None:
    most, rate = 20.0, 3000.0  # N·m, N·m/s
    written(tmp_path, f"torque_limits={most}", f"torque_rate_limits={rate}", controller="pid")
    controller(start, start_ramp=0)
    effort = [5.0, -25.0, 0.0]
    before = [max(-most, min(most, x)) for x in effort]
    for _ in range(30):
        torque = robot.measure(AWAY, REST, effort)
        assert all(abs(x) <= most for x in torque)
        assert all(abs(x - b) <= rate * 1e-3 + 1e-9 for x, b in zip(torque, before))
        before = torque
    assert sorted(map(abs, torque)) == [most] * 3
    robot.watcher.spin_until(lambda: int(robot.health.get("clipped", 0)) == 30, "all torques clipped")
    assert robot.level >= b"\x01"  # a slow machine may make it an error
    assert "30 torques clipped, last: joint1: torque" in robot.health["message"]


@ros
def test_nothing_jumps_at_the_start(start: Start, robot: Robot, tmp_path: Path) -> None:
    """A robot at rest away from the reference is first held where it is: by gravity's torque."""
    scenario = written(tmp_path, controller="ctc")
    controller(start, start_ramp=2)
    gravity = scenario.model.gravity(tuple(AWAY))
    assert robot.measure(AWAY, REST, REST) == pytest.approx(gravity, abs=1e-9)


@ros
def test_a_dry_run_computes_and_publishes_no_command(start: Start, robot: Robot, tmp_path: Path) -> None:
    written(tmp_path, controller="pid")
    controller(start, dry_run="true")
    robot.has_commands = False
    for _ in range(20):
        robot.measure(AWAY, REST, REST)
    assert robot.watcher.node.count_publishers(COMMANDS) == 0
    assert robot.commands == []
    robot.watcher.spin_until(lambda: "dry run, no command" in robot.health.get("message", ""), "its report")
    assert robot.health["commands_published"] == "0"


@ros
@pytest.mark.slow
def test_a_dead_publisher_stops_the_controller_until_it_is_activated_again(
    start: Start, robot: Robot, tmp_path: Path
) -> None:
    scenario = written(tmp_path, controller="pid")
    controller(start, measurement_timeout=1, stop_command="gravity")
    robot.measure(AWAY, REST, REST)
    robot.watcher.spin_until(lambda: robot.health.get("stopped"), "the stop")
    assert robot.level == b"\x02"
    assert robot.health["stopped"].startswith("no joint_states that can be used for ")
    gravity = scenario.model.gravity(tuple(AWAY))
    robot.watcher.spin_until(
        lambda: robot.commands[-1] == pytest.approx(gravity, abs=1e-9), "the last torque"
    )
    published = int(robot.health["commands_published"])
    assert published == len(robot.commands)
    late = JointState(name=list(NAMES), position=AWAY, velocity=REST, effort=REST)
    late.header.stamp.sec, late.header.stamp.nanosec = divmod(robot.stamp + DT_NS, NANOSECONDS)
    ticks = int(robot.health["ticks"])
    robot.watcher.spin_until(
        lambda: robot.states.publish(late) or int(robot.health["ticks"]) > ticks, "a late measurement taken"
    )
    assert len(robot.commands) == published
    robot.change(Transition.TRANSITION_DEACTIVATE)
    robot.change(Transition.TRANSITION_ACTIVATE)
    robot.stamp += 5 * NANOSECONDS
    robot.measure(AWAY, REST, REST)


@ros
def test_a_joint_beyond_its_limits_stops_the_controller(start: Start, robot: Robot, tmp_path: Path) -> None:
    written(tmp_path, "velocity_limits=2", controller="pid")
    controller(start)
    robot.measure(AWAY, REST, REST)
    message = JointState(name=list(NAMES), position=AWAY, velocity=[0.0, 2.5, 0.0], effort=REST)
    message.header.stamp.sec, message.header.stamp.nanosec = divmod(robot.stamp + DT_NS, NANOSECONDS)
    robot.watcher.spin_until(lambda: robot.states.publish(message) or robot.health.get("stopped"), "the stop")
    assert robot.health["stopped"] == "joint2: velocity 2.5 rad/s is beyond its limit of 2 rad/s"
    robot.watcher.spin_until(lambda: robot.commands[-1] == REST, "zero torque")


@ros
def test_deactivation_leads_to_the_last_torque_by_steps(start: Start, robot: Robot, tmp_path: Path) -> None:
    written(tmp_path, controller="pid")
    controller(start, stop_ramp=0.3)
    torque = robot.measure(AWAY, REST, REST)
    published = len(robot.commands)
    robot.change(Transition.TRANSITION_DEACTIVATE)
    robot.watcher.spin_until(lambda: robot.commands[-1] == REST, "zero torque")
    last = robot.commands[published - 1 :]
    assert last[0] == torque
    for before, after in itertools.pairwise(last):
        assert all(abs(a) <= abs(b) + 1e-12 for a, b in zip(after, before))


@ros
@pytest.mark.slow
def test_a_trajectory_is_followed_and_a_bad_one_changes_nothing(
    start: Start, robot: Robot, tmp_path: Path
) -> None:
    written(tmp_path, controller="ctc")
    controller(start, start_ramp=0, reference_topic="/joint_trajectory")
    references: dict[int, list[float]] = {}

    def on_reference(message: JointState) -> None:
        stamp = message.header.stamp.sec * NANOSECONDS + message.header.stamp.nanosec
        references[stamp] = list(message.position)

    robot.watcher.node.create_subscription(JointState, "/reference", on_reference, 100)
    publisher = robot.watcher.node.create_publisher(JointTrajectory, "/joint_trajectory", 10)

    def send(names: list[str], count: str) -> None:
        message = JointTrajectory(joint_names=names)
        point = JointTrajectoryPoint(positions=[3.0, 1.0, 2.0], velocities=[0.0] * 3)
        point.time_from_start.nanosec = 20 * DT_NS
        message.points = [point]
        robot.watcher.spin_until(publisher.get_subscription_count, "its subscriber")
        publisher.publish(message)
        robot.watcher.spin_until(lambda: int(robot.health.get(count, 0)), count)

    def reference() -> list[float]:
        robot.measure(AWAY, REST, REST)
        robot.watcher.spin_until(lambda: robot.stamp in references, "a reference")
        return references[robot.stamp]

    assert [reference() for _ in range(5)] == [AWAY] * 5
    send(["joint3", "joint1", "joint2"], "trajectories_taken")
    begin = 4 * 1e-3
    motion = Trajectory(
        (Waypoint(begin, tuple(AWAY), (0.0,) * 3), Waypoint(begin + 0.02, (1.0, 2.0, 3.0), (0.0,) * 3))
    )
    for tick in range(5, 40):
        assert reference() == pytest.approx(motion.at(tick * 1e-3, 3).position, abs=1e-9)
        if tick == 10:
            send(["joint3", "joint1"], "trajectories_refused")
            assert (
                "joint_names: joint3, joint1; expected each of joint1, joint2, joint3 once"
                in (robot.health["message"])
            )
            assert robot.level >= b"\x01"  # a slow machine may make it an error
    assert robot.health["trajectories_taken"] == "1"


@ros
@pytest.mark.parametrize(
    ("name", "parameters", "text"),
    [
        (
            "controller",
            {**ROBOT, "command_joints": "joint1,joint2"},
            "expected each of joint1, joint2, joint3",
        ),
        ("controller", {"dry_run": "true"}, "dry_run: needs command_interface: float64_multi_array"),
        ("controller", {**ROBOT, "start_ramp": -1}, "start_ramp: -1 is out of range; expected a number"),
        ("controller", {**ROBOT, "stop_command": "brake"}, "stop_command: no 'brake'"),
        ("controller", {**ROBOT, "data_path": "executor"}, "expected listener or waitset"),
        ("plant", {"stamps": "free"}, "stamps: free needs command_interface: float64_multi_array"),
        ("plant", {**ROBOT, "mode": "lockstep"}, "expected mode: real_time"),
    ],
)
def test_what_does_not_go_together_is_one_line(
    start: Start, domain: int, name: str, parameters: dict[str, Any], text: str
) -> None:
    process = node(start, name, **parameters)
    out, err = process.communicate(timeout=60)
    assert process.returncode == 2, err
    assert "Traceback" not in out + err
    (line,) = [x for x in err.splitlines() if "error" in x]
    assert text in line


@ros
def test_our_plant_is_a_robot_for_other_controllers(start: Start, watcher: Any, tmp_path: Path) -> None:
    """It takes torques in the order of the joints named, publishes the ROS clock, and has our faults."""
    push = 7.0  # N·m, on joint 2
    faults = (
        f"[{{type: external_torque, joint: 2, torque: {push}, trigger: hand}}, "
        "{type: free_joint, joint: 1, trigger: hand}]"
    )
    written(tmp_path, f"injection.faults={faults}", "injection.disturbances=[]", "duration=1000")
    node(start, "plant", scenario="scenario.yaml", stamps="free", **ROBOT)
    states: list[JointState] = []
    truths: list[JointState] = []
    watcher.node.create_subscription(JointState, "/joint_states", states.append, 10)
    watcher.node.create_subscription(JointState, "/true_state", truths.append, 10)
    commands = watcher.node.create_publisher(Float64MultiArray, COMMANDS, 10)
    command = Float64MultiArray(data=[3.0, 1.0, 2.0])
    clock = watcher.node.get_clock().now().nanoseconds / NANOSECONDS

    def acts(array: list[JointState], *torque: float) -> bool:
        commands.publish(command)
        if not array or list(array[-1].effort) != pytest.approx(torque, abs=1e-12):
            array.clear()
            return False
        return True

    watcher.spin_until(lambda: acts(states, 1.0, 2.0, 3.0), "the command of others")
    assert abs(states[-1].header.stamp.sec - clock) < 600
    watcher.spin_until(lambda: acts(truths, 1.0, 2.0, 3.0), "nothing is broken yet")
    for label in ("external_torque_0", "free_joint_0"):
        answer = watcher.call(Trigger, f"/plant/faults/{label}/arm", Trigger.Request())
        assert answer.success, answer.message
    watcher.spin_until(lambda: acts(truths, 0.0, 2.0 + push, 3.0), "both faults")
    watcher.spin_until(lambda: acts(states, 1.0, 2.0, 3.0), "drives that notice nothing")
