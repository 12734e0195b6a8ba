# SPDX-License-Identifier: Apache-2.0
"""Replay: a recorded run is proved stage by stage; what is not as it was is named, and nothing else."""

from __future__ import annotations

import dataclasses
import math
import random
from typing import Any

import pytest

from everything import EVERYTHING
from ftcm_core.controllers.smc import SMC
from ftcm_core.observers.do import DO
from ftcm_core.plants import Plant
from ftcm_core.recording.trace import Change
from ftcm_core.registry import components, register
from ftcm_core.replay import Record, Replay, cause, replay, verdict
from ftcm_core.robots import Robot
from ftcm_core.scenario import Scenario, from_mapping, load
from ftcm_core.signals import Measurement, Vector
from ftcm_core.simulation import simulate
from ftcm_core.simulation.stages import DetectorStage, ObserverStage
from plugins import registry_kept
from records import Lag, changed, late_run, record_of, said_otherwise

STAGES = ("plant", "observer", "controller", "injector", "detector")
FAULTS = [
    {"type": "loss_of_effectiveness", "start": 0.1},
    {"type": "payload_pickup", "start": 0.2},
    {"type": "sensor_bias", "start": 0.1},
    *({"type": "dropped_messages", "start": 0.05, "topic": topic, "probability": 0.2}
      for topic in ("joint_states", "disturbance_estimate", "joint_torques", "disturbance")),
]  # fmt: skip


def everything() -> Scenario:
    """Every kind of stage and of fault."""
    injection = {
        "disturbances": ["vo_kang_friction"],
        "faults": [*FAULTS, {"type": "vo_kang_fault", "start": 0.2}],
    }
    return from_mapping({**EVERYTHING, "injection": injection, "duration": 0.4}, origin="test")


def paper(*overrides: str, controller: str = "ftcm") -> Scenario:
    return load("paper", ["duration=0.4", "injection.faults.0.start=0.2", *overrides], controller=controller)


def differing(found: Replay) -> dict[str, tuple[int, ...]]:
    """Ticks that differ, of the stages in which some do."""
    return {stage.name: stage.differing for stage in found.stages if stage.differing}


# A run in process.


@pytest.mark.parametrize("controller", components("controller"))
def test_a_run_with_any_law_is_equal(controller: str) -> None:
    found = replay(record_of(simulate(paper(controller=controller))))
    assert found.whole
    assert {stage.name: stage.ticks for stage in found.stages} == dict.fromkeys(STAGES[:4], 401)
    assert verdict(found) == "equal, float for float: 401 ticks"
    assert cause(found, {"numpy": ("1", "2")}) == ""


def test_a_run_with_something_of_everything_is_equal() -> None:
    found = replay(record_of(simulate(everything())))
    assert found.whole
    assert {stage.name: stage.ticks for stage in found.stages} == dict.fromkeys(STAGES, 401)


def test_components_that_were_changed_are_changed_again() -> None:
    changes = (
        Change(100, "controller", SMC()),
        Change(150, "observer", DO(k1=10000.0)),
        Change(200, "controller", SMC(c=5.0)),
    )
    record = record_of(simulate(paper(), changes))
    assert replay(record).whole
    found = replay(dataclasses.replace(record, changes=changes[:1]))
    assert set(differing(found)) == {"observer", "controller"}
    assert (differing(found)["observer"][0], differing(found)["controller"][0]) == (150, 200)


@pytest.mark.parametrize(
    ("topic", "array", "stage", "signal"),
    [
        ("joint_states", 0, "plant", "position"),
        ("joint_states", 2, "plant", "effort"),
        ("disturbance_estimate", 0, "observer", "disturbance_estimate"),
        ("joint_torques", 0, "controller", "command"),
        ("reference", 1, "controller", "reference_velocity"),
        ("disturbance", 0, "injector", "disturbance"),
    ],
)
@pytest.mark.parametrize("lockstep", [True, False])
def test_one_changed_number_is_one_difference(
    topic: str, array: int, stage: str, signal: str, lockstep: bool
) -> None:
    record = dataclasses.replace(record_of(simulate(paper())), lockstep=lockstep)
    message = record.said[topic][117]
    assert message is not None
    found = replay(changed(record, topic, 117, array, 1, 1e-9))
    assert differing(found) == {stage: (117,)}
    first = found.first
    assert first is not None
    assert (first.tick, first.signal, first.joint, first.computed) == (117, signal, 1, message[array][1])
    assert first.apart == pytest.approx(1e-9, rel=1e-4)
    assert f"first at tick 117, t = 0.117 s: {signal} of joint2: recorded " in verdict(found)
    found = replay(changed(record, topic, 117, array, 1, 0.1))
    assert differing(found) == {stage: (117,)}
    assert cause(found, {}) == (
        "the record was changed after the run: all else follows from what the replay gives there"
    )


def test_ticks_lost_from_a_lockstep_record_are_bridged() -> None:
    record = record_of(simulate(everything()))
    lost = {(topic, k): None for topic in record.said for k in range(100, 150)}
    lost |= {("disturbance_estimate", 200): None, ("joint_torques", 300): None, ("joint_states", 400): None}
    found = replay(said_otherwise(record, lost))
    assert found.whole
    assert {stage.name: stage.ticks for stage in found.stages} == {
        "plant": 351, "observer": 350, "controller": 351, "injector": 351, "detector": 351
    }  # fmt: skip


@pytest.mark.parametrize("lockstep", [True, False])
def test_another_robot_is_a_plant_that_differs_and_no_other_stage(lockstep: bool) -> None:
    scenario = paper()
    record = dataclasses.replace(record_of(simulate(scenario)), lockstep=lockstep)
    heavier = dataclasses.replace(scenario.robot, payload_mass=0.1)
    other = dataclasses.replace(scenario, robot=heavier, model=scenario.model)
    found = replay(dataclasses.replace(record, scenario=other))
    assert differing(found) == {"plant": tuple(range(1, 401))}
    assert cause(found, {}).startswith("other code than that of the run, though its versions are the same")
    versions = {"revision": ("abc", "def")}
    assert cause(found, versions) == (
        "other code, or another version of a library; recorded with revision abc (here def)"
    )


def test_what_differs_in_the_last_digits_everywhere_is_rounding() -> None:
    record, draw = record_of(simulate(paper())), random.Random(4)
    nudged = {
        ("joint_states", k): tuple(
            tuple(x * (1.0 + draw.choice((0.0, 2.3e-16))) for x in vector) for vector in message
        )
        for k, message in enumerate(record.said["joint_states"])
        if message
    }
    found = replay(said_otherwise(record, nudged))
    assert len(differing(found)["plant"]) > 300
    assert found.stages[0].largest < 1e-15
    assert cause(found, {"numpy": ("1.26", "2.4")}) == (
        "single operations round differently: another processor, operating system or library; "
        "recorded with numpy 1.26 (here 2.4)"
    )


@pytest.mark.parametrize(
    ("overrides", "status"),
    [
        (["velocity_limits=1"], "limit_exceeded"),
        (["position_upper_limits=0.3"], "limit_exceeded"),
        (["controller.upsilon1=1e9", "dt=0.02"], "diverged"),
    ],
)
def test_a_run_that_could_not_go_on_ends_here_too(overrides: list[str], status: str) -> None:
    trace = simulate(paper(*overrides))
    assert (trace.status, trace.ticks < 401) == (status, True)
    record = record_of(trace)
    found = replay(record)
    assert found.whole
    assert found.end[0] == status
    assert found.end[1] in trace.detail
    elsewhere = {"diverged": "limit_exceeded", "limit_exceeded": "diverged"}[status]
    found = replay(dataclasses.replace(record, status=elsewhere))
    assert not found.equal
    assert verdict(found) == f"differs at its end: recorded as {elsewhere}, here {status}: {found.end[1]}"
    assert cause(found, {}) == "other limits or other code"


def test_a_law_that_left_its_domain_sent_no_number() -> None:
    """As its node does: the torque of that tick is not a number, and the plant ends the run."""
    record = record_of(simulate(paper()))
    nan = (math.nan,) * 3
    first = {topic: messages[:201] for topic, messages in record.said.items()}
    cut = dataclasses.replace(record, said=first, status="diverged")
    found = replay(said_otherwise(cut, {("joint_torques", 200): (nan,)}))
    assert differing(found) == {"controller": (200,)}
    assert "recorded nan N·m, here " in verdict(found)


# A plant that gets its inputs late.


def some(draw: random.Random) -> Lag:
    """One message in eight is a tick or two late."""
    return lambda k: draw.choice([0] * 14 + [1, 2])


def frozen(draw: random.Random) -> Lag:
    """A sender that is stopped from tick 100 to 250, then catches up with what it has not done."""
    return lambda k: max(0, 250 - k) if 100 <= k < 250 else max(0, 280 - k) if 250 <= k < 280 and k % 3 else 0


def in_bursts(draw: random.Random) -> Lag:
    """What stopped at tick 100 comes in two bursts: after the first the command is fresh for one tick."""
    return lambda k: max(0, 255 - k) if 100 <= k <= 155 else max(0, 300 - k) if 155 < k < 300 else 0


def in_bursts_later(draw: random.Random) -> Lag:
    """The same, a tick later."""
    return lambda k: in_bursts(draw)(k) and in_bursts(draw)(k) + 1


CASES = {
    "as it is": paper(),
    "limits": paper("torque_limits=[60, 120, 50]", "torque_rate_limits=[20000, 20000, 20000]"),
    "delay": paper("torque_delay=2", "torque_limits=[97.6, 186.4, 89.4]"),
    "hidden": paper(
        "torque_delay=1",
        "sensor={type: encoder, noise: 1e-5}",
        "detector=residual_threshold",
        "injection.faults=[{type: loss_of_effectiveness, start: 0.1}, {type: payload_pickup, start: 0.2}]",
    ),
}


@pytest.mark.parametrize(
    ("lag", "of_disturbances", "braked", "stops"),
    [
        (some, some, 0, 0),
        (frozen, frozen, 50, 1),
        (in_bursts, in_bursts, 99, 2),
        (in_bursts, in_bursts_later, 99, 2),
    ],
)
@pytest.mark.parametrize("case", CASES)
def test_what_acted_is_found_where_inputs_were_late(
    case: str, lag: Any, of_disturbances: Any, braked: int, stops: int
) -> None:
    scenario, draw = CASES[case], random.Random(4)
    record, held = late_run(scenario, lag(draw), of_disturbances(draw))
    assert held.ticks > 70
    assert held.safe_stop == braked
    found = replay(record)
    assert found.equal
    assert found.undecided == 0
    assert not found.whole
    assert "the plant moved with what it held: command in " in verdict(found)
    if scenario.limits.torque is None:  # else a drive at its limit does the same whatever it gets
        assert found.held.safe_stop == held.safe_stop
        # What went into a delay before a safe stop, or the end, never comes out.
        assert held.command - (stops + 1) * scenario.torque_delay <= found.held.command <= held.command
    assert found.held.disturbance == held.disturbance


@pytest.mark.parametrize("lag", [some, frozen])
def test_what_acted_is_found_where_messages_were_dropped_besides(lag: Any) -> None:
    """Also where drives are at their limits in a safe stop: which messages get lost depends on the tick."""
    draw = random.Random(4)
    record, held = late_run(everything(), lag(draw), lag(draw))
    assert held.ticks > 70
    found = replay(record)
    assert found.equal
    assert found.undecided == 0


def test_a_number_changed_in_a_late_run_is_one_difference() -> None:
    draw = random.Random(4)
    record, _ = late_run(paper(), some(draw), some(draw))
    for topic, stage in (("joint_states", "plant"), ("joint_torques", "controller")):
        assert differing(replay(changed(record, topic, 300, 0, 2, 1e-3))) == {stage: (300,)}


def test_what_was_never_sent_is_not_found() -> None:
    """A torque that acted, of which nothing tells, is a difference."""
    draw = random.Random(4)
    record, _ = late_run(paper(), some(draw), some(draw))
    foreign = dataclasses.replace(record, said={**record.said, "joint_torques": [((0.0, 0.0, 0.0),)] * 401})
    found = replay(foreign)
    assert not found.equal
    assert len(differing(found)["controller"]) == 401


def test_a_lost_measurement_of_a_late_run_is_found_by_what_follows() -> None:
    record, _ = late_run(paper(), lambda k: int(k == 199), lambda k: 0)
    found = replay(said_otherwise(record, {("joint_states", 200): None}))
    assert found.equal
    assert found.undecided == 0
    assert found.held.command == 1


def test_ticks_that_the_record_does_not_tell_are_named() -> None:
    """What moved the plant over several ticks of which nothing is left is not known."""
    draw = random.Random(4)
    lag = some(draw)
    record, _ = late_run(paper(), lag, lag)
    found = replay(said_otherwise(record, {(t, k): None for t in record.said for k in range(200, 250)}))
    undecided = {stage.name: stage.undecided for stage in found.stages if stage.undecided}
    assert found.equal
    assert undecided["plant"][0] == 250
    assert all(k >= 250 for ticks in undecided.values() for k in ticks)
    assert verdict(found).startswith(
        "equal, float for float, where it can be decided: 401 ticks; not decided: plant tick"
    )


# Stages that skip ticks.


@pytest.mark.parametrize("name", ["observer", "detector"])
def test_skipped_ticks_are_skipped_again(name: str) -> None:
    """With a law that uses no observer, so that nothing else changes."""
    detector = ["detector={type: residual_threshold, hold: 0.0125, threshold: 10}"] * (name == "detector")
    scenario = paper(*detector, controller="pid")
    record = dataclasses.replace(record_of(simulate(scenario)), lockstep=False)
    answered = [k for k in range(401) if k % 7 not in (3, 4) and not 100 <= k < 130]
    found = replay(_answered(record, name, answered))
    assert found.equal
    assert found.undecided == 0
    assert {stage.name: stage.ticks for stage in found.stages}[name] == len(answered)


def test_answers_that_are_lost_are_no_skipped_ticks() -> None:
    record = dataclasses.replace(record_of(simulate(paper())), lockstep=False)
    found = replay(said_otherwise(record, {("disturbance_estimate", k): None for k in (100, 101, 250)}))
    assert found.equal
    assert found.undecided == 0


def _answered(record: Record, name: str, ticks: list[int]) -> Record:
    """The record of a stage that answers only some ticks."""
    scenario, said = record.scenario, record.said
    topic = {"observer": "disturbance_estimate", "detector": "detection"}[name]
    answers: dict[tuple[str, int], Any] = {(topic, k): None for k in range(record.ticks)}
    observer = ObserverStage(scenario.observer, scenario.model, scenario.dt)
    detector = DetectorStage(scenario) if scenario.detector else None
    before = None
    for k in ticks:
        y, tau_hat, u = (said[t][k] for t in ("joint_states", "disturbance_estimate", "joint_torques"))
        assert None not in (y, tau_hat, u)
        passed = 1 if before is None else k - before
        if name == "observer":
            answers[topic, k] = (observer.step(Measurement(*y), passed),)
        elif detector:
            detection = detector.step(Measurement(*y), *u, *tau_hat, passed)
            answers[topic, k] = (detection.alarm, detection.verdict, detection.residual)
        before = k
    return said_otherwise(record, answers)


# Engines and stages that are not plain.


def test_an_engine_that_changes_its_state_in_place_is_put_back() -> None:
    with registry_kept():

        @register("plant", "in_place")
        class InPlace(Plant):
            """Moves on in memory of its own."""

            def init(self, robot: Robot, position: Vector, velocity: Vector) -> Any:
                return [position, velocity]

            def step(self, robot: Robot, dt: float, torque: Vector, state: Any) -> Any:
                q, v = state
                v = tuple(x + dt * a for x, a in zip(v, robot.forward_dynamics(q, v, torque)))
                state[:] = tuple(x + dt * d for x, d in zip(q, v)), v
                return state

            def motion(self, state: Any) -> tuple[Vector, Vector]:
                return state[0], state[1]

        draw = random.Random(4)
        record, held = late_run(paper("plant=in_place"), some(draw), some(draw))
        found = replay(record)
        assert found.equal
        assert found.held == held


@pytest.mark.slow
def test_a_compiled_run_is_compiled_again(tmp_path: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("numba", reason="numba is not installed")
    from ftcm_core import compiled

    record = record_of(compiled.simulate(everything()))
    assert record.compiled == frozenset(STAGES)
    assert replay(record).whole
    assert differing(replay(changed(record, "joint_torques", 117, 0, 1, 1e-3))) == {"controller": (117,)}
