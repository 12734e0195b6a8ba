# SPDX-License-Identifier: Apache-2.0
"""Components of a user's own file over the graph: chosen and tuned by parameters, recorded, read back."""

from __future__ import annotations

import subprocess
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

pytest.importorskip("rclpy", reason="ROS 2 (rclpy) is not installed")

from sensor_msgs.msg import JointState

from ftcm_core.errors import FtcmError
from ftcm_core.registry import load_plugin
from ftcm_core.scenario import load
from ftcm_core.signals import Measurement
from ftcm_core.simulation import simulate
from ftcm_core.simulation.stages import ControllerStage
from ftcm_ros.bags.reader import read_bag
from ftcm_ros.transport.plane import qos
from ftcm_ros.transport.topics import ESTIMATE, JOINT_STATES, TORQUES
from plugins import registry_kept
from programs import program
from traces import same

pytestmark = pytest.mark.ros

OWN = """
import os
from pathlib import Path
from typing import ClassVar

from ftcm_core.controllers import Controller
from ftcm_core.detectors import Detector
from ftcm_core.params import joint_parameters, param
from ftcm_core.registry import register
from ftcm_core.signals import Detection


@register("controller", "own_law")
class OwnLaw(Controller):
    'PD with model; of the estimate a share, not more than `most`, and the rest at the next tick.'

    kp: float = param(60.0, unit="1/s²", above=0.0, per_joint=True, doc="gain", source="chosen")
    kd: float = param(16.0, unit="1/s", above=0.0, per_joint=True, doc="gain", source="chosen")
    share: float = param(
        0.7, unit="-", at_least=0.0, at_most=1.0, per_joint=True, doc="share", source="chosen"
    )
    most: float | None = param(
        None, unit="N·m", above=0.0, per_joint=True, optional=True, kind="float", doc="limit", source="chosen"
    )

    needs_observer: ClassVar[bool] = True

    def init(self, joints):
        return ((0.0,),) * joints

    def prepare(self, model, dt, y, reference, state):
        if file := os.environ.get("PREPARED"):
            Path(file).touch()
        a = [
            ar - p.kp * (q - qr) - p.kd * (v - vr)
            for p, q, v, qr, vr, ar in zip(
                joint_parameters(self, model.joints), y.position, y.velocity, *reference
            )
        ]
        return model.inverse_dynamics(y.position, y.velocity, tuple(a))

    def step(self, model, dt, y, reference, disturbance_estimate, state, prepared):
        u, kept = [], []
        parameters = joint_parameters(self, model.joints)
        for p, x, d, (rest,) in zip(parameters, prepared, disturbance_estimate, state):
            now = p.share * d if p.most is None else max(-p.most, min(p.most, p.share * d))
            u.append(x + now + rest)
            kept.append((d - now,))
        return tuple(u), tuple(kept)


@register("detector", "own_detector")
class OwnDetector(Detector):
    'Residual: the command of the tick before, less the torque that the drives report.'

    limit: float = param(1e-9, unit="N·m", above=0.0, per_joint=True, doc="largest", source="chosen")

    def init(self, joints):
        return (0.0,) * joints

    def step(self, model, dt, y, u, disturbance_estimate, state):
        assert disturbance_estimate == (0.0,) * model.joints, "it uses no observer, so it sees none"
        residual = tuple(x - e for x, e in zip(state, y.effort))
        limits = [p.limit for p in joint_parameters(self, model.joints)]
        return Detection(residual, tuple(float(abs(r) > x) for r, x in zip(residual, limits))), u
"""
OVERRIDES = ["injection.faults.0.start=0.3", "torque_limits=[60, 60, 40]"]


@pytest.fixture
def own(tmp_path: Path) -> Path:
    """The user's file."""
    file = tmp_path / "own.py"
    file.write_text(OWN, encoding="utf-8")
    return file


def analyse(*arguments: object) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [*program("analyse"), *map(str, arguments)], capture_output=True, text=True, check=False
    )


def check_that_the_bag_names_it(bag: Path, own: Path) -> None:
    """Without the plug-in, what the bag says is one line that tells what to do; with it, all is well."""
    with pytest.raises(FtcmError) as error:
        read_bag(bag)
    run = analyse(bag)
    assert (run.returncode, run.stdout) == (2, "")
    (line,) = run.stderr.strip().splitlines()
    for text in (line, str(error.value)):
        assert "no controller 'own_law'" in text
        assert f"the run used the plug-ins {own}: give them with --plugin" in text
    run = analyse(bag, "--plugin", own)
    assert run.returncode == 0, run.stderr
    assert "| ftcm" in run.stdout or "| own_law" in run.stdout


def test_a_law_and_a_detector_of_ones_own_are_chosen_and_tuned_by_parameters(
    live: Callable[..., Any], watcher: Any, tmp_path: Path, own: Path
) -> None:
    wanted = [*OVERRIDES, "detector=residual_threshold"]
    arguments = [a for o in (*wanted, "duration=600") for a in ("--set", o)]
    run = live("paper", "--controllers", "ftcm", "--plugin", "own.py", *arguments)
    run.first_tick(("controller", "ftcm"), ("detector", "residual_threshold"), ("observer", "do"))
    (descriptor,) = watcher.describe("controller", ["own_law.share"])
    assert descriptor.description == "share [-] (chosen)"
    ((taken, reason),) = watcher.set("controller", own_law__kp=-1.0)
    assert not taken
    assert "own_law.kp: -1 is out of range" in reason
    run.change("controller", controller="own_law", own_law__kp=[70.0, 80.0, 90.0], own_law__most=25.0)
    run.change("detector", detector="own_detector", own_detector__limit=0.5)
    run.interrupt()
    bag = tmp_path / "runs" / "test" / "bags" / "ftcm"
    check_that_the_bag_names_it(bag, own)
    with registry_kept():
        load_plugin(str(own))
        trace = read_bag(bag).trace
        assert [(c.kind, c.component.type_name) for c in trace.changes] == [
            *[("controller", "own_law")] * 3, *[("detector", "own_detector")] * 2,
        ]  # fmt: skip
        law, detector = (c.component for c in (trace.changes[2], trace.changes[4]))
        assert (law.kp, law.kd, law.share, law.most) == ((70.0, 80.0, 90.0), 16.0, 0.7, 25.0)
        assert detector.limit == 0.5
        # A plant that is stopped may have served some of its last measurement only.
        ticks = trace.ticks - 1
        assert trace.changes[-1].tick < ticks
        as_far = load("paper", [*wanted, f"duration={ticks / 1000}"], controller="ftcm")
        assert same(trace, simulate(as_far, trace.changes), slice(ticks))


def test_a_law_that_does_not_just_add_the_estimate_equals_the_in_process_run(
    experiment: Callable[..., Any], tmp_path: Path, own: Path
) -> None:
    """Chosen by the scenario, which names the file, together with the detector."""
    wanted = [*OVERRIDES, "detector=own_detector", "duration=0.6"]
    with registry_kept():
        load_plugin(str(own))
        scenario = load("paper", ["controller={type: own_law, most: 2}", *wanted])
        text = scenario.to_yaml().replace(str(own), own.name)
        expected = simulate(scenario)
        unlimited = simulate(load("paper", wanted, controller="own_law"))
    assert own.name in text
    assert str(own) not in text
    (tmp_path / "mine.yaml").write_text(text, encoding="utf-8")
    run = experiment("mine.yaml")
    assert run.returncode == 0, run.stderr
    bag = tmp_path / "runs" / "test" / "bags" / "own_law"
    check_that_the_bag_names_it(bag, own)
    with registry_kept():
        load_plugin(str(own))
        found = read_bag(bag)
        assert found.missing == {}
        assert same(found.trace, expected)
    assert not same(expected, unlimited), "the limit on the estimate has acted"
    assert expected.alarm is not None
    assert expected.alarm.any()


def test_it_is_prepared_while_the_observer_works(
    start: Callable[..., Any], watcher: Any, tmp_path: Path, own: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The measurement alone makes it compute what needs no estimate; the torque comes with the estimate."""
    prepared = tmp_path / "prepared"
    with registry_kept():
        load_plugin(str(own))
        scenario = load("paper", controller="own_law")
    monkeypatch.setenv("PREPARED", str(prepared))
    start("nodes.controller", "--ros-args", "-p", f"plugins:={own}", "-p", "controller:=own_law")
    monkeypatch.delenv("PREPARED")
    states = watcher.node.create_publisher(JointState, JOINT_STATES.name, qos(JOINT_STATES))
    estimates = watcher.node.create_publisher(JointState, ESTIMATE.name, qos(ESTIMATE))
    torques: dict[int, tuple[float, ...]] = {}
    watcher.node.create_subscription(
        JointState, TORQUES.name, lambda m: torques.update({m.header.stamp.nanosec: tuple(m.effort)}),
        qos(TORQUES),
    )  # fmt: skip
    watcher.spin_until(
        lambda: (
            states.get_subscription_count() == estimates.get_subscription_count() == 1
            and watcher.node.count_publishers(TORQUES.name)
        ),
        "the controller",
    )
    names, stage = list(scenario.robot.joint_names), ControllerStage(scenario)
    for tick in range(5):
        time_ns = tick * scenario.dt_ns
        y = Measurement((0.01 * tick, 0.2, -0.1), (0.5, 0.0, 0.1 * tick), (0.0,) * 3)
        tau_hat = (3.0 * tick, -30.0, 40.0)
        state = JointState(name=names, position=y.position, velocity=y.velocity, effort=y.effort)
        estimate = JointState(name=names, effort=tau_hat)
        state.header.stamp.nanosec = estimate.header.stamp.nanosec = time_ns
        states.publish(state)
        watcher.spin_until(prepared.exists, "the preparation")
        prepared.unlink()
        assert time_ns not in torques, "no torque without the estimate"
        estimates.publish(estimate)
        watcher.spin_until(lambda t=time_ns: t in torques, "the torque")
        assert torques[time_ns] == stage.step(time_ns, y, tau_hat)[0]
        assert not prepared.exists(), "prepared once"


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        ("import nowhere_at_all", "ModuleNotFoundError in line 1: No module named 'nowhere_at_all'"),
        ("x = (", "SyntaxError in line 1"),
        (OWN.replace('"own_law"', '"ftcm"'), "controller 'ftcm' is registered twice"),
    ],
    ids=["import", "syntax", "name taken"],
)
def test_what_is_wrong_in_a_plug_in_is_one_line_of_the_node(
    start: Callable[..., Any], domain: int, own: Path, text: str, reason: str
) -> None:
    own.write_text(text, encoding="utf-8")
    process = start("nodes.controller", "--ros-args", "-p", f"plugins:={own}")
    out, err = process.communicate(timeout=60)
    assert process.returncode == 2, err
    assert "Traceback" not in out + err
    (line,) = err.strip().splitlines()
    assert str(own) in line
    assert reason in line
