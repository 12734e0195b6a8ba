# SPDX-License-Identifier: Apache-2.0
"""What the benchmark drives is the loop itself."""

from __future__ import annotations

from typing import Any

from bench_core import loop_with
from ftcm_core.scenario import load
from ftcm_core.simulation import Loop


def test_other_forward_dynamics_are_used_and_nothing_else_changes() -> None:
    scenario = load("paper")
    calls = 0

    def step(*point: Any) -> Any:
        nonlocal calls
        calls += 1
        return scenario.robot.forward_dynamics(*point)

    loops = Loop(scenario), loop_with(scenario, step)
    rows: tuple[list[Any], list[Any]] = [], []
    for loop, into in zip(loops, rows):
        for k in range(20):
            loop.tick(k * scenario.dt_ns, False, into.append)
    assert rows[0] == rows[1]
    assert len(rows[0]) == 20
    assert calls == 4 * 20, "the four evaluations of each step"
