# SPDX-License-Identifier: Apache-2.0
"""The benchmark of the graph measures every row and writes its page; what it measures is not judged here."""

from __future__ import annotations

import re
import subprocess
from collections.abc import Callable
from pathlib import Path

import pytest

pytest.importorskip("rclpy", reason="ROS 2 (rclpy) is not installed")
pytest.importorskip("matplotlib", reason="the figures of analyse need it")
pytest.importorskip("numba", reason="compiled stages are measured too")

pytestmark = pytest.mark.ros

ROWS = (
    "bare chain of four processes at 1 kHz",
    "lockstep, full graph, ticks/s",
    "ratio, pair by pair",
    "latency from measurement to disturbance at the plant",
    "start of the graph to its first tick",
    "lockstep, composed, with recorder, complete bags, ticks/s",
    "bare loop at 1 kHz",
    "real time, composed: missed",
    "real time, composed: latency",
    "real time, composed, compiled stages: processors",
    "real time, composed, SCHED_FIFO: missed",
    "real time, composed, one core kept busy: missed",
    "real time, composed at 4 kHz: missed",
    "real time, processes: missed",
    "real time, processes, SCHED_FIFO: missed",
    "real time, processes, one core kept busy: missed",
    "reading a bag of 40 s, 5 topics",
    "analyse: reading it, metrics and tables",
    "analyse --output: the same",
)


@pytest.mark.nightly
@pytest.mark.timeout(700)
def test_every_row_is_measured(start: Callable[..., subprocess.Popen[str]], tmp_path: Path) -> None:
    process = start("bench_graph.py", "--repetitions", "1", "--seconds", "1", "--output", "page.md")
    out, err = process.communicate(timeout=600)
    assert process.returncode == 0, err
    page = (tmp_path / "page.md").read_text()
    assert out.strip() in page
    assert "Written by `make bench ARGS='--repetitions 1 --seconds 1'`" in page
    table = [line.strip("|").split("|") for line in page.splitlines() if line.startswith("|")]
    assert {len(row) for row in table} == {3}
    for wanted in ROWS:
        (value,) = [row[1] for row in table if wanted in row[0]]
        assert re.search(r"\d", value), wanted
