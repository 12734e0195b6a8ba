# SPDX-License-Identifier: Apache-2.0
"""Tables: their numbers are those of the results, and Table 2 stands only beside the paper's experiment."""

from __future__ import annotations

import copy
import json
import math
from typing import Any

import pytest

from ftcm_core.recording.metrics import result
from ftcm_core.report.results import to_json
from ftcm_core.report.table import (
    PUBLISHED,
    comparison_table,
    is_paper_run,
    paper_table,
    settling_table,
    transient_share,
)
from ftcm_core.scenario import load
from ftcm_core.simulation import simulate

Result = dict[str, Any]


@pytest.fixture(scope="module")
def paper() -> dict[str, Result]:
    """Results that claim to be the paper's experiment: of shorter runs, to be quick."""
    found = {}
    for name in PUBLISHED:
        changes = ["duration=2", "injection.faults.0.start=1.5"]
        claim = load("paper", controller=name).to_mapping()
        found[name] = {**result(simulate(load("paper", changes, name))), "configuration": claim}
    return found


@pytest.fixture(scope="module")
def short() -> Result:
    """A short run, with its fault in it."""
    return result(simulate(load("paper", ["duration=2", "injection.faults.0.start=1.5"])))


def cells(table: str, name: str) -> list[list[str]]:
    """Every table line of one run, split into cells."""
    lines = [line.strip("|").split(" | ") for line in table.splitlines() if line.startswith("|")]
    split = [[cell.strip() for cell in line] for line in lines]
    return [line for line in split if line[0] == name]


def test_published_values_are_table_2() -> None:
    """Table 2 of the paper, E1 E2 E3."""
    assert PUBLISHED == {
        "smc": (0.008021, 0.007490, 0.154244),
        "nftsmc": (0.019966, 0.005121, 0.004845),
        "ftcm": (0.002819, 0.002807, 0.002785),
    }


def test_every_number_is_the_result_s(short: Result) -> None:
    """Put numbers into a result that no run has; find each where it belongs."""
    changed = copy.deepcopy(short)
    metrics = changed["metrics"]
    metrics["whole"]["mean_abs_error"] = [0.1111, 0.2222, 0.3333]
    metrics["whole"]["iae"], metrics["transient"]["iae"] = [4.0] * 3, [1.0, 2.0, 3.0]
    metrics["transient"]["mean_abs_error"] = [1.1, 1.2, 1.3]
    metrics["before_fault"]["mean_abs_error"] = [2.1e-8, 2.2e-8, 2.3e-8]
    metrics["after_fault"]["mean_abs_error"] = [3.1e-3, 3.2e-3, None]
    metrics["after_fault"]["max_abs_error"] = [4.1, 4.2, 4.3]
    metrics["after_transient"]["torque_total_variation"] = [123456.0, 5.1, 99.94]
    mean, windows, effort = cells(comparison_table([changed]), "ftcm")
    assert mean == ["ftcm", "0.1111", "0.2222", "0.3333", "25.00 % / 50.00 % / 75.00 %", "completed"]
    assert windows == ["ftcm", "1.1 / 1.2 / 1.3", "2.1e-08 / 2.2e-08 / 2.3e-08", "0.0031 / 0.0032 / –"]
    assert effort == ["ftcm", "4.1 / 4.2 / 4.3", "123,456 / 5.1 / 99.9"]
    metrics["whole"]["settling_time"], changed["settling_time_bound"] = (
        [0.25, 0.5, None],
        [1.0, 2.0, math.nan],
    )
    (settling,) = cells(settling_table([changed]), "ftcm")
    assert settling == ["ftcm", "0.250 / 0.500 / –", "1.000 / 2.000 / –"]


def test_windows_a_run_does_not_have() -> None:
    """A run shorter than its transient, without a fault in it."""
    found = result(simulate(load("paper", ["duration=0.5"])))
    assert found["metrics"]["after_fault"] is None
    mean, windows, effort = cells(comparison_table([found]), "ftcm")
    assert mean[-1] == "completed"
    assert windows[2:] == ["–", "–"]
    assert effort[1:] == ["–", "–"]


def test_a_diverged_run_says_when_and_why(short: Result) -> None:
    """Its line has the status and the time; the reason stands below."""
    arguments = ["controller.kd=2010", "duration=3"]
    diverged = result(simulate(load("paper", arguments, controller="ctc")))
    assert diverged["status"] == "diverged"
    table = comparison_table([short, diverged])
    time = diverged["detail"].split()[3]
    assert cells(table, "ctc")[0][-1] == f"diverged at {time} s"
    assert "joint velocity" in table
    assert cells(table, "ftcm")[0][-1] == "completed"


def test_incomplete_run_without_a_scenario(short: Result) -> None:
    """A foreign recording: no scenario, no times in its detail."""
    foreign = {**short, "scenario": None, "controller": None, "configuration": None, "status": "incomplete"}
    table = comparison_table([foreign])
    assert cells(table, "unknown")[0][-1] == "incomplete"
    assert paper_table([foreign]) == ""


def test_labels_and_scenarios_name_the_lines(short: Result) -> None:
    """A label replaces the controller's name; without labels, several scenarios get a column."""
    assert cells(comparison_table([{**short, "label": "from the bag"}]), "from the bag")
    other = {**short, "scenario": "other"}
    assert cells(comparison_table([short, other]), "other")[0][1] == "ftcm"


def test_paper_table_has_published_values_ratios_and_the_two_misses(paper: dict[str, Result]) -> None:
    """Published, ours and the ratio in each line; what does not reproduce is said with our ratios."""
    text = paper_table(list(paper.values()))
    for name, published in PUBLISHED.items():
        (line,) = cells(text, name)
        ours = paper[name]["metrics"]["whole"]["mean_abs_error"]
        for j in range(3):
            assert float(line[1 + 3 * j]) == published[j]
            assert float(line[2 + 3 * j]) == pytest.approx(ours[j], rel=1e-3)
            assert float(line[3 + 3 * j]) == pytest.approx(ours[j] / published[j], abs=1e-3)
    smc = paper["smc"]["metrics"]["whole"]["mean_abs_error"][2] / 0.154244
    nftsmc = paper["nftsmc"]["metrics"]["whole"]["mean_abs_error"][0] / 0.019966
    assert f"SMC E3 (ratio {smc:.3g}) and NFTSMC E1 (ratio {nftsmc:.3g}) do not reproduce" in text
    assert "all initial transient" in text


def test_paper_table_follows_the_result(paper: dict[str, Result]) -> None:
    """A changed mean changes value and ratio; the sentence names only controllers that ran."""
    changed = copy.deepcopy(paper["nftsmc"])
    changed["metrics"]["whole"]["mean_abs_error"][0] = 0.0399320
    text = paper_table([changed])
    assert cells(text, "nftsmc")[0][1:4] == ["0.019966", "0.03993", "2.000"]
    assert "NFTSMC E1 (ratio 2) does not reproduce" in text
    assert "SMC E3 (" not in text.replace("NFTSMC", "")
    assert "FTCM row" not in text


def test_entries_close_to_the_published_ones_are_counted(paper: dict[str, Result]) -> None:
    """Within 10 %, either way."""
    changed = copy.deepcopy(paper["ftcm"])
    changed["metrics"]["whole"]["mean_abs_error"] = [1.09 * 0.002819, 0.91 * 0.002807, 1.11 * 0.002785]
    assert "2 of 3 entries" in paper_table([changed])


@pytest.mark.slow
def test_the_paper_s_experiment_itself() -> None:
    """Seven of nine entries come out; of the FTCM row, over 99.9 % arises in the first second."""
    results = [result(simulate(load("paper", controller=name))) for name in PUBLISHED]
    assert all(map(is_paper_run, results))
    assert "7 of 9 entries" in paper_table(results)
    share = transient_share(results[-1])
    assert share is not None
    assert min(share) > 0.999


@pytest.mark.parametrize(
    "change",
    [
        ["controller.gamma1=3"],
        ["observer.k1=10000"],
        ["injection.faults.0.severity=0.5"],
        ["injection.disturbances=[]"],
        ["initial_state.position=0.1"],
        ["torque_limits=500"],
        ["reference.type=constant"],
    ],
)
def test_only_the_paper_s_experiment_is_compared(paper: dict[str, Result], change: list[str]) -> None:
    """A result whose configuration differs in anything that matters does not."""
    assert is_paper_run(paper["ftcm"])
    assert not is_paper_run({**paper["ftcm"], "configuration": load("paper", change).to_mapping()})


def test_what_does_not_matter_may_differ(paper: dict[str, Result]) -> None:
    """The name, the seed (nothing in it is random), and the observer of a law that uses none."""
    same = load("paper", ["name=mine", "seed=4", "observer.type=none"], controller="smc").to_mapping()
    assert is_paper_run({**paper["smc"], "configuration": same})
    assert is_paper_run(json.loads(to_json(paper["ftcm"])))
    assert not is_paper_run({**paper["ftcm"], "status": "diverged"})
    assert not is_paper_run({**paper["ftcm"], "changes": [{"tick": 1, "kind": "controller", "type": "smc"}]})
