# SPDX-License-Identifier: Apache-2.0
"""Which drawn value the error of a contender follows: Spearman's rank correlation over the runs there are.

1: the larger the value, the larger the error, in every pair of runs; -1: the smaller; 0: neither, or both, as
with an error that swings with the value. A run that did not complete has the largest error of all, so it
counts. Intervals of 95 % are by the bootstrap (percentile method): resamples of the draws, ranked anew.
Needs scipy (extra ``statistics``).
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from typing import Any, NamedTuple

import numpy as np

from ftcm_core.campaign.intervals import CONFIDENCE
from ftcm_core.extras import need
from ftcm_core.recording.trace import Array

FEWEST = 10
"""Draws without which nothing is said (chosen)."""
MOST = 2048
"""So many draws are looked at, the first ones (chosen: beyond, an interval is narrower than 0.09)."""
RESAMPLES = 1000
_AT_A_TIME = 100


class Correlation(NamedTuple):
    """How an error follows a drawn value; all in [-1, 1], without unit."""

    value: float
    """Spearman's rank correlation."""
    low: float
    """Ends of its bootstrap interval of 95 %."""
    high: float


def drawn_numbers(vary: Iterable[str], results: Iterable[Mapping[str, Any]]) -> dict[str, dict[int, float]]:
    """Return what was drawn: path, to number of the run, to value; without paths whose values have no order.

    Args:
        vary: paths.
        results: lines of ``runs.jsonl``.
    """
    found: dict[str, dict[int, float]] = {path: {} for path in vary}
    for one in results:
        texts = dict(text.partition("=")[::2] for text in one["set"])
        for path, values in found.items():
            if one["run"] not in values:
                values[one["run"]] = _number(texts[path])
    return {path: values for path, values in found.items() if all(map(math.isfinite, values.values()))}


def _number(text: str) -> float:
    """A drawn number; NaN for something else."""
    try:
        return float(text)
    except ValueError:
        return math.nan


def correlations(
    drawn: Mapping[str, Mapping[int, float]], errors: Mapping[str, Mapping[int, float]]
) -> dict[str, dict[str, Correlation | None]]:
    """Correlate the errors of contenders with what was drawn.

    Args:
        drawn: path, to number of the run, to value.
        errors: contender, to number of the run, to error; of a run that is not there, infinite.

    Returns:
        Contender, to path; None where one of both is the same in every run. Empty for fewer than
        :data:`FEWEST` draws.

    Raises:
        FtcmError: scipy is not installed.
    """
    need("scipy", "statistics", "sensitivity")
    from scipy.stats import rankdata, spearmanr

    numbers = sorted({n for values in drawn.values() for n in values})[:MOST]
    if len(numbers) < FEWEST:
        return {}
    x = np.array([[values[n] for n in numbers] for values in drawn.values()])
    y = np.array([[own.get(n, math.inf) for n in numbers] for own in errors.values()])
    random, parts = np.random.default_rng(0), []
    for _ in range(RESAMPLES // _AT_A_TIME):
        chosen = random.integers(len(numbers), size=(_AT_A_TIME, len(numbers)))
        a, b = (_standard(rankdata(rows[:, chosen], axis=-1)) for rows in (x, y))
        parts.append(np.einsum("pbn,cbn->cpb", a, b))
    tail = 0.5 * (1.0 - CONFIDENCE)
    low, high = np.quantile(np.concatenate(parts, axis=-1), [tail, 1.0 - tail], axis=-1)
    return {
        name: {
            path: Correlation(float(spearmanr(x[p], y[c]).statistic), float(low[c, p]), float(high[c, p]))
            if len(set(x[p])) > 1 and len(set(y[c])) > 1
            else None
            for p, path in enumerate(drawn)
        }
        for c, name in enumerate(errors)
    }


def _standard(ranks: Array) -> Array:
    """Ranks less their mean, of length 1; zero where all are equal: a resample without information."""
    centred = ranks - ranks.mean(axis=-1, keepdims=True)
    length = np.linalg.norm(centred, axis=-1, keepdims=True)
    return np.divide(centred, length, out=np.zeros_like(centred), where=length > 0.0)
