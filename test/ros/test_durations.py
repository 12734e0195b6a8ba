# SPDX-License-Identifier: Apache-2.0
"""Mean and percentiles in bounded memory, against the samples sorted."""

from __future__ import annotations

import random
import sys
from typing import Any

import pytest

from ftcm_ros.timing.durations import Durations, statistics


def size(durations: Durations) -> int:
    return sum(sys.getsizeof(v) for v in vars(durations).values())


def test_the_whole_run_to_a_microsecond_the_last_second_exactly() -> None:
    draw = random.Random(3)
    samples = [round(draw.lognormvariate(13.0, 0.5)) for _ in range(20_000)]  # around 440 µs
    durations = Durations()
    for i in range(0, len(samples), 1000):
        for ns in samples[i : i + 1000]:
            durations.add(ns)
        assert durations.recent("x") == statistics("x", samples[i : i + 1000])
    exact: dict[str, Any] = statistics("x", samples)
    found = durations.whole("x")
    assert found.keys() == exact.keys()
    assert found["x_max_us"] == exact["x_max_us"]
    assert found["x_mean_us"] == exact["x_mean_us"]
    for name, value in exact.items():
        assert found[name] == pytest.approx(value, abs=1.0)


def test_long_and_negative_ones_are_counted_too() -> None:
    durations = Durations()
    for ns in (-5_000, 12_300_000, 250_000_000, 99_000_000_000):
        durations.add(ns)
    assert durations.whole("x") == {
        "x_mean_us": 24_815_573.8,
        "x_p50_us": 250_000.0,
        "x_p99_us": 9_999_000.0,
        "x_p999_us": 9_999_000.0,
        "x_max_us": 99_000_000.0,
    }
    assert Durations().whole("x") == {}


def test_memory_does_not_grow_with_the_run() -> None:
    durations = Durations()
    sizes = []
    for second in range(100):
        for i in range(1000):
            durations.add(1000 * (second * 7919 + i * 31) % 20_000_000)
        durations.recent("x")
        sizes.append(size(durations))
    assert max(sizes) == sizes[0]
