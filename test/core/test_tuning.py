# SPDX-License-Identifier: Apache-2.0
"""Tuning: what is chosen, what is refused, and that it does not depend on luck."""

import json
import signal
import subprocess
import sys
import time

import numpy as np
import pytest

from ftcm_core import compiled
from ftcm_core.cli import main
from ftcm_core.errors import FtcmError
from ftcm_core.recording.metrics import METRICS, windows
from ftcm_core.scenario import load
from ftcm_core.scenario.parameter_files import parameter_overrides
from ftcm_core.simulation import simulate
from ftcm_core.tuning.plan import tuning_from_file
from ftcm_core.tuning.running import choose, pareto

FILES = ("trials.jsonl", "best.yaml", "summary.json", "table.md", "held_out/runs.jsonl")
SHORT = "set: [duration=0.12, transient=0.02]\nvary: {injection.faults.0.start: 'uniform(0.03, 0.06)'}\n"
FTCM = """\
campaign: mine.yaml
controller: ftcm
parameters:
  controller.gamma1: loguniform(0.5, 20)
  controller.upsilon1: loguniform(0.5, 100)
  observer.k1: loguniform(1000, 300000)
objectives: [after_fault.mean_abs_error, after_transient.torque_total_variation]
limits: {whole.torque_peak: 400}
trials: 20
batch: 4
seed: 3
training: {runs: 2}
held_out: {runs: 3, vary: {injection.faults.0.start: "uniform(0.06, 0.09)"}}
"""


def written(folder, text=FTCM, campaign=SHORT):
    (folder / "mine.yaml").write_text(f"scenario: paper\n{campaign}")
    (folder / "tune.yaml").write_text(text)
    return str(folder / "tune.yaml")


def tuned(folder, output, *options, text=FTCM):
    command = ["tune", written(folder, text), "--engine", "plain", "--output", str(folder / output), "--json"]
    return main([*command, *options])


def contents(folder):
    return {name: (folder / name).read_bytes() for name in FILES}


# ---- the choice ----


def trial(number, *objectives):
    return {"number": number, "objectives": list(objectives)}


def numbers(trials):
    return [t["number"] for t in trials]


@pytest.mark.pure
def test_the_front_has_what_nothing_beats():
    trials = [trial(0, 1, 9), trial(1, 2, 5), trial(2, 3, 6), trial(3, 4, 1), trial(4, 4, 2), trial(5, 2, 5)]
    assert numbers(pareto(trials)) == [0, 1, 5, 3]


@pytest.mark.pure
def test_the_best_is_no_worse_than_the_start_in_the_other_objectives():
    front = [trial(0, 1, 9), trial(1, 2, 5), trial(3, 4, 1)]
    assert choose(front, (3, 6))["number"] == 1
    assert choose(front, (3, 10))["number"] == 0
    assert choose(front, (3, 0.5))["number"] == 3, "none is as good: the one that is least worse"
    assert choose([trial(0, 2), trial(1, 1)], (5,))["number"] == 1


# ---- what is refused ----


@pytest.mark.pure
@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ("trials: 20", "trails: 20", "'trails': unknown key; did you mean 'trials'?"),
        ("trials: 20", "trials: none", "trials: 'none' is not a whole number"),
        ("controller: ftcm", "controller: fctm", "no controller 'fctm'; did you mean 'ftcm'?"),
        ("controller.gamma1: log", "controller.gamma: log", "controller.gamma: unknown parameter"),
        ("loguniform(0.5, 20)", "uniform(-1, 20)", "controller.gamma1: -1 is out of range"),
        ("loguniform(0.5, 20)", "normal(2, 1)", "controller.gamma1: normal has no ends"),
        ("loguniform(0.5, 20)", "uniform(3)", "controller.gamma1: 'uniform(3)' is not uniform(LOW, HIGH)"),
        ("controller.gamma1", "controller.gamma1.0", "controller.gamma1 is 2.0, which has no entry '0'"),
        ("controller.gamma1", "plant.substeps", "expected a parameter of the law or the observer"),
        ("[after_fault.mean", "[after_falt.mean", "no window 'after_falt'; did you mean 'after_fault'?"),
        ("torque_total_variation]", "torque_variation]", "no metric 'torque_variation'; did you mean"),
        ("torque_peak: 400", "torque_peak: [1, 2]", "has 2 entries; expected one number, or one per"),
        ("torque_peak: 400", "torque_peak: high", "'high' is not a number"),
        ("runs: 2", "rums: 2", "training: 'rums': unknown key; did you mean 'runs'?"),
        ("campaign: mine.yaml", "campaign: 5", "campaign: 5 is not the path"),
    ],
)  # fmt: skip
def test_a_tune_file_is_read_strictly(tmp_path, old, new, said):
    assert old in FTCM
    with pytest.raises(FtcmError) as error:
        tuning_from_file(written(tmp_path, FTCM.replace(old, new)))
    assert said in str(error.value)
    assert str(error.value).startswith("tune.yaml: ")


@pytest.mark.pure
def test_held_out_runs_are_others(tmp_path):
    tuning = tuning_from_file(written(tmp_path))
    training, held_out = (
        {run.drawn["injection.faults.0.start"] for run in campaign.run_list()}
        for campaign in (tuning.training, tuning.held_out)
    )
    assert max(map(float, training)) < 0.06 < min(map(float, held_out))
    plain = tuning_from_file(written(tmp_path, FTCM.partition("training:")[0]))
    assert (plain.training.seed, plain.held_out.seed) == (0, 1)


def test_without_optuna_one_line_says_what_to_install(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr("importlib.util.find_spec", lambda name: None)
    assert tuned(tmp_path, "a") == 2
    assert 'tuning needs optuna; pip install "ftcm_core[tune]"' in capsys.readouterr().err
    assert not (tmp_path / "a").exists()


# ---- the search ----


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    pytest.importorskip("optuna", reason="optuna is not installed")
    folder = tmp_path_factory.mktemp("tune")
    assert tuned(folder, "a", "--jobs", "1") == 0
    return folder / "a"


@pytest.fixture(scope="module")
def trials(whole):
    return [json.loads(line) for line in (whole / "trials.jsonl").read_text().splitlines()]


def test_every_trial_is_within_its_ranges_and_all_are_there(trials):
    assert numbers(trials) == list(range(20))
    for one in trials:
        assert 0.5 <= one["parameters"]["controller.gamma1"] <= 20
        assert 1000 <= one["parameters"]["observer.k1"] <= 300000
    assert len({json.dumps(one["parameters"]) for one in trials}) == 20


def test_a_candidate_outside_of_a_condition_is_not_run(trials, tmp_path):
    """Eq 34 of the law, stability of the observer: what `ftcm simulate` warns of."""
    refused = [one for one in trials if one["constraints"][0] > 0]
    assert refused
    assert any("eq 34" in one["said"] for one in refused)
    assert all(one["runs"] == 0 and not one["feasible"] for one in refused)
    for one in trials:
        settings = [f"{path}={value!r}" for path, value in one["parameters"].items()]
        assert bool(load("paper", settings, "ftcm").warnings()) == (one["constraints"][0] > 0)


def test_the_objectives_are_those_of_the_runs(whole, trials, tmp_path):
    """The parameter file, simulated: mean over joints, then over the two training runs."""
    summary = json.loads((whole / "summary.json").read_text())
    tuning = tuning_from_file(written(tmp_path))
    found = []
    for run in tuning.training.run_list():
        settings = [*parameter_overrides(str(whole / "best.yaml")), *tuning.training.settings(run)]
        trace = simulate(load("paper", settings))
        rows = windows(trace)
        found.append([np.mean(METRICS[m][0](trace, rows[w])) for w, m in tuning.objectives])
    assert summary["best"]["objectives"] == pytest.approx(np.mean(found, axis=0).tolist(), rel=1e-12)


def test_the_choice_is_feasible_and_the_comparison_is_of_runs_held_out(whole, trials):
    summary = json.loads((whole / "summary.json").read_text())
    assert summary["best"]["feasible"]
    assert summary["best"] == trials[summary["best"]["number"]]
    assert summary["best"] in summary["pareto"]
    assert list(summary["held_out"]["results"]) == ["start", "tuned"]
    lines = (whole / "held_out" / "runs.jsonl").read_text().splitlines()
    starts = {
        s for line in lines for s in json.loads(line)["set"] if s.startswith("injection.faults.0.start=")
    }
    assert len(starts) == 3
    assert all(float(s.partition("=")[2]) > 0.06 for s in starts)
    assert "start / tuned" in (whole / "table.md").read_text()


@pytest.mark.slow
def test_neither_processes_nor_luck_matter(whole, tmp_path, capsys):
    assert tuned(tmp_path, "b", "--jobs", "2") == 0
    assert contents(tmp_path / "b") == contents(whole)
    capsys.readouterr()
    assert tuned(tmp_path, "c", "--jobs", "1", "--seed", "4", "--trials", "4") == 0
    other = (tmp_path / "c" / "trials.jsonl").read_text().splitlines()
    assert json.loads(other[0])["parameters"] != json.loads(
        (whole / "trials.jsonl").read_text().splitlines()[0]
    )


@pytest.mark.parametrize("told", [1, 6, 20])
def test_of_an_ended_tuning_whole_batches_are_kept(whole, tmp_path, capsys, told):
    """The journal is cut behind the result of so many trials, batches being of four, and in the next line."""
    file, output = written(tmp_path), tmp_path / "b"
    output.mkdir()
    (output / "tune.json").write_bytes((whole / "tune.json").read_bytes())
    lines = (whole / "journal.log").read_bytes().splitlines(keepends=True)
    results = [i for i, line in enumerate(lines) if b'"values":[' in line]
    end = results[told - 1] + 1
    (output / "journal.log").write_bytes(b"".join(lines[:end]) + b"".join(lines[end:])[:9])
    assert main(["tune", file, "--engine", "plain", "--jobs", "1", "--output", str(output), "--resume"]) == 0
    assert contents(output) == contents(whole)


@pytest.mark.slow
def test_a_tuning_that_is_killed_goes_on(whole, tmp_path, capsys):
    """SIGKILL to the real command, then the same with --resume, against one that was left alone."""
    file, output = written(tmp_path), tmp_path / "b"
    command = ["tune", file, "--engine", "plain", "--jobs", "1", "--output", str(output), "--json"]
    process = subprocess.Popen(
        [sys.executable, "-m", "ftcm_core.cli", *command],
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
    )
    journal, until = output / "journal.log", time.monotonic() + 60
    try:
        while (
            not (journal.exists() and journal.read_text().count('"values"') > 5) and time.monotonic() < until
        ):
            time.sleep(0.005)
    finally:
        process.send_signal(signal.SIGKILL)
        process.wait()
    assert not (output / "trials.jsonl").exists(), "killed in the middle"
    with journal.open("a") as text:
        text.write('{"op_code": 6, "wor')  # as if it was killed while it wrote
    assert main([*command, "--resume"]) == 0
    assert contents(output) == contents(whole)
    capsys.readouterr()
    assert main([*command, "--resume", "--trials", "24"]) == 2
    assert "tuning.trials is 20 there, 24 here" in capsys.readouterr().err


@pytest.mark.slow
def test_with_one_objective_the_worse_half_is_stopped_early(tmp_path, capsys):
    pytest.importorskip("optuna", reason="optuna is not installed")
    text = FTCM.replace(", after_transient.torque_total_variation]", "]").replace("runs: 2", "runs: 4")
    text = text.replace("limits: {whole.torque_peak: 400}\n", "").replace("trials: 20", "trials: 48")
    text = text.replace(
        "  controller.upsilon1: loguniform(0.5, 100)\n  observer.k1: loguniform(1000, 300000)\n", ""
    )
    assert tuned(tmp_path, "a", "--jobs", "1", text=text) == 0
    summary = json.loads(capsys.readouterr().out)
    found = [json.loads(line) for line in (tmp_path / "a" / "trials.jsonl").read_text().splitlines()]
    stopped = [one for one in found if one["state"] == "stopped"]
    assert stopped
    assert all(1 < one["runs"] < 4 and one["objectives"] is None for one in stopped)
    complete = [one["objectives"][0] for one in found if one["state"] == "complete"]
    assert summary["best"]["objectives"][0] == min(complete) < summary["start"]["objectives"][0]


def test_limits_that_nothing_meets_are_one_line(tmp_path, capsys):
    pytest.importorskip("optuna", reason="optuna is not installed")
    text = FTCM.replace("torque_peak: 400", "torque_peak: 1").replace("trials: 20", "trials: 4")
    assert tuned(tmp_path, "a", "--jobs", "1", text=text) == 2
    error = capsys.readouterr().err.rpartition("\r")[2]
    assert "none of 4 trials met every condition" in error


@pytest.mark.parametrize("kind", ["", "_rough"])
@pytest.mark.parametrize("law", ["ftcm", "smc", "nftsmc"])
def test_the_shipped_files_can_be_tuned(root, law, kind):
    pytest.importorskip("scipy", reason="scipy is not installed")
    tuning = tuning_from_file(str(root / "config" / "tune" / f"{law}{kind}.yaml"))
    assert tuning.start.controller.type_name == law
    same = ("trials", "batch", "seed", "objectives", "limits", "training", "held_out")
    other = tuning_from_file(str(root / "config" / "tune" / f"ftcm{kind}.yaml"))
    assert all(getattr(tuning, key) == getattr(other, key) for key in same), "the same procedure and budget"


@pytest.mark.slow
@pytest.mark.parametrize("law", ["ftcm", "smc", "nftsmc"])
def test_the_shipped_parameters_are_better_than_table_1_in_the_paper_s_experiment(root, law):
    """In no objective worse, in the mean over the joints, and the torque within the robot's limits."""
    pytest.importorskip("numba", reason="numba is not installed")
    found = []
    for settings in ([], parameter_overrides(str(root / "config" / "tuned" / f"{law}.yaml"))):
        scenario = load("paper", settings, law)
        assert scenario.warnings() == []
        trace = compiled.simulate(scenario)
        assert trace.status == "completed"
        rows = windows(trace)
        error = METRICS["mean_abs_error"][0](trace, rows["after_fault"]).mean()
        variation = METRICS["torque_total_variation"][0](trace, rows["after_transient"]).mean()
        found.append((error, variation))
    assert found[1][0] < found[0][0]
    assert found[1][1] < found[0][1]
    assert (METRICS["torque_peak"][0](trace, rows["whole"]) <= [97.6, 186.4, 89.4]).all()


@pytest.mark.pure
def test_the_page_shows_the_shipped_file(root):
    text = (root / "config" / "tune" / "ftcm.yaml").read_text("utf-8")
    assert f"```yaml\n{text.rstrip()}\n```\n" in (root / "docs" / "tuning.md").read_text("utf-8")
