# SPDX-License-Identifier: Apache-2.0
"""What the isolating detector says of faults of the PUMA, and what it cannot tell."""

from __future__ import annotations

import numpy as np
import pytest

from ftcm_core.detectors import VERDICTS
from ftcm_core.detectors.isolating import Isolating, judged
from ftcm_core.faults import AdditiveFault
from ftcm_core.params import param
from ftcm_core.recording.detection import detection_scores, pooled_scores
from ftcm_core.recording.trace import Trace
from ftcm_core.registry import find, register
from ftcm_core.robots import Robot
from ftcm_core.scenario import load
from ftcm_core.signals import Vector
from ftcm_core.simulation import simulate
from plugins import registry_kept

pytestmark = pytest.mark.pure

QUIET = ["injection.disturbances=[]", "reference={type: sine, amplitude: 0.5, frequency: 0.5}"]
ENCODER = "sensor={type: encoder, resolution: 1e-5, noise: 1e-5}"


def run(fault: str, *more: str, detector: str = "threshold: [3, 3, 1]") -> Trace:
    """A run of the PUMA, with a fault from t = 1 s."""
    overrides = [*QUIET, f"detector={{type: isolating, {detector}}}", "duration=2", *more]
    found = simulate(
        load("paper", [*overrides, f"injection.faults=[{fault}]" if fault else "injection.faults=[]"])
    )
    assert found.status == "completed"
    return found


def judgement(trace: Trace) -> tuple[str, int]:
    """Verdict and joint of the only fault, which is detected; no false alarm."""
    scores = detection_scores(trace)
    assert scores is not None
    (fault,) = scores["faults"]
    assert fault["detected"]
    assert scores["false_alarms"] == 0
    return fault["verdict"], fault["verdict_joint"]


@pytest.mark.parametrize("joint", [1, 2, 3])
@pytest.mark.parametrize("sensor", ["sensor=ideal", ENCODER])
def test_faults_of_a_sensor_are_named_with_their_joint(sensor: str, joint: int) -> None:
    """A step of 10 mrad of the position, and 0.1 rad/s of the velocity."""
    for bias in ("bias: 0.01", "bias: 0, velocity_bias: 0.1"):
        fault = f"{{type: sensor_bias, start: 1, joint: {joint}, {bias}}}"
        assert judgement(run(fault, sensor)) == ("sensor", joint), bias


@pytest.mark.parametrize("joint", [2, 3])
@pytest.mark.parametrize("sensor", ["sensor=ideal", ENCODER])
def test_loss_of_effectiveness_is_named_with_its_joint(sensor: str, joint: int) -> None:
    """40 % of the torque of a joint under its weight."""
    fault = f"{{type: loss_of_effectiveness, start: 1, loss: 0.4, joint: {joint}}}"
    assert judgement(run(fault, sensor)) == ("loss_of_effectiveness", joint)


@pytest.mark.parametrize("joint", [1, 2, 3])
@pytest.mark.parametrize("sensor", ["sensor=ideal", ENCODER])
def test_an_added_torque_is_named_with_its_joint(sensor: str, joint: int) -> None:
    """5 N·m that nobody reports: a bias of the drive or an outer force, which is the same to the joint."""
    with registry_kept():

        @register("fault", "test_push")
        class Push(AdditiveFault):
            """A constant torque: ω = 5 N·m."""

            push: float = param(5.0, unit="N·m", doc="torque", source="chosen")

            def omega(self, robot: Robot, t: float, q: Vector, v: Vector, u: Vector) -> Vector:
                """The same for every joint."""
                return (self.push,) * len(q)

        assert find("fault", "test_push") is Push
        fault = f"{{type: test_push, start: 1, joint: {joint}}}"
        assert judgement(run(fault, sensor)) == ("added_torque", joint)


def test_a_payload_is_taken_for_a_loss() -> None:
    """What it cannot tell: too weak a drive from too heavy an arm, where weight makes the torque."""
    trace = run("{type: payload_pickup, start: 1, mass: 4}", detector="threshold: [5, 5, 2]")
    assert judgement(trace) == ("loss_of_effectiveness", 3)


def test_nothing_is_said_before_the_fault() -> None:
    """No alarm, no verdict; the verdict is unknown before it is decided."""
    trace = run("{type: loss_of_effectiveness, start: 1, loss: 0.4, joint: 2}")
    assert trace.verdict is not None
    assert trace.alarm is not None
    assert not trace.verdict[500:1001].any()
    assert set(trace.verdict[1050:1400, 1].tolist()) == {1.0}
    assert np.array_equal(trace.verdict > 0, trace.alarm > 0)


def judge(r: np.ndarray, w: np.ndarray, *, own: float = 0.0, sensor: float = 0.0, since: float = 1.0) -> str:
    """The verdict of some residuals and torques."""
    one = float(len(r))
    sums = (float(r @ r), float(r @ w), float(w @ w), float(r.sum()), one)
    return VERDICTS[int(judged(1.0, own, sensor, since, 0.4, 0.05, *sums))]


W = 20.0 + 10.0 * np.sin(np.arange(200) / 20.0)


def test_the_judgement_of_made_up_residuals() -> None:
    """Also what it cannot tell: under a constant torque, a lost share and an added torque are the same."""
    assert judge(-0.3 * W, W) == "loss_of_effectiveness"
    assert judge(np.full(200, 4.0), W) == "added_torque"
    assert judge(0.3 * W, W) == "unknown", "a drive does not gain"
    assert judge(-1.5 * W, W) == "unknown", "nor lose more than it has"
    assert judge(10.0 * np.sin(np.arange(200) / 7.0), W) == "unknown"
    assert judge(-0.3 * np.full(200, 20.0), np.full(200, 20.0)) == "unknown"
    assert judge(-0.3 * W, W, since=0.3) == "unknown", "too early"
    assert judge(-0.3 * W, W, sensor=0.1) == "unknown", "another sensor is wrong"
    assert judge(-0.3 * W, W, own=0.1) == "sensor"
    assert judged(0.0, 0.0, 0.0, 0.0, 0.4, 0.05, 0.0, 0.0, 0.0, 0.0, 0.0) == 0.0


def test_the_isolation_of_many_runs_is_counted() -> None:
    """By the true type and the verdict."""
    scores = [
        detection_scores(run(f"{{type: {fault}, start: 1, joint: 2}}"))
        for fault in ("sensor_bias", "loss_of_effectiveness, loss: 0.4")
    ]
    found = pooled_scores([one for one in scores if one is not None])["isolation"]
    assert found["sensor_bias"] == {**dict.fromkeys(VERDICTS, 0), "sensor": 1}
    assert found["loss_of_effectiveness"] == {**dict.fromkeys(VERDICTS, 0), "loss_of_effectiveness": 1}


def test_a_robot_without_model_error_is_never_judged() -> None:
    """Defaults, no fault, no noise."""
    trace = run("", detector="threshold: 0.1, motion_threshold: 0.001")
    assert Isolating().threshold == 10.0
    assert trace.alarm is not None
    assert not trace.alarm.any()
