# SPDX-License-Identifier: Apache-2.0
"""Node processes that are told to end at odd moments."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

pytest.importorskip("rclpy", reason="ROS 2 (rclpy) is not installed")

from ftcm_ros.bags.reader import read_bag
from ftcm_ros.parameters.node_parameters import NODES
from ftcm_ros.run.local_nodes import LocalNodes
from node_processes import node_pids

pytestmark = pytest.mark.ros


@pytest.mark.parametrize("delay", [0.0, 0.1, 0.3])
def test_nodes_ended_while_they_start_say_nothing(domain: int, tmp_path: Path, delay: float) -> None:
    """As when another node could not start."""
    nodes = LocalNodes(tmp_path, {})
    nodes.start({name: {"autostart": False} for name in NODES})
    time.sleep(delay)  # the parameter: when they are told; an import has no event to wait for
    codes = nodes.stop()
    assert {name: code for name, code in codes.items() if code not in (0, 130)} == {}
    assert {name: (tmp_path / f"{name}.log").read_text() for name in NODES} == dict.fromkeys(NODES, "")


def test_a_recorder_that_is_told_to_end_in_real_time(live: Callable[..., Any], tmp_path: Path) -> None:
    """It closes its bag at once, though messages still come, and the experiment says what happened."""
    run = live("paper", "--controllers", "ftcm", "--mode", "real_time", "--set", "duration=30")
    run.first_tick(("controller", "ftcm"), ("observer", "do"))
    process: subprocess.Popen[str] = run.process
    os.kill(node_pids(process.pid)["recorder"], signal.SIGTERM)
    _, err = process.communicate(timeout=60)
    assert process.returncode == 1
    (line,) = [line for line in err.splitlines() if line.startswith("experiment: error: ")]
    assert "node 'recorder' has ended as one that was told to (status 0); its last words: " in line
    bag = read_bag(tmp_path / "runs" / "test" / "bags" / "ftcm")
    assert bag.recovered == ""
    assert bag.trace.ticks > 100
    summary = json.loads((tmp_path / "runs" / "test" / "summary.json").read_text())
    assert summary["results"][0]["status"] == "incomplete"


@pytest.mark.parametrize("name", ["experiment", "nodes.plant", "nodes.composed"])
def test_a_middleware_that_is_not_there_is_one_line(
    start: Callable[..., subprocess.Popen[str]], monkeypatch: pytest.MonkeyPatch, name: str
) -> None:
    monkeypatch.setenv("RMW_IMPLEMENTATION", "rmw_nothing_cpp")
    process = start(name)
    out, err = process.communicate(timeout=60)
    assert (process.returncode, out) == (2, "")
    (line,) = err.splitlines()
    assert line.startswith("ftcm_ros: error: RMW_IMPLEMENTATION=rmw_nothing_cpp: no such middleware here; ")
    assert "rmw_fastrtps_cpp" in line
