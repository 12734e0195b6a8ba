# SPDX-License-Identifier: Apache-2.0
"""Experiments side by side on one machine, each in a ROS domain of its own."""

from __future__ import annotations

import os
import subprocess
from collections.abc import Callable
from pathlib import Path

import pytest

pytest.importorskip("rclpy", reason="ROS 2 (rclpy) is not installed")

from ftcm_core.scenario import load
from ftcm_core.simulation import simulate
from ftcm_ros.bags.reader import read_bag
from traces import same

pytestmark = [pytest.mark.ros, pytest.mark.alone]

COUNT = int(os.environ.get("FTCM_PARALLEL", "10"))
CEILING = 280.0


@pytest.mark.slow
def test_experiments_in_parallel_domains_do_not_touch_each_other(
    start: Callable[..., subprocess.Popen[str]], tmp_path: Path
) -> None:
    """Every run differs from the others, so that a message gone astray would show."""
    overrides = {
        f"run{i}": ["duration=0.8", f"seed={i}", f"injection.faults.0.start={0.1 + 0.05 * i}"]
        for i in range(COUNT)
    }
    overrides = {n: [*o, "sensor={type: encoder, noise: 1e-5}"] for n, o in overrides.items()}
    started = {
        name: start(
            "experiment", "paper", "--controllers", "ftcm", "--name", name, "--no-figures",
            *(a for o in chosen for a in ("--set", o)),
        )
        for name, chosen in overrides.items()
    }  # fmt: skip
    for name, process in started.items():
        _, err = process.communicate(timeout=CEILING)
        assert process.returncode == 0, f"{name}: {err}"
    for name, chosen in overrides.items():
        bag = read_bag(tmp_path / "runs" / name / "bags" / "ftcm")
        again = simulate(load("paper", chosen, controller="ftcm"))
        assert bag.missing == {}
        assert bag.trace.ticks == again.ticks == 801
        assert same(bag.trace, again)
