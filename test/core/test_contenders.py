# SPDX-License-Identifier: Apache-2.0
"""What a campaign compares: controllers, observers, detectors, and parameter sets by name."""

import importlib.util
import json
from pathlib import Path

import pytest

from ftcm_core import campaign
from ftcm_core.campaign import Campaign
from ftcm_core.cli import main
from ftcm_core.errors import FtcmError
from ftcm_core.recording.metrics import evaluate
from ftcm_core.scenario import load, replace
from ftcm_core.simulation import simulate

ROOT = Path(__file__).resolve().parents[2]
SHORT = ("duration=0.05", "transient=0.01", "injection.faults.0.start=0.02")
VARY = (campaign.parse_variation("injection.faults.0.severity=uniform(0.5, 1.5)"),)


def ran(tmp_path, **more):
    wanted = Campaign("paper", runs=2, variations=VARY, overrides=SHORT, **more)
    summary = campaign.run_campaign(wanted, engine="plain", jobs=1, folder=tmp_path)
    return summary, list(campaign.read_runs(tmp_path / "runs.jsonl"))


def test_every_combination_of_laws_observers_and_detectors_runs(tmp_path):
    summary, runs = ran(
        tmp_path, controllers=("ftcm", "ctc"), observers=("do", "eso"), detectors=("cusum", "glr")
    )
    names = [f"{c}+{o}+{d}" for c in ("ftcm", "ctc") for o in ("do", "eso") for d in ("cusum", "glr")]
    assert list(summary["results"]) == names
    assert [(r["run"], r["contender"]) for r in runs] == [(n, name) for n in range(2) for name in names]
    assert all("detection" in r for r in runs)
    one = runs[11]
    assert one["contender"] == "ftcm+eso+glr"
    scenario = load("paper", one["set"], one["controller"])
    assert (scenario.observer.type_name, scenario.detector.type_name) == ("eso", "glr")
    assert json.loads(json.dumps(evaluate(simulate(scenario)))) == one["metrics"]


def test_the_parameters_of_a_scenario_stay_with_its_own_component(tmp_path):
    """`detector.type` keeps what the file says of that detector; another one has its defaults."""
    path = tmp_path / "mine.yaml"
    path.write_text(
        "robot: puma560\nreference: vo_kang_cosine\ncontroller: ctc\nobserver: {type: do, k1: 10000}\n"
        "detector: {type: cusum, threshold: 3}\nduration: 0.02\n"
    )
    runs = Campaign(str(path), observers=("do", "eso"), detectors=("cusum", "glr"), runs=1)
    found = [runs.scenario(run) for run in runs.run_list()]
    assert [s.observer.type_name for s in found] == ["do", "do", "eso", "eso"]
    assert found[0].observer.k1 == found[1].observer.k1 == 10000
    assert [s.detector.values["threshold"] == 3 for s in found] == [True, False, True, False]


def test_parameter_sets_are_contenders_by_name(tmp_path):
    (tmp_path / "tuned.yaml").write_text("controller: {type: ftcm, gamma1: 3}\nobserver: {type: do}\n")
    (tmp_path / "c.yaml").write_text(
        f"scenario: paper\nruns: 2\nset: {list(SHORT)}\n"
        "contenders:\n  Table 1: [controller.type=ftcm]\n  tuned: tuned.yaml\n"
    )
    planned = campaign.from_file(str(tmp_path / "c.yaml"))
    assert [planned.scenario(run).controller.gamma1 for run in planned.run_list()] == [2.0, 3.0] * 2
    summary = campaign.run_campaign(planned, engine="plain", jobs=1)
    assert list(summary["results"]) == ["Table 1", "tuned"]
    assert summary["comparisons"][0]["contenders"] == ["Table 1", "tuned"]
    assert "Table 1 / tuned" in campaign.table(summary)


def test_contenders_are_compared_over_the_same_draws(tmp_path):
    """The ratio in the summary is that of the runs, pair by pair."""
    summary, runs = ran(tmp_path, controllers=("ftcm", "smc"))
    metric = ("after_transient", "torque_total_variation")
    values = {(r["contender"], r["run"]): r["metrics"][metric[0]][metric[1]][1] for r in runs}
    ratios = [values["ftcm", n] / values["smc", n] for n in range(2)]
    (pair,) = [p for p in summary["comparisons"] if (p["window"], p["metric"]) == metric]
    assert pair["contenders"] == ["ftcm", "smc"]
    assert pair["joints"][1]["ratio"] == pytest.approx((ratios[0] * ratios[1]) ** 0.5)
    (ranked,) = [r for r in summary["ranking"] if (r["window"], r["metric"]) == metric]
    assert ranked["joints"][1]["mean_ranks"] == [1.0, 2.0]


def test_a_parameter_file_is_taken_by_simulate_and_campaign(tmp_path, capsys):
    file = tmp_path / "tuned.yaml"
    file.write_text("controller: {type: ftcm, gamma1: 3}\ntuning: {trials: 5}\n")
    assert main(["simulate", "paper", "--params", str(file), "--set", "duration=0.02", "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["configuration"]["controller"]["gamma1"] == 3
    short = ["--set", *SHORT, "--engine", "plain"]
    assert main(["campaign", "paper", "--params", str(file), "--runs", "1", "--json", *short]) == 0
    assert "gamma1" in str(json.loads(capsys.readouterr().out)["campaign"]["set"])


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("contenders: [a]", "contenders: ['a'] is not a mapping of names"),
        ("contenders: {a: 5}", "contenders: a: 5 is not a list of settings"),
        ("contenders: {a: nowhere.yaml}", "no scenario file 'nowhere.yaml'"),
        ("contenders: {a: []}\nobservers: [do]", "observers: contenders are given too"),
        ("observers: [od]", "no observer 'od'; did you mean 'do'?"),
        ("observers: [do]\nset: ['observer={type: eso}']", "observer: is set, and observers are given too"),
        ("detectors: [glr]\nvary: {detector.type: 'choice(glr, cusum)'}", "detector.type: is set, and"),
        ("contenders: {a: []}\nset: [observer=eso]", "observer: is set, and contenders are given too"),
        ("sampling: 5", "sampling: 5 is none"),
        ("contenders: {a @ b: []}", "'a @ b': a name of a contender or scenario has no ' @ '"),
        ("scenarios: [paper]", "scenario: scenarios are given too"),
    ],
)
def test_mistakes_are_one_line(tmp_path, text, said):
    (tmp_path / "c.yaml").write_text(f"scenario: paper\n{text}\n")
    with pytest.raises(FtcmError) as error:
        campaign.from_file(str(tmp_path / "c.yaml"))
    assert said in str(error.value)


@pytest.fixture
def two_arms(tmp_path):
    """A campaign of two laws on an arm of two and one of three joints."""
    loss = "injection: {faults: [{type: loss_of_effectiveness, joint: 2, start: 0.02}]}"
    common = f"reference: sine\ncontroller: ftcm\nobserver: do\n{loss}\n"
    robot = ROOT / "config" / "robots" / "two_joint.urdf"
    (tmp_path / "two.yaml").write_text(f"robot: {{type: urdf, file: {robot}}}\n{common}")
    (tmp_path / "three.yaml").write_text(f"robot: puma560\n{common}")
    (tmp_path / "c.yaml").write_text(
        "scenarios: [two.yaml, three.yaml]\nruns: 3\ncontrollers: [ftcm, ctc]\n"
        "set: [duration=0.05, transient=0.01]\nvary: {injection.faults.0.loss: 'uniform(0.2, 0.8)'}\n"
    )
    return campaign.from_file(str(tmp_path / "c.yaml"))


def test_every_contender_runs_in_every_scenario_with_the_same_draws(two_arms, tmp_path):
    folder = tmp_path / "out"
    folder.mkdir()
    summary = campaign.run_campaign(two_arms, engine="plain", jobs=1, folder=folder)
    assert list(summary["results"]) == ["ftcm @ two", "ctc @ two", "ftcm @ three", "ctc @ three"]
    runs = list(campaign.read_runs(folder / "runs.jsonl"))
    drawn = [r["set"][-1] for r in runs]
    assert [len(set(drawn[i : i + 4])) for i in range(0, 12, 4)] == [1, 1, 1]
    assert len(set(drawn)) == 3
    joints = [len(r["metrics"]["after_fault"]["mean_abs_error"]) for r in runs[:4]]
    assert joints == [2, 2, 3, 3]
    one = runs[5]
    scenario = load(dict(two_arms.scenarios)["two"], one["set"], one["controller"])
    assert json.loads(json.dumps(evaluate(simulate(scenario)))) == one["metrics"]
    if importlib.util.find_spec("pyarrow"):
        from pyarrow import parquet

        column = parquet.read_table(folder / "runs.parquet")["after_fault.mean_abs_error.joint3"]
        assert [x is None for x in column.to_pylist()] == [True, True, False, False] * 3


def test_contenders_are_compared_within_their_scenario(two_arms):
    summary = campaign.run_campaign(two_arms, engine="plain", jobs=1)
    pairs = {tuple(pair["contenders"]) for pair in summary["comparisons"]}
    assert pairs == {("ftcm @ two", "ctc @ two"), ("ftcm @ three", "ctc @ three")}
    assert {len(one["contenders"]) for one in summary["ranking"]} == {2}
    lines = [line for line in campaign.table(summary).splitlines() if line.startswith("|")]
    assert any("ftcm @ three / ctc @ three" in line for line in lines)


def test_two_scenarios_of_one_name_are_refused(tmp_path):
    (tmp_path / "c.yaml").write_text("scenarios: [paper, paper]\n")
    with pytest.raises(FtcmError, match="paper: is given twice; a scenario is called as its file is"):
        campaign.from_file(str(tmp_path / "c.yaml"))


def test_a_parameter_file_without_parameters_is_refused(tmp_path, capsys):
    (tmp_path / "a.yaml").write_text("trials: 5\n")
    assert main(["simulate", "paper", "--params", str(tmp_path / "a.yaml")]) == 2
    assert "none of controller, observer, detector in it" in capsys.readouterr().err


@pytest.mark.parametrize("file", sorted((ROOT / "config" / "suites").glob("*.yaml")), ids=lambda p: p.stem)
def test_the_shipped_suites_can_be_run(file):
    """Their first and last draw with every contender, for some hundredths of a second."""
    pytest.importorskip("scipy", reason="scipy is not installed")  # their draws are even
    planned = campaign.from_file(str(file))
    some = [run for run in planned.run_list() if run.number in (0, planned.runs - 1)]
    assert len(some) >= 6
    for run in some:
        scenario = replace(planned.scenario(run), duration=0.04)
        assert simulate(scenario).status == "completed"
