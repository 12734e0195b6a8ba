# SPDX-License-Identifier: Apache-2.0
"""The suite of faults: every row is a run that can be done again; tables say what the rows say."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

from ftcm_core.campaign import fault_suite
from ftcm_core.campaign.fault_suite import Suite, run_suite, summary, tables
from ftcm_core.cli.main import main
from ftcm_core.errors import FtcmError
from ftcm_core.faults import TOPICS
from ftcm_core.recording.detection import detection_scores
from ftcm_core.recording.metrics import result
from ftcm_core.registry import components
from ftcm_core.scenario import load
from ftcm_core.simulation import simulate

SHORT = {"onset": 0.1, "duration": 0.2, "controllers": ("ctc", "ftcm")}


def test_every_row_is_a_run_that_can_be_done_again() -> None:
    rows = run_suite(
        Suite(
            **SHORT, faults=("sensor_bias", "payload_pickup"), joints=(1, 3), conditions=("ideal", "encoder")
        ),
        jobs=1,
    )
    assert [(r["condition"], r["fault"], r["joint"], r["controller"]) for r in rows] == [
        (condition, fault, joint, law)
        for condition in ("encoder", "ideal")
        for fault, joint in (("none", 0), ("payload_pickup", 0), ("sensor_bias", 1), ("sensor_bias", 3))
        for law in ("ctc", "ftcm")
    ]
    (row,) = [r for r in rows if (r["condition"], r["joint"], r["controller"]) == ("encoder", 3, "ftcm")]
    overrides = [
        "duration=0.2",
        "sensor=encoder",
        "injection.faults=[{type: sensor_bias, start: 0.1, joint: 3}]",
    ]
    found = result(simulate(load("paper", overrides, "ftcm")))["metrics"]["after_fault"]
    for name in ("rms_error", "max_abs_error", "torque_total_variation"):
        assert row[name] == max(found[name])
    assert (row["site"], row["status"]) == ("sensor", "completed")


def test_with_a_detector_a_row_says_what_it_told() -> None:
    """Delay and verdict as in the scores of the run; without a detector there is nothing of it."""
    detector = "detector=isolating"
    suite = Suite(
        **{**SHORT, "duration": 0.4}, faults=("frozen_sensor", "payload_pickup"), overrides=(detector,)
    )
    rows = run_suite(suite, jobs=1)
    (found,) = [r for r in rows if (r["fault"], r["controller"]) == ("frozen_sensor", "ftcm")]
    fault = "injection.faults=[{type: frozen_sensor, start: 0.1, joint: 2}]"
    scores = detection_scores(simulate(load("paper", ["duration=0.4", detector, fault], "ftcm")))
    assert scores is not None
    (score,) = scores["faults"]
    assert score["detected"]
    assert (found["detection_delay"], found["verdict"], found["verdict_joint"]) == (
        score["delay"], score["verdict"], score["verdict_joint"],
    )  # fmt: skip
    text = tables(rows, [])
    assert f"{1000 * score['delay']:.3g}, {score['verdict']} {score['verdict_joint'] or ''}".strip() in text
    assert "verdict" not in run_suite(Suite(**SHORT, faults=("frozen_sensor",)), jobs=1)[0]


def test_by_default_every_fault_that_suits_the_robot_is_in_it() -> None:
    found = fault_suite.faults_of(Suite(), load("paper"))
    assert {fault.type_name for _, _, fault in found} == set(components("fault"))
    assert [name for name, _, fault in found if fault.type_name == "dropped_messages"] == [
        f"dropped_messages ({topic})" for topic in TOPICS
    ]
    assert {fault.start for _, _, fault in found} == {3.0}


def test_a_wrong_model_is_one_of_all_masses_and_inertias() -> None:
    """The robot stays. Gravity follows, to the part that is measured of this robot, not made of masses."""
    scenario = load("paper")
    heavier, lighter = (fault_suite.conditions()[n](scenario) for n in ("heavier_model", "lighter_model"))
    q = (0.3, -0.4, 0.7)
    for other, factor in ((heavier, 1.2), (lighter, 0.8)):
        assert other.robot == scenario.robot
        for name in ("mass", "inertia_xx", "inertia_yy", "inertia_zz", "motor_inertia"):
            assert getattr(other.model, name) == tuple(factor * x for x in getattr(scenario.model, name))
        gravity = [factor * x for x in scenario.model.gravity(q)]
        assert other.model.gravity(q) == pytest.approx(gravity, rel=1e-3)


def row(fault: str, law: str, error: float | None, status: str = "completed") -> dict[str, Any]:
    numbers = dict.fromkeys(fault_suite.METRICS, error)
    return {"condition": "ideal", "fault": fault, "joint": 2, "controller": law, "status": status, **numbers}


def test_tables() -> None:
    """The best of a line in bold; what ended early says how; the run without a fault counts for no win."""
    rows = [row("none", "a", 1e-3), row("none", "b", 2e-3), row("x", "a", 3e-3), row("x", "b", 2e-3),
            row("y", "a", None, "limit_exceeded"), row("y", "b", 9e-3)]  # fmt: skip
    text = tables(rows, ["rms_error"])
    assert "| none | 2 | **1** | 2 |" in text
    assert "| x | 2 | 3 | **2** |" in text
    assert "| y | 2 | limit exceeded | **9** |" in text
    assert "| ideal | a | 2 | 1 | 0 | 3 |" in summary(rows)
    assert "| ideal | b | 2 | 0 | 2 | 5.5 |" in summary(rows)


def test_the_command(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """The same rows on stdout and in the folder."""
    short = ["suite", "faults", "--onset", "0.1", "--duration", "0.2", "--controllers", "ctc", "--jobs", "1"]
    assert main([*short, "--faults", "vo_kang_fault", "--json", "--output", str(tmp_path / "out")]) == 0
    printed = json.loads(capsys.readouterr().out)
    assert [r["fault"] for r in printed["rows"]] == ["none", "vo_kang_fault"]
    assert json.loads((tmp_path / "out" / "summary.json").read_text())["rows"] == printed["rows"]
    assert "| vo_kang_fault | 2 |" in (tmp_path / "out" / "table.md").read_text()


@pytest.mark.parametrize(
    ("change", "text"),
    [
        ({"faults": ("sensor_bais",)}, "no fault 'sensor_bais'; did you mean 'sensor_bias'?"),
        ({"conditions": ("ideel",)}, "no condition 'ideel'; did you mean 'ideal'?"),
        ({"joints": (4,)}, "joint 4: expected 1 to 3"),
        ({"onset": 7.0}, "onset: 7 s; expected between 0 and the duration 0.2 s"),
    ],
)
def test_what_makes_no_sense_is_one_line(change: dict[str, Any], text: str) -> None:
    with pytest.raises(FtcmError) as caught:
        run_suite(Suite(**{**SHORT, **change}), jobs=1)
    assert str(caught.value) == text
