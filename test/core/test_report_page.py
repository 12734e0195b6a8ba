# SPDX-License-Identifier: Apache-2.0
"""The report as one HTML file: it fetches nothing, loses no peak, and says what the summary says."""

from __future__ import annotations

import base64
import dataclasses
import functools
import importlib.util
import json
import math
import re
import shlex
from collections.abc import Mapping, Sequence
from html.parser import HTMLParser
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import strategies as st

from ftcm_core import campaign
from ftcm_core.cli import main
from ftcm_core.recording.trace import Array, Trace
from ftcm_core.report import figures
from ftcm_core.report.page.conclusions import conclusions, times
from ftcm_core.report.page.curves import BARS, EVENTS, INTERVALS, page_data, single, timeline
from ftcm_core.report.page.decimation import AFTER, BEFORE, intervals, kept
from ftcm_core.report.page.markup import from_markdown
from ftcm_core.report.page.of_campaign import QUANTILES, campaign_page, pareto_front
from ftcm_core.report.page.of_runs import repeatable
from ftcm_core.report.page.of_suite import verdict as suite_verdict
from ftcm_core.report.results import labelled, write_results
from ftcm_core.report.table import markdown
from ftcm_core.scenario import load
from ftcm_core.simulation import simulate
from inputs import inputs

SHORT = ("duration=1.6", "injection.faults.0.start=1.2")
MIB = 2**20


@functools.cache
def run(*overrides: str, controller: str = "ftcm") -> Trace:
    """A short run with a fault in it."""
    return simulate(load("paper", [*SHORT, *overrides], controller))


def results(*traces: Trace) -> list[dict[str, Any]]:
    return [labelled(t.scenario.controller.type_name if t.scenario else "?", t) for t in traces]


def said(*traces: Trace) -> str:
    onsets = [t.fault_intervals[0].onset if t.fault_intervals else None for t in traces]
    return "\n".join(conclusions(results(*traces), onsets))


class Page(HTMLParser):
    """What is in a page: sentences of the verdict, rows of tables, addresses, commands, data."""

    def __init__(self, folder: Path) -> None:
        super().__init__()
        self.text = (folder / "report.html").read_text(encoding="utf-8")
        self.tags: list[tuple[str, dict[str, str | None]]] = []
        self.rows: list[list[str]] = []
        self.of_tag: dict[str, list[str]] = {}
        self.open: list[str] = []
        self.feed(self.text)
        self.data: dict[str, Any] = json.loads(
            next(t for t in self.of_tag["script"] if t.startswith("{")), parse_constant=pytest.fail
        )

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append((tag, dict(attrs)))
        self.open.append(tag)
        if tag == "tr":
            self.rows.append([])
        self.of_tag.setdefault(tag, []).append("")

    def handle_endtag(self, tag: str) -> None:
        while self.open and self.open.pop() != tag:
            pass

    def handle_data(self, data: str) -> None:
        for tag in set(self.open):
            self.of_tag[tag][-1] += data
        if "td" in self.open or "th" in self.open:
            self.rows[-1].append(data)

    def check_alone(self) -> None:
        """Nothing in the page makes a browser fetch something, and its policy forbids it to."""
        policies = [a["content"] for _, a in self.tags if a.get("http-equiv") == "Content-Security-Policy"]
        assert [p and p.startswith("default-src 'none';") for p in policies] == [True]
        fetching = {"src", "srcset", "poster", "data", "action", "background", "ping", "xlink:href"}
        assert not [a for _, a in self.tags if fetching & set(a)]
        assert all(str(a["href"]).startswith("#") for _, a in self.tags if "href" in a)
        assert not {tag for tag, _ in self.tags} & {"link", "iframe", "img", "object", "embed", "base"}
        style = "".join(self.of_tag["style"])
        assert not re.search(r"url\(|@import", style)
        script = self.of_tag["script"][-1]
        assert not re.search(r"\bfetch\(|XMLHttpRequest|import\s*\(|WebSocket|sendBeacon|\.src\b", script)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Results of three laws with a detector, as the command writes them."""
    out = tmp_path_factory.mktemp("compared") / "out"
    laws = ["--controllers", "smc", "nftsmc", "ftcm"]
    options = ["--set", *SHORT, "detector=cusum", "--no-figures", "--output", str(out)]
    assert main(["compare", "paper", *laws, *options]) == 0
    return out


def test_the_page_of_runs_fetches_nothing(folder: Path) -> None:
    Page(folder).check_alone()


@pytest.mark.parametrize("page", [
    '<script src="x.js"></script>', '<link rel="stylesheet" href="https://example.org/x.css">',
    '<img src="data:,">', "<style>a { background: url(x.png) }</style>",
])  # fmt: skip
def test_a_page_that_fetches_would_be_noticed(folder: Path, tmp_path: Path, page: str) -> None:
    text = (folder / "report.html").read_text(encoding="utf-8")
    (tmp_path / "report.html").write_text(text.replace("<header>", f"{page}<header>"), encoding="utf-8")
    with pytest.raises(AssertionError):
        Page(tmp_path).check_alone()


# ---- decimation ----


def columns() -> st.SearchStrategy[list[float]]:
    value = st.floats(width=64) | st.sampled_from([0.0, 1.0, -1.0, float("nan")])
    return st.lists(value, min_size=0, max_size=300)


@inputs(200, values=columns(), parts=st.integers(1, 40), events=st.lists(st.integers(-5, 400), max_size=3))
def test_no_peak_of_any_interval_is_lost(values: list[float], parts: int, events: list[int]) -> None:
    column = np.array(values, dtype=np.float64)
    begins = intervals(len(column), parts, events)
    rows = kept(column, begins)
    assert (np.diff(rows) > 0).all()
    assert len(rows) <= 2 * len(begins)
    for begin, end in zip(begins, np.append(begins[1:], len(column))):
        part = column[begin:end]
        drawn = column[rows[(rows >= begin) & (rows < end)]]
        assert len(drawn) >= 1
        finite = part[np.isfinite(part)]
        if len(finite):
            assert (drawn[np.isfinite(drawn)].min(), drawn[np.isfinite(drawn)].max()) == (
                finite.min(),
                finite.max(),
            )
        else:
            assert not np.isfinite(drawn).any()


def test_near_an_event_every_tick_is_drawn() -> None:
    begins = intervals(10_000, 100, [5000])
    near = np.arange(5000 - BEFORE, 5000 + AFTER + 1)
    assert np.isin(near, begins).all()
    assert len(begins) <= 100 + len(near)
    assert (intervals(200, 100) == np.arange(200)).all(), "a short run is kept whole"


def curves(data: dict[str, Any], key: str) -> dict[tuple[int, int], tuple[Array, Array]]:
    """Ticks and values of each curve of a quantity, by run and joint."""
    (quantity,) = [q for q in data["quantities"] if q["key"] == key]
    lines = [c for c in quantity["curves"] if not c["dotted"]]
    return {
        (c["run"], c["joint"]): (
            np.frombuffer(base64.b64decode(c["ticks"]), "<u4"),
            np.frombuffer(base64.b64decode(c["values"]), "<f4"),
        )
        for c in lines
    }


def test_what_is_drawn_was_recorded_and_has_the_peaks() -> None:
    """Each point is a recorded tick, in single precision; the largest torque is among them."""
    trace = run()
    long = stretched(trace, 20)
    for (_, joint), (ticks, values) in curves(page_data([("x", long)]), "torque").items():
        assert len(ticks) < long.ticks / 2
        np.testing.assert_array_equal(values, long.command[ticks, joint].astype(np.float32))
        assert (values.min(), values.max()) == tuple(
            np.float32(f(long.command[:, joint])) for f in (np.min, np.max)
        )


def stretched(trace: Trace, times_as_long: int) -> Trace:
    """A trace that repeats another one's columns."""
    repeated = {name: np.tile(values, (times_as_long, 1)) for name, values in trace.columns.items()}
    ticks = times_as_long * trace.ticks
    return dataclasses.replace(trace, time_ns=np.arange(ticks) * 1_000_000, **repeated)


def test_a_value_too_large_for_a_float_does_not_become_infinite() -> None:
    values = single(np.array([1e300, -1e300, np.inf, np.nan, 1e-8]))
    assert np.isfinite(values[[0, 1]]).all()
    assert np.isnan(values[[2, 3]]).all()
    assert values[4] == np.float32(1e-8)


@pytest.mark.slow
def test_three_laws_for_forty_seconds_stay_below_six_megabytes(tmp_path: Path) -> None:
    """Noise in every column, alarms on and off: nothing of it can be left out."""
    random = np.random.default_rng(1)
    scenario = load("paper", ["detector=cusum"])
    ticks = scenario.last_tick + 1
    names = ("position", "velocity", "effort", "disturbance_estimate", "command", "disturbance",
             "reference_position", "reference_velocity", "residual")  # fmt: skip
    noise = {name: random.normal(size=(ticks, 3)) for name in names}
    flags = {"alarm": (random.random((ticks, 3)) > 0.5).astype(float)}
    trace = Trace(
        ("a", "b", "c"), 1e-3, np.arange(ticks) * 1_000_000, **noise, **flags,
        scenario=scenario, accelerations=lambda q, tau: q * tau,
    )  # fmt: skip
    traces = [(name, trace) for name in ("smc", "nftsmc", "ftcm")]
    write_results(tmp_path, traces, figures=False)
    size = (tmp_path / "report.html").stat().st_size
    assert size < 6 * MIB
    data = Page(tmp_path).data
    assert data["interval"] == pytest.approx(ticks // INTERVALS * 1e-3)
    assert all(len(row["bars"]) <= 3 * BARS for row in data["rows"])
    most = 2 * (INTERVALS + EVENTS * (BEFORE + AFTER + 1))
    assert all(len(found) <= most for found, _ in curves(data, "torque").values())


# ---- numbers ----


def test_the_tables_have_the_numbers_of_the_summary(folder: Path) -> None:
    page = Page(folder)
    summary = json.loads((folder / "summary.json").read_text(encoding="utf-8"))
    for result in summary["results"]:
        rows = [row for row in page.rows if row and row[0] == result["label"]]
        metrics = result["metrics"]
        assert [f"{x:.4g}" for x in metrics["whole"]["mean_abs_error"]] == rows[0][1:4]
        for cell, window in zip(rows[1][1:], ("transient", "before_fault", "after_fault")):
            assert cell == " / ".join(f"{x:.3g}" for x in metrics[window]["mean_abs_error"])
        (found,) = [row for row in rows if "vo_kang_fault" in row]
        assert f"{result['detection']['faults'][0]['delay']:.3g}" in found
    for name, value in summary["provenance"].items():
        if value is not None:
            assert [name, str(value)] in page.rows


def test_the_verdict_is_that_of_the_summary(folder: Path) -> None:
    """Who tracked best and by what factor, worked out anew from ``summary.json``."""
    sentences = Page(folder).of_tag["li"]
    summary = json.loads((folder / "summary.json").read_text(encoding="utf-8"))
    means = {
        r["label"]: float(np.mean(r["metrics"]["after_fault"]["mean_abs_error"])) for r in summary["results"]
    }
    best, second, third = sorted(means, key=means.__getitem__)
    assert sentences[0] == "All 3 runs completed."
    assert sentences[1] == (
        f"After the fault at 1.2 s {best} tracked best: mean |e| {means[best]:.3g} rad (mean of the joints), "
        f"{times(means[second] / means[best])} less than {second} ({means[second]:.3g} rad) and "
        f"{times(means[third] / means[best])} less than {third} ({means[third]:.3g} rad)."
    )
    delays = {r["label"]: r["detection"]["faults"][0]["delay"] for r in summary["results"]}
    for law, delay in delays.items():
        assert any(
            s.startswith(f"{law}, detector cusum: the fault was detected {delay:.3g} s after its onset")
            for s in sentences
        )


def test_a_factor_in_words() -> None:
    assert [times(x) for x in (1.234, 56.78, 1234.5)] == ["1.23 times", "56.8 times", "1,230 times"]


def test_what_did_not_complete_is_said_first_and_is_not_ranked() -> None:
    bad = simulate(load("paper", ["duration=3", "controller.kd=2010", "injection.faults.0.start=1.2"], "ctc"))
    good = simulate(load("paper", ["duration=3", "injection.faults.0.start=1.2"]))
    text = said(bad, good)
    assert text.startswith(f"1 of 2 runs did not complete: ctc diverged at {bad.ended_at:g} s.\n")
    assert "After the fault at 1.2 s only ftcm can be judged: mean |e| " in text
    assert "tracked best" not in text


def test_runs_that_track_alike_are_called_equal() -> None:
    text = said(run(), run("seed=3"))
    assert "ftcm and ftcm tracked best, about equally" in text
    assert "times less" not in text


def test_without_fault_or_detector_nothing_is_said_of_them() -> None:
    trace = simulate(load("paper", ["duration=1.6", "injection.faults=[]"]))
    text = said(trace)
    assert "After the transient the mean |e| of ftcm is " in text
    assert "the fault" not in text
    assert "No run has a detector" in text
    assert "the fault was missed" in said(run("detector={type: cusum, threshold: 1e6}"))


def test_runs_of_different_experiments_are_not_ranked_together() -> None:
    text = said(run(), run("duration=1.5"))
    assert "tracked best" not in text
    assert text.count("the mean |e| of ftcm is") == 2


def test_a_joint_in_which_another_law_is_better_is_named() -> None:
    one, other = results(run(), run(controller="smc"))
    one["metrics"]["after_fault"]["mean_abs_error"] = [1.0, 1.0, 1.0]
    other["metrics"]["after_fault"]["mean_abs_error"] = [9.0, 0.5, 9.0]
    told = conclusions([one, other], [1.2, 1.2])
    assert "Of joint 2 alone, smc tracked better (0.5 rad)." in told


# ---- frame ----


def test_names_from_outside_cannot_break_the_page(tmp_path: Path) -> None:
    evil = '</script><script>alert("x")</script>'
    trace = run()
    write_results(tmp_path, [(evil, trace)], figures=False)
    page = Page(tmp_path)
    assert sum(tag == "script" for tag, _ in page.tags) == 2
    assert page.data["runs"][0]["label"] == evil
    assert evil in page.of_tag["title"][0]


def test_markdown_of_ours_becomes_html() -> None:
    text = markdown([["a", "b|c"], ["1.5", "**x**"]])
    html = from_markdown(f"Mean |e|,\nrad:\n\n{text}\n\n- one\n- two < three\n")
    assert html.startswith("<p>Mean |e|, rad:</p>\n")
    assert "<thead><tr><th>a</th><th>b|c</th></tr></thead>" in html
    assert '<tr><td class="number">1.5</td><td><b>x</b></td></tr>' in html
    assert html.endswith("<ul><li>one</li><li>two &lt; three</li></ul>")
    assert "<td>---" not in html


def test_the_command_in_the_page_gives_the_same_page(folder: Path, tmp_path: Path, monkeypatch: Any) -> None:
    """Both commands: as it was typed, and from the complete scenario beside the page."""
    typed, from_files = Page(folder).of_tag["pre"][-2:]
    monkeypatch.chdir(tmp_path)
    program, *words = shlex.split(typed)
    assert program == "ftcm"
    assert main(words) == 0
    first, again = (json.loads((f / "summary.json").read_text()) for f in (folder, tmp_path / "NEW"))
    assert first["results"] == again["results"]
    monkeypatch.chdir(folder)
    _, *words = shlex.split(from_files.splitlines()[-1])
    assert main([*words, "--output", str(tmp_path / "one"), "--no-figures"]) == 0
    (one,) = json.loads((tmp_path / "one" / "summary.json").read_text())["results"]
    assert {k: v for k, v in one.items() if k != "configuration"} == {
        k: v for k, v in first["results"][-1].items() if k != "configuration"
    }


def test_a_command_makes_a_new_folder_each_time() -> None:
    assert repeatable(("ftcm", "x", "--output", "a b", "--json")) == "ftcm x --output NEW --json"
    assert repeatable(("e", "--name=a", "--set", "x=[1, 2]")) == "e --name=NEW --set 'x=[1, 2]'"


def test_the_timeline_has_faults_alarms_and_decisions() -> None:
    detector = "detector={type: isolating}"
    trace = simulate(
        load("paper", ["duration=3",
                       "injection.faults=[{type: sensor_bias, start: 1.5, joint: 2, bias: 0.3}]",
                       detector, "policies=[{type: derate}]"])
    )  # fmt: skip
    rows = {row["name"]: row for row in timeline([("a", trace)])}
    flags = trace.alarm[:, 1] > 0.5
    begins = trace.time[1:][flags[1:] & ~flags[:-1]]
    own = [bar for bar in rows["a: alarms"]["bars"] if bar[2].startswith("joint 2")]
    assert [bar[0] for bar in own] == begins.tolist()
    assert len(trace.decisions) > 0
    marks = rows["a: decisions, changes"]["marks"]
    assert [t for t, _ in marks][: len(trace.decisions)] == [d.tick * trace.dt for d in trace.decisions]
    (fault,) = page_data([("a", trace)])["faults"]
    assert (fault["onset"], fault["end"], fault["label"]) == (1.5, None, "sensor_bias_0")


# ---- campaign, suite, formats ----


def test_the_page_of_a_campaign_shows_the_quantiles_of_its_summary(tmp_path: Path) -> None:
    out = tmp_path / "out"
    varied = ["--vary", "injection.faults.0.severity=uniform(0.5, 1.5)"]
    values = ["--set", "duration=0.4", "transient=0.1", "injection.faults.0.start=0.2"]
    command = ["campaign", "paper", "--runs", "5", "--engine", "plain", "--controllers", "smc", "ftcm"]
    command += [*varied, *values, "--output", str(out)]
    assert main(command) == 0
    page = Page(out)
    page.check_alone()
    summary = json.loads((out / "summary.json").read_text(encoding="utf-8"))
    (group,) = page.data["campaign"]["groups"]
    columns = {c["name"]: c for c in group["columns"]}
    joints = columns["after fault: mean abs error, rad"]["joints"]
    at = {q: i for i, q in enumerate(QUANTILES)}
    for run_number, law in enumerate(("smc", "ftcm")):
        entry = summary["results"][law]["metrics"]["after_fault"]["mean_abs_error"]
        for joint in range(3):
            shown = joints[joint][run_number]
            assert (shown["run"], shown["count"], shown["of"]) == (run_number, 5, 5)
            for name, quantile in (("median", 0.5), ("q05", 0.05), ("q95", 0.95)):
                assert shown["box"][at[quantile]] == pytest.approx(entry[name][joint], rel=1e-12)
    lines = list(campaign.read_runs(out / "runs.jsonl"))
    means = {
        (r["run"], r["controller"]): np.mean(r["metrics"]["after_fault"]["mean_abs_error"]) for r in lines
    }
    wins = sum(means[k, "ftcm"] < means[k, "smc"] for k, law in means if law == "ftcm")
    first, count = ("ftcm", wins) if wins >= 3 else ("smc", 5 - wins)
    assert f"{first} had the smallest mean |e| (mean of the joints) in {count} of 5 draws" in page.text


def test_a_campaign_without_a_completed_run_has_a_page() -> None:
    summary = {
        "campaign": {"scenario": "x"}, "provenance": {},
        "results": {"a": {"runs": 2, "completed": 0.0}},
    }  # fmt: skip
    lines = [{"run": k, "contender": "a", "status": "diverged", "metrics": {}} for k in (0, 1)]
    text = campaign_page(summary, lines, "", ())
    assert "Runs that did not complete: 2 of 2 of a." in text


def made_up_campaign(
    completed: Mapping[str, Sequence[bool]], vary: Mapping[str, str] | None = None
) -> tuple[dict[str, Any], list[dict[str, Any]]]:
    """Summary and runs of contenders of one controller: errors and torques grow with the draw's number."""
    lines = []
    for number in range(len(next(iter(completed.values())))):
        for place, (name, done) in enumerate(completed.items()):
            row = {
                "mean_abs_error": [1e-3 * (1 + number + place)] * 2,
                "torque_total_variation": [10.0 + number] * 2,
            }
            lines.append(
                {"run": number, "contender": name, "controller": "ftcm", "set": [f"x={number}"],
                 "status": "completed" if done[number] else "diverged",
                 "metrics": {"after_fault": row, "after_transient": row}}
            )  # fmt: skip
    results = {
        name: {"runs": len(done), "completed": sum(done) / len(done)} for name, done in completed.items()
    }
    about = {"scenario": "x", "vary": dict(vary or {})}
    return {"campaign": about, "provenance": {}, "results": results}, lines


def written(summary: dict[str, Any], lines: list[dict[str, Any]], folder: Path) -> Page:
    (folder / "report.html").write_text(campaign_page(summary, lines, "", ()), encoding="utf-8")
    return Page(folder)


def test_runs_that_did_not_complete_are_counted_beside_every_plot(tmp_path: Path) -> None:
    done = {"all": [True] * 12, "some": [True] * 8 + [False] * 4, "few": [True] * 2 + [False] * 10}
    page = written(*made_up_campaign(done, {"x": "uniform(0, 12)"}), tmp_path)
    (group,) = page.data["campaign"]["groups"]
    boxes = group["columns"][0]["joints"][0]
    assert [(box["count"], box["of"]) for box in boxes] == [(12, 12), (8, 12), (2, 12)]
    assert (
        "off the axes are the runs that did not complete: some 4 of 12; few 10 of 12, so without a mark."
        in page.text
    )
    marks = {page.data["runs"][law["run"]]["label"]: law for law in group["tradeoff"][0]["laws"]}
    if importlib.util.find_spec("scipy"):
        assert [mark["values"][0] > 0.9 for mark in group["sensitivity"][0]["marks"]] == [True, True, False]
    assert [three[1] for three in marks["few"]["spread"]] == [None, None], "the median run did not complete"
    assert [three[2] for three in marks["some"]["spread"]] == [None, None]
    assert marks["all"]["spread"][1][1] == pytest.approx(6.5e-3)
    assert [marks[name]["front"] for name in done] == [True, False, False]


def test_contenders_with_the_same_controller_are_told_apart(tmp_path: Path) -> None:
    page = written(*made_up_campaign({"Table 1": [True] * 3, "slower": [True] * 3}), tmp_path)
    assert (
        "After the fault Table 1 had the smallest mean |e| (mean of the joints) in 3 of 3 draws" in page.text
    )
    assert [len(joint) for joint in page.data["campaign"]["groups"][0]["columns"][0]["joints"]] == [2, 2]


def test_contenders_of_several_scenarios_are_drawn_by_scenario(tmp_path: Path) -> None:
    names = ("a @ one", "b @ one", "a @ two", "b @ two")
    page = written(*made_up_campaign(dict.fromkeys(names, [True] * 3)), tmp_path)
    assert [run["label"] for run in page.data["runs"]] == ["a", "b"]
    groups = page.data["campaign"]["groups"]
    assert [group["name"] for group in groups] == ["one", "two"]
    assert [[law["run"] for law in group["tradeoff"][0]["laws"]] for group in groups] == [[0, 1], [0, 1]]
    assert "two: after the fault a had the smallest mean |e|" in page.text


def test_the_pareto_front_is_of_those_that_no_other_beats_in_both() -> None:
    points = [(1.0, 5.0), (2.0, 2.0), (3.0, 2.0), (4.0, 1.0), (4.0, 4.0), (0.5, math.inf), (2.0, 2.0)]
    assert pareto_front(points) == [True, True, False, True, False, False, True]


def test_the_verdict_of_a_suite_counts_its_rows() -> None:
    def row(fault: str, law: str, error: float | None) -> dict[str, Any]:
        site = "" if fault == "none" else "sensor"
        about = {"condition": "ideal", "fault": fault, "joint": 2, "site": site}
        return {**about, "controller": law, "rms_error": error}

    rows = [row("none", "a", 1.0), row("none", "b", 0.1), row("x", "a", 1.0), row("x", "b", 2.0),
            row("y", "a", None), row("y", "b", 3.0), row("z", "a", 1.0), row("z", "b", 2.0)]  # fmt: skip
    assert suite_verdict(rows) == [
        "ideal: a has the smallest RMS error after the onset in 2 of 3 faults, b in 1.",
        "ideal: runs that ended early: 1 of a.",
    ]
    for r, delay in zip(rows[2:], (0.01, 0.02, None, 0.04, 0.03, None)):
        r["detection_delay"] = delay
    assert suite_verdict(rows)[2] == (
        "ideal: faults detected: 2 of 3 with a, in the median after 0.02 s; 2 of 3 with b, in the median "
        "after 0.03 s."
    )


def test_the_page_of_a_suite(tmp_path: Path) -> None:
    out = tmp_path / "out"
    short = ["suite", "faults", "--onset", "0.1", "--duration", "0.2", "--controllers", "ctc", "--jobs", "1"]
    assert main([*short, "--faults", "vo_kang_fault", "--output", str(out)]) == 0
    page = Page(out)
    page.check_alone()
    rows = json.loads((out / "summary.json").read_text(encoding="utf-8"))["rows"]
    (plot,) = page.data["suite"]
    assert plot["curves"][0]["x"] == [1000.0 * r["rms_error"] for r in rows if r["rms_error"]]


def test_figures_in_other_formats(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    pytest.importorskip("matplotlib")
    monkeypatch.setattr(figures, "FIGURES", {"torque": figures.torque})  # of all of them one
    command = ["simulate", "paper", "--set", "duration=0.1", "--figure-format"]
    assert main([*command, "svg,pdf", "--output", str(tmp_path / "out")]) == 0
    written = {p.name for p in (tmp_path / "out" / "figures").iterdir()}
    assert written == {"torque.svg", "torque.pdf"}
    capsys.readouterr()
    assert main([*command, "gif", "--output", str(tmp_path / "bad")]) == 2
    assert capsys.readouterr().err == "ftcm: error: --figure-format 'gif': known: pdf, png, svg\n"
    assert not (tmp_path / "bad").exists()


def test_a_run_without_scenario_or_ticks_has_a_page(tmp_path: Path) -> None:
    """A bag may lack the one and, if it was hardly begun, have few of the other."""
    trace = dataclasses.replace(run(), scenario=None)
    write_results(tmp_path / "a", [("x", trace)], figures=False)
    assert "How to repeat it" not in Page(tmp_path / "a").text
    one = {name: values[:1] for name, values in trace.columns.items()}
    write_results(
        tmp_path / "b", [("x", dataclasses.replace(run(), time_ns=trace.time_ns[:1], **one))], figures=False
    )
    assert Page(tmp_path / "b").data["runs"][0]["label"] == "x"
