# SPDX-License-Identifier: Apache-2.0
"""Metrics: pure functions of a trace, one value per joint, over windows of it.

Every function takes the trace's rows of one window and returns an array of shape (joints,).
"""

from __future__ import annotations

import functools
from collections.abc import Callable
from typing import Any

import numpy as np

from ftcm_core.recording.detection import detection_scores
from ftcm_core.recording.trace import Array, Trace

SETTLING_BAND = 1e-3
"""Band of the settling time, rad (chosen: 0.06 deg)."""
HIGH_FREQUENCY = 50.0
"""Torque content above this counts as high-frequency, Hz (chosen: far above the motion)."""
STEADY_SHARE = 0.1
"""Share of a window, at its end, over which the steady-state error is taken (chosen)."""


WINDOWS = ("whole", "transient", "after_transient", "before_fault", "after_fault")
"""What :func:`windows` returns the rows of."""


def windows(trace: Trace) -> dict[str, slice | None]:
    """Return the rows of each window; None where a run has no such window.

    ``whole``; ``transient``, the first seconds (the scenario says how many); ``after_transient``, the
    rest; ``before_fault``, from the transient's end to the first onset, or to the end without faults;
    ``after_fault``, from the first onset on.
    """
    scenario = trace.scenario
    last = trace.ticks

    def row(t: float) -> int:
        return int(np.searchsorted(trace.time_ns, min(t * 1e9, 2.0**62)))

    settled = row(scenario.transient if scenario else 1.0)
    intervals = trace.fault_intervals
    fault = row(intervals[0].onset) if intervals else last
    found = {
        "whole": slice(0, last),
        "transient": slice(0, settled),
        "after_transient": slice(settled, last),
        "before_fault": slice(min(settled, fault), fault),
        "after_fault": slice(fault, last),
    }
    return {name: s if s.stop - s.start >= 2 else None for name, s in found.items()}


def mean_abs_error(trace: Trace, rows: slice) -> Array:
    """Mean of |e|, rad: the "average control error" of Table 2."""
    return _mean(trace, np.abs(trace.error[rows]))


def rms_error(trace: Trace, rows: slice) -> Array:
    """Root mean square of e, rad."""
    return np.asarray(np.sqrt(_mean(trace, trace.error[rows] ** 2)))


def max_abs_error(trace: Trace, rows: slice) -> Array:
    """Largest |e|, rad."""
    return _largest(np.abs(trace.error[rows]))


def iae(trace: Trace, rows: slice) -> Array:
    """Integral of |e|, rad·s."""
    return np.asarray(trace.sums(np.abs(trace.error[rows])) * trace.dt)


def ise(trace: Trace, rows: slice) -> Array:
    """Integral of e², rad²·s."""
    return np.asarray(trace.sums(trace.error[rows] ** 2) * trace.dt)


def itae(trace: Trace, rows: slice) -> Array:
    """Integral of (time since the window's begin) times |e|, rad·s²."""
    t = trace.time[rows] - trace.time[rows][0]
    return np.asarray(t @ np.abs(trace.error[rows]) * trace.dt)


def settling_time(trace: Trace, rows: slice, band: float = SETTLING_BAND) -> Array:
    """Time from the window's begin until |e| stays within the band, s; NaN if it does not."""
    outside = ~(np.abs(trace.error[rows]) <= band)
    last = np.array([np.flatnonzero(column)[-1] + 1 if column.any() else 0 for column in outside.T])
    return np.where(last < len(outside), last * trace.dt, np.nan)


def steady_state_error(trace: Trace, rows: slice) -> Array:
    """Mean of |e| over the last tenth of the window, rad."""
    count = max(1, int((rows.stop - rows.start) * STEADY_SHARE))
    return _mean(trace, np.abs(trace.error[rows][-count:]))


def torque_rms(trace: Trace, rows: slice) -> Array:
    """Root mean square of the commanded torque, N·m."""
    return np.asarray(np.sqrt(_mean(trace, trace.command[rows] ** 2)))


def torque_peak(trace: Trace, rows: slice) -> Array:
    """Largest |u| of the commanded torque, N·m."""
    return _largest(np.abs(trace.command[rows]))


def torque_total_variation(trace: Trace, rows: slice) -> Array:
    """Sum of |u_{k+1} - u_k| per second, N·m/s: a measure of chattering."""
    u = trace.command[rows]
    return np.asarray(trace.sums(np.abs(np.diff(u, axis=0))) / ((len(u) - 1) * trace.dt))


def torque_high_frequency_rms(trace: Trace, rows: slice) -> Array:
    """Root mean square of the commanded torque's content above 50 Hz, N·m (Hann window, mean removed).

    Zeros are added up to a length that is transformed fast.
    """
    u = trace.command[rows]
    taper, energy = _hann(len(u))
    columns = np.ascontiguousarray(u.T) - _mean(trace, u)[:, None]
    n = _fast_length(len(u))
    power = np.abs(np.fft.rfft(columns * taper, n, axis=1)) ** 2
    if n % 2 == 0:
        power[:, -1] /= 2.0  # the Nyquist line stands for itself alone, all others for two
    high = power[:, np.fft.rfftfreq(n, trace.dt) > HIGH_FREQUENCY]
    return np.asarray(np.sqrt(2.0 * trace.sums(np.ascontiguousarray(high.T)) / n / energy))


def saturation_share(trace: Trace, rows: slice) -> Array:
    """Share of ticks at which the command is at or beyond the torque limit; 0 without limits."""
    limits = trace.scenario.limits.torque if trace.scenario else None
    if limits is None:
        return np.zeros(trace.command.shape[1])
    columns = np.abs(trace.command[rows]).T
    shares = [np.count_nonzero(u >= limit) / len(u) for u, limit in zip(columns, limits)]
    return np.where([np.isnan(u).any() for u in columns], np.nan, shares)


def observer_rms_error(trace: Trace, rows: slice) -> Array:
    """Root mean square of the observer's error Δ - Δ̂, rad/s²."""
    return np.asarray(np.sqrt(_mean(trace, trace.observer_error[rows] ** 2)))


def observer_max_error(trace: Trace, rows: slice) -> Array:
    """Largest |Δ - Δ̂|, rad/s²."""
    return _largest(np.abs(trace.observer_error[rows]))


def _mean(trace: Trace, values: Array) -> Array:
    """Mean over the rows."""
    return np.asarray(trace.sums(values) / len(values))


def _largest(values: Array) -> Array:
    """Largest value of each column, NaN if there is one; of many rows side by side, which is faster."""
    rows, joints = values.shape
    whole = rows - rows % _BESIDE
    found = [row for row in (values[:whole].reshape(-1, _BESIDE * joints), values[whole:]) if len(row)]
    return np.asarray(np.max(np.vstack([np.max(x, axis=0).reshape(-1, joints) for x in found]), axis=0))


_BESIDE = 128
"""So many rows :func:`_largest` looks at side by side (chosen: the fastest of powers of two)."""


@functools.lru_cache(maxsize=len(WINDOWS) + 1)
def _hann(n: int) -> tuple[Array, float]:
    """Hann window of n values, and the sum of its squares."""
    taper = 0.5 - 0.5 * np.cos(2.0 * np.pi * np.arange(n) / n)
    return taper, np.sum(taper**2)


@functools.lru_cache(maxsize=len(WINDOWS) + 1)
def _fast_length(n: int) -> int:
    """Smallest length of at least n without prime factors beyond 5."""
    products: list[int] = [5**a * 3**b for a in range(n.bit_length()) for b in range(n.bit_length())]
    return min(odd << max(0, (-(-n // odd) - 1).bit_length()) for odd in products)


METRICS: dict[str, tuple[Callable[[Trace, slice], Array], str]] = {
    "mean_abs_error": (mean_abs_error, "rad"),
    "rms_error": (rms_error, "rad"),
    "max_abs_error": (max_abs_error, "rad"),
    "iae": (iae, "rad·s"),
    "ise": (ise, "rad²·s"),
    "itae": (itae, "rad·s²"),
    "settling_time": (settling_time, "s"),
    "steady_state_error": (steady_state_error, "rad"),
    "torque_rms": (torque_rms, "N·m"),
    "torque_peak": (torque_peak, "N·m"),
    "torque_total_variation": (torque_total_variation, "N·m/s"),
    "torque_high_frequency_rms": (torque_high_frequency_rms, "N·m"),
    "saturation_share": (saturation_share, "-"),
    "observer_rms_error": (observer_rms_error, "rad/s²"),
    "observer_max_error": (observer_max_error, "rad/s²"),
}
"""Every metric and its unit, in the order of reports."""


def evaluate(trace: Trace) -> dict[str, dict[str, list[float | None]] | None]:
    """Return window -> metric -> one value per joint; None for what a run does not have."""
    found: dict[str, dict[str, list[float | None]] | None] = {}
    for name, rows in windows(trace).items():
        if rows is None:
            found[name] = None
            continue
        with np.errstate(over="ignore", invalid="ignore"):
            found[name] = {
                metric: _finite(function(trace, rows)) for metric, (function, _) in METRICS.items()
            }
    return found


def result(trace: Trace) -> dict[str, Any]:
    """Return a run's result for programs: what ran, how it ended, its metrics, scores of its detector.

    ``settling_time_bound`` (eq 15, or the law's own) is the controller's bound from the initial error, per
    joint, beside the measured ``metrics.whole.settling_time``; null for a law without one.
    """
    scenario = trace.scenario
    law = scenario.controller if scenario else None
    first = trace.command[0] if trace.ticks else np.full(len(trace.joint_names), np.nan)
    bounds: list[float | None] = [None] * len(trace.joint_names)
    if law is not None and trace.ticks:
        bounds = [law.settling_time_bound(abs(e), j) for j, e in enumerate(trace.error[0].tolist())]
    return {
        "scenario": scenario.name if scenario else None,
        "controller": law.type_name if law else None,
        "observer": scenario.observer.type_name if scenario else None,
        "status": trace.status,
        "detail": trace.detail,
        "ended_at": trace.ended_at,
        "ticks": trace.ticks,
        "first_torque": _finite(first),
        "settling_time_bound": _finite(np.array(bounds, dtype=np.float64)),
        "metrics": evaluate(trace),
        "detection": detection_scores(trace),
        "changes": [
            {"tick": c.tick, "kind": c.kind, "by": c.by, **c.component.to_mapping()} for c in trace.changes
        ],
        "decisions": [{**d._asdict(), "policy": scenario.policy_labels[d.number]} for d in trace.decisions]
        if scenario
        else [],
        "configuration": scenario.to_mapping() if scenario else None,
    }


def _finite(values: Array) -> list[float | None]:
    return [float(x) if np.isfinite(x) else None for x in values]
