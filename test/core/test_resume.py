# SPDX-License-Identifier: Apache-2.0
"""A campaign that was ended goes on where it was, and ends with the files it would have had."""

import fcntl
import json
import signal
import subprocess
import sys
import time

import pytest

from campaigns import FILES, contents, planned
from ftcm_core import campaign
from ftcm_core.campaign import running
from ftcm_core.cli import main
from ftcm_core.errors import FtcmError

PLANNED = planned(runs=3, fault=0.01)
OPTIONS = [
    "paper", "--engine", "plain", "--controllers", "ftcm", "smc",
    "--set", "duration=0.05", "transient=0.01", "injection.faults.0.start=0.02",
    "--vary", "observer.k1=uniform(10000, 20000)",
]  # fmt: skip


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    folder = tmp_path_factory.mktemp("whole")
    campaign.run_campaign(PLANNED, engine="plain", jobs=1, folder=folder)
    return folder


@pytest.mark.parametrize(
    ("share", "kept"), [(0.0, 0), (0.01, 0), (0.5, 3), (0.999, 5), (1.0, 6)], ids=lambda x: f"{x:g}"
)
def test_what_is_missing_is_run_and_nothing_else(whole, tmp_path, monkeypatch, share, kept):
    text = (whole / "runs.jsonl").read_bytes()
    (tmp_path / "runs.jsonl").write_bytes(text[: int(share * len(text))])
    (tmp_path / "campaign.json").write_bytes((whole / "campaign.json").read_bytes())
    ran, told = [], []
    real = running.run_one
    monkeypatch.setattr(running, "run_one", lambda c, run, e: ran.append(run) or real(c, run, e))
    campaign.run_campaign(
        PLANNED, engine="plain", jobs=1, folder=tmp_path, resume=True, progress=lambda *x: told.append(x)
    )
    assert len(ran) == 6 - kept
    assert told[0] == (kept, 6)
    assert contents(tmp_path) == contents(whole)


@pytest.mark.slow
def test_a_campaign_that_is_killed_goes_on(tmp_path, capsys):
    """SIGKILL to the real command, then the same with --resume, against one that was left alone."""
    command = ["campaign", *OPTIONS, "--runs", "40"]
    ended, whole = tmp_path / "ended", tmp_path / "whole"
    process = subprocess.Popen(
        [sys.executable, "-m", "ftcm_core.cli", *command, "--output", str(ended), "--jobs", "2"],
        stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL,
    )  # fmt: skip
    try:
        lines, until = ended / "runs.jsonl", time.monotonic() + 60
        while not (lines.exists() and lines.stat().st_size) and time.monotonic() < until:
            time.sleep(0.005)
    finally:
        process.send_signal(signal.SIGKILL)
        process.wait()
    there = lines.read_bytes().count(b"\n")
    assert 0 < there < 80, "killed in the middle"
    assert not (ended / "summary.json").exists()
    with lines.open("ab") as file:
        file.write(b'{"run": 17, "con')  # as if it was killed while it wrote
    assert main([*command, "--output", str(ended), "--resume", "--jobs", "1"]) == 0
    assert main([*command, "--output", str(whole), "--jobs", "1"]) == 0
    capsys.readouterr()
    assert contents(ended) == contents(whole)


def test_another_campaign_is_not_gone_on_with(tmp_path, capsys):
    folder = tmp_path / "a"
    assert main(["campaign", *OPTIONS, "--runs", "1", "--output", str(folder)]) == 0
    before = contents(folder)
    for more, said in (
        (["--runs", "2"], "campaign.runs is 1 there, 2 here"),
        (["--seed", "5"], "campaign.seed is 0 there, 5 here"),
        (["--controllers", "smc"], "campaign.controllers is ['ftcm', 'smc'] there, ['smc'] here"),
        (["--set", "duration=0.06"], "campaign.set is ['duration=0.05'"),
    ):
        capsys.readouterr()
        assert main(["campaign", *OPTIONS, "--runs", "1", "--output", str(folder), "--resume", *more]) == 2
        error = capsys.readouterr().err
        assert said in error
        assert len(error.splitlines()) == 1
        assert contents(folder) == before
    lines = (folder / "runs.jsonl").read_text().splitlines()
    (folder / "runs.jsonl").write_text(lines[1] + "\n")
    assert main(["campaign", *OPTIONS, "--runs", "1", "--output", str(folder), "--resume"]) == 2
    assert "runs.jsonl:1: is not run 1 of this campaign" in capsys.readouterr().err


def test_a_changed_scenario_is_another_campaign(tmp_path, capsys):
    scenario = tmp_path / "mine.yaml"
    text = "robot: puma560\nreference: vo_kang_cosine\ncontroller: smc\nobserver: do\nduration: 0.02\n"
    scenario.write_text(text)
    command = ["campaign", str(scenario), "--runs", "1", "--engine", "plain", "--output", str(tmp_path / "a")]
    assert main(command) == 0
    scenario.write_text(text.replace("smc", "ctc"))
    assert main([*command, "--resume"]) == 2
    assert "scenario_sha256 is " in capsys.readouterr().err


def test_other_versions_are_told(whole, tmp_path):
    for name in (*FILES, "campaign.json"):
        (tmp_path / name).write_bytes((whole / name).read_bytes())
    identity = json.loads((whole / "campaign.json").read_text())
    identity["provenance"]["numpy"] = "1.0"
    (tmp_path / "campaign.json").write_text(json.dumps(identity))
    told = []
    campaign.run_campaign(PLANNED, engine="plain", folder=tmp_path, resume=True, note=told.append)
    assert [text for text in told if "numpy was 1.0, is " in text]


def test_there_must_be_something_to_go_on_with(tmp_path, capsys):
    assert main(["campaign", *OPTIONS, "--resume"]) == 2
    assert "--resume: expected --output DIR" in capsys.readouterr().err
    for folder in (tmp_path, tmp_path / "not-there"):
        assert main(["campaign", *OPTIONS, "--output", str(folder), "--resume"]) == 2
        error = capsys.readouterr().err
        assert "has nothing to resume: no campaign.json that can be read" in error
        assert len(error.splitlines()) == 1


def test_two_processes_do_not_write_the_same_results(whole, tmp_path, capsys):
    for name in (*FILES, "campaign.json"):
        (tmp_path / name).write_bytes((whole / name).read_bytes())
    with open(tmp_path / "runs.jsonl") as file:
        fcntl.flock(file, fcntl.LOCK_EX)
        with pytest.raises(FtcmError, match="another process is at it"):
            campaign.run_campaign(PLANNED, engine="plain", folder=tmp_path, resume=True)
    assert contents(tmp_path) == contents(whole)
