# SPDX-License-Identifier: Apache-2.0
"""Faults of every site: their effect on the recorded signals, worked out from the trace itself."""

from __future__ import annotations

import math
from itertools import pairwise

import numpy as np
import pytest

from ftcm_core import compiled
from ftcm_core.errors import ScenarioError
from ftcm_core.faults import TOPICS
from ftcm_core.random_streams import gaussian, stream_key, uniform
from ftcm_core.recording.trace import Trace
from ftcm_core.scenario import Scenario, from_mapping, load
from ftcm_core.signals import Measurement
from ftcm_core.simulation import simulate
from ftcm_core.simulation.stages import robot_changes
from plugins import robots_known, scenario_mapping
from traces import close, rows_of, same

START, DT = 0.05, 1e-3
FIRST = 51
"""First tick after the onset."""
LOSS = "{type: loss_of_effectiveness, start: 0.05, loss: [0.1, 0.5, 0.9]}"
BIAS = "{type: sensor_bias, start: 0.05, bias: [0.01, -0.02, 0]}"
PAYLOAD = "{type: payload_pickup, start: 0.05, mass: 2}"
DROPS = "{type: dropped_messages, start: 0.05, probability: 0.3, topic: %s}"
ADDITIVE = "{type: vo_kang_fault, start: 0.05}"


def scenario(*faults: str, more: tuple[str, ...] = ()) -> Scenario:
    """The paper's experiment, 0.2 s of it, with faults of its own."""
    return load("paper", ["duration=0.2", f"injection.faults=[{', '.join(faults)}]", *more])


def run(*faults: str, more: tuple[str, ...] = ()) -> Trace:
    """Simulate it."""
    return simulate(scenario(*faults, more=more))


def after(trace: Trace, rate: float = math.inf) -> np.ndarray:
    """ψ at every tick, of shape (ticks, 1), by eq 4."""
    since = trace.time[:, None] - START
    with np.errstate(invalid="ignore"):
        return np.where(since > 0.0, 1.0 if math.isinf(rate) else 1.0 - np.exp(-rate * since), 0.0)


# Actuators.


@pytest.mark.parametrize(
    ("more", "rate", "severity"),
    [("", math.inf, 1.0), ("profile: incipient, rate: 20", 20.0, 1.0), ("severity: 0.5", math.inf, 0.5)],
)
def test_loss_of_effectiveness(more: str, rate: float, severity: float) -> None:
    """Torque on the joints = (1 - ψ loss) effort + disturbance; the drives report what was asked for."""
    trace = run(LOSS.replace("}", f", {more}}}" if more else "}"))
    assert trace.joint_torque is not None
    loss = np.array([0.1, 0.5, 0.9])
    share = 1.0 - severity * loss * after(trace, rate)[:-1]
    expected = trace.effort[1:] * share + trace.disturbance[:-1]
    assert trace.joint_torque[1:] == pytest.approx(expected, rel=1e-13, abs=1e-13)
    assert np.array_equal(trace.effort[1:], trace.command[:-1])
    lost = (trace.effort[1:] * (1.0 - share))[FIRST:]
    assert (np.abs(lost).max(axis=0) > 0.5).all(), "the loss is one that matters"
    healthy = run(LOSS.replace("0.05", "9"))
    assert same(trace, healthy, slice(FIRST + 1))
    assert not np.array_equal(trace.velocity[FIRST + 1], healthy.velocity[FIRST + 1])


# Sensors.


def test_a_constant_bias() -> None:
    """Measured = true + bias after the onset, exactly the true motion before; the velocity is not off."""
    trace = run(BIAS)
    assert trace.measured_position is not None
    off = trace.measured_position - trace.position
    assert off == pytest.approx(np.array([0.01, -0.02, 0.0]) * after(trace), abs=1e-15)
    assert np.array_equal(trace.measured_position[:FIRST], trace.position[:FIRST])
    assert np.array_equal(trace.measured_velocity, trace.velocity)
    assert np.array_equal(trace.joint_torque[1:], trace.effort[1:] + trace.disturbance[:-1])


def test_a_steady_drift_is_in_the_velocity_too() -> None:
    """Position off by drift (t - T_f), velocity by drift; both grown by ψ."""
    trace = run("{type: sensor_drift, start: 0.05, drift: [0.3, 0, -0.1], profile: incipient, rate: 20}")
    assert trace.measured_position is not None
    assert trace.measured_velocity is not None
    drift, psi = np.array([0.3, 0.0, -0.1]), after(trace, 20.0)
    since = np.maximum(trace.time - START, 0.0)[:, None]
    assert trace.measured_position - trace.position == pytest.approx(psi * drift * since, abs=1e-15)
    assert trace.measured_velocity - trace.velocity == pytest.approx(psi * drift, abs=1e-14)


def test_a_random_walk_is_that_of_its_stream() -> None:
    """Steps of walk √dt times the stream's numbers, from the onset on; another seed is another walk."""
    fault = "{type: sensor_drift, start: 0.05, drift: 0, walk: [0.02, 0.01, 0]}"
    trace, again, other = run(fault), run(fault), run(fault, more=("seed=1",))
    assert same(trace, again)
    assert not same(trace, other)
    assert same(trace, other, slice(FIRST))
    assert trace.measured_position is not None
    key = stream_key(0, "fault.sensor_drift.0")
    steps = np.zeros((trace.ticks, 3))
    for k in range(FIRST, trace.ticks):
        for joint, intensity in enumerate((0.02, 0.01, 0.0)):
            steps[k, joint] = intensity * math.sqrt(DT) * gaussian(key, float(3 * k + joint))
    walk = np.cumsum(steps, axis=0)
    assert trace.measured_position - trace.position == pytest.approx(walk, abs=1e-14)
    assert np.abs(walk[-1, :2]).min() > 1e-5


def test_a_walk_spreads_as_it_says() -> None:
    """Standard deviation walk √t over 400 seeds."""
    ends = []
    for seed in range(400):
        found = scenario("{type: sensor_drift, start: 0, drift: 0, walk: 0.02}", more=(f"seed={seed}",))
        (fault,) = found.faults
        state = fault.init(3, stream_key(seed, "fault.sensor_drift.0"))  # type: ignore[attr-defined]
        for k in range(101):
            q, _, state = fault.step(k * DT, DT, (0.0,) * 3, (0.0,) * 3, state)  # type: ignore[attr-defined]
        ends.append(q)
    assert np.std(ends, axis=0) == pytest.approx([0.02 * math.sqrt(0.1)] * 3, rel=0.1)
    assert np.abs(np.corrcoef(np.transpose(ends))[np.triu_indices(3, 1)]).max() < 0.15


def test_controller_and_observer_believe_the_biased_sensor() -> None:
    """The measured motion is held at the reference, so the true one is off by the bias."""
    trace = simulate(load("paper", ["duration=3", f"injection.faults=[{BIAS}]", "injection.disturbances=[]"]))
    assert trace.measured_position is not None
    seen = trace.measured_position - trace.reference_position
    assert np.abs(seen[2500:]).max() < 1e-4
    assert trace.error[2500:] == pytest.approx(np.tile([-0.01, 0.02, 0.0], (501, 1)), abs=1e-4)


# The robot.


def test_a_payload_is_picked_up() -> None:
    """At t > T_f the plant moves the loaded robot; the model goes on without, and the motion has no jump."""
    trace, healthy = run(PAYLOAD), run()
    assert trace.joint_torque is None
    assert same(trace, healthy, slice(FIRST + 1))
    assert not np.array_equal(trace.velocity[FIRST + 1], healthy.velocity[FIRST + 1])
    assert trace.scenario is not None
    assert trace.scenario.model == trace.scenario.robot
    ((time_ns, loaded),) = robot_changes(trace.scenario)
    assert (time_ns, loaded) == (FIRST * 1_000_000, trace.scenario.robot.loaded(2.0))
    assert np.abs(trace.velocity[FIRST + 1] - healthy.velocity[FIRST + 1]).max() < 0.05


def test_payloads_add_up_in_the_order_of_time() -> None:
    """Whatever their order in the file; they add to what the robot has; the observer finds the weight."""
    later = PAYLOAD.replace("0.05", "0.1").replace("mass: 2", "mass: 0.5")
    found = [
        robot_changes(scenario(*x, more=("robot.payload_mass=1",)))
        for x in ((PAYLOAD, later), (later, PAYLOAD))
    ]
    assert found[0] == found[1]
    assert [robot.payload_mass for _, robot in found[0]] == [3.0, 3.5]  # type: ignore[attr-defined]
    quiet = ["injection.disturbances=[]", "duration=2", f"injection.faults=[{PAYLOAD}]"]
    trace = simulate(load("paper", quiet))
    q = tuple(trace.position[-1].tolist())
    robot = trace.scenario.robot  # type: ignore[union-attr]
    weight = np.subtract(robot.loaded(2.0).gravity(q), robot.gravity(q))  # type: ignore[union-attr]
    assert trace.disturbance_estimate[-1] == pytest.approx(weight, abs=0.1)
    assert np.abs(weight).max() > 5.0


@pytest.mark.parametrize("start", ["0.2", "0.3", "1e16", "1e300", "1.7e308"])
def test_a_payload_after_the_end_is_none(start: str) -> None:
    """However late: the run ends before."""
    late = run(PAYLOAD.replace("0.05", start))
    assert robot_changes(late.scenario) == ()  # type: ignore[arg-type]
    assert same(late, run())


def test_the_first_tick_of_a_payload_is_the_first_after_its_onset() -> None:
    """At a tick, just before and just after it, and from the beginning on: the fault acts at t > T_f."""
    for start, tick in (("0.05", 51), ("0.0499999", 50), ("0.0500001", 51), ("0", 1), ("0.1995", 200)):
        ((time_ns, _),) = robot_changes(scenario(PAYLOAD.replace("0.05", start)))
        assert time_ns == tick * 1_000_000


def test_a_robot_that_cannot_be_loaded_is_refused() -> None:
    """The arm of six joints has no such parameter; the pendulum has."""
    fault = {"injection": {"faults": [{"type": "payload_pickup", "start": 0.05}]}}
    with robots_known():
        assert simulate(from_mapping(scenario_mapping("pendulum", **fault))).status == "completed"
        with pytest.raises(
            ScenarioError, match=r"injection\.faults\.0: needs a robot with the parameter payload"
        ):
            from_mapping(scenario_mapping("serial_arm", **fault))


# Communication.


def received(trace: Trace, fault: int = 0, probability: float = 0.3, seed: int = 0) -> np.ndarray:
    """For every tick, the tick whose message is received: the fault's own stream, message by message."""
    key, now, found = stream_key(seed, f"fault.dropped_messages.{fault}"), 0, []
    for k in range(trace.ticks):
        if not (k >= FIRST and uniform(key, float(k)) < probability):
            now = k
        found.append(now)
    return np.array(found)


def test_dropped_commands() -> None:
    """The drive goes on with the last one received."""
    trace = run(DROPS % "joint_torques")
    sent = received(trace)
    assert np.array_equal(trace.effort[1:], trace.command[sent[:-1]])
    assert 0.15 < (sent[FIRST:] != np.arange(FIRST, trace.ticks)).mean() < 0.45


def test_dropped_measurements() -> None:
    """Position, velocity and effort of one message are received, or held, together."""
    trace = run(DROPS % "joint_states")
    sent = received(trace)
    assert np.array_equal(trace.measured_position, trace.position[sent])
    assert np.array_equal(trace.measured_velocity, trace.velocity[sent])
    applied = np.vstack([np.zeros((1, 3)), trace.command[:-1]])
    assert np.array_equal(trace.effort, applied[sent])
    assert trace.joint_torque is not None
    assert np.array_equal(trace.joint_torque[1:], trace.command[:-1] + trace.disturbance[:-1])


def test_dropped_disturbances() -> None:
    """What acts beside the drives is that of the last one received."""
    trace = run(DROPS % "disturbance", ADDITIVE)
    sent = received(trace)
    assert trace.joint_torque is not None
    assert np.array_equal(trace.joint_torque[1:], trace.effort[1:] + trace.disturbance[sent[:-1]])


def test_dropped_estimates() -> None:
    """The law gets the last one received; the recorded estimate is the one that was sent."""
    trace = run(DROPS % "disturbance_estimate")
    sent, found = received(trace), scenario(DROPS % "disturbance_estimate")
    law = found.controller
    state = law.init(3)
    for k, row in enumerate(rows_of(trace)):
        y = Measurement(row["measured_position"], row["measured_velocity"], row["effort"])
        reference = found.reference.at(k * DT, 3)
        estimate = tuple(trace.disturbance_estimate[sent[k]].tolist())
        prepared = law.prepare(found.model, DT, y, reference, state)
        u, state = law.step(found.model, DT, y, reference, estimate, state, prepared)
        assert u == row["command"]
    assert (sent != np.arange(trace.ticks)).any()


@pytest.mark.parametrize("topic", TOPICS)
def test_no_message_or_every_message_lost(topic: str) -> None:
    """Nothing lost changes nothing; with everything lost the last one before stays."""
    none, healthy = run((DROPS % topic).replace("0.3", "0")), run((DROPS % topic).replace("0.05", "9"))
    assert same(none, healthy)
    every = run((DROPS % topic).replace("0.3", "1"))
    assert same(every, healthy, slice(FIRST))
    held = {"joint_torques": every.effort[FIRST + 1 :], "joint_states": every.measured_position[FIRST:]}
    if topic in held:
        assert np.array_equal(held[topic], np.tile(held[topic][0], (len(held[topic]), 1)))
    assert not same(every, healthy)


# Seeds and streams; several at once.


def test_every_fault_has_a_stream_of_its_own() -> None:
    """A fault of another type shifts none; the second of a type has another; the seed decides."""
    commands = DROPS % "joint_torques"
    alone, beside = run(commands), run("{type: sensor_drift, start: 0.05, drift: 0, walk: 0.001}", commands)
    for trace in (alone, beside):
        sent = received(trace)
        assert np.array_equal(trace.effort[1:], trace.command[sent[:-1]])
    twice = run(DROPS % "disturbance", commands)
    second = received(twice, 1)
    assert np.array_equal(twice.effort[1:], twice.command[second[:-1]])
    assert not np.array_equal(second, received(twice, 0))
    other = run(commands, more=("seed=5",))
    assert np.array_equal(other.effort[1:], other.command[received(other, seed=5)[:-1]])
    assert not np.array_equal(received(other, seed=5), received(other))


def test_a_random_fault_leaves_the_noise_of_the_encoder_alone() -> None:
    """Up to the onset the runs are equal, and the noise goes on as before."""
    encoder = ("sensor={type: encoder, resolution: 0, noise: 0.001}",)
    noisy, beside = run(more=encoder), run(DROPS % "disturbance_estimate", more=encoder)
    assert noisy.measured_position is not None
    assert beside.measured_position is not None
    noise = [x.measured_position - x.position for x in (noisy, beside)]  # type: ignore[operator]
    assert noise[0] == pytest.approx(noise[1], abs=1e-12)


EVERYTHING = (LOSS, BIAS, PAYLOAD, ADDITIVE, *(DROPS % topic for topic in TOPICS))
DRIVES = ("torque_limits=[97.6, 186.4, 89.4]", "torque_rate_limits=9000", "torque_delay=2")


def test_several_faults_at_once() -> None:
    """Each does what it does alone: what acts is what is received, weakened, with what is received added."""
    trace = run(*EVERYTHING)
    assert trace.status == "completed"
    assert trace.joint_torque is not None
    assert trace.measured_position is not None
    link = {topic: received(trace, n) for n, topic in enumerate(sorted(TOPICS))}
    share = 1.0 - np.array([0.1, 0.5, 0.9]) * after(trace)[:-1]
    drives = trace.command[link["joint_torques"][:-1]]
    expected = drives * share + trace.disturbance[link["disturbance"][:-1]]
    assert trace.joint_torque[1:] == pytest.approx(expected, rel=1e-13, abs=1e-13)
    reported = np.vstack([np.zeros((1, 3)), drives])
    assert np.array_equal(trace.effort, reported[link["joint_states"]])
    biased = trace.position + np.array([0.01, -0.02, 0.0]) * after(trace)
    assert trace.measured_position == pytest.approx(biased[link["joint_states"]], abs=1e-15)


@pytest.mark.slow
@pytest.mark.parametrize(
    "more", [(), pytest.param(DRIVES, marks=pytest.mark.nightly)], ids=["", "limits and delay"]
)
def test_several_faults_at_once_compiled(more: tuple[str, ...]) -> None:
    """As plainly, closely: over the pick-up of the payload too."""
    pytest.importorskip("numba")
    found = scenario(*EVERYTHING, more=(*more, "sensor={type: encoder, resolution: 0, noise: 1e-5}"))
    trace = compiled.simulate(found)
    assert trace.engine == "compiled"
    close(trace, simulate(found), rtol=1e-6, atol=1e-6)


# The record reproduces the motion.


@pytest.mark.parametrize(
    "faults", [(), (LOSS,), (BIAS,), (PAYLOAD,), (ADDITIVE,), *((DROPS % t,) for t in TOPICS), EVERYTHING]
)
@pytest.mark.parametrize(
    "more", [(), DRIVES, ("sensor=encoder",), ("plant={substeps: 2}", "robot.payload_mass=1")]
)
def test_the_recorded_torques_reproduce_the_motion(faults: tuple[str, ...], more: tuple[str, ...]) -> None:
    """From each row, moved by the torque on the joints recorded after it: the next row, bit for bit."""
    trace = run(*faults, more=more)
    found = trace.scenario
    assert found is not None
    assert trace.ticks == 201
    robot, changes = found.robot, list(robot_changes(found))
    rows = rows_of(trace)
    for k, (now, following) in enumerate(pairwise(rows)):
        while changes and k * found.dt_ns >= changes[0][0]:
            robot = changes.pop(0)[1]
        if trace.joint_torque is None:
            tau = tuple(map(float.__add__, following["effort"], now["disturbance"]))
        else:
            tau = following["joint_torque"]
        moved = found.plant.step(
            robot, found.dt, tau, found.plant.init(robot, now["position"], now["velocity"])
        )
        assert found.plant.motion(moved) == (following["position"], following["velocity"]), k
    assert not changes
