# SPDX-License-Identifier: Apache-2.0
"""Scores of detection: of runs made by hand, whose scores can be counted; and where they are shown."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from ftcm_core.cli import main
from ftcm_core.recording.detection import (
    detection_scores,
    poisson_at_most,
    poisson_interval,
    pooled_scores,
)
from ftcm_core.recording.trace import FaultEvent, Trace
from ftcm_core.report.table import detection_table
from ftcm_core.scenario import load

DT, TICKS = 0.1, 101  # 10 s
BIAS = "{type: sensor_bias, joint: 2, start: 4, lifetime: timed, duration: 2}"


def made(alarms: dict[int, list[tuple[int, int]]], faults: str = BIAS, **more: Any) -> Trace:
    """A run of 10 s with alarms of joints (from 1) in half-open intervals of ticks."""
    scenario = load(
        "paper",
        [f"dt={DT}", "duration=10", "transient=1", "detector=cusum", f"injection.faults=[{faults}]"],
    )
    zeros, alarm = np.zeros((TICKS, 3)), np.zeros((TICKS, 3))
    for joint, intervals in alarms.items():
        for first, end in intervals:
            alarm[first:end, joint - 1] = 1.0
    names = ("position", "velocity", "effort", "disturbance_estimate", "command", "disturbance")
    columns = {name: zeros for name in (*names, "reference_position", "reference_velocity", "residual")}
    return Trace(
        joint_names=scenario.robot.joint_names,
        dt=DT,
        time_ns=np.arange(TICKS) * 100_000_000,
        scenario=scenario,
        **{"alarm": alarm, **columns, **more},
    )


def scores(trace: Trace) -> dict[str, Any]:
    """Scores of a run that has some."""
    found = detection_scores(trace)
    assert found is not None
    return found


def test_a_fault_is_detected_by_the_first_alarm_that_begins_while_it_acts() -> None:
    """Delay from the onset; joints of that alarm; what is on when it acts no more ends by itself."""
    found = scores(made({2: [(43, 80)], 3: [(43, 44), (50, 51)]}))
    assert found["faults"] == [
        {
            "type": "sensor_bias", "joint": 2, "onset": 4.0, "end": 6.0, "detected": True,
            "delay": pytest.approx(0.3), "alarm_joints": [2, 3], "alarm_before": False,
            "verdict": None, "verdict_joint": None,
        }
    ]  # fmt: skip
    assert (found["false_alarms"], found["transient_alarms"]) == (0, 0)


@pytest.mark.parametrize(("tick", "detected"), [(40, False), (41, True), (60, True), (61, False)])
def test_it_acts_after_its_onset_and_up_to_its_end(tick: int, detected: bool) -> None:
    """At t = 4 s it does not yet, at 6 s it still does; elsewhere the alarm is false."""
    found = scores(made({1: [(tick, tick + 1)]}))
    assert found["faults"][0]["detected"] is detected
    assert found["false_alarms"] == (0 if detected else 1)


def test_an_alarm_that_is_on_already_does_not_detect() -> None:
    """It is false, once; one of another joint that begins then does."""
    found = scores(made({1: [(30, 100)]}))
    assert (found["faults"][0]["detected"], found["faults"][0]["alarm_before"]) == (False, True)
    assert found["faults"][0]["delay"] is None
    assert found["false_alarms"] == 1
    both = scores(made({1: [(30, 100)], 3: [(45, 46)]}))["faults"][0]
    assert (both["detected"], both["alarm_joints"]) == (True, [3])


def test_false_alarms_have_an_exposure() -> None:
    """10 s less 1 s of transient less 2 s of fault, counted in ticks: 71 ticks."""
    found = scores(made({1: [(5, 6), (20, 22), (90, 95)], 2: [(90, 91)]}))
    assert found["transient_alarms"] == 1
    assert found["false_alarms"] == 3
    assert found["exposure"] == pytest.approx(7.1)
    assert found["false_alarms_per_hour"] == pytest.approx(3 / 7.1 * 3600)
    assert found["false_share"] == pytest.approx(7 / 71)


def test_every_time_a_fault_acts_counts_and_one_after_the_run_does_not() -> None:
    """A fault armed by hand twice; another that would begin after the end."""
    by_hand = "{type: sensor_bias, joint: 1, trigger: hand}, {type: sensor_bias, start: 50}"
    events = (FaultEvent(20, 0, 2.0, 3.0), FaultEvent(70, 0, 7.0, 8.0))
    found = scores(made({1: [(72, 80)]}, by_hand, fault_events=events))
    assert [(f["onset"], f["detected"]) for f in found["faults"]] == [(2.0, False), (7.0, True)]


def test_faults_that_act_at_once_are_both_credited() -> None:
    """No test of an alarm could tell to which it belongs."""
    found = scores(made({1: [(50, 60)]}, f"{BIAS}, {{type: sensor_bias, joint: 1, start: 4.5}}"))
    assert [f["delay"] for f in found["faults"]] == pytest.approx([1.0, 0.5])
    assert found["faults"][1]["end"] is None


def test_a_missing_tick_begins_no_alarm() -> None:
    """It is taken as the one before; none before the first."""
    trace = made({1: [(20, 30)]})
    assert trace.alarm is not None
    trace.alarm[[0, 24, 25]] = math.nan
    assert scores(trace)["false_alarms"] == 1


def test_there_are_no_scores_without_detector_or_truth() -> None:
    """None; and with faults all the time no rate."""
    assert detection_scores(made({}, alarm=None)) is None
    always = scores(made({}, "{type: sensor_bias, start: 0}"))
    assert (always["exposure"], always["false_alarms_per_hour"]) == (0.0, None)


def test_the_verdict_of_a_fault_is_what_was_said_most_of_what_can_be_told() -> None:
    """`unknown` counts only where nothing else was said; what is said before or after the fault does not."""
    said = np.zeros((TICKS, 3))
    said[30:41, 0], said[61:, 0] = 3.0, 3.0
    assert scores(made({}, verdict=said))["faults"][0]["verdict"] == "none"
    said[41:61, 2] = 1.0
    fault = scores(made({}, verdict=said))["faults"][0]
    assert (fault["verdict"], fault["verdict_joint"]) == ("unknown", 3)
    said[50:53, 1], said[55:57, 0] = 2.0, 4.0
    fault = scores(made({}, verdict=said))["faults"][0]
    assert (fault["verdict"], fault["verdict_joint"]) == ("sensor", 2)
    found = pooled_scores([scores(made({}, verdict=said)), scores(made({}))])["isolation"]
    assert found == {
        "sensor_bias": {"none": 0, "unknown": 0, "sensor": 1, "loss_of_effectiveness": 0, "added_torque": 0}
    }


def test_runs_are_pooled() -> None:
    """Delays 0.1 to 1.0 s and two missed; exposures and false alarms are summed."""
    runs = [scores(made({2: [(40 + k, 60)], 1: [(20, 21)]})) for k in range(1, 11)]
    found = pooled_scores([*runs, scores(made({})), scores(made({}))])
    assert (found["runs"], found["faults"], found["missed"]) == (12, 12, 2)
    assert found["missed_rate"] == pytest.approx(1 / 6)
    assert found["delay_median"] == pytest.approx(0.55)
    assert found["delay_q95"] == pytest.approx(0.955)
    assert found["exposure"] == pytest.approx(12 * 7.1)
    assert found["false_alarms_per_hour"] == pytest.approx(10 / (12 * 7.1) * 3600)
    low, high = found["false_alarms_per_hour_95"]
    assert (low / 3600 * 85.2, high / 3600 * 85.2) == pytest.approx((4.795, 18.390), abs=1e-3)  # Garwood


def test_the_interval_of_a_count_has_the_tails_that_it_should() -> None:
    """2.5 % on either side; of none, the upper end alone: -ln 0.025."""
    assert poisson_interval(0) == pytest.approx((0.0, -math.log(0.025)))
    for count in (1, 7, 300):
        low, high = poisson_interval(count)
        assert 1.0 - poisson_at_most(count - 1, low) == pytest.approx(0.025, rel=1e-6)
        assert poisson_at_most(count, high) == pytest.approx(0.025, rel=1e-6)


def test_the_table_says_what_was_missed() -> None:
    """One line per fault and per run, and all together."""
    results = [
        {"scenario": "s", "controller": "c", "label": name, "detection": scores(made(alarms))}
        for name, alarms in (("one", {2: [(45, 60)]}), ("two", {2: [(30, 99)]}))
    ]
    text = detection_table([*results, {"scenario": "s", "controller": "c", "detection": None}])
    assert "| one   | cusum      | sensor_bias | 2       | 4          | 0.5 " in text
    assert "missed, alarm on before" in text
    assert "Together, 2 runs: 1 of 2 faults missed; delay 0.5 s (median)" in text
    assert detection_table([{"detection": None}]) == ""


def test_the_command_shows_them(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """In its tables and in summary.json."""
    faults = "injection.faults=[{type: loss_of_effectiveness, start: 1, joint: 2}]"
    detector = "detector={type: cusum, residual: momentum}"
    command = ["simulate", "paper", "--set", "duration=1.2", faults, detector, "--no-figures"]
    assert main([*command, "--output", str(tmp_path / "out")]) == 0
    assert "| ftcm  | cusum      | loss_of_effectiveness | 2 " in capsys.readouterr().out
    summary = json.loads((tmp_path / "out" / "summary.json").read_text())
    (fault,) = summary["results"][0]["detection"]["faults"]
    assert fault["detected"]
    assert 0.0 < fault["delay"] < 0.1
    assert summary["detection"]["missed"] == 0
