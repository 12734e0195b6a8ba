# SPDX-License-Identifier: Apache-2.0
"""The residual threshold: when it raises an alarm, and what a run records of it."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from ftcm_core.cli import main
from ftcm_core.detectors.residual_threshold import ResidualThreshold
from ftcm_core.errors import ScenarioError
from ftcm_core.recording.trace import Change, Trace
from ftcm_core.recording.trace_file import load_trace
from ftcm_core.robots.puma560 import Puma560
from ftcm_core.scenario import load, replace
from ftcm_core.signals import Measurement, Vector
from ftcm_core.simulation import simulate
from ftcm_core.simulation.stages import DetectorStage
from traces import same

ROBOT, DT, ZERO = Puma560(), 1e-3, (0.0, 0.0, 0.0)
REST = Measurement(ZERO, ZERO, ZERO)
FAULT = ["injection.faults.0.start=1", "duration=1.2"]


def alarms(detector: ResidualThreshold, estimates: list[Vector], dt: float = DT) -> list[Vector]:
    """Alarms of a sequence of estimates; the residual is the estimate."""
    state, found = detector.init(3), []
    for estimate in estimates:
        detection, state = detector.step(ROBOT, dt, REST, ZERO, estimate, state)
        assert detection.residual == estimate
        found.append(detection.alarm)
    return found


@pytest.mark.parametrize(("hold", "ticks"), [(0.0, 1), (0.0005, 1), (0.0035, 4), (0.0105, 11)])
@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_an_alarm_comes_once_the_excess_has_lasted(hold: float, ticks: int, sign: float) -> None:
    """Either sign; it goes with the excess, and the time then counts from zero again."""
    high, low = (sign * 5.1,) * 3, (sign * 4.9,) * 3
    found = alarms(ResidualThreshold(threshold=5.0, hold=hold), [low, *[high] * 20, low, *[high] * 20])
    assert found[0] == ZERO
    first = [x[0] for x in found[1:21]]
    assert first == [0.0] * (ticks - 1) + [1.0] * (21 - ticks)
    assert found[21] == ZERO
    assert found[22:] == found[1:21]


def test_the_threshold_itself_is_no_excess_and_every_joint_has_its_own() -> None:
    """Thresholds and times per joint."""
    detector = ResidualThreshold(threshold=[5.0, 6.0, 7.0], hold=[0.0, 0.0015, 0.0])
    assert alarms(detector, [(5.0, 6.0, 7.0)] * 3) == [ZERO] * 3
    found = alarms(detector, [(6.5, 6.5, 6.5)] * 3)
    assert found == [(1.0, 0.0, 0.0), (1.0, 1.0, 0.0), (1.0, 1.0, 0.0)]


def test_time_is_real_time_where_ticks_were_skipped() -> None:
    """One message after five ticks counts as five."""
    scenario = load("paper", ["detector={type: residual_threshold, threshold: 5, hold: 0.0035}"])
    stage, late = DetectorStage(scenario), DetectorStage(scenario)
    high = (6.0,) * 3
    assert [stage.step(REST, ZERO, high).alarm for _ in range(4)][-2:] == [ZERO, (1.0,) * 3]
    assert late.step(REST, ZERO, high, ticks=5).alarm == (1.0,) * 3


def raised(trace: Trace) -> np.ndarray:
    """First alarm of each joint after the transient, s; NaN if there is none."""
    assert trace.alarm is not None
    late = trace.alarm[600:]
    return np.where(late.any(axis=0), trace.time[600 + np.argmax(late, axis=0)], np.nan)


def test_a_run_records_residuals_and_alarms() -> None:
    """The residual is the estimate of the same tick; alarms follow from it by threshold and time."""
    scenario = load("paper", [*FAULT, "detector={type: residual_threshold, threshold: 3, hold: 0.0045}"])
    trace = simulate(scenario)
    assert list(trace.columns)[-3:] == ["residual", "alarm", "verdict"]
    assert trace.residual is not None
    assert trace.alarm is not None
    assert np.array_equal(trace.residual, trace.disturbance_estimate)
    above = np.abs(trace.disturbance_estimate) > 3.0
    expected, run = np.zeros_like(above, dtype=float), np.zeros(3)
    for k, row in enumerate(above):
        run = np.where(row, run + 1, 0)
        expected[k] = run >= 5
    assert np.array_equal(trace.alarm, expected)
    assert trace.verdict is not None
    assert np.array_equal(trace.verdict, expected), "unknown, as it cannot tell"
    assert not trace.alarm[600:1001].any(), "friction alone is below the threshold"
    assert (raised(trace)[[0, 2]] > 1.0).all()
    assert (raised(trace)[[0, 2]] < 1.02).all()


def test_a_detector_changes_nothing_of_the_run() -> None:
    """It only looks: every other column is that of the run without one."""
    with_one, without = (
        simulate(load("paper", [*FAULT, "detector=residual_threshold"])),
        simulate(load("paper", FAULT)),
    )
    assert without.residual is None
    for name, column in without.columns.items():
        assert np.array_equal(column, with_one.columns[name]), name


def test_a_swap_keeps_the_time_of_the_same_kind() -> None:
    """Another threshold holds from its tick on."""
    scenario = load("paper", [*FAULT, "detector={type: residual_threshold, threshold: 1e6}"])
    change = Change(1150, "detector", ResidualThreshold(threshold=3.0, hold=0.0))
    trace, never = simulate(scenario, [change]), simulate(scenario)
    assert trace.alarm is not None
    assert never.alarm is not None
    assert not never.alarm.any()
    assert not trace.alarm[:1150].any()
    assert trace.alarm[1150].tolist() == [1.0, 1.0, 1.0]
    assert same(trace, never, slice(1150))


def test_an_observer_is_needed() -> None:
    """One line says which part asks for it."""
    with pytest.raises(
        ScenarioError, match=r"observer: none, but detector 'residual_threshold' uses the dist"
    ):
        load("paper", ["detector=residual_threshold", "observer=none"], "smc")
    smc = load("paper", ["detector=residual_threshold", "duration=0.05"], "smc")
    assert simulate(smc).residual is not None
    assert replace(smc, detector=None).columns == load("paper", [], "smc").columns


def test_the_command_line_writes_what_it_finds(tmp_path: Path) -> None:
    """In trace.npz, with the scenario in which the detector stands."""
    command = ["simulate", "paper", "--set", *FAULT, "detector={type: residual_threshold, threshold: 3}"]
    assert main([*command, "--no-figures", "--output", str(tmp_path / "out")]) == 0
    trace = load_trace(tmp_path / "out" / "trace.npz")
    assert trace.scenario is not None
    assert trace.scenario.detector == ResidualThreshold(threshold=3.0)
    assert same(trace, simulate(trace.scenario))
    assert trace.alarm is not None
    assert trace.alarm.any()
