# SPDX-License-Identifier: Apache-2.0
"""Intervals and comparisons of a campaign, against published results and by simulation."""

import math

import numpy as np
import pytest

from ftcm_core.campaign import comparison
from ftcm_core.campaign.intervals import median_interval, wilson_interval

pytestmark = pytest.mark.pure

DEMSAR_RANKS = np.array(
    [
        (4, 3, 2, 1), (1, 2, 3, 4), (4, 1, 2, 3), (4, 1, 3, 2), (4, 2, 3, 1), (1, 2.5, 4, 2.5), (3, 2, 4, 1),
        (2.5, 2.5, 4, 1), (4, 3, 2, 1), (2.5, 2.5, 2.5, 2.5), (4, 2.5, 1, 2.5), (3, 2, 4, 1), (4, 1, 2, 3),
        (3, 1, 4, 2),
    ]
)  # fmt: skip
"""Demšar, Statistical comparisons of classifiers over multiple data sets, JMLR 7 (2006), Table 6."""
DEMSAR_DIFFERENCES = np.array(
    [0.005, -0.008, 0.017, 0.033, 0.006, -0.005, 0.007, 0.0, 0.063, 0.0, 0.022, 0.047, 0.009, 0.021]
)
"""The same, Table 2."""


def test_wilson_interval_of_8_in_10():
    assert wilson_interval(8, 10) == pytest.approx((0.490162, 0.943318), abs=1e-6)


@pytest.mark.parametrize(("successes", "count"), [(0, 10), (10, 10), (8, 10), (999, 1000), (1, 1)])
def test_wilson_interval_as_scipy_has_it(successes, count):
    stats = pytest.importorskip("scipy.stats", reason="scipy is not installed")
    expected = stats.binomtest(successes, count).proportion_ci(method="wilson")
    assert wilson_interval(successes, count) == pytest.approx(tuple(expected), abs=1e-12)


@pytest.mark.parametrize("n", [10, 25, 26])
def test_the_interval_has_the_median_as_often_as_it_says(n):
    """1,000 samples: the share that has it is known to 0.7 % (one standard deviation)."""
    draw = np.random.default_rng(n)
    hits = 0
    for _ in range(1000):
        low, high = median_interval(np.exp(draw.normal(size=n)))
        hits += low <= 1.0 <= high
    assert 0.925 <= hits / 1000 <= 0.975


@pytest.mark.parametrize("n", [9, 10, 101])
def test_the_interval_is_that_of_resampling(n):
    """Both resample 10,000 times: the ends agree to what is left to chance, a small part of the width."""
    stats = pytest.importorskip("scipy.stats", reason="scipy is not installed")
    values = np.random.default_rng(3).exponential(size=n)
    expected = stats.bootstrap(
        (values,), np.median, method="percentile", n_resamples=10_000
    ).confidence_interval
    width = expected.high - expected.low
    assert median_interval(values) == pytest.approx(tuple(expected), abs=0.1 * width)


def test_an_interval_needs_two_values_and_lies_within_them():
    assert median_interval(np.array([])) is None
    assert median_interval(np.array([1.0])) is None
    assert median_interval(np.array([1.0, 2.0])) == (1.0, 2.0)


def test_mean_ranks_of_demsar():
    found = comparison.mean_ranks(DEMSAR_RANKS)
    assert found["mean_ranks"] == pytest.approx([3.143, 2.000, 2.893, 1.964], abs=5e-4)
    pytest.importorskip("scipy", reason="scipy is not installed")
    # Demšar's χ² = 9.28 has p = 0.0258; what scipy corrects for ties makes it smaller.
    assert 0.01 < found["friedman_p"] < 0.0258


def test_critical_difference_of_demsar():
    pytest.importorskip("scipy", reason="scipy is not installed")
    assert comparison.critical_difference(4, 14) == pytest.approx(1.25, abs=5e-3)
    for k, q in ((2, 1.960), (3, 2.343), (5, 2.728), (10, 3.164)):  # his Table 5 (a)
        assert comparison.critical_difference(k, 50) == pytest.approx(
            q * math.sqrt(k * (k + 1) / 300.0), rel=5e-4
        )


def test_rank_biserial_by_hand():
    """Without the zeros: the ranks of -0.008 and -0.005 are 5 and 1.5, of 78 in all."""
    assert comparison.rank_biserial(DEMSAR_DIFFERENCES) == pytest.approx((71.5 - 6.5) / 78)
    assert comparison.rank_biserial(np.array([1.0, 2.0])) == 1.0
    assert comparison.rank_biserial(np.zeros(3)) == 0.0


def test_ranks_of_equal_values_are_their_mean():
    assert comparison.ranks(np.array([3.0, 1.0, 3.0, math.inf])).tolist() == [2.5, 1.0, 2.5, 4.0]


def test_holm_by_hand():
    assert comparison.holm([0.01, 0.04, None, 0.03, 0.005]) == pytest.approx([0.03, 0.06, None, 0.06, 0.02])
    assert comparison.holm([0.6, 0.9]) == [1.0, 1.0]


def test_a_pair_that_differs_by_a_factor():
    a = np.array([1.0, 2.0, 3.0, 5.0, 8.0, 13.0])
    found = comparison.paired(2.0 * a, a)
    assert found["ratio"] == pytest.approx(2.0)
    assert found["ratio_95"] == pytest.approx((2.0, 2.0))
    assert (found["difference"], found["rank_biserial"]) == (4.0, 1.0)
    pytest.importorskip("scipy", reason="scipy is not installed")
    assert found["p"] == pytest.approx(2 / 2**6), "exact: all six of one sign"


def test_values_that_are_not_positive_have_no_ratio():
    found = comparison.paired(np.array([0.0, 1.0, 2.0]), np.array([1.0, 1.0, 1.0]))
    assert (found["ratio"], found["ratio_95"]) == (None, None)
    assert found["difference"] == 0.0


def test_who_does_not_complete_is_ranked_last_and_not_paired():
    metric = ("after_fault", "mean_abs_error")
    kept = {
        "a": {metric: {0: (1.0,), 1: (1.0,)}},
        "b": {metric: {0: (2.0,), 1: (2.0,), 2: (2.0,)}},
        "c": {metric: {0: (3.0,)}},
    }
    found = comparison.comparisons(kept, 4)
    (ranked,) = found["ranking"]
    assert ranked["draws"] == 3, "nobody completed the fourth"
    # Ranks of a: 1, 1, 2.5 (with c, which did not complete either); of b: 2, 2, 1; of c: 3, 3, 2.5.
    assert ranked["joints"][0]["mean_ranks"] == pytest.approx([4.5 / 3, 5 / 3, 8.5 / 3])
    pairs = {tuple(p["contenders"]): p for p in found["comparisons"]}
    assert [pairs["a", "b"][k] for k in ("pairs", "only_first", "only_second")] == [2, 0, 1]
    assert [pairs["b", "c"][k] for k in ("pairs", "only_first", "only_second")] == [1, 2, 0]
    assert pairs["a", "b"]["joints"][0]["ratio"] == pytest.approx(0.5)
