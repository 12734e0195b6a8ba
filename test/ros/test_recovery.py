# SPDX-License-Identifier: Apache-2.0
"""Recorders that are killed or run out of disk, in real experiments: what is kept, and what is said."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

pytest.importorskip("rclpy", reason="ROS 2 (rclpy) is not installed")

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from sensor_msgs.msg import JointState

from ftcm_core.scenario import load
from ftcm_core.simulation import simulate
from ftcm_ros.bags.reader import BagContents, read_bag
from node_processes import node_pids
from programs import program
from traces import same

pytestmark = pytest.mark.ros

Start = Callable[..., "subprocess.Popen[str]"]
SECONDS = 20.0
SCENARIO = ("paper", "--controllers", "ftcm", "--set", f"duration={SECONDS:g}")


def equals_the_in_process_run(bag: BagContents) -> bool:
    """What was recovered has no gap and equals, float for float, the run in one process."""
    trace = bag.trace
    again = simulate(load("paper", [f"duration={trace.time_ns[-1] / 1e9}"], controller="ftcm"))
    assert bag.missing == {}
    assert trace.ticks == again.ticks
    return same(trace, again)


@pytest.mark.parametrize(
    ("storage", "mode"),
    [
        ("mcap", "lockstep"),
        pytest.param("sqlite3", "lockstep", marks=pytest.mark.slow),
        pytest.param("mcap", "real_time", marks=pytest.mark.nightly),
    ],
)
def test_of_a_killed_recorder_only_the_last_second_is_lost(
    start: Start, watcher: Any, domain: int, tmp_path: Path, storage: str, mode: str
) -> None:
    stamps: list[int] = []

    def on_measurement(message: JointState) -> None:
        stamps.append(message.header.stamp.sec * 10**9 + message.header.stamp.nanosec)

    watcher.node.create_subscription(JointState, "joint_states", on_measurement, 1)
    process = start(
        "experiment", *SCENARIO, "--storage", storage, "--mode", mode, "--no-composed", "--name", "test",
        "--no-figures", "--domain-id", str(domain),
    )  # fmt: skip
    assert process.stderr is not None
    next(line for line in process.stderr if "ticks/s" in line)
    pids = node_pids(process.pid)
    watcher.spin_until(lambda: stamps, "a measurement")
    os.kill(pids["plant"], signal.SIGSTOP)
    end = time.monotonic() + 1.0
    while time.monotonic() < end:
        watcher.executor.spin_once(timeout_sec=0.05)
    os.kill(pids["recorder"], signal.SIGKILL)
    out, err = process.communicate(timeout=60)
    assert process.returncode == 1
    assert "Traceback" not in err
    assert "warning: ftcm: bag was not closed; recovered: complete to t = " in err
    assert "node 'recorder' was ended by SIGKILL" in err.splitlines()[-1]
    bag = read_bag(tmp_path / "runs" / "test" / "bags" / "ftcm")
    # The stopped plant may have served the watcher but not the recorder, and cannot send again what that has
    # missed: at most a second, in lockstep the ticks that the plant may run ahead.
    assert bag.trace.time_ns[-1] >= stamps[-1] - 1_000_000_000
    if mode == "lockstep":
        assert equals_the_in_process_run(bag)
    assert bag.missing == {}
    assert "| ftcm" in out
    summary = json.loads((tmp_path / "runs" / "test" / "summary.json").read_text())
    assert summary["results"][0]["ticks"] == bag.trace.ticks


@pytest.mark.slow
@pytest.mark.parametrize("storage", ["mcap", pytest.param("sqlite3", marks=pytest.mark.nightly)])
def test_a_recorder_killed_at_any_moment_leaves_a_bag_that_can_be_read(
    start: Start, tmp_path: Path, storage: str
) -> None:
    process = start("experiment", *SCENARIO, "--storage", storage, "--name", "test", "--no-figures")
    assert process.stderr is not None
    next(line for line in process.stderr if "ticks/s" in line)
    os.kill(node_pids(process.pid)["recorder"], signal.SIGKILL)
    process.communicate(timeout=60)
    bag = read_bag(tmp_path / "runs" / "test" / "bags" / "ftcm")
    assert bag.recovered
    assert equals_the_in_process_run(bag)


@pytest.fixture
def small_disk(tmp_path: Path) -> Iterator[Path]:
    """A file system of 4 MB: about 3 s of a run."""
    place = tmp_path / "disk"
    place.mkdir()
    mount = subprocess.run(
        ["mount", "-t", "tmpfs", "-o", "size=4m", "none", place], capture_output=True, text=True, check=False
    )
    if mount.returncode:
        pytest.skip(f"a small file system cannot be mounted here: {mount.stderr.strip()}")
    yield place
    subprocess.run(["umount", place], check=True)


@pytest.mark.slow
@pytest.mark.parametrize("storage", ["mcap", pytest.param("sqlite3", marks=pytest.mark.nightly)])
def test_a_full_disk_ends_the_run_with_its_reason(
    start: Start, watcher: Any, domain: int, small_disk: Path, storage: str
) -> None:
    said: list[str] = []

    def on_diagnostics(message: DiagnosticArray) -> None:
        said.extend(
            s.message
            for s in message.status
            if s.name == "recorder: tick" and s.level == DiagnosticStatus.ERROR
        )

    watcher.node.create_subscription(DiagnosticArray, "/diagnostics", on_diagnostics, 10)
    process = start(
        "experiment", *SCENARIO, "--storage", storage, "--name", "test", "--domain-id", str(domain),
        "--runs", str(small_disk),
    )  # fmt: skip
    watcher.spin_until(lambda: said, "the recorder's error on /diagnostics")
    _, err = process.communicate(timeout=60)
    assert process.returncode == 1
    assert "Traceback" not in err
    path = small_disk / "test" / "bags" / "ftcm"
    reason = "No space left on device" if storage == "mcap" else "database or disk is full"
    assert f"bag {str(path)!r} cannot be written: {reason}; every tick up to t = " in said[0]
    run, results = err.splitlines()[-2:]
    assert f"recorder: error: {said[0]}" in run
    assert "results cannot be written" in results
    bag = read_bag(path)
    assert equals_the_in_process_run(bag)
    kept = float(said[0].partition("up to t = ")[2].split()[0])
    assert bag.trace.time_ns[-1] >= round(kept * 1e9) > 0


def test_a_file_size_limit_ends_the_run_with_its_reason(tmp_path: Path, domain: int) -> None:
    """As a full disk, where nothing can be mounted; the other files of the run can be written."""
    run = subprocess.run(
        ["prlimit", "--fsize=1500000", *program("experiment"), *SCENARIO,
         "--name", "test", "--no-figures"],
        capture_output=True, text=True, timeout=60, check=False, cwd=tmp_path,
    )  # fmt: skip
    assert run.returncode == 1
    assert "Traceback" not in run.stderr
    assert "cannot be written: File too large; every tick up to t = " in run.stderr.splitlines()[-1]
    assert "recovered: complete to t = " in run.stderr
    assert equals_the_in_process_run(read_bag(tmp_path / "runs" / "test" / "bags" / "ftcm"))
    assert (tmp_path / "runs" / "test" / "table.md").exists()


def test_a_disk_that_is_full_before_the_run_ends_it_before_the_first_tick(
    start: Start, small_disk: Path
) -> None:
    (small_disk / "test").mkdir()
    with pytest.raises(OSError, match="No space left"):
        (small_disk / "filler").write_bytes(bytes(10**7))
    process = start("nodes.recorder", "--ros-args", "-p", f"bag:={small_disk / 'test' / 'bag'}")
    out, err = process.communicate(timeout=60)
    assert process.returncode == 2
    assert "Traceback" not in out + err
    (line,) = [x for x in err.strip().splitlines() if "error" in x]
    assert f"bag '{small_disk / 'test' / 'bag'}' cannot be made: No space left on device" in line
    assert list((small_disk / "test").iterdir()) == []
