# SPDX-License-Identifier: Apache-2.0
"""The size of a fault that a detector just detects."""

from __future__ import annotations

import json
from typing import Any

import pytest

from ftcm_core.campaign.detectable import just_detectable
from ftcm_core.cli.main import main
from ftcm_core.errors import FtcmError
from ftcm_core.scenario import load

PATH = "injection.faults.0.torque"
STEP = [
    "controller=ctc", "duration=0.4", "transient=0.05", "injection.disturbances=[]", "reference=constant",
    "injection.faults=[{type: external_torque, start: 0.1, joint: 2}]",
]  # fmt: skip


def edge(detector: str, low: float = 0.1, high: float = 100.0, **more: Any) -> dict[str, Any]:
    """The edge of a constant torque on joint 2 of a robot that stands still."""
    return just_detectable(
        load("paper", [*STEP, f"detector={detector}"]), PATH, low, high, jobs=1, engine="plain", **more
    )


@pytest.mark.parametrize("threshold", [4.0, 20.0])
def test_a_threshold_on_the_momentum_finds_a_torque_of_its_size(threshold: float) -> None:
    """The residual comes to the torque itself, so that size is the edge: to the precision asked for."""
    found = edge(f"{{type: residual_threshold, residual: momentum, threshold: {threshold}, hold: 0}}")
    assert found["missed"] < found["detected"]
    assert found["detected"] - found["missed"] <= 0.05 * found["detected"]
    assert found["missed"] * 0.95 < threshold < found["detected"] * 1.05
    sizes = [one["size"] for one in found["tried"]]
    assert sizes == sorted(sizes)
    assert {one["size"]: one["detected"] for one in found["tried"]}[found["detected"]] == 1


def test_noise_makes_it_a_share_of_the_runs() -> None:
    """Near the edge some runs find it and some do not."""
    detector = "{type: residual_threshold, residual: momentum, threshold: 4, hold: 0.1}"
    noisy = load("paper", [*STEP, f"detector={detector}", "sensor={type: encoder, noise: 1e-4}"])
    found = just_detectable(noisy, PATH, 0.1, 100.0, runs=8, share=1.0, precision=0.02, engine="plain")
    assert any(0 < one["detected"] < 8 for one in found["tried"])
    assert found["detected"] > 4.0


@pytest.mark.parametrize(
    ("overrides", "size", "said"),
    [
        ([], f"{PATH}=1:100", "has no detector"),
        (["detector=cusum", "injection.faults=[]"], f"{PATH}=1:100", "has 0 faults; expected one"),
        (["detector=cusum"], "observer.k1=1:100", "expected a parameter of the fault"),
        (["detector=cusum"], f"{PATH}=5:1", "expected a smaller and a larger size"),
        (["detector=cusum"], f"{PATH}=-1:1", "expected a smaller and a larger size"),
        (["detector=cusum"], f"{PATH}=1", "expected PATH=SMALL:LARGE"),
        (["detector=cusum"], f"{PATH}=a:b", "expected PATH=SMALL:LARGE"),
        (["detector={type: residual_threshold, hold: 0}"], f"{PATH}=90:100", "= 90 is detected; expected"),
        (["detector={type: residual_threshold, threshold: 1e6}"], f"{PATH}=1:10", "= 10 is missed; expected"),
        (["detector=cusum"], "injection.faults.0.torqe=1:10", "unknown key; did you mean 'torque'?"),
    ],
)
def test_what_makes_no_sense_is_told(
    overrides: list[str], size: str, said: str, capsys: pytest.CaptureFixture[str]
) -> None:
    """In one line, status 2."""
    arguments = ["detectable", "paper", "--size", size, "--engine", "plain", "--jobs", "1"]
    assert main([*arguments, "--set", *STEP, *overrides]) == 2
    lines = capsys.readouterr().err.splitlines()
    assert said in lines[-1]
    assert lines[-1].startswith("ftcm: error: ")


def test_the_command_prints_what_it_tried(capsys: pytest.CaptureFixture[str]) -> None:
    """As a table, and as JSON."""
    detector = "detector={type: residual_threshold, residual: momentum, threshold: 10, hold: 0}"
    arguments = ["detectable", "paper", "--size", f"{PATH}=1:100", "--precision", "0.5", "--jobs", "1"]
    assert main([*arguments, "--engine", "plain", "--set", *STEP, detector]) == 0
    printed = capsys.readouterr()
    assert "Just detectable: injection.faults.0.torque between " in printed.out
    assert "| 100 " in printed.out
    assert "100: detected in 1 of 1" in printed.err
    assert main([*arguments, "--engine", "plain", "--json", "--set", *STEP, detector]) == 0
    assert json.loads(capsys.readouterr().out)["runs"] == 1


def test_a_share_that_is_none_is_refused() -> None:
    """So is a number of runs below one."""
    for more in ({"share": 0.0}, {"runs": 0}, {"precision": 1.0}):
        with pytest.raises(FtcmError, match="expected at least 1 run"):
            edge("cusum", **more)
