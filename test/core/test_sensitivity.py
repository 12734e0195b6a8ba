# SPDX-License-Identifier: Apache-2.0
"""What the errors of a campaign follow: rank correlations with their intervals."""

import math

import numpy as np
import pytest

from ftcm_core.campaign.sensitivity import FEWEST, correlations, drawn_numbers

pytest.importorskip("scipy", reason="scipy is not installed")
pytestmark = pytest.mark.pure

N = 40
X = np.random.default_rng(1).uniform(0, 1, N)


def numbered(values):
    return dict(enumerate(np.asarray(values, dtype=float).tolist()))


def test_an_error_that_grows_or_shrinks_with_a_value_has_one_or_minus_one():
    errors = {"grows": numbered(np.exp(5 * X)), "shrinks": numbered(1 / (1 + X)), "stays": numbered(0 * X)}
    found = correlations({"x": numbered(X), "constant": numbered(0 * X)}, errors)
    assert found["grows"]["x"] == pytest.approx((1.0, 1.0, 1.0))
    assert found["shrinks"]["x"] == pytest.approx((-1.0, -1.0, -1.0))
    assert found["stays"]["x"] is None
    assert found["grows"]["constant"] is None


def test_a_run_that_did_not_complete_has_the_largest_error():
    errors = {n: 1.0 - x for n, x in numbered(X).items() if x < 0.5}
    (own,) = correlations({"x": numbered(X)}, {"law": errors}).values()
    known = correlations({"x": numbered(X)}, {"law": {n: errors.get(n, 1e9) for n in range(N)}})["law"]
    assert own == known
    assert own["x"].value > 0.0, "of those that completed it is -1"


def test_too_few_draws_say_nothing():
    few = numbered(X[: FEWEST - 1])
    assert correlations({"x": few}, {"law": few}) == {}


def test_the_interval_has_the_true_correlation_as_often_as_it_says():
    """Of two normal variables with correlation r, Spearman's is 6/π asin(r/2)."""
    r, samples = 0.6, 200
    random = np.random.default_rng(5)
    true = 6.0 / math.pi * math.asin(r / 2.0)
    hits = 0
    for _ in range(samples):
        a, b = random.standard_normal((2, N))
        one = correlations({"x": numbered(a)}, {"law": numbered(r * a + math.sqrt(1 - r * r) * b)})["law"][
            "x"
        ]
        hits += one.low <= true <= one.high
    three_deviations = 3.0 * math.sqrt(0.95 * 0.05 / samples)
    assert abs(hits / samples - 0.95) < three_deviations


def test_values_without_an_order_are_left_out():
    rows = [
        {"run": k, "set": ["a=9", "x.y=2", f"a={k}e-05", f"torque_limits={limits}"]}
        for k, limits in enumerate(("null", "[1, 2, 3]"))
        for _ in range(2)
    ]
    assert drawn_numbers(["a", "x.y", "torque_limits"], rows) == {
        "a": {0: 0.0, 1: 1e-05},
        "x.y": {0: 2.0, 1: 2.0},
    }
