# SPDX-License-Identifier: Apache-2.0
"""Confidence intervals of what a campaign estimates, from a finite number of runs."""

from __future__ import annotations

import functools
import math

import numpy as np
import numpy.typing as npt

from ftcm_core.recording.trace import Array

CONFIDENCE = 0.95
NORMAL_975 = 1.959963984540054
"""97.5 % quantile of the normal distribution."""
RESAMPLES = 10_000


def median_interval(values: Array) -> tuple[float, float] | None:
    """Bootstrap interval of the median, percentile method (Efron 1979), 95 %; None for under two values.

    Resamples of n values differ by the ranks that they have. Their middle ranks are drawn as such: those of n
    uniform numbers, whose m-th is beta-distributed. So 10,000 resamples cost no more for a million values
    than for ten, and are the same ones for every metric.

    Args:
        values: shape (n,), finite.
    """
    if len(values) < 2:
        return None
    low, high = _middle_ranks(len(values))
    ordered = np.sort(values)
    medians = 0.5 * (ordered[low] + ordered[high])
    tail = 0.5 * (1.0 - CONFIDENCE)
    return float(np.quantile(medians, tail)), float(np.quantile(medians, 1.0 - tail))


@functools.lru_cache(maxsize=16)
def _middle_ranks(n: int) -> tuple[npt.NDArray[np.intp], npt.NDArray[np.intp]]:
    """Ranks, from 0, of the two middle values of each resample of n; of an odd number they are one."""
    draw, m = np.random.default_rng(0), (n + 1) // 2
    first = draw.beta(m, n + 1 - m, RESAMPLES)
    second = first if n % 2 else first + (1.0 - first) * draw.beta(1, n - m, RESAMPLES)
    low, high = (np.minimum((n * x).astype(np.intp), n - 1) for x in (first, second))
    return low, high


def wilson_interval(successes: int, count: int) -> tuple[float, float]:
    """Interval of a probability, 95 %, of which so many of so many trials succeeded (Wilson 1927).

    Args:
        successes: from 0 to ``count``.
        count: at least 1.
    """
    z, share = NORMAL_975, successes / count
    middle = share + z * z / (2.0 * count)
    half = z * math.sqrt(share * (1.0 - share) / count + z * z / (4.0 * count * count))
    scale = 1.0 + z * z / count
    low = 0.0 if successes == 0 else (middle - half) / scale
    high = 1.0 if successes == count else (middle + half) / scale
    return low, high
