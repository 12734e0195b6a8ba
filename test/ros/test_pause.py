# SPDX-License-Identifier: Apache-2.0
"""A run that is paused, goes on tick by tick, and goes on; one that is slower than the clock."""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

pytest.importorskip("rclpy", reason="ROS 2 (rclpy) is not installed")

from std_srvs.srv import SetBool, Trigger

from ftcm_core.scenario import load
from ftcm_core.simulation import simulate
from ftcm_ros.bags.reader import read_bag
from traces import same

pytestmark = pytest.mark.ros

HELD_SECONDS = 4.5
"""Longer than what the watchdog waits for a tick: --patience 2, and its 1.5 s for reports."""


@pytest.mark.parametrize(
    ("mode", "nodes"),
    [
        ("lockstep", "--no-composed"),
        ("real_time", "--composed"),
        pytest.param("lockstep", "--composed", marks=pytest.mark.nightly),
        pytest.param("real_time", "--no-composed", marks=pytest.mark.nightly),
    ],
)
def test_a_run_is_paused_and_goes_on(
    live: Callable[..., Any], watcher: Any, tmp_path: Path, nodes: str, mode: str
) -> None:
    """Nobody is blamed for the ticks that do not come; in lockstep the run is that without a pause."""
    length = 10.0 if mode == "lockstep" else 4.0
    settings = [f"duration={length}", "injection.faults.0.start=2"]
    run = live(
        "paper", "--mode", mode, "--controllers", "ftcm", nodes, "--patience", "2",
        *(x for s in settings for x in ("--set", s)),
    )  # fmt: skip

    def pause(on: bool) -> tuple[bool, str]:
        answer = watcher.call(SetBool, "/plant/pause", SetBool.Request(data=on))
        return answer.success, answer.message

    def step() -> tuple[bool, str]:
        answer = watcher.call(Trigger, "/plant/step", Trigger.Request())
        return answer.success, answer.message

    def plant(key: str) -> str:
        return str(run.health.get("plant", {}).get(key, ""))

    run.until(lambda: int(plant("tick") or 0) > 300, "ticks")
    assert step() == (False, "the run is not paused; call ~/pause with data: true first")
    done, where = pause(True)
    assert done
    assert where.endswith(": paused")
    run.until(lambda: plant("paused") == "True", "paused")
    held = int(plant("tick"))
    assert f"paused in tick {held}" in plant("message")
    assert pause(True)[1].endswith("paused already")
    end = time.monotonic() + HELD_SECONDS
    run.until(lambda: time.monotonic() > end, "nobody is blamed")
    assert int(plant("tick")) == held
    assert watcher.set("plant", step_ticks=25) == [(True, "")]
    assert step()[0]
    run.until(lambda: int(plant("tick")) != held, "steps")
    run.until(lambda: int(plant("tick")) == held + 25, "25 ticks")
    assert plant("paused") == "True"
    assert pause(False)[0]
    run.end()
    bag = read_bag(tmp_path / "runs" / "test" / "bags" / "ftcm")
    assert bag.missing == {}
    assert bag.trace.status == "completed"
    assert bag.nodes["plant"]["pauses"] == "1"
    assert float(bag.nodes["plant"]["paused_seconds"]) > HELD_SECONDS
    if mode == "lockstep":
        assert same(bag.trace, simulate(load("paper", settings)))
    else:
        skipped = int(bag.nodes["plant"]["plant_overrun"])
        assert skipped < HELD_SECONDS / bag.trace.scenario.dt / 2, "a pause is no delay"


def test_real_time_at_half_the_speed(experiment: Callable[..., Any], tmp_path: Path) -> None:
    """The ticks come half as often, of the same length in the run."""
    run = experiment(
        "paper", "--mode", "real_time", "--controllers", "ftcm", "--speed", "0.5", "--set", "duration=2"
    )
    assert run.returncode == 0, run.stderr
    bag = read_bag(tmp_path / "runs" / "test" / "bags" / "ftcm")
    assert bag.trace.time[-1] == 2.0
    assert float(bag.nodes["plant"]["elapsed_seconds"]) > 3.99


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["--mode", "real_time", "--speed", "0"], "speed: 0 is out of range; expected a factor above 0"),
        (["--mode", "lockstep", "--speed", "2"], "speed: 2 is not possible with mode: lockstep"),
    ],
)
def test_a_speed_that_cannot_be_is_refused(
    experiment: Callable[..., Any], arguments: list[str], words: str
) -> None:
    run = experiment("paper", "--controllers", "ftcm", *arguments)
    assert run.returncode == 2, run.stderr
    assert words in run.stderr
    assert "Traceback" not in run.stderr
