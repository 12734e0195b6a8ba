# SPDX-License-Identifier: Apache-2.0
"""What the residuals show, and what not: in runs and in made-up measurements."""

from __future__ import annotations

import math

import numpy as np
import pytest

from ftcm_core.detectors.residual_threshold import ResidualThreshold
from ftcm_core.robots.puma560 import Puma560
from ftcm_core.scenario import load
from ftcm_core.signals import Measurement
from ftcm_core.simulation import simulate
from ftcm_core.simulation.stages import DetectorStage

DT, GAIN = 1e-3, 50.0
ROBOT, ZERO = Puma560(), (0.0, 0.0, 0.0)
QUIET = ["injection.disturbances=[]", "reference={type: sine, amplitude: 0.5, frequency: 0.5}"]


def residual(residual: str, overrides: list[str], duration: float = 0.6) -> np.ndarray:
    """Residuals of a run, shape (ticks, joints)."""
    detector = f"detector={{type: residual_threshold, residual: {residual}, gain: {GAIN}}}"
    trace = simulate(load("paper", [*QUIET, f"duration={duration}", detector, *overrides]))
    assert trace.status == "completed"
    assert trace.residual is not None
    return trace.residual


def test_momentum_follows_an_added_torque_with_its_pole() -> None:
    """Drives that hold the weight, and a constant torque more: r = (1 - E^(-K t)) d of every joint.

    The motion is integrated with the midpoint rule, as the residual has it.
    """
    added = (3.0, -2.0, 1.0)
    q, v, held = (0.3, -0.4, 0.7), ZERO, ROBOT.gravity((0.3, -0.4, 0.7))
    total = tuple(map(float.__add__, held, added))
    detector = ResidualThreshold(residual="momentum", gain=GAIN)
    state, found = detector.init(3), []
    for _ in range(201):
        seen, state = detector.step(ROBOT, DT, Measurement(q, v, held), ZERO, ZERO, state)
        found.append(seen.residual)
        a = ROBOT.forward_dynamics(q, v, total)
        halfway = [tuple(x + 0.5 * DT * rate for x, rate in zip(*pair)) for pair in ((q, v), (v, a))]
        a = ROBOT.forward_dynamics(*halfway, total)
        q, v = (tuple(x + DT * rate for x, rate in zip(*pair)) for pair in ((q, halfway[1]), (v, a)))
    assert found[0] == ZERO
    expected = [[(1.0 - math.exp(-GAIN * k * DT)) * d for d in added] for k in range(201)]
    assert np.array(found) == pytest.approx(np.array(expected), abs=2e-4)
    assert found[-1] == pytest.approx(added, rel=1e-3), "E^(-10) is left"


def test_momentum_does_not_react_to_motion_of_an_exact_model() -> None:
    """With up to 100 N·m: what is left is the midpoint rule, whose error falls with dt²."""
    coarse = np.abs(residual("momentum", []))
    fine = np.abs(residual("momentum", ["dt=0.0005"]))
    assert coarse.max() < 2e-3
    assert coarse[300:].max() / fine[600:].max() == pytest.approx(4.0, rel=0.3)


def test_momentum_sees_what_the_drive_does_not_report() -> None:
    """Half of the effectiveness of joint 2 lost: r follows what is lost, others stay."""
    fault = ["injection.faults=[{type: loss_of_effectiveness, start: 0.3, joint: 2, loss: 0.5}]"]
    trace = simulate(
        load("paper", [*QUIET, *fault, "duration=0.6", "detector={type: cusum, residual: momentum}"])
    )
    assert trace.residual is not None
    assert trace.joint_torque is not None
    lost = trace.joint_torque - trace.effort
    assert np.abs(lost[400:, 1]).min() > 5.0
    low_passed = np.zeros(3)
    for k in range(1, trace.ticks):
        low_passed += (1.0 - math.exp(-GAIN * DT)) * (lost[k] - low_passed)
        assert trace.residual[k] == pytest.approx(low_passed, abs=5e-3)


def motion(positions: np.ndarray, velocities: np.ndarray) -> np.ndarray:
    """Residual of the motion of made-up measurements of one joint, thrice."""
    detector = ResidualThreshold(residual="motion", gain=GAIN)
    state, found = detector.init(3), []
    for q, v in zip(positions.tolist(), velocities.tolist()):
        seen, state = detector.step(ROBOT, DT, Measurement((q,) * 3, (v,) * 3, ZERO), ZERO, ZERO, state)
        found.append(seen.residual[1])
    return np.array(found)


TIME = np.arange(1000) * DT
LATE = TIME > 0.5
Q, V = np.sin(3.0 * TIME), 3.0 * np.cos(3.0 * TIME)
since = np.where(LATE, TIME - 0.5, 0.0)


def test_motion_is_silent_while_positions_and_velocities_belong_together() -> None:
    """The trapezoid is off by dt² q⁗/12: 7e-6 rad/s."""
    assert np.abs(motion(Q, V)).max() < DT**2 * 27.0 / 12.0 * 1.01


def test_motion_shows_each_fault_of_a_sensor_by_its_own_mark() -> None:
    """A step decays from L times its size; a velocity bias, drift, gain and freeze show while they last."""
    step = motion(Q + 0.01 * LATE, V)
    first = int(np.argmax(LATE))
    assert step[first] == pytest.approx((1.0 - math.exp(-GAIN * DT)) * 0.01 / DT, rel=1e-3)
    assert step[first + 40] / step[first] == pytest.approx(math.exp(-GAIN * 0.04), rel=1e-3)
    bias = motion(Q, V + 0.2 * LATE)
    assert bias[-1] == pytest.approx(-0.2, rel=1e-3)
    drift = motion(Q + 0.1 * since, V)
    assert drift[-1] == pytest.approx(0.1, rel=1e-3)
    gain = motion(Q * np.where(LATE, 1.1, 1.0), V)
    assert np.abs(gain[first + 100 :] - 0.1 * V[first + 100 :]).max() < 0.1
    frozen = motion(np.where(LATE, Q[first], Q), V)
    assert np.abs(frozen[first + 100 :] + V[first + 100 :]).max() < 0.2
    assert np.abs(frozen[-1]) > 1.0


def test_motion_does_not_see_what_changes_both_alike() -> None:
    """A sensor that freezes at rest, and a drift that the velocity has too, are no contradiction."""
    assert motion(np.full(100, 0.3), np.zeros(100)).tolist() == [0.0] * 100
    healthy, drifting = motion(Q, V), motion(Q + 0.1 * since, V + 0.1 * LATE)
    later = int(np.argmax(LATE)) + 1
    assert drifting[later + 300 :] == pytest.approx(healthy[later + 300 :], abs=1e-7)


def test_motion_reacts_to_the_sensor_and_not_to_the_actuator() -> None:
    """Runs: a bias of 1 mrad, or the random walk of a drift, is far beyond what a loss of 30 % does to it."""
    healthy = np.abs(residual("motion", [])).max()
    lost = np.abs(residual("motion", ["injection.faults=[{type: loss_of_effectiveness, start: 0.3}]"])).max()
    assert lost == pytest.approx(healthy, abs=1e-4), "the trapezoid follows a kink of the velocity"
    for fault in ("bias, bias: 0.001", "bias, bias: 0, velocity_bias: 0.1", "drift, walk: 0.01"):
        seen = residual("motion", [f"injection.faults=[{{type: sensor_{fault}, start: 0.3, joint: 2}}]"])
        assert np.abs(seen[:301]).max() <= healthy, fault
        assert np.abs(seen[301:, 1]).max() > 10.0 * lost, fault


def test_a_detector_of_another_residual_starts_afresh() -> None:
    """Its state is of another structure; one of the same goes on."""
    stage = DetectorStage(load("paper", ["detector={type: residual_threshold, residual: momentum}"]))
    y = Measurement((0.1, 0.2, 0.3), (1.0, 1.0, 1.0), ZERO)
    stage.step(y, ZERO, ZERO)
    before = stage.state
    stage.swap(ResidualThreshold(residual="momentum", threshold=3.0))
    assert stage.state is before
    stage.swap(ResidualThreshold(residual="motion"))
    assert stage.state == ResidualThreshold(residual="motion").init(3)
