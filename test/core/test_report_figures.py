# SPDX-License-Identifier: Apache-2.0
"""Figures: written for any run, with nothing left out by decimation and the user's settings untouched."""

from __future__ import annotations

import builtins
import dataclasses
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from ftcm_core.errors import FtcmError
from ftcm_core.recording.trace import Change, Trace
from ftcm_core.recording.trace_file import load_trace, save_trace
from ftcm_core.report import figures
from ftcm_core.report.figures import FIGURES, write_figures
from ftcm_core.report.panels import envelope
from ftcm_core.scenario import load
from ftcm_core.signals import COLUMNS
from ftcm_core.simulation import simulate
from traces import same

matplotlib = pytest.importorskip("matplotlib")


def run(*overrides: str, controller: str = "ftcm") -> Trace:
    """A short run with a fault in it."""
    return simulate(load("paper", ["duration=1.6", "injection.faults.0.start=1.2", *overrides], controller))


@pytest.fixture(scope="module")
def traces() -> list[tuple[str, Trace]]:
    """The paper's three controllers, shortly."""
    return [(name, run(controller=name)) for name in ("smc", "nftsmc", "ftcm")]


def texts(figure: Any) -> list[str]:
    """Every text inside the panels of a figure."""
    return [t.get_text() for ax in figure.axes for t in ax.texts if not t.get_rotation()]


def test_every_figure_is_written(traces: list[tuple[str, Trace]], tmp_path: Path) -> None:
    """One file per figure and format; the user's settings are as before; a print-size PNG stays small."""
    before = dict(matplotlib.rcParams)
    written = write_figures(traces, tmp_path / "figures", formats=("png", "svg"))
    assert dict(matplotlib.rcParams) == before
    assert {p.name for p in written} == {f"{name}.{suffix}" for name in FIGURES for suffix in ("png", "svg")}
    for path in written:
        assert path.stat().st_size > 5_000
        if path.suffix == ".png":
            assert path.read_bytes().startswith(b"\x89PNG")
            assert path.stat().st_size < 600_000


@pytest.mark.parametrize("name", FIGURES)
def test_every_run_is_in_the_legend(name: str, traces: list[tuple[str, Trace]]) -> None:
    """Each controller; or, of the disturbance, truth and estimate of the run that uses it."""
    figure = FIGURES[name](traces)
    (legend,) = figure.legends
    labels = {t.get_text() for t in legend.get_texts()}
    expected = {"true", "estimate"} if name == "disturbance" else {"smc", "nftsmc", "ftcm"}
    assert expected | {"fault onset"} <= labels
    assert texts(figure) == []


def test_faults_are_named_where_they_begin_and_shaded_up_to_where_they_end() -> None:
    """In every panel whose time they are in; one that does not end has no shade."""
    timed = "{type: sensor_bias, start: 0.05, lifetime: timed, duration: 0.1}"
    trace = run("duration=0.2", f"injection.faults=[{timed}, {{type: payload_pickup, start: 0.12}}]")
    for ax in FIGURES["torque"]([("ftcm", trace)]).axes[::2]:
        named = {t.get_text(): t.xy[0] for t in ax.texts if t.get_rotation() == 90}
        assert named == {"sensor_bias_0": 0.05, "payload_pickup_0": 0.12}
        (shade,) = ax.patches
        assert (shade.get_x(), shade.get_width()) == pytest.approx((0.05, 0.1))


def test_columns_that_are_not_recorded_are_said_so(traces: list[tuple[str, Trace]], tmp_path: Path) -> None:
    """A foreign bag without commands, disturbance and reference, with and without other runs beside it."""
    trace = traces[2][1]
    nan = np.full_like(trace.position, np.nan)
    absent = {"command": nan, "disturbance": nan, "reference_position": nan, "reference_velocity": nan}
    foreign = dataclasses.replace(trace, **absent, scenario=None)  # type: ignore[arg-type]
    assert len(write_figures([("bag", foreign)], tmp_path)) == len(FIGURES)
    assert texts(FIGURES["torque"]([("bag", foreign)])) == ["not recorded"] * 6
    assert texts(FIGURES["torque"]([*traces, ("bag", foreign)])) == ["bag: not recorded"] * 6
    law_without = [("pid", run(controller="pid"))]
    assert set(texts(FIGURES["sliding_variable"](law_without))) == {"no sliding variable"}


def test_a_run_with_every_column_missing_or_no_tick(tmp_path: Path) -> None:
    """Nothing to draw is no reason to fail."""
    trace = run("duration=0.1")
    nothing = dataclasses.replace(trace, **{c: np.full_like(trace.position, np.nan) for c in trace.columns})  # type: ignore[arg-type]
    empty = dataclasses.replace(
        trace, time_ns=trace.time_ns[:0], **{c: column[:0] for c, column in trace.columns.items()}
    )
    for i, runs in enumerate(([("nothing", nothing)], [("empty", empty)], [])):
        assert len(write_figures(runs, tmp_path / str(i))) == len(FIGURES)


def test_a_diverged_run_does_not_set_the_axes(traces: list[tuple[str, Trace]], tmp_path: Path) -> None:
    """The limits are those of the sound runs; the legend tells."""
    diverged = run("controller.kd=2010", controller="ctc")
    assert diverged.status == "diverged"
    assert np.abs(diverged.command).max() > 1e6
    wild = dataclasses.replace(diverged, command=np.where(diverged.command > 1e6, 1e308, diverged.command))
    for name in FIGURES:
        alone = [ax.get_ylim() for ax in FIGURES[name](traces[1:]).axes]
        beside = FIGURES[name]([*traces[1:], ("ctc", wild)])
        assert [ax.get_ylim() for ax in beside.axes] == alone
    labels = [t.get_text() for t in FIGURES["torque"]([*traces, ("ctc", wild)]).legends[0].get_texts()]
    assert "ctc (diverged)" in labels
    assert len(write_figures([("ctc", wild)], tmp_path)) == len(FIGURES)


def test_envelope_keeps_the_extremes() -> None:
    """A single spike in a long column survives; gaps stay gaps; a short column is left alone."""
    time = np.arange(40_001) * 1e-3
    values = np.sin(time)
    values[12_345], values[23_456], values[30_000] = 7.0, -9.0, np.nan
    values[35_000:36_000] = np.inf
    t, smallest, largest = envelope(time, values, bins=500)
    assert len(t) == len(smallest) == len(largest) == 500
    assert np.nanmax(largest) == 7.0
    assert np.nanmin(smallest) == -9.0
    assert np.isnan(largest[(t > 35.1) & (t < 35.9)]).all()
    assert np.all(np.diff(t) > 0)
    assert np.array_equal(envelope(time[:100], values[:100])[1], values[:100])


def test_the_smooth_run_is_drawn_over_the_rough_one(traces: list[tuple[str, Trace]]) -> None:
    """In the torque panels the chattering laws lie below the smooth one, whatever the order given."""
    for runs in (traces, traces[::-1]):
        whole = FIGURES["torque"](runs).axes[0]
        colour = figures._STYLES[[n for n, _ in runs].index("ftcm")][0]
        drawn = [line for line in whole.lines if len(line.get_xdata())]
        smooth = [line.get_zorder() for line in drawn if line.get_color() == colour]
        others = [line.get_zorder() for line in drawn if line.get_color() != colour]
        assert min(smooth) > max(others)


def test_without_matplotlib_it_says_what_to_install(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """The extra is optional; the message names it."""
    original = builtins.__import__

    def refuse(name: str, *arguments: Any, **options: Any) -> Any:
        if name.startswith("matplotlib"):
            raise ImportError(name)
        return original(name, *arguments, **options)

    monkeypatch.setattr(builtins, "__import__", refuse)
    with pytest.raises(FtcmError, match=r'pip install "ftcm_core\[figures\]"'):
        write_figures([], tmp_path)


def test_a_saved_trace_reads_back_equal(tmp_path: Path) -> None:
    """Columns bit for bit, scenario, status and the changes during the run."""
    scenario = load("paper", ["duration=0.1"])
    change = Change(50, "controller", load("paper", ["controller.c=[1, 2, 3]"], "smc").controller)
    trace = simulate(scenario, [change])
    save_trace(tmp_path / "trace.npz", trace)
    again = load_trace(tmp_path / "trace.npz")
    assert same(trace, again)
    about = ("joint_names", "dt", "scenario", "status", "detail", "ended_at", "engine", "changes")
    assert [getattr(again, name) for name in about] == [getattr(trace, name) for name in about]
    (tmp_path / "other.npz").write_bytes(b"PK no archive")
    for path in (tmp_path / "other.npz", tmp_path / "none.npz"):
        with pytest.raises(FtcmError):
            load_trace(path)


EVERY_COLUMN = [
    "sensor=encoder",
    "detector={type: residual_threshold, threshold: 1}",
    "injection.faults=[{type: loss_of_effectiveness, start: 0.02}]",
]


def test_a_saved_trace_keeps_the_columns_that_only_some_runs_have(tmp_path: Path) -> None:
    """Measured motion, torque on the joints, residuals and alarms; a run without them has none afterwards."""
    trace = simulate(load("paper", ["duration=0.1", *EVERY_COLUMN]))
    assert list(trace.columns) == list(COLUMNS)
    save_trace(tmp_path / "trace.npz", trace)
    again = load_trace(tmp_path / "trace.npz")
    assert same(trace, again)
    assert again.scenario == trace.scenario
    for name in ("measured_position", "measured_velocity", "joint_torque", "residual", "alarm"):
        assert np.abs(again.columns[name]).max() > 0.0, name
    plain = simulate(load("paper", ["duration=0.1"]))
    save_trace(tmp_path / "plain.npz", plain)
    assert list(load_trace(tmp_path / "plain.npz").columns) == list(plain.columns)
    ended = simulate(load("paper", ["duration=1", "velocity_limits=0.3"]))
    save_trace(tmp_path / "ended.npz", ended)
    read = load_trace(tmp_path / "ended.npz")
    assert (read.status, read.ended_at, read.engine) == ("limit_exceeded", ended.ended_at, "plain")
    assert read.ended_at is not None
