# SPDX-License-Identifier: Apache-2.0
"""The soak test: a short one on real processes, and that it notices loss and growth."""

from __future__ import annotations

import csv
import shutil
import subprocess
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace

import pytest

pytest.importorskip("rclpy", reason="ROS 2 (rclpy) is not installed")

from ftcm_core.errors import FtcmError
from ftcm_ros.bags.writer import TopicCount
from soak import GROWTH_LIMIT_KB, check, growth, main

pytestmark = [pytest.mark.ros, pytest.mark.alone]

MILLISECOND = 1_000_000


def counted(ticks: list[int]) -> TopicCount:
    count = TopicCount()
    for tick in ticks:
        count.add(tick * MILLISECOND, MILLISECOND)
    return count


@pytest.mark.slow
def test_no_tick_is_lost_and_no_process_grows(
    start: Callable[..., subprocess.Popen[str]], tmp_path: Path
) -> None:
    process = start(
        "soak.py", "--minutes", "1", "--warm-up", "40", "--every", "1", "--folder", "soak",
        "--output", "figures.md",
    )  # fmt: skip
    out, err = process.communicate(timeout=280)
    assert process.returncode == 0, out + err
    assert "60,001 ticks, 300,005 messages on 5 data topics" in out
    assert " 0 ticks missing" in out
    assert "Deadlines missed: " in out
    assert (tmp_path / "figures.md").read_text() == out
    with (tmp_path / "soak" / "memory.csv").open() as file:
        assert {row["process"] for row in csv.DictReader(file)} == {"composed", "recorder", "experiment"}


@pytest.mark.parametrize(
    ("ticks", "text"),
    [
        ([0, 1, 2, 3, 4], ""),
        ([0, 1, 3, 4], "4 messages, 1 ticks missing, 0 repeated"),
        ([0, 1, 2, 3], "4 messages, 0 ticks missing"),
        ([1, 2, 3, 4], "1 ticks missing"),
        ([0, 1, 2, 2, 3, 4], "1 repeated"),
    ],
)
def test_loss_is_noticed(ticks: list[int], text: str) -> None:
    found = check({"joint_torques": counted(ticks)}, {}, 5, 60.0)
    assert len(found) == bool(text)
    assert all(text in line and "joint_torques" in line for line in found)


def test_growth_after_the_warm_up_is_noticed(tmp_path: Path) -> None:
    file = tmp_path / "memory.csv"
    rows = [(t, "plant", 50_000 + (90_000 if t < 60 else 0)) for t in range(0, 600, 5)]
    rows += [(t, "recorder", 40_000 + 3 * t) for t in range(0, 600, 5)]
    file.write_text("seconds,process,kb\n" + "".join(f"{t},{n},{kb}\n" for t, n, kb in rows))
    memory = growth(file, 60.0)
    assert memory == {"plant": (50_000, 50_000, 50_000), "recorder": (40_195, 41_770, 41_785)}
    assert GROWTH_LIMIT_KB == 1024
    assert check({}, memory, 5, 60.0) == ["recorder: 1575 kB more after 60 s; expected less than 1024 kB"]
    with pytest.raises(FtcmError, match="make the run longer"):
        growth(file, 590.0)


def test_mistakes_are_one_line(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(shutil, "disk_usage", lambda _: SimpleNamespace(free=10**9))
    assert main(["--minutes", "60", "--folder", str(tmp_path / "new")]) == 1
    assert main(["--folder", str(tmp_path)]) == 1
    assert main(["--set", "controler.x=1", "--folder", str(tmp_path / "other")]) == 1
    lines = capsys.readouterr().err.splitlines()
    assert len(lines) == 3
    assert "has 1.0 GB free; expected 7.2 GB for 3600 s" in lines[0]
    assert "exists already" in lines[1]
    assert "controler" in lines[2]
