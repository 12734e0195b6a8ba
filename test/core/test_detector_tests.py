# SPDX-License-Identifier: Apache-2.0
"""The tests of residuals by their formulas: delays, and sizes found at the same rate of false alarms."""

from __future__ import annotations

import numpy as np
import pytest

from ftcm_core.detectors.adaptive_threshold import AdaptiveThreshold
from ftcm_core.detectors.cusum import Cusum
from ftcm_core.detectors.glr import GLR
from ftcm_core.detectors.residual_detector import ResidualDetector
from ftcm_core.detectors.residual_threshold import ResidualThreshold
from ftcm_core.robots.puma560 import Puma560
from ftcm_core.signals import Measurement, Vector

ROBOT, DT, ZERO = Puma560(), 1e-3, (0.0, 0.0, 0.0)


def alarms(
    detector: ResidualDetector, residuals: np.ndarray, velocity: Vector = ZERO, u: Vector = ZERO
) -> np.ndarray:
    """Alarms of residuals of shape (ticks, 3); the residual is the estimate."""
    state, found = detector.init(3), []
    y = Measurement(ZERO, velocity, ZERO)
    for r in residuals.tolist():
        seen, state = detector.step(ROBOT, DT, y, u, tuple(r), state)
        found.append(seen.alarm)
    return np.array(found)


def statistics(detector: ResidualDetector, residuals: np.ndarray) -> np.ndarray:
    """The statistic of a single joint, tick by tick."""
    memory, found = detector.memory(), []
    for r in residuals.tolist():
        g, memory = detector.statistic(detector, DT, r, 0.0, 0.0, memory)
        found.append(g)
    return np.array(found)


@pytest.mark.parametrize("size", [7.0, -9.0, 25.0])
def test_cusum_finds_a_step_after_the_time_of_the_formula(size: float) -> None:
    """The first tick for which ticks · (|A| - drift) dt exceeds the threshold, for either sign."""
    threshold, drift, onset = 0.1003, 5.0, 50
    found = alarms(
        Cusum(threshold=threshold, drift=drift),
        np.where(np.arange(400) < onset, 0.0, size)[:, None] * [1, 1, 0],
    )
    ticks = int(np.argmax(found[:, 0])) - onset + 1
    assert ticks == int(threshold / ((abs(size) - drift) * DT)) + 1
    assert found[onset + ticks - 1 :, 0].all()
    assert np.array_equal(found[:, 0], found[:, 1])
    assert not found[:, 2].any()


def test_cusum_forgets_what_is_below_its_drift_and_ends_its_alarm() -> None:
    """4.9 for ever is no alarm; after a long fault the alarm ends within threshold / drift."""
    detector = Cusum(threshold=0.1, drift=5.0)
    assert not alarms(detector, np.full((2000, 3), 4.9)).any()
    found = alarms(detector, np.where(np.arange(1200) < 1000, 50.0, 0.0)[:, None] * [1, 1, 1])[:, 0]
    assert found[999]
    assert 1000 + 18 <= int(np.argmin(found[1000:])) + 1000 <= 1000 + 21


def test_glr_is_the_largest_ratio_over_all_jumps_in_the_window() -> None:
    """Against the formula, written with arrays; a constant residual A gives A² N / (2 σ²) after N ticks."""
    r = np.random.default_rng(1).normal(size=200)
    detector = GLR(sigma=1.3, window=20)
    found = statistics(detector, r)
    for k in (0, 5, 19, 20, 150):
        sums = np.cumsum(r[max(0, k - 19) : k + 1][::-1])
        assert found[k] == pytest.approx(np.max(sums**2 / np.arange(1, len(sums) + 1)) / (2 * 1.3**2))
    assert statistics(detector, np.full(40, 0.5))[-1] == pytest.approx(0.25 * 20 / (2 * 1.3**2))


def test_glr_finds_a_smaller_step_than_the_threshold_at_the_same_rate_of_false_alarms() -> None:
    """White noise of deviation 1, thresholds that 10 of 20,000 ticks exceed. A step of σ lasts 30 ticks.

    The fixed threshold is then 3.5 σ, and a step of σ passes it with 1 - (1 - 0.0065)^30 = 18 %. GLR has seen
    30 σ²/2 at the end of the step, against a threshold of 8 to 9.
    """
    rng = np.random.default_rng(2)
    glr, fixed = GLR(sigma=1.0, window=30), ResidualThreshold(hold=0.0)
    noise = rng.normal(size=20_000)
    levels = [np.sort(statistics(d, noise))[-11] for d in (glr, fixed)]
    caught = [0, 0]
    for _ in range(200):
        r = rng.normal(size=60)
        r[30:] += 1.0
        for i, detector in enumerate((glr, fixed)):
            caught[i] += bool((statistics(detector, r)[30:] > levels[i]).any())
    assert caught[0] > 0.85 * 200
    assert caught[1] == pytest.approx(0.18 * 200, abs=3.0 * (200 * 0.18 * 0.82) ** 0.5)


def test_the_adaptive_threshold_grows_with_speed_and_torque() -> None:
    """2 + 3 |v| + 0.1 |u|: just below it nothing, just above an alarm; each joint by itself."""
    detector = AdaptiveThreshold(threshold=2.0, per_speed=3.0, per_torque=0.1, hold=0.0)
    v, u = (0.0, -1.0, 2.0), (0.0, 30.0, -50.0)
    limits = np.array([2.0, 8.0, 13.0])
    assert not alarms(detector, -0.999 * limits[None, :], v, u).any()
    assert alarms(detector, -1.001 * limits[None, :], v, u).all()
    one = limits * [1.001, 0.999, 0.999]
    assert alarms(detector, one[None, :], v, u).tolist() == [[1.0, 0.0, 0.0]]


def test_a_window_of_another_length_starts_afresh() -> None:
    """Its state has another structure."""
    assert GLR(window=5).continues(GLR(window=5, sigma=9.0))
    assert not GLR(window=5).continues(GLR(window=6))
    assert not GLR().continues(Cusum())
