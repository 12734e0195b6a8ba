# SPDX-License-Identifier: Apache-2.0
"""Metrics on made-up traces whose answers are known; windows; results that programs can read."""

from __future__ import annotations

import json
import math
from typing import Any

import numpy as np
import pytest

from ftcm_core.recording import metrics
from ftcm_core.recording.metrics import METRICS, evaluate, result, windows
from ftcm_core.recording.trace import Change, Trace
from ftcm_core.robots.puma560 import Puma560
from ftcm_core.scenario import load
from ftcm_core.signals import COLUMNS
from ftcm_core.simulation import simulate

DT = 1e-3


def made_up(ticks: int = 1000, overrides: list[str] | None = None, **columns: Any) -> Trace:
    """A trace of zeros but for the columns given, which may be one value per tick."""
    data = {name: np.zeros((ticks, 3)) for name, column in COLUMNS.items() if not column.when}
    for name, column in columns.items():
        values = np.asarray(column, dtype=float)
        data[name] = np.repeat(values[:, None], 3, axis=1) if values.ndim == 1 else values
    return Trace(
        joint_names=("a", "b", "c"),
        dt=DT,
        time_ns=np.arange(ticks, dtype=np.int64) * 1_000_000,
        **data,
        scenario=None if overrides is None else load("paper", overrides),
    )


def value(metric: str, trace: Trace, rows: slice | None = None) -> list[float]:
    """One metric, by its name in reports."""
    return METRICS[metric][0](trace, rows or slice(0, trace.ticks)).tolist()


ALTERNATING = np.where(np.arange(1000) % 2, -1.0, 1.0)
SINGLE = np.eye(1, 1000, 700)[0]  # 1 rad at t = 0.7 s only
ERRORS = np.stack([np.full(1000, -2.0), ALTERNATING, SINGLE], axis=1)


@pytest.mark.parametrize(
    ("metric", "expected"),
    [
        ("mean_abs_error", [2.0, 1.0, 1e-3]),
        ("rms_error", [2.0, 1.0, math.sqrt(1e-3)]),
        ("max_abs_error", [2.0, 1.0, 1.0]),
        ("iae", [2.0, 1.0, 1e-3]),
        ("ise", [4.0, 1.0, 1e-3]),
        ("itae", [2 * 0.4995, 0.4995, 0.7e-3]),
        ("steady_state_error", [2.0, 1.0, 0.0]),
    ],
)
def test_error_metrics(metric: str, expected: list[float]) -> None:
    """A constant, an alternating and a single error, over one second; the sign does not matter."""
    assert value(metric, made_up(position=ERRORS)) == pytest.approx(expected, rel=1e-12)
    assert value(metric, made_up(reference_position=ERRORS)) == pytest.approx(expected, rel=1e-12)


def test_error_metrics_of_a_window() -> None:
    """Only its rows count; ITAE's time begins with it; the steady state is its last tenth."""
    trace, rows = made_up(position=ERRORS), slice(600, 750)
    assert value("mean_abs_error", trace, rows)[2] == pytest.approx(1 / 150, rel=1e-14)
    assert value("itae", trace, rows)[2] == pytest.approx(0.1 * DT, rel=1e-12)
    assert value("iae", trace, rows)[0] == pytest.approx(0.3, rel=1e-14)
    assert value("steady_state_error", trace, rows) == pytest.approx([2.0, 1.0, 0.0])
    assert value("steady_state_error", trace, slice(601, 701)) == pytest.approx([2.0, 1.0, 0.1])


def test_settling_time() -> None:
    """From the window's begin until |e| stays within 1 mrad: the last time out counts."""
    t = np.arange(10_000) * DT
    decay, leaves_again = np.exp(-t), np.where(t == 5.0, -0.002, 0.0005)
    trace = made_up(10_000, position=np.stack([decay, leaves_again, np.zeros(10_000)], axis=1))
    assert value("settling_time", trace) == pytest.approx([6.908, 5.001, 0.0], rel=1e-12)
    assert value("settling_time", trace, slice(5000, 10_000)) == pytest.approx([1.908, 0.001, 0.0], rel=1e-12)
    assert np.isnan(value("settling_time", made_up(position=ERRORS))[:2]).all(), "never settles"
    assert value("settling_time", made_up(position=np.full(1000, 1e-3))) == [0.0] * 3, "the band is closed"


def test_torque_metrics() -> None:
    """RMS, peak and variation per second of a constant, an alternating and a ramping torque."""
    torque = np.stack([np.full(1000, 3.0), 5 * ALTERNATING, np.arange(1000) * DT], axis=1)
    trace = made_up(command=torque)
    assert value("torque_rms", trace) == pytest.approx([3.0, 5.0, math.sqrt(np.mean(torque[:, 2] ** 2))])
    assert value("torque_peak", trace) == pytest.approx([3.0, 5.0, 0.999])
    assert value("torque_total_variation", trace) == pytest.approx([0.0, 10.0 / DT, 1.0], rel=1e-12)


@pytest.mark.parametrize("ticks", [1000, 1001, 40_001])
@pytest.mark.parametrize(
    ("frequency", "share"), [(5.0, 0.0), (40.0, 0.0), (60.0, 1.0), (200.0, 1.0), (437.0, 1.0)]
)
def test_high_frequency_torque(ticks: int, frequency: float, share: float) -> None:
    """A sine's RMS counts above 50 Hz and not below, whatever the constant torque under it."""
    t = np.arange(ticks) * DT
    trace = made_up(ticks, command=100.0 + 4.0 * np.sin(2 * np.pi * frequency * t + 0.3))
    assert value("torque_high_frequency_rms", trace) == pytest.approx(
        [share * 4 / math.sqrt(2)] * 3, abs=2e-2
    )


@pytest.mark.parametrize("ticks", [1000, 1001])
def test_high_frequency_torque_of_chattering(ticks: int) -> None:
    """A torque that flips ±4 N·m every tick has an RMS of 4 N·m, all of it above 50 Hz."""
    trace = made_up(ticks, command=4.0 * np.where(np.arange(ticks) % 2, -1.0, 1.0))
    assert value("torque_high_frequency_rms", trace) == pytest.approx([4.0] * 3, rel=2e-3)


def test_saturation_share() -> None:
    """Ticks at or beyond the limit, of either sign; without limits there is nothing to reach."""
    torque = np.stack([np.repeat([10.0, 9.9], 500), -20 * ALTERNATING, np.zeros(1000)], axis=1)
    limited = made_up(command=torque, overrides=["torque_limits=[10, 20, 30]"])
    assert value("saturation_share", limited) == [0.5, 1.0, 0.0]
    assert value("saturation_share", made_up(command=torque, overrides=[])) == [0.0] * 3
    assert value("saturation_share", made_up(command=torque)) == [0.0] * 3


def test_observer_metrics() -> None:
    """Δ - Δ̂ = -M⁻¹ (d + tau_hat), for a d three times as large in one tick; zero for tau_hat = -d."""
    robot, q = Puma560(), (0.3, -0.4, 0.7)
    d = np.outer(ALTERNATING * (1.0 + 2.0 * SINGLE), [1.0, 2.0, -3.0])
    size = np.abs(robot.inertia_acceleration(q, (1.0, 2.0, -3.0)))
    blind = made_up(position=np.tile(q, (1000, 1)), disturbance=d, overrides=[])
    perfect = made_up(position=np.tile(q, (1000, 1)), disturbance=d, disturbance_estimate=-d, overrides=[])
    for metric, factor in (("observer_rms_error", math.sqrt(1.008)), ("observer_max_error", 3.0)):
        assert value(metric, blind) == pytest.approx(factor * size, rel=1e-13)
        assert value(metric, perfect) == [0.0] * 3


@pytest.mark.parametrize(
    ("transient", "faults", "expected"),
    [  # rows of transient, after_transient, before_fault, after_fault
        (0.2, [0.6], [(0, 200), (200, 1000), (200, 600), (600, 1000)]),
        (0.2, [], [(0, 200), (200, 1000), (200, 1000), None]),
        (0.2, [5], [(0, 200), (200, 1000), (200, 1000), None]),
        (0.7, [0.3], [(0, 700), (700, 1000), None, (300, 1000)]),
        (0, [0], [None, (0, 1000), None, (0, 1000)]),
        (7, [0.9985], [(0, 1000), None, None, None]),  # one row alone is no window
        (0.1, [0.8, 0.4], [(0, 100), (100, 1000), (100, 400), (400, 1000)]),
        (1e300, [1e300], [(0, 1000), None, None, None]),
    ],
)
def test_windows(transient: float, faults: list[float], expected: list[tuple[int, int] | None]) -> None:
    """Rows of each; None for a window that a run does not have."""
    entries = ", ".join(f"{{type: vo_kang_fault, start: {t}}}" for t in faults)
    found = windows(made_up(overrides=[f"transient={transient}", f"injection.faults=[{entries}]"]))
    assert list(found) == ["whole", "transient", "after_transient", "before_fault", "after_fault"]
    assert list(found.values()) == [slice(0, 1000), *(rows and slice(*rows) for rows in expected)]


def test_missing_data_give_no_value() -> None:
    """A column that a recording lacks is NaN; what needs it has no value, rather than a good one."""
    nothing = np.full(1000, np.nan)
    needs = {
        "position": ("mean_abs_error", "rms_error", "max_abs_error", "iae", "ise", "itae", "settling_time",
                     "steady_state_error", "observer_rms_error"),
        "command": ("torque_rms", "torque_peak", "torque_total_variation", "torque_high_frequency_rms",
                    "saturation_share"),
        "disturbance": ("observer_rms_error", "observer_max_error"),
    }  # fmt: skip
    for column, names in needs.items():
        whole = evaluate(made_up(overrides=["torque_limits=10"], **{column: nothing}))["whole"]
        assert whole is not None
        for name in names:
            assert whole[name] == [None] * 3, (column, name)
        others = set(METRICS) - set(names) - {"observer_max_error"}
        assert all(None not in whole[name] for name in others), column


def test_evaluate_has_every_metric_of_every_window() -> None:
    """As plain floats, one per joint; a missing window is None."""
    trace = simulate(load("paper", ["duration=1.2", "injection.faults.0.start=1.1"]))
    found = evaluate(trace)
    assert list(found) == ["whole", "transient", "after_transient", "before_fault", "after_fault"]
    for window, name in ((w, n) for w in found for n in METRICS):
        part = found[window]
        assert part is not None
        assert [type(x) for x in part[name]] == [float] * 3 or name == "settling_time"
    short = evaluate(simulate(load("paper", ["duration=0.5"])))
    assert (short["after_transient"], short["before_fault"], short["after_fault"]) == (None, None, None)


@pytest.mark.parametrize("ticks", [2, 127, 128, 129, 1000])
def test_the_largest_is_found_wherever_it_is(ticks: int) -> None:
    """Also where rows are looked at side by side; a missing value is none."""
    errors = np.random.default_rng(ticks).normal(size=(ticks, 3))
    for row in {0, ticks // 2, ticks - 1}:
        there = errors.copy()
        there[row, 1] = -9.0
        expected = [max(map(abs, there[:, joint].tolist())) for joint in range(3)]
        assert value("max_abs_error", made_up(ticks, position=there)) == expected
        there[row, 2] = np.nan
        assert np.isnan(value("max_abs_error", made_up(ticks, position=there))).tolist() == [
            False,
            False,
            True,
        ]


def test_metrics_are_pure() -> None:
    """They leave the trace as it is."""
    trace = simulate(load("paper", ["duration=0.2"]))
    before = [column.tobytes() for column in trace.columns.values()]
    assert evaluate(trace) == evaluate(trace)
    assert [column.tobytes() for column in trace.columns.values()] == before


def test_every_metric_is_documented() -> None:
    """What it is, with its unit."""
    for name, (function, unit) in METRICS.items():
        assert function.__name__ == name
        assert function is getattr(metrics, name)
        assert unit == "-" or unit in (function.__doc__ or ""), name


def test_result_is_complete_and_serialisable() -> None:
    """What ran, how it ended, the first torque, the bound of eq 15, and everything needed to run it again."""
    changes = [Change(50, "controller", load("paper", ["controller=smc"]).controller)]
    trace = simulate(load("paper", ["duration=0.1"]), changes=changes)
    found = json.loads(json.dumps(result(trace), allow_nan=False))
    assert (found["scenario"], found["controller"], found["observer"]) == ("paper", "ftcm", "do")
    assert (found["status"], found["detail"], found["ticks"]) == ("completed", "", 101)
    assert found["first_torque"] == trace.command[0].tolist()
    assert found["settling_time_bound"] == pytest.approx([0.5**0.4 / 0.8] * 3, rel=1e-14)
    assert found["changes"][0]["tick"] == 50
    assert (found["changes"][0]["kind"], found["changes"][0]["type"]) == ("controller", "smc")
    assert found["configuration"] == load("paper", ["duration=0.1"]).to_mapping()
    assert found["metrics"]["after_fault"] is None


@pytest.mark.parametrize("law", ["smc", "pid"])
def test_no_settling_time_bound(law: str) -> None:
    """Null for a law without one."""
    found = result(simulate(load("paper", ["duration=0.01", f"controller={law}"])))
    assert found["settling_time_bound"] == [None] * 3


def test_result_of_a_bare_trace() -> None:
    """A recording that does not say what it is of."""
    found = json.loads(json.dumps(result(made_up()), allow_nan=False))
    assert (found["scenario"], found["controller"], found["configuration"]) == (None, None, None)
    empty = json.loads(json.dumps(result(made_up(0)), allow_nan=False))
    assert set(empty["metrics"].values()) == {None}
    assert empty["first_torque"] == [None] * 3
