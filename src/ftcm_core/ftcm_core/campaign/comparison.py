# SPDX-License-Identifier: Apache-2.0
"""Contenders compared over the same draws: differences in pairs, and ranks.

What has an interval or an effect size needs numpy only; probabilities of tests, and the critical difference
of the ranks, need scipy (extra ``statistics``) and are null without.

- *Ratio*: exp of the median of ln(a/b), with its bootstrap interval; null where a value is not positive.
  *Difference*: the median of a - b, likewise.
- *Effect size*: the matched-pairs rank-biserial correlation (Kerby 2014), from -1 (a below b in every
  draw) to 1, of the logarithms, or of the differences where there is no ratio.
- *Test*: Wilcoxon's signed-rank test of the same, two-sided; ``p_holm`` is corrected (Holm 1979) for all the
  comparisons of the campaign.
- *Ranks*: in each draw the contenders have the ranks 1 (smallest) to k; one that did not complete is behind
  all others. Friedman's test is of all having the same mean rank; mean ranks that differ by less than
  Nemenyi's critical difference are not told apart at 5 % (Demšar 2006).
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import numpy as np

from ftcm_core.campaign.intervals import median_interval
from ftcm_core.extras import has
from ftcm_core.recording.trace import Array

AT = " @ "
"""Between a contender's name and that of its scenario, where a campaign has several."""
Kept = Mapping[tuple[str, str], Mapping[int, Sequence[float]]]
"""Window and metric, to number of the run, to values per joint: the completed runs of a contender."""


def by_scenario(contenders: Iterable[str]) -> dict[str, list[str]]:
    """Return the contenders of each scenario; of a campaign with one, its name is empty."""
    found: dict[str, list[str]] = {}
    for name in contenders:
        found.setdefault(name.partition(AT)[2], []).append(name)
    return found


def comparisons(kept: Mapping[str, Kept], runs: int) -> dict[str, Any]:
    """Compare contenders: the parts ``comparisons`` and ``ranking`` of a summary.

    Those of one scenario are compared with each other.

    Args:
        kept: by contender.
        runs: number of draws.
    """
    metrics = [key for key in next(iter(kept.values())) if any(one[key] for one in kept.values())]
    fields = list(by_scenario(kept).values())
    pairs = [
        _pair(names, metric, *(kept[name][metric] for name in names))
        for metric in metrics
        for field in fields
        for names in itertools.combinations(field, 2)
    ]
    pairs = [pair for pair in pairs if pair["joints"]]
    tests = [joint for pair in pairs for joint in pair["joints"]]
    for joint, p in zip(tests, holm([joint["p"] for joint in tests])):
        joint["p_holm"] = p
    ranked = [
        ranking({name: kept[name] for name in field}, metric, runs)
        for metric in metrics
        for field in fields
        if len(field) > 1 and any(kept[name][metric] for name in field)
    ]
    return {"comparisons": pairs, "ranking": ranked}


def _pair(
    names: tuple[str, str],
    metric: tuple[str, str],
    first: Mapping[int, Sequence[float]],
    second: Mapping[int, Sequence[float]],
) -> dict[str, Any]:
    """Compare two contenders in one metric, joint by joint, over the draws that both completed."""
    both = sorted(set(first) & set(second))
    a, b = (np.array([one[number] for number in both]) for one in (first, second))
    joints = [paired(x, y) for x, y in zip(a.T, b.T)] if both else []
    return {
        "window": metric[0], "metric": metric[1], "contenders": list(names), "pairs": len(both),
        "only_first": len(set(first) - set(second)), "only_second": len(set(second) - set(first)),
        "joints": joints,
    }  # fmt: skip


def paired(a: Array, b: Array) -> dict[str, Any]:
    """Compare two contenders' values of one metric and joint, shape (draws,) each; smaller is better.

    Returns:
        ``ratio``, ``ratio_95``, ``difference``, ``difference_95``, ``rank_biserial``, ``p``.
    """
    known = np.isfinite(a) & np.isfinite(b)
    a, b = a[known], b[known]
    if not len(a):
        return dict.fromkeys(("ratio", "ratio_95", "difference", "difference_95", "rank_biserial", "p"))
    difference, logarithms = a - b, None
    if min(a.min(), b.min()) > 0.0:
        logarithms = np.log(a) - np.log(b)
    tested = difference if logarithms is None else logarithms
    interval = None if logarithms is None else median_interval(logarithms)
    return {
        "ratio": None if logarithms is None else math.exp(float(np.median(logarithms))),
        "ratio_95": interval and tuple(map(math.exp, interval)),
        "difference": float(np.median(difference)),
        "difference_95": median_interval(difference),
        "rank_biserial": rank_biserial(tested),
        "p": signed_rank_p(tested),
    }


def ranks(values: Array) -> Array:
    """Ranks from 1, of equal values their mean."""
    _, inverse, counts = np.unique(values, return_inverse=True, return_counts=True)
    last = np.cumsum(counts)
    means: Array = (last - 0.5 * (counts - 1))[inverse]
    return means


def rank_biserial(differences: Array) -> float:
    """Matched-pairs rank-biserial correlation: of the ranks of |d|, what is above zero less what is below.

    Zeros are left out; 0 if nothing else is there.
    """
    d = differences[differences != 0.0]
    weights = ranks(np.abs(d))
    return float(np.sum(weights * np.sign(d)) / np.sum(weights)) if len(d) else 0.0


def signed_rank_p(differences: Array) -> float | None:
    """Probability of Wilcoxon's signed-rank test, two-sided; 1 where all are zero, None without scipy."""
    if not np.any(differences):
        return 1.0
    if not has("scipy"):
        return None
    from scipy.stats import wilcoxon

    return float(wilcoxon(differences).pvalue)


def holm(probabilities: Sequence[float | None]) -> list[float | None]:
    """Correct the probabilities of several tests, so that an error among all is as likely as in one.

    Args:
        probabilities: None: no test, and not counted.
    """
    known = sorted((p, i) for i, p in enumerate(probabilities) if p is not None)
    found: list[float | None] = [None] * len(probabilities)
    largest = 0.0
    for place, (p, i) in enumerate(known):
        largest = max(largest, min(1.0, (len(known) - place) * p))
        found[i] = largest
    return found


def ranking(kept: Mapping[str, Kept], metric: tuple[str, str], runs: int) -> dict[str, Any]:
    """Rank contenders in one metric, joint by joint.

    Args:
        kept: by contender.
        metric: window and metric.
        runs: number of draws; those that nobody completed are left out, and one is not.
    """
    columns = [one[metric] for one in kept.values()]
    numbers = [n for n in range(runs) if any(n in column for column in columns)]
    joints = len(next(x for column in columns for x in column.values()))
    worst = (math.inf,) * joints
    table = np.array([[column.get(n, worst) for column in columns] for n in numbers])
    table = np.where(np.isfinite(table), table, math.inf)  # shape (draws, contenders, joints)
    return {
        "window": metric[0], "metric": metric[1], "draws": len(numbers), "contenders": list(kept),
        "critical_difference": critical_difference(len(kept), len(numbers)),
        "joints": [mean_ranks(table[:, :, joint]) for joint in range(joints)],
    }  # fmt: skip


def mean_ranks(table: Array) -> dict[str, Any]:
    """Mean rank of each contender and the probability of Friedman's test.

    Args:
        table: shape (draws, contenders); smaller is better.

    Returns:
        ``mean_ranks`` and ``friedman_p``, which is None for fewer than three contenders or without scipy.
    """
    means = np.mean([ranks(row) for row in table], axis=0)
    p = None
    if table.shape[1] >= 3 and len(table) >= 2 and has("scipy"):
        from scipy.stats import friedmanchisquare

        with np.errstate(invalid="ignore", divide="ignore"):  # all are equal
            p = float(friedmanchisquare(*table.T).pvalue)
    return {"mean_ranks": means.tolist(), "friedman_p": p if p is None or math.isfinite(p) else 1.0}


def critical_difference(contenders: int, draws: int) -> float | None:
    """Nemenyi's critical difference of mean ranks at 5 %: q √(k (k + 1) / (6 N)); None without scipy.

    Args:
        contenders: k, at least 2.
        draws: N.
    """
    if contenders < 2 or draws < 2 or not has("scipy"):
        return None
    from scipy.stats import studentized_range

    q = float(studentized_range.ppf(0.95, contenders, math.inf)) / math.sqrt(2.0)
    return q * math.sqrt(contenders * (contenders + 1) / (6.0 * draws))
