# SPDX-License-Identifier: Apache-2.0
"""Mean and percentiles of durations over a run of any length, in memory that does not grow with it."""

from __future__ import annotations

from array import array

import numpy as np
import numpy.typing as npt

FINE_NS, COARSE_NS = 1_000, 1_000_000
BINS = 10_000
"""Bins of 1 µs up to 10 ms, then as many of 1 ms; what is longer counts in the last."""


class Durations:
    """Durations in ns: those since the last report as they are, all of the run counted in bins."""

    def __init__(self) -> None:
        """None yet."""
        self._recent = array("q")
        self._counts = np.zeros(2 * BINS, dtype=np.int64)
        self._count = self._sum = self._largest = 0

    def add(self, ns: int) -> None:
        """Add one."""
        self._recent.append(ns)

    def recent(self, name: str) -> dict[str, float]:
        """Return the statistics of those since the last call, exact, as :func:`statistics` does."""
        recent, self._recent = self._recent, array("q")
        if not recent:
            return {}
        samples = np.frombuffer(recent.tobytes(), dtype=np.int64)  # a copy: a late value may still be added
        bins = np.where(samples < BINS * FINE_NS, samples // FINE_NS, BINS + samples // COARSE_NS)
        np.add.at(self._counts, bins.clip(0, 2 * BINS - 1), 1)
        self._count += len(samples)
        self._sum += int(samples.sum())
        self._largest = max(self._largest, int(samples.max()))
        return statistics(name, samples)

    def whole(self, name: str) -> dict[str, float]:
        """Return those of all: percentiles to 1 µs up to 10 ms and 1 ms beyond, the others exact."""
        self.recent(name)
        total = self._count
        if not total:
            return {}
        below = np.cumsum(self._counts)
        found = {
            label: int(np.searchsorted(below, min(total - 1, int(share * total)), side="right"))
            for label, share in SHARES.items()
        }
        return {
            f"{name}_mean_us": round(self._sum / total / 1000, 1),
            **{f"{name}_{label}_us": _start(i) / 1000 for label, i in found.items()},
            f"{name}_max_us": round(self._largest / 1000, 1),
        }


SHARES = {"p50": 0.5, "p99": 0.99, "p999": 0.999}


def statistics(name: str, samples: npt.ArrayLike) -> dict[str, float]:
    """Return mean, p50, p99, p99.9 and the largest of samples in ns, as µs; nothing without samples."""
    ordered = np.sort(np.asarray(samples, dtype=np.int64))
    count = len(ordered)
    if not count:
        return {}
    found = {
        f"{name}_{label}_us": round(int(ordered[min(count - 1, int(share * count))]) / 1000, 1)
        for label, share in SHARES.items()
    }
    mean = round(int(ordered.sum()) / count / 1000, 1)
    return {f"{name}_mean_us": mean, **found, f"{name}_max_us": round(int(ordered[-1]) / 1000, 1)}


def _start(index: int) -> int:
    return index * FINE_NS if index < BINS else (index - BINS) * COARSE_NS
