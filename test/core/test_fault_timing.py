# SPDX-License-Identifier: Apache-2.0
"""When faults act: profiles, triggers, lifetimes, orders by hand; and that their order does not matter."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from ftcm_core import compiled
from ftcm_core.errors import FtcmError, ScenarioError
from ftcm_core.faults.sensor_bias import SensorBias
from ftcm_core.faults.timing import NEVER, intermittent, tick_number
from ftcm_core.recording.metrics import windows
from ftcm_core.recording.trace import Change, FaultEvent, FaultInterval, FaultOrder, Trace
from ftcm_core.recording.trace_file import load_trace, save_trace
from ftcm_core.scenario import from_mapping, load, replace
from ftcm_core.simulation import simulate
from ftcm_core.simulation.ground_truth import fault_signals, fault_sizes
from traces import same

pytestmark = pytest.mark.pure

DT = 1e-3


def run(*faults: str, changes: tuple[Change, ...] = (), more: tuple[str, ...] = ()) -> Trace:
    """The paper's experiment, 0.2 s of it, with faults of its own."""
    return simulate(
        load("paper", ["duration=0.2", f"injection.faults=[{', '.join(faults)}]", *more]), changes
    )


def order(tick: int, action: str, number: int = 0) -> Change:
    """An order by hand."""
    return Change(tick, "fault", FaultOrder(number, action))


def bias(trace: Trace) -> np.ndarray:
    """What the sensors report too much, rad."""
    assert trace.measured_position is not None
    return np.asarray(trace.measured_position - trace.position)


# Profiles.


@pytest.mark.parametrize(
    ("profile", "expected"),
    [
        ({"profile": "abrupt"}, lambda x: 1.0),
        ({"profile": "incipient", "rate": 3.0}, lambda x: 1.0 - math.exp(-3.0 * x)),
        ({"profile": "ramp", "rise": 0.5}, lambda x: min(1.0, x / 0.5)),
        ({"profile": "periodic", "period": 0.25, "duty": 0.4}, lambda x: float(x % 0.25 < 0.1)),
        (
            {"profile": "one_shot", "period": 0.8},
            lambda x: math.sin(math.pi * x / 0.8) ** 2 if x < 0.8 else 0.0,
        ),
    ],
    ids=lambda x: x["profile"] if isinstance(x, dict) else "",
)
def test_profile(profile: dict[str, Any], expected: Any) -> None:
    """Nothing up to the onset and after the end; its formula between, times the severity."""
    fault = SensorBias(start=2.0, severity=3.0, **profile)
    for since in (1e-3, 0.03, 0.1234, 0.3, 0.61, 0.9, 1.7):
        found = fault.size(2.0 + since, 2.0, NEVER, 0.0)
        assert found == pytest.approx(3.0 * expected(since), rel=1e-9, abs=1e-12)
        assert fault.size(2.0 + since, 2.0, 2.0 + since, 0.0) == found, "up to its end"
        assert fault.size(2.0 + since, 2.0, 2.0 + since - 1e-9, 0.0) == 0.0
    for t in (0.0, 1.9, 2.0):
        assert fault.size(t, 2.0, NEVER, 0.0) == 0.0
    assert fault.size(5.0, NEVER, NEVER, 0.0) == 0.0


def test_intermittent_is_drawn_for_each_period() -> None:
    """On for the share `duty` of the periods, constant within each; another stream is another draw."""
    fault = SensorBias(profile="intermittent", period=0.5, duty=0.3, start=0.0)
    values = [[fault.size(0.5 * n + x, 0.0, NEVER, key) for n in range(4000)] for key in (7.0, 8.0)
              for x in (0.01, 0.49)]  # fmt: skip
    assert values[0] == values[1]
    assert values[0] != values[2]
    assert np.mean(values[0]) == pytest.approx(0.3, abs=4 * math.sqrt(0.3 * 0.7 / 4000))
    assert abs(np.corrcoef(values[0][1:], values[0][:-1])[0, 1]) < 0.05
    assert set(values[0]) == {0.0, 1.0}
    assert intermittent(0.0, 0.5, 1.0, 7.0) == 0.0


@given(k=st.integers(0, 10**7), dt_ns=st.integers(10_000, 100_000_000))
def test_ticks_are_numbered_as_they_are(k: int, dt_ns: int) -> None:
    """Whatever the rounding of t and dt."""
    assert tick_number(k * dt_ns / 1e9, dt_ns / 1e9) == k


# Triggers and lifetimes.


def test_a_condition_sets_a_fault_off_for_good() -> None:
    """It acts from the tick after the first in which the condition is met, and stays when it no longer is."""
    speed = np.abs(run("{type: sensor_bias, start: 9}").velocity[:, 1])
    limit = 0.99 * float(speed.max())
    first = int(np.argmax(speed > limit))
    assert 20 < first < 150
    fault = (
        "{type: sensor_bias, start: 0.01, bias: 0.001, trigger: condition, trigger_signal: speed, "
        f"trigger_joint: 2, trigger_above: {limit}"
    )
    trace = run(fault + "}")
    assert trace.fault_intervals == (FaultInterval(0, first / 1000, NEVER),)
    assert [(e.number, e.onset) for e in trace.fault_events] == [(0, first / 1000)]
    assert not bias(trace)[: first + 1].any()
    assert bias(trace)[first + 1 :] == pytest.approx(0.001, rel=1e-9)
    assert (np.abs(trace.velocity[first + 1 :, 1]) < limit).any()
    timed = run(fault + ", lifetime: timed, duration: 0.02}")
    assert timed.fault_intervals[0].end == pytest.approx(first / 1000 + 0.02)
    assert bias(timed)[first + 1 : first + 21] == pytest.approx(0.001, rel=1e-9)
    assert not bias(timed)[first + 21 :].any()


@pytest.mark.parametrize(
    ("signal", "bound", "fault"),
    [
        ("position", "trigger_above: 0.001", "type: sensor_bias"),
        ("position", "trigger_below: 0.05", "type: sensor_bias"),
        ("torque", "trigger_above: 45", "type: loss_of_effectiveness"),
        ("torque", "trigger_above: 45", "type: vo_kang_fault"),
        ("speed", "trigger_above: 0.01", "type: payload_pickup"),
        ("speed", "trigger_above: 0.01", "type: dropped_messages, topic: joint_states, probability: 1"),
    ],
)
def test_a_condition_may_look_at_anything_anywhere(signal: str, bound: str, fault: str) -> None:
    """At every site: the onset is the first tick in which the recorded signal meets it."""
    trace = run(
        f"{{{fault}, start: 0.005, trigger: condition, trigger_signal: {signal}, trigger_joint: 2, {bound}}}"
    )
    effort = np.vstack([trace.effort[1:], trace.effort[-1:]])  # applied in the tick, reported in the next
    if "vo_kang" in fault:
        effort = trace.command
    values = {"position": trace.position, "speed": np.abs(trace.velocity), "torque": np.abs(effort)}[signal][
        :, 1
    ]
    limit = float(bound.split()[1])
    met = (values > limit if "above" in bound else values < limit) & (np.arange(trace.ticks) > 5)
    assert met.any()
    assert trace.fault_intervals[0].onset == pytest.approx(np.argmax(met) * DT)


def test_a_timed_payload_is_put_down_again() -> None:
    """The robot is the loaded one for as long, and then what it was."""
    trace = run("{type: payload_pickup, start: 0.05, mass: 2, lifetime: timed, duration: 0.05}")
    for_good = run("{type: payload_pickup, start: 0.05, mass: 2}")
    assert same(trace, for_good, slice(102))
    assert not np.array_equal(trace.velocity[102], for_good.velocity[102])
    waiting = run(
        "{type: payload_pickup, start: 0.049, mass: 2, lifetime: timed, duration: 0.05, trigger: condition, "
        "trigger_signal: speed, trigger_above: -1}"
    )
    assert waiting.fault_intervals[0].onset == 0.05
    assert same(waiting, trace), "found by a condition at the same time, the run is the same"


# By hand.


HAND = "{type: sensor_bias, bias: 0.001, trigger: hand}"


def test_a_fault_is_armed_and_cleared_by_hand() -> None:
    """Armed in tick k it acts at t > t_k; cleared in tick k, up to t_k; and again."""
    changes = (order(50, "arm"), order(80, "clear"), order(120, "arm"))
    trace = run(HAND, changes=changes)
    assert trace.fault_intervals == (FaultInterval(0, 0.05, 0.08), FaultInterval(0, 0.12, NEVER))
    expected = np.zeros(201)
    expected[51:81] = expected[121:] = 0.001
    assert bias(trace) == pytest.approx(np.tile(expected[:, None], 3), rel=1e-9, abs=1e-15)
    assert run(HAND).fault_intervals == ()
    rows = windows(trace)["before_fault"], windows(trace)["after_fault"]
    assert rows == (None, slice(50, 201)), "the windows of the metrics begin where the fault does"


def test_by_hand_is_as_by_time() -> None:
    """The same run, bit for bit, at every site."""
    for number, kind in enumerate(
        ("sensor_bias", "loss_of_effectiveness", "vo_kang_fault", "payload_pickup", "dropped_messages",
         "dropped_messages, topic: disturbance_estimate")
    ):  # fmt: skip
        by_time = run(f"{{type: {kind}, start: 0.05, lifetime: timed, duration: 0.05}}")
        by_hand = run(f"{{type: {kind}, trigger: hand}}", changes=(order(50, "arm"), order(100, "clear")))
        assert same(by_time, by_hand), (number, kind)
        assert not same(by_time, run())


def test_a_fault_until_cleared_begins_by_time() -> None:
    """Its end is decided while the run is on."""
    trace = run(
        "{type: sensor_bias, bias: 0.001, start: 0.03, lifetime: until_cleared}",
        changes=(order(70, "clear"),),
    )
    assert trace.fault_intervals == (FaultInterval(0, 0.03, 0.07),)
    assert trace.fault_events == (FaultEvent(70, 0, 0.03, 0.07),)
    assert (bias(trace).any(axis=1).nonzero()[0][[0, -1]] == [31, 70]).all()


def test_a_trace_keeps_what_was_decided(tmp_path: Path) -> None:
    """Orders and events come back from the file, and the run can be done again from it."""
    trace = run(HAND, changes=(order(50, "arm"), order(80, "clear")))
    save_trace(tmp_path / "trace.npz", trace)
    read = load_trace(tmp_path / "trace.npz")
    assert (read.changes, read.fault_events) == (trace.changes, trace.fault_events)
    assert read.fault_intervals == trace.fault_intervals
    assert read.scenario is not None
    assert same(simulate(read.scenario, read.changes), trace)


# Ground truth.


def test_sizes_and_signals() -> None:
    """What is added is the size times what the effect says; nothing where the size is zero."""
    faults = (
        "{type: sensor_bias, start: 0.05, bias: [0.01, -0.02, 0], profile: ramp, rise: 0.1, severity: 2}",
        "{type: loss_of_effectiveness, start: 0.1, loss: 0.5, joint: 2}",
        "{type: vo_kang_fault, start: 0.02, lifetime: timed, duration: 0.05}",
        "{type: payload_pickup, start: 0.1}",
        "{type: dropped_messages, start: 0.05, probability: 0.3}",
    )
    trace = run(*faults)
    sizes, signals = fault_sizes(trace), fault_signals(trace)
    assert sizes.shape == (201, 5)
    since = np.maximum(trace.time - 0.05, 0.0)
    assert sizes[:, 0] == pytest.approx(2.0 * np.minimum(1.0, since / 0.1), abs=1e-12)
    assert [np.flatnonzero(sizes[:, n])[[0, -1]].tolist() for n in (1, 2, 3)] == [
        [101, 200],
        [21, 70],
        [101, 200],
    ]
    assert signals[0]["position"] == pytest.approx(sizes[:, :1] * [0.01, -0.02, 0.0], abs=1e-12)
    assert trace.measured_position is not None
    assert signals[0]["position"] == pytest.approx(bias(trace), abs=1e-15)
    lost = signals[1]["torque"][:-1, 1]
    assert lost == pytest.approx(-0.5 * sizes[:-1, 1] * trace.effort[1:, 1], abs=1e-12)
    assert not signals[1]["torque"][:, [0, 2]].any()
    without = simulate(replace(trace.scenario, faults=()))  # type: ignore[type-var]
    assert without.disturbance[0] == pytest.approx(trace.disturbance[0])
    assert np.flatnonzero(signals[2]["torque"].any(axis=1))[[0, -1]].tolist() == [21, 70]
    assert signals[3] == {}
    assert 0.1 < signals[4]["disturbed"][51:].mean() < 0.5
    assert not signals[4]["disturbed"][:51].any()


def test_signals_of_a_run_that_does_not_come_again_are_refused() -> None:
    """A run in real time that missed deadlines, for example."""
    trace = run(HAND, changes=(order(50, "arm"),))
    trace.position[100:] += 1e-12
    with pytest.raises(FtcmError, match="another motion from tick 100 on"):
        fault_signals(trace)


# Any number at once, in any order.


MANY = [
    "{type: loss_of_effectiveness, start: 0.02, loss: 0.2}",
    "{type: loss_of_effectiveness, start: 0.05, loss: 0.3, joint: 2}",
    "{type: vo_kang_fault, start: 0.03}",
    "{type: vo_kang_fault, start: 0.06, severity: 0.1, joint: 1}",
    "{type: sensor_drift, start: 0.02, walk: 0.001}",
    "{type: sensor_drift, start: 0.04, walk: 0.002, joint: 3}",
    "{type: sensor_bias, start: 0.01, bias: 0.0003, profile: intermittent, period: 0.01}",
    "{type: dropped_messages, start: 0.01, topic: joint_torques}",
    "{type: dropped_messages, start: 0.05, topic: joint_torques, probability: 0.3}",
    "{type: payload_pickup, start: 0.03, mass: 1}",
    "{type: payload_pickup, start: 0.07, mass: 0.3}",
]


@settings(deadline=None, max_examples=10)
@given(order=st.permutations(range(len(MANY))))
def test_the_order_of_faults_in_a_scenario_does_not_matter(order: list[int]) -> None:
    """Bit for bit, random ones included."""
    assert same(run(*[MANY[i] for i in order]), run(*MANY))


def test_one_joint_breaks_the_others_do_not() -> None:
    """`joint` picks one; 0 is all."""
    for joint in range(4):
        off = bias(run(f"{{type: sensor_bias, start: 0.05, bias: 0.001, joint: {joint}}}"))[100] > 0
        assert off.tolist() == [joint in (0, j) for j in (1, 2, 3)]


# What is refused.


@pytest.mark.parametrize(
    ("fault", "text"),
    [
        ({"type": "sensor_bias", "joint": 4}, "joint: 4 is out of range; expected 0 (all) to 3"),
        ({"type": "sensor_bias", "trigger": "condition"}, "condition, but trigger_above and trigger_below"),
        ({"type": "sensor_bias", "trigger": "condition", "trigger_above": 1, "trigger_joint": 5},
         "trigger_joint: 5 is out of range; expected 1 to 3"),
        ({"type": "dropped_messages", "topic": "disturbance_estimate", "trigger": "condition",
          "trigger_above": 1},
         "does not know the true motion; expected time or hand"),
        ({"type": "sensor_bias", "trigger": "somehow"}, "not one of time, condition, hand"),
        ({"type": "sensor_bias", "lifetime": "timed", "duration": 0}, "duration: 0 is out of range"),
    ],
)  # fmt: skip
def test_what_makes_no_sense_is_one_line(fault: dict[str, Any], text: str) -> None:
    scenario = {**load("paper").to_mapping(), "injection": {"faults": [fault]}}
    with pytest.raises(ScenarioError) as caught:
        from_mapping(scenario)
    assert text in str(caught.value)
    assert str(caught.value).startswith("scenario: injection.faults.0")
    assert "\n" not in str(caught.value)


def test_a_robot_that_may_change_at_any_time_is_not_compiled() -> None:
    """With the reason; by time it is."""
    pytest.importorskip("numba")
    scenario = load("paper", ["duration=0.05", "injection.faults=[{type: payload_pickup, trigger: hand}]"])
    with pytest.raises(compiled.NotCompilable, match="changes the robot at a time that is not known"):
        compiled.simulate(scenario)
