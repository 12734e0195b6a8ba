# SPDX-License-Identifier: Apache-2.0
"""Campaigns: draws, statistics, reproduction of single runs, strict errors."""

import io
import json
import multiprocessing
import statistics
import sys
import time
import tracemalloc

import pytest

from ftcm_core import campaign
from ftcm_core.campaign import Campaign, parse_variation
from ftcm_core.cli import main
from ftcm_core.cli.output import progress
from ftcm_core.errors import FtcmError
from ftcm_core.recording.metrics import evaluate
from ftcm_core.scenario import load
from ftcm_core.simulation import simulate

SHORT = ("duration=0.05", "transient=0.01", "injection.faults.0.start=0.02")
K1 = parse_variation("observer.k1=uniform(10000, 20000)")
NEGATIVE = parse_variation("observer.k1=uniform(-2, -1)")
SEVERITY = parse_variation("injection.faults.0.severity=normal(1, 0.1)")


def planned(runs=4, variations=(K1, SEVERITY), **more):
    return Campaign("paper", runs=runs, seed=1, variations=variations, overrides=SHORT, **more)


@pytest.mark.parametrize(
    ("text", "low", "high"),
    [("x=uniform(5, 15)", 5, 15), ("x=loguniform(1e-3,1e3)", 1e-3, 1e3), ("x=integer(-2, 2)", -2, 2),
     ("x=choice(1, 4)", 1, 4)],
)  # fmt: skip
def test_draws_stay_where_they_belong(text, low, high):
    values = [float(parse_variation(text).draw(3, run)) for run in range(500)]
    assert low <= min(values) <= max(values) <= high
    assert len(set(values)) > 1


def test_normal_draws():
    values = [float(parse_variation("x=normal(10, 2)").draw(0, run)) for run in range(4000)]
    assert statistics.mean(values) == pytest.approx(10.0, abs=0.15)
    assert statistics.stdev(values) == pytest.approx(2.0, abs=0.1)


def test_integers_are_equally_likely():
    values = [int(parse_variation("x=integer(0, 3)").draw(0, run)) for run in range(4000)]
    assert all(900 < values.count(x) < 1100 for x in range(4))


def test_choices_may_be_any_yaml():
    variation = parse_variation("torque_limits=choice(null, [97.6, 186.4, 89.4])")
    assert {variation.draw(0, run) for run in range(20)} == {"null", "[97.6, 186.4, 89.4]"}


def test_one_more_variation_or_controller_shifts_no_other():
    alone = planned(variations=(K1,)).run_list()
    both = planned(variations=(SEVERITY, K1), controllers=("smc", "ftcm")).run_list()
    assert [r.drawn["observer.k1"] for r in alone] == [r.drawn["observer.k1"] for r in both[::2]]
    assert [r.drawn for r in both[::2]] == [r.drawn for r in both[1::2]]
    assert len({r.drawn["observer.k1"] for r in alone}) == 4


def test_a_run_is_reproduced_by_the_settings_it_reports(tmp_path):
    campaign.run_campaign(planned(), engine="plain", jobs=1, folder=tmp_path)
    runs = list(campaign.read_runs(tmp_path / "runs.jsonl"))
    assert [r["run"] for r in runs] == [0, 1, 2, 3]
    again = evaluate(simulate(load("paper", runs[2]["set"], runs[2]["controller"])))
    assert json.loads(json.dumps(again)) == runs[2]["metrics"]


def test_results_do_not_depend_on_the_number_of_processes():
    one, two = (campaign.run_campaign(planned(), engine="plain", jobs=jobs) for jobs in (1, 2))
    assert one == two


def test_processes_that_have_started_end_with_a_mistake():
    """They start while the draws are still being checked."""
    with pytest.raises(FtcmError, match="is out of range"):
        campaign.run_campaign(planned(variations=(NEGATIVE,)), engine="plain", jobs=2)
    assert not multiprocessing.active_children()


@pytest.mark.slow
def test_memory_does_not_grow_with_the_number_of_runs():
    """Metrics are kept, traces are not: ten more of 401 ticks and 24 columns would take 0.8 MB."""

    def peak(runs):
        tracemalloc.start()
        wanted = Campaign("paper", runs=runs, seed=1, variations=(K1,), overrides=("duration=0.4",))
        campaign.run_campaign(wanted, engine="plain", jobs=1)
        largest = tracemalloc.get_traced_memory()[1]
        tracemalloc.stop()
        return largest

    peak(1)
    assert peak(12) - peak(2) < 500_000


def test_summary_is_of_the_completed_runs(tmp_path):
    breaking = parse_variation("injection.faults.0.severity=choice(1, 1e9)")
    summary = campaign.run_campaign(planned(8, (breaking,)), engine="plain", jobs=1, folder=tmp_path)
    found = summary["results"]["ftcm"]
    runs = [r for r in campaign.read_runs(tmp_path / "runs.jsonl")]
    completed = [r for r in runs if r["status"] == "completed"]
    assert 0 < len(completed) < 8
    assert found["completed"] == len(completed) / 8
    assert found["diverged"] == 1 - found["completed"]
    values = [r["metrics"]["after_fault"]["mean_abs_error"][0] for r in completed]
    assert found["metrics"]["after_fault"]["mean_abs_error"]["median"][0] == statistics.median(values)
    assert "completed" in campaign.table(summary)


def test_the_scores_of_a_detector_are_pooled_over_the_runs(tmp_path):
    onset = parse_variation("injection.faults.0.start=uniform(0.6, 0.9)")
    wanted = Campaign(
        "paper",
        runs=3,
        variations=(onset,),
        overrides=("duration=1", "transient=0.5", "detector={type: cusum, residual: momentum}"),
    )
    summary = campaign.run_campaign(wanted, engine="plain", jobs=1, folder=tmp_path)
    found = summary["results"]["ftcm"]["detection"]
    runs = [r["detection"] for r in campaign.read_runs(tmp_path / "runs.jsonl")]
    assert (found["runs"], found["faults"]) == (3, 3)
    assert found["delay_median"] == statistics.median(r["faults"][0]["delay"] for r in runs)
    assert "Together, 3 runs: 0 of 3 faults missed; delay" in campaign.table(summary)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("observer.k1", "expected path=distribution"),
        ("observer.k1=5", "expected path=distribution"),
        ("observer.k1=unifrom(1, 2)", "did you mean 'uniform'"),
        ("observer.k1=uniform(1)", "uniform(LOW, HIGH)"),
        ("observer.k1=uniform(2, 1)", "uniform(LOW, HIGH)"),
        ("observer.k1=uniform(1, inf)", "uniform(LOW, HIGH)"),
        ("observer.k1=loguniform(0, 1)", "LOW > 0"),
        ("observer.k1=normal(0, -1)", "DEVIATION >= 0"),
        ("observer.k1=integer(0.5, 1)", "integer(LOW, HIGH)"),
        ("observer.k1=choice()", "choice(VALUE"),
    ],
)
def test_a_variation_that_is_none_is_refused(text, said):
    with pytest.raises(FtcmError) as error:
        parse_variation(text)
    assert said in str(error.value)
    assert "\n" not in str(error.value)


def test_a_draw_out_of_range_is_refused_before_any_run_naming_run_path_and_value(capsys):
    assert main(["campaign", "paper", "--runs", "20", "--vary", "observer.k1=uniform(-20000, 20000)"]) == 2
    said = capsys.readouterr().err
    assert "run " in said
    assert "observer.k1=-" in said
    assert "out of range; expected a number" in said
    assert len(said.splitlines()) == 1


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["paper", "--runs", "0"], "runs: 0 is not a whole number in [1,"),
        (["paper", "--seed", "-1"], "seed: -1"),
        (["paper", "--jobs", "0"], "--jobs 0"),
        (["paper", "--controllers", "scm"], "did you mean 'smc'?"),
        (["paper", "--vary", "a.b=uniform(0,1)", "a.b=uniform(0,1)"], "is varied twice"),
        (["paper", "--vary", "observer.k3=uniform(0,1)"], "observer.k3: unknown key; did you mean"),
        (["no-such"], "no scenario file"),
        ([], "campaign takes one scenario"),
    ],
)
def test_mistakes_are_one_line(arguments, said, capsys):
    assert main(["campaign", *arguments]) == 2
    error = capsys.readouterr().err
    assert said in error
    assert len(error.splitlines()) == 1


def test_campaign_file_and_command_line(tmp_path, capsys):
    path = tmp_path / "faults.yaml"
    path.write_text(
        "scenario: paper\nruns: 3\nseed: 5\ncontrollers: [ftcm, smc]\n"
        f"set: {list(SHORT)}\nvary:\n  injection.faults.0.severity: uniform(0.5, 1.5)\n"
    )
    out = tmp_path / "out"
    command = ["campaign", str(path), "--runs", "2", "--engine", "plain", "--jobs", "1", "--json"]
    assert main([*command, "--output", str(out)]) == 0
    said = capsys.readouterr()
    last = said.err.rpartition("\r")[2].strip()
    assert last == f"ftcm: report: {out / 'report.html'}", "what showed the progress is wiped out"
    summary = json.loads(said.out)
    assert summary["campaign"]["seed"] == 5
    assert {name: r["runs"] for name, r in summary["results"].items()} == {"ftcm": 2, "smc": 2}
    names = {p.name for p in out.iterdir()} - {"runs.parquet"}  # with pyarrow only
    assert names == {"campaign.json", "report.html", "runs.jsonl", "summary.json", "table.md"}
    assert main([*command, "--output", str(out)]) == 2
    assert "exists already" in capsys.readouterr().err


class _Terminal(io.StringIO):
    def isatty(self):
        return True


def test_progress_says_how_much_is_done_on_one_line(monkeypatch):
    terminal = _Terminal()
    monkeypatch.setattr(sys, "stderr", terminal)
    with progress("run") as show:
        for n in (1, 2, 4):
            show(n, 4)
            time.sleep(0.12)
    shown = terminal.getvalue()
    assert "4/4" in shown
    assert "run" in shown
    assert "\n" not in shown
    assert shown.rpartition("\r")[2].strip() == ""
    monkeypatch.setattr(sys, "stderr", None)
    with progress("run") as show:
        show(1, 4)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("scenario: paper\nvarry: {}\n", "did you mean 'vary'?"),
        ("scenario: paper\nvary: [1]\n", "expected a mapping of paths"),
        ("scenario: paper\nset: x=1\n", "is not a list of texts"),
        ("scenario: 5\n", "is not a path or name"),
        ("scenario: paper\nruns: many\n", "runs: 'many' is not a whole number"),
        ("scenario: paper\nvary: {observer.k1: 5..6}\n", "expected path=distribution"),
    ],
)
def test_a_campaign_file_is_read_strictly(tmp_path, text, said):
    path = tmp_path / "c.yaml"
    path.write_text(text)
    with pytest.raises(FtcmError) as error:
        campaign.from_file(str(path))
    assert said in str(error.value)
    assert str(error.value).startswith("c.yaml: ")


def test_compiled_without_numba_is_one_line(monkeypatch, capsys):
    monkeypatch.setattr("importlib.util.find_spec", lambda name: None)
    assert campaign.chosen_engine("auto") == "plain"
    assert main(["campaign", "paper", "--engine", "compiled"]) == 2
    assert 'pip install "ftcm_core[compiled]"' in capsys.readouterr().err


@pytest.mark.slow
def test_compiled_and_plain_campaigns_agree():
    pytest.importorskip("numba")
    found = [
        campaign.run_campaign(planned(), engine=e, jobs=1)["results"]["ftcm"] for e in ("plain", "compiled")
    ]
    assert found[1]["engines"] == {"compiled": 4}
    plain, other = (x["metrics"]["after_transient"] for x in found)
    for metric, values in plain.items():
        for expected, seen in zip(values["median"], other[metric]["median"]):
            assert seen == (None if expected is None else pytest.approx(expected, rel=1e-3)), metric
