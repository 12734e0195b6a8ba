# SPDX-License-Identifier: Apache-2.0
"""Mean and percentiles of durations over a run of any length, in memory that does not grow with it."""

from __future__ import annotations

from array import array
from collections.abc import Sequence
from itertools import accumulate

FINE_NS, COARSE_NS = 1_000, 1_000_000
BINS = 10_000
"""Bins of 1 µs up to 10 ms, then as many of 1 ms; what is longer counts in the last."""


class Durations:
    """Durations in ns: those since the last report as they are, all of the run counted in bins."""

    def __init__(self) -> None:
        """None yet."""
        self._recent = array("q")
        self._counts = array("L", bytes(2 * BINS * array("L").itemsize))
        self._count = self._sum = self._largest = 0

    def add(self, ns: int) -> None:
        """Add one."""
        self._recent.append(ns)

    def recent(self, name: str) -> dict[str, float]:
        """Return the statistics of those since the last call, exact, as :func:`statistics` does."""
        recent, self._recent = self._recent, array("q")
        for ns in recent:
            self._counts[_bin(ns)] += 1
        self._count += len(recent)
        self._sum += sum(recent)
        self._largest = max(self._largest, *recent, 0)
        return statistics(name, recent)

    def whole(self, name: str) -> dict[str, float]:
        """Return those of all: percentiles to 1 µs up to 10 ms and 1 ms beyond, the others exact."""
        self.recent(name)
        total = self._count
        if not total:
            return {}
        found = {}
        for label, share in SHARES.items():
            rank = min(total - 1, int(share * total))
            found[label] = next(i for i, below in enumerate(accumulate(self._counts)) if below > rank)
        return {
            f"{name}_mean_us": round(self._sum / total / 1000, 1),
            **{f"{name}_{label}_us": _start(i) / 1000 for label, i in found.items()},
            f"{name}_max_us": round(self._largest / 1000, 1),
        }


SHARES = {"p50": 0.5, "p99": 0.99, "p999": 0.999}


def statistics(name: str, samples: Sequence[int]) -> dict[str, float]:
    """Return mean, p50, p99, p99.9 and the largest of samples in ns, as µs; nothing without samples."""
    if not samples:
        return {}
    ordered = sorted(samples)
    found = {
        f"{name}_{label}_us": round(ordered[min(len(ordered) - 1, int(share * len(ordered)))] / 1000, 1)
        for label, share in SHARES.items()
    }
    mean = round(sum(samples) / len(samples) / 1000, 1)
    return {f"{name}_mean_us": mean, **found, f"{name}_max_us": round(ordered[-1] / 1000, 1)}


def _bin(ns: int) -> int:
    if ns < BINS * FINE_NS:
        return max(0, ns // FINE_NS)
    return min(BINS + ns // COARSE_NS, 2 * BINS - 1)


def _start(index: int) -> int:
    return index * FINE_NS if index < BINS else (index - BINS) * COARSE_NS
