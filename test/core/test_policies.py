# SPDX-License-Identifier: Apache-2.0
"""Accommodation: when a policy decides, what it changes from then on, and what that is good for."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from ftcm_core.compiled import NotCompilable, program
from ftcm_core.controllers.ctc import CTC
from ftcm_core.controllers.ftcm import FTCM
from ftcm_core.errors import ParameterError, ScenarioError
from ftcm_core.observers.do import DO
from ftcm_core.policies.derate import Derate
from ftcm_core.policies.replace_sensor import ReplaceSensor
from ftcm_core.policies.safe_stop import SafeStop
from ftcm_core.policies.switch import Switch
from ftcm_core.recording.metrics import result
from ftcm_core.recording.trace import Change, Decision, Trace
from ftcm_core.recording.trace_file import load_trace, save_trace
from ftcm_core.references.vo_kang_cosine import VoKangCosine
from ftcm_core.report.table import accommodation_table
from ftcm_core.scenario import Scenario, from_mapping, load, replace
from ftcm_core.signals import Detection, Measurement
from ftcm_core.simulation import Loop, simulate
from ftcm_core.simulation.accommodation import Accommodation, Pace, paced
from traces import same

LOSS = {"type": "loss_of_effectiveness", "start": 0.8, "joint": 2}
FROZEN = {"type": "frozen_sensor", "start": 1.3, "joint": 2, "quantity": "position"}
SWITCH, STOP = {"type": "switch"}, {"type": "safe_stop"}
DATA: dict[str, Any] = {
    "robot": "puma560", "reference": "vo_kang_cosine", "controller": "ftcm", "observer": "do",
    "detector": "isolating", "duration": 2.0, "transient": 0.5,
    "initial_state": {"position": VoKangCosine().at(0.0, 3).position},
}  # fmt: skip


def scenario(*policies: Any, faults: Any = (LOSS,), **more: Any) -> Scenario:
    """A run of two seconds with faults and policies."""
    return from_mapping({**DATA, "injection": {"faults": list(faults)}, "policies": list(policies), **more})


def detection(*alarms: float, verdict: float = 1.0) -> Detection:
    """What a detector says, one number per joint."""
    return Detection((0.0,) * len(alarms), alarms, tuple(verdict * a for a in alarms))


# ---- when ----


def test_a_decision_waits_until_a_verdict_has_lasted_and_is_made_once() -> None:
    """``hold`` of three ticks: said in ticks 5 to 8, in force from tick 9; a break begins it anew."""
    accommodation = Accommodation(scenario({"type": "safe_stop", "hold": 0.003}))
    found = []
    for tick, alarm in enumerate([0, 1, 1, 0, 0, 1, 1, 1, 1, 1, 1]):
        found += accommodation.hear(tick + 1, detection(0.0, alarm, 0.0))
    assert found == [Decision(9, 0, 2, "unknown")]


def test_only_the_verdict_and_the_joint_that_were_asked_for() -> None:
    """``sensor`` of joint 3; what else is told changes nothing."""
    accommodation = Accommodation(scenario({"type": "safe_stop", "verdict": "sensor", "joint": 3}))
    assert not accommodation.hear(1, detection(1.0, 1.0, 1.0))
    assert not accommodation.hear(2, detection(1.0, 1.0, 0.0, verdict=2.0))
    assert accommodation.hear(3, detection(0.0, 0.0, 1.0, verdict=2.0)) == [Decision(3, 0, 3, "sensor")]


@pytest.mark.parametrize("verdict", [7.0, -1.0, 2.5, float("nan")])
def test_a_verdict_that_means_nothing_is_unknown(verdict: float) -> None:
    """Somebody else's detector may say anything; its alarm counts."""
    accommodation = Accommodation(scenario("safe_stop", {"type": "derate", "verdict": "sensor"}))
    found = accommodation.hear(1, detection(0.0, 1.0, 0.0)._replace(verdict=(0.0, verdict, 0.0)))
    assert found == [Decision(1, 0, 2, "unknown")]


def test_sensors_are_replaced_joint_by_joint_and_the_law_is_switched_once() -> None:
    """Each joint has sensors of its own, the robot one law."""
    accommodation = Accommodation(scenario("replace_sensor", {"type": "switch", "controller": "ctc"}))
    first = accommodation.hear(1, detection(0.0, 1.0, 0.0))
    assert [(d.number, d.joint) for d in first] == [(0, 2), (1, 2)]
    second = accommodation.hear(2, detection(1.0, 1.0, 0.0))
    assert [(d.number, d.joint) for d in second] == [(0, 1)]


def test_what_is_told_in_a_tick_acts_from_the_next_one_on() -> None:
    """The run is that without policies up to the decision, float for float, and another one after it."""
    passive, active = simulate(scenario()), simulate(scenario({"type": "switch", "controller": "ctc"}))
    (decision,) = active.decisions
    assert passive.alarm is not None
    told = int(np.argmax(passive.alarm.any(axis=1)))
    assert decision == (told + 1, 0, 2, "unknown")
    assert same(passive, active, slice(told + 1))
    assert (passive.command[told + 1] != active.command[told + 1]).any()


# ---- what ----


def test_a_switched_law_is_a_change_that_the_policy_made() -> None:
    """As if somebody had swapped it by hand in that tick; replayed, the policy does it again."""
    active = simulate(
        scenario({"type": "switch", "controller": "ctc", "observer": {"type": "do", "k1": 1e4}})
    )
    tick = active.decisions[0].tick
    assert active.changes == (
        Change(tick, "controller", CTC(), "switch_0"),
        Change(tick, "observer", DO(k1=1e4), "switch_0"),
    )
    by_hand = simulate(scenario(), [Change(c.tick, c.kind, c.component) for c in active.changes])
    assert same(active, by_hand)
    assert active.scenario is not None
    assert same(active, simulate(active.scenario, active.changes))


def test_retuning_keeps_what_the_law_remembers() -> None:
    """The same law with other parameters: no step but that of the gains."""
    policy = {"type": "switch", "controller": {"type": "ftcm", "gamma1": 3.0}}
    active = simulate(scenario(policy, {"type": "derate"}))
    assert [c.component for c in active.changes] == [FTCM(gamma1=3.0)]
    assert [d.number for d in active.decisions] == [0, 1]


@given(
    factor=st.floats(0.0, 0.99), ramp=st.floats(0.05, 2.0), begin=st.floats(0.0, 10.0), t=st.floats(0.0, 5.0)
)
def test_a_pace_is_its_own_derivative(factor: float, ramp: float, begin: float, t: float) -> None:
    """The speed is the slope of the reference's time, and the third number that of the speed."""
    pace = Pace(begin, 1.0, begin, factor, ramp)
    h = 1e-5
    (s0, v0, _), (_, v1, a1), (s2, v2, _) = (pace.at(begin + t + d) for d in (0.0, h, 2.0 * h))
    assert (s2 - s0) / (2.0 * h) == pytest.approx(v1, abs=1e-6 / ramp)
    assert (v2 - v0) / (2.0 * h) == pytest.approx(a1, abs=1e-3 / ramp)
    assert min(1.0, factor) - 1e-12 <= v1 <= 1.0
    assert pace.at(begin) == (begin, 1.0, 0.0)
    assert pace.at(begin + ramp + 1.0)[1:] == pytest.approx((factor, 0.0))


def test_the_slower_of_two_paces_holds() -> None:
    """A stop while slowing down begins at the speed there is; what is faster comes too late."""
    accommodation = Accommodation(
        scenario({"type": "derate"}, {"type": "safe_stop", "joint": 2}, {"type": "derate", "joint": 3})
    )
    accommodation.hear(1000, detection(1.0, 0.0, 0.0))
    slowing = accommodation.pace
    assert slowing == Pace(1.0, 1.0, 1.0, 0.5, 0.5)
    accommodation.hear(1250, detection(0.0, 1.0, 0.0))
    reached, speed, _ = slowing.at(1.25)
    assert accommodation.pace == Pace(1.25, speed, reached, 0.0, 0.5)
    stopping = accommodation.pace
    accommodation.hear(1300, detection(0.0, 0.0, 1.0))
    assert accommodation.pace is stopping


def test_a_stopped_reference_stands_still_on_its_path() -> None:
    """And its velocity and acceleration fit its position on the way there."""
    reference, pace = VoKangCosine(), Pace(1.0, 1.0, 1.0, 0.0, 0.5)
    end = paced(reference, pace, 3.0, 3)
    assert end.position == reference.at(1.25, 3).position
    assert end.velocity == end.acceleration == (0.0, 0.0, 0.0)
    h = 1e-4
    before, now, after = (paced(reference, pace, 1.2 + d, 3) for d in (-h, 0.0, h))
    for j in range(3):
        slope = (after.position[j] - before.position[j]) / (2.0 * h)
        assert now.velocity[j] == pytest.approx(slope, abs=1e-6)
        bend = (after.position[j] - 2.0 * now.position[j] + before.position[j]) / h**2
        assert now.acceleration[j] == pytest.approx(bend, abs=1e-4)


def test_a_safe_stop_holds_the_robot() -> None:
    """40 % of the torque of joint 2 lost, then FTCM holds the robot where the path has stopped."""
    trace = simulate(scenario({"type": "safe_stop"}))
    assert trace.status == "completed"
    assert np.abs(trace.velocity[-1]).max() < 1e-3
    assert (trace.reference_position[-1] == trace.reference_position[-200]).all()
    assert np.abs(trace.error[-1]).max() < 1e-3


def test_a_derated_motion_goes_along_the_same_path_slower() -> None:
    """Every position that it comes to is one of the planned path, later."""
    trace = simulate(scenario({"type": "derate", "factor": 0.5, "ramp": 0.2}))
    tick = trace.decisions[0].tick
    since = trace.time[-1] - trace.time[tick]
    gone = since - 0.5 * 0.2 * 0.5 - 0.5 * (since - 0.2)
    planned = VoKangCosine().at(float(trace.time[tick] + gone), 3).position
    assert trace.reference_position[-1] == pytest.approx(planned, abs=1e-9)


# ---- replaced sensors ----


def motion(t: float) -> tuple[tuple[float, ...], tuple[float, ...]]:
    """A smooth motion of two joints."""
    return (float(np.sin(t)), 0.1 * t), (float(np.cos(t)), 0.1)


@pytest.mark.parametrize("quantity", ["position", "velocity"])
def test_a_replaced_signal_is_the_true_one(quantity: str) -> None:
    """From the other signal of the joint; the other joint's, and everything before, is left as it is."""
    policy = ReplaceSensor(quantity=quantity)
    memory, dt = policy.memory(2), 1e-3
    for k in range(2000):
        (q, v), broken = motion(k * dt), float(k >= 1000)
        wrong = Measurement(q, v, (0.0, 0.0))
        if k >= 990:  # broken for ten ticks before that is told
            wrong = wrong._replace(**{quantity: (9.0, getattr(wrong, quantity)[1])})
        y, memory = policy.measured(dt, wrong, (broken, 0.0), memory)
        if not broken:
            assert y == wrong
            continue
        assert y.position[1] == q[1]
        assert y.velocity[1] == v[1]
        assert y.position[0] == pytest.approx(q[0], abs=1e-5)
        assert y.velocity[0] == pytest.approx(v[0], abs=1e-9 if quantity == "position" else 3e-3)


def test_ticks_that_were_skipped_count_in_the_integral() -> None:
    """In real time a node may miss a tick."""
    policy = ReplaceSensor()
    memory = policy.memory(2)
    for k in (*range(500), *range(502, 900), *range(910, 1200)):
        q, v = motion(k * 1e-3)
        gap = {502: 3, 910: 11}.get(k, 1)
        wrong = Measurement((9.0, q[1]), v, (0.0, 0.0)) if k >= 1000 else Measurement(q, v, (0.0, 0.0))
        y, memory = policy.measured(gap * 1e-3, wrong, (float(k >= 1000), 0.0), memory)
    assert y.position[0] == pytest.approx(q[0], abs=1e-5)


def test_a_frozen_position_that_the_passive_law_cannot_survive() -> None:
    """The paper's FTCM runs away by a radian; with the sensor replaced it stays within 5 mrad.

    What is left is what the joint moved between the fault and the earliest measurement that is trusted again.
    """
    policy = {"type": "replace_sensor", "verdict": "sensor"}
    passive = simulate(scenario(faults=[FROZEN], duration=5.0))
    active = simulate(scenario(policy, faults=[FROZEN], duration=5.0))
    after = slice(1301, None)
    assert np.abs(passive.error[after, 1]).max() > 1.0
    assert np.abs(active.error[after, 1]).max() < 5e-3
    trusted = active.decisions[0].tick - round(ReplaceSensor().lookback / active.dt)
    moved = active.position[trusted, 1] - active.position[1300, 1]
    assert active.error[-1, 1] == pytest.approx(moved, rel=0.05)


# ---- refusals, files, words ----


@pytest.mark.parametrize(
    ("policies", "more", "said"),
    [
        ([SWITCH | {"controller": "ftmc"}], {}, "policies.0.controller: no controller 'ftmc'; did you"),
        ([SWITCH | {"controller": {"c": 1}}], {}, "policies.0.controller: {'c': 1} has no 'type'"),
        ([SWITCH | {"controller": {"type": "smc", "cc": 1}}], {}, "0.controller: cc: unknown key"),
        ([SWITCH | {"observer": "{"}], {}, "policies.0.observer: '{' is neither a name nor a mapping"),
        ([SWITCH | {"controller": {"type": "smc", "c": [1, 2]}}], {}, "policies.0.controller.c: "),
        ([STOP | {"joint": 4}], {}, "policies.0: joint: 4 is out of range; expected 0 (whichever) to 3"),
        ([STOP | {"verdict": "sensors"}], {}, "did you mean 'sensor'?"),
        ([{"type": "safe_stopp"}], {}, "0.type: no policy 'safe_stopp'; did you mean 'safe_stop'?"),
        ([STOP], {"detector": None}, "policies: act on what a detector says"),
        (
            [SWITCH | {"controller": "ftcm"}], {"controller": "ctc", "observer": "none"},
            "controller 'ftcm' uses the disturbance estimate",
        ),
    ],
)  # fmt: skip
def test_a_policy_that_cannot_be(policies: Any, more: dict[str, Any], said: str) -> None:
    """In one line, with the place."""
    with pytest.raises(ScenarioError) as error:
        scenario(*policies, **more)
    assert said in str(error.value)


def test_a_switch_made_in_python_is_checked_too() -> None:
    """Not only by the reader of scenarios."""
    with pytest.raises(ParameterError, match="controller: no controller 'pid2'"):
        Switch(controller="pid2")
    assert Switch(controller="ctc") == Switch(controller='{"type": "ctc"}')


def test_a_scenario_with_policies_reads_back() -> None:
    """With every default of what takes over."""
    one = scenario({"type": "switch", "controller": {"type": "smc", "c": 4}}, "derate", "replace_sensor")
    assert from_mapping(one.to_mapping()) == one
    assert one.to_mapping()["policies"][0]["controller"]["c"] == 4.0
    assert one.policy_labels == ("switch_0", "derate_0", "replace_sensor_0")
    assert one.policies[1:] == (Derate(), ReplaceSensor())


def active_run() -> Trace:
    """One with a change made by a policy."""
    return simulate(scenario({"type": "switch", "controller": "ctc"}, {"type": "safe_stop", "hold": 0.1}))


def test_decisions_are_kept_and_told(tmp_path: Path) -> None:
    """In the trace's file, the result for programs and the table."""
    trace = active_run()
    save_trace(tmp_path / "trace.npz", trace)
    read = load_trace(tmp_path / "trace.npz")
    assert (read.decisions, read.changes) == (trace.decisions, trace.changes)
    found = result(trace)
    assert [d["policy"] for d in found["decisions"]] == ["switch_0", "safe_stop_0"]
    assert found["changes"][0]["by"] == "switch_0"
    table = accommodation_table([found])
    assert f"| {trace.decisions[1].tick * 1e-3:.6g}" in table
    quiet = simulate(scenario(SafeStop().to_mapping(), faults=()))
    assert quiet.decisions == ()
    assert "none" in accommodation_table([result(quiet)])
    assert accommodation_table([result(simulate(scenario()))]) == ""


def test_a_run_with_policies_is_run_plainly() -> None:
    """What may change while it runs is not compiled; the reason is said."""
    loop = Loop(scenario("safe_stop"))
    with pytest.raises(NotCompilable, match="policies change"):
        program.program_for(loop)


def test_without_policies_nothing_is_in_the_way() -> None:
    """No accommodation is made; the paper's run has none."""
    assert Loop(load("paper")).accommodation is None
    assert replace(scenario("derate"), policies=()) == scenario()
