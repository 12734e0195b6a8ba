# SPDX-License-Identifier: Apache-2.0
"""Thresholds for a stated rate of false alarms: how they are found, and whether fresh runs keep the rate."""

from __future__ import annotations

import json
import math
from pathlib import Path

import numpy as np
import pytest

from ftcm_core import compiled
from ftcm_core.campaign.calibration import (
    PEAKS,
    calibrate,
    fault_free,
    held_statistic,
    level_for,
)
from ftcm_core.cli import main
from ftcm_core.errors import FtcmError
from ftcm_core.recording.detection import HOUR, detection_scores, poisson_interval
from ftcm_core.scenario import Scenario, load, replace
from ftcm_core.scenario.yaml_text import parse_yaml
from ftcm_core.simulation import simulate

NOISY = ["sensor={type: encoder, noise: 1e-4}", "transient=0.5"]
FAULT = "injection.faults=[{type: sensor_bias, start: 0.6}]"


def crossings(run: np.ndarray, level: float) -> int:
    """How often a level is passed upwards."""
    return int(np.count_nonzero((run[:-1] <= level) & (run[1:] > level)))


def probability_of_split(first: int, second: int, share: float) -> float:
    """Two-sided probability of a split of events as uneven as this one, where ``share`` fall on the second.

    Given their sum, the second of two Poisson counts of the same rate is binomial, whatever the rate.
    """
    n = first + second
    each = [math.comb(n, k) * share**k * (1.0 - share) ** (n - k) for k in range(n + 1)]
    return min(1.0, 2.0 * min(math.fsum(each[: second + 1]), math.fsum(each[second:])))


def test_a_counted_level_is_the_lowest_with_the_rate() -> None:
    """It is passed at most c times, and just below it more often."""
    rng = np.random.default_rng(3)
    runs = [rng.normal(size=5000).cumsum() / 50.0 + rng.normal(size=5000) for _ in range(3)]
    for expected in (30.0, 100.0, 101.5, 999.0):
        found = level_for(runs, expected)
        assert found.method == "counted"
        assert sum(crossings(x, found.threshold) for x in runs) == found.peaks <= expected
        below = math.nextafter(found.threshold, -math.inf)
        assert sum(crossings(x, below) for x in runs) > expected


def test_the_tail_is_that_of_exponential_noise() -> None:
    """Of independent values with P(x > h) = E^(-h/2), n E^(-h/2) pass h: h = 2 ln(n / c).

    β is known to 1/sqrt(30) of itself: the level to β ln(30 / c) / sqrt(30), its start to β / sqrt(30).
    """
    n, errors = 20_000, []
    for seed in range(20):
        run = np.random.default_rng(seed).exponential(2.0, n)
        for expected in (3.0, 0.1):
            found = level_for([run[: n // 2], run[n // 2 :]], expected)
            assert found.method == "exponential tail"
            deviation = 2.0 * math.hypot(math.log(PEAKS / expected), 1.0) / math.sqrt(PEAKS)
            errors.append((found.threshold - 2.0 * math.log(n / expected)) / deviation)
    assert abs(np.mean(errors)) < 0.5
    assert np.abs(errors).max() < 3.5


@pytest.mark.parametrize(
    "detector",
    [
        "{type: residual_threshold, residual: momentum, threshold: [8, 6, 2], hold: 0.0025}",
        "{type: adaptive_threshold, residual: motion, threshold: 0.004, per_speed: 0.001, per_torque: 0, "
        "hold: 0}",
        "{type: glr, residual: estimate, sigma: 4, window: 10, threshold: 25}",
    ],
)
def test_alarms_are_where_the_statistic_passes_the_threshold(detector: str) -> None:
    """Those of the silent run, counted afterwards, are those of the run with the threshold."""
    scenario = load("paper", [*NOISY, "duration=1.5", f"detector={detector}", "injection.faults=[]"])
    scores = detection_scores(simulate(scenario))
    assert scores is not None
    silent = simulate(fault_free(scenario))
    assert silent.alarm is not None
    assert not silent.alarm.any()
    held = held_statistic(silent)
    assert scenario.detector is not None
    limits = np.broadcast_to(scenario.detector.values["threshold"], (3,))
    counted = sum(crossings(held[:, j], limits[j]) for j in range(3))
    assert scores["false_alarms"] == counted
    assert counted > 10


def fresh_alarms(scenario: Scenario, seeds: range, plain: bool) -> tuple[int, float]:
    """False alarms of runs with other seeds, and their exposure, s."""
    count, exposure = 0, 0.0
    for seed in seeds:
        run = replace(scenario, faults=(), seed=seed)
        scores = detection_scores(simulate(run) if plain else compiled.simulate(run))
        assert scores is not None
        count, exposure = count + scores["false_alarms"], exposure + scores["exposure"]
    return count, exposure


def test_fresh_runs_keep_the_rate_of_the_command(tmp_path: Path) -> None:
    """One command; its file is given back; the alarms of fresh seeds are as many as those that were counted.

    The faults of the scenario are left out when calibrating.
    """
    file, rate = tmp_path / "found.yaml", 60_000.0
    common = [*NOISY, "duration=2", FAULT, "detector.residual=momentum", "detector.hold=0"]
    command = ["calibrate", "paper", "--detector", "residual_threshold", "--set", *common]
    more = ["--false-alarms-per-hour", str(rate), "--runs", "6", "--engine", "plain", "--jobs", "1"]
    assert main([*command, *more, "--output", str(file)]) == 0
    found, _ = parse_yaml(file.read_text(), "found.yaml")
    about = found["calibration"]
    assert about["seeds"] == [1, 6]
    assert about["exposure"] == pytest.approx(6 * 1.501)
    assert [x["method"] for x in about["joints"]] == ["counted"] * 3
    counted = sum(x["peaks"] for x in about["joints"])
    assert counted == pytest.approx(rate * about["exposure"] / HOUR, abs=3.0)
    scenario = load("paper", [*NOISY, "duration=2", f"detector={json.dumps(found['detector'])}"])
    count, exposure = fresh_alarms(scenario, range(1000, 1006), plain=True)
    share = exposure / (exposure + about["exposure"])
    assert probability_of_split(counted, count, share) > 0.01, (counted, count)
    assert probability_of_split(counted, count // 2, share) < 0.01, "the test would see half of the rate"
    out = tmp_path / "out"
    again = [
        "simulate",
        "paper",
        "--detector-file",
        str(file),
        "--set",
        *NOISY,
        "duration=0.6",
        "--no-figures",
    ]
    assert main([*again, "--output", str(out)]) == 0
    kept = json.loads((out / "summary.json").read_text())["results"][0]["configuration"]["detector"]
    assert kept == found["detector"]


@pytest.mark.nightly
@pytest.mark.slow
@pytest.mark.parametrize("test", ["residual_threshold", "cusum", "glr"])
def test_the_rate_holds_beyond_what_was_counted(test: str) -> None:
    """Three alarms of a joint expected in 100 s: from the tail. 400 s of fresh runs have 36, if it is right.

    β from 30 peaks is known to 18 %, the rate at ln(30 / 3) of them to a factor of E^(0.18 · 2.3 · 2) = 2.3.
    """
    sigma = ", sigma: 2" if test == "glr" else ", drift: 3" if test == "cusum" else ", hold: 0"
    detector = f"detector={{type: {test}, residual: momentum{sigma}}}"
    scenario = load("paper", [*NOISY, "duration=20.5", "injection.faults=[]", detector])
    found = calibrate(scenario, 9 * HOUR / 100.0, 5, jobs=1)
    assert [x["method"] for x in found["calibration"]["joints"]] == ["exponential tail"] * 3
    scenario = load("paper", [*NOISY, "duration=20.5", f"detector={json.dumps(found['detector'])}"])
    count, exposure = fresh_alarms(scenario, range(2000, 2020), plain=False)
    low, high = (x / exposure * 100.0 for x in poisson_interval(count, 0.99))
    assert low < 9.0 * 2.3
    assert high > 9.0 / 2.3


def test_what_cannot_be_calibrated_is_said_in_one_line(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """No detector, no noise, no rate, a file without a detector."""
    common = ["--false-alarms-per-hour", "1", "--runs", "2", "--engine", "plain", "--jobs", "1"]
    short = ["duration=0.7", *NOISY]
    other = tmp_path / "other.yaml"
    other.write_text("robot: puma560\n")
    for command, text in (
        (["calibrate", "paper", *common, "--set", *short], "the scenario has no detector; expected one"),
        (["calibrate", "paper", "--detector", "cusm", *common], "did you mean 'cusum'"),
        (
            ["calibrate", "paper", "--detector", "cusum", *common[2:], "--false-alarms-per-hour", "0"],
            "above 0",
        ),
        (
            ["calibrate", "paper", "--detector", "cusum", *common, "--set", "duration=0.7", "transient=0.5"],
            "joint1: only 0 peaks of the statistic in all runs, expected 10",
        ),
        (
            ["simulate", "paper", "--detector-file", str(other)],
            "no detector in it; expected a file that ftcm",
        ),
    ):
        assert main(command) == 2, command
        assert text in capsys.readouterr().err.splitlines()[-1]


def test_runs_that_are_alike_are_said_to_be(capsys: pytest.CaptureFixture[str]) -> None:
    """Without noise every seed gives the same run."""
    notes: list[str] = []
    scenario = load("paper", ["duration=0.6", "transient=0", "detector={type: residual_threshold, hold: 0}"])
    with pytest.raises(FtcmError, match="peaks"):
        calibrate(scenario, 1.0, 2, engine="plain", jobs=1, note=notes.append)
    assert notes[0].startswith("all runs are alike")
