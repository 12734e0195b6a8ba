# SPDX-License-Identifier: Apache-2.0
"""Scores of fault detection against ground truth: pure functions of a trace, and of the scores of many.

What counts as what:

- An alarm *begins* in a tick in which a joint has one that had none in the tick before.
- A fault is *detected* if an alarm of any joint begins while it acts; the delay is from its onset to the
  first such alarm. An alarm that was on before does not count. Of faults that act at once, each is credited.
- An alarm that begins while no fault acts is *false*, also one that comes just after a fault has ended. Those
  of the scenario's transient, in which a healthy run is far from its reference, are counted apart.
- The *exposure* is the time after the transient in which no fault acts.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

from ftcm_core.detectors import VERDICTS
from ftcm_core.recording.trace import Trace

Flags = npt.NDArray[np.bool_]

HOUR = 3600.0
"""s"""


def alarms(trace: Trace) -> Flags | None:
    """Return which joints have an alarm, shape (ticks, joints); a missing tick is as the one before.

    None for a run without a detector.
    """
    if trace.alarm is None:
        return None
    known = ~np.isnan(trace.alarm)
    if known.all():
        return trace.alarm > 0.5
    rows = np.where(known, np.arange(trace.ticks)[:, None], 0)
    last = np.maximum.accumulate(rows, axis=0)
    return np.take_along_axis(trace.alarm, last, axis=0) > 0.5


def beginnings(flags: Flags) -> Flags:
    """Return where an alarm begins, shape (ticks, joints)."""
    before = np.vstack([np.zeros_like(flags[:1]), flags[:-1]])
    return flags & ~before


def detection_scores(trace: Trace) -> dict[str, Any] | None:
    """Return the scores of a run; None without a detector or without the scenario, which has the truth.

    ``faults``: one entry per time that a fault acts: ``type``, ``joint`` (0: all), ``onset``, ``end``
    (null: does not end), ``detected``, ``delay`` (s; null if missed), ``alarm_joints`` (numbers of the
    joints of the first alarm), ``alarm_before`` (an alarm was on at the onset), ``verdict`` and
    ``verdict_joint`` (what was said most of the time). ``false_alarms``: how many joints' alarms are false;
    ``exposure``, s; ``false_alarms_per_hour`` (null without exposure); ``false_share``, the share of the
    exposure with an alarm; ``transient_alarms``, those that begin in the transient while no fault acts.
    """
    flags, scenario = alarms(trace), trace.scenario
    if flags is None or scenario is None or scenario.detector is None:
        return None
    time, begun = trace.time, beginnings(flags)
    healthy = np.ones(trace.ticks, dtype=bool)
    faults = []
    for number, onset, end in trace.fault_intervals:
        acts = (time > onset) & (time <= end)
        healthy &= ~acts
        if not acts.any():
            continue
        fault, first = scenario.faults[number], int(np.argmax(acts))
        hits = np.flatnonzero(acts & begun.any(axis=1))
        at = int(hits[0]) if len(hits) else None
        faults.append(
            {
                "type": fault.type_name,
                "joint": getattr(fault, "joint", 0),
                "onset": onset,
                "end": end if end <= time[-1] else None,
                "detected": at is not None,
                "delay": None if at is None else float(time[at] - onset),
                "alarm_joints": [] if at is None else [int(j) + 1 for j in np.flatnonzero(begun[at])],
                "alarm_before": bool(first and flags[first - 1].any()),
                **_verdict(trace, acts),
            }
        )
    settled = healthy & (time >= scenario.transient)
    exposure = float(np.count_nonzero(settled)) * trace.dt
    false = int(np.count_nonzero(begun[settled]))
    return {
        "detector": scenario.detector.type_name,
        "faults": faults,
        "false_alarms": false,
        "exposure": exposure,
        "false_alarms_per_hour": false / exposure * HOUR if exposure else None,
        "false_share": float(np.mean(flags[settled].any(axis=1))) if exposure else None,
        "transient_alarms": int(np.count_nonzero(begun[healthy & ~settled])),
    }


def _verdict(trace: Trace, rows: Flags) -> dict[str, Any]:
    """What a detector said most of the time in some rows, and of which joint."""
    if trace.verdict is None:
        return {"verdict": None, "verdict_joint": None}
    said = trace.verdict[rows]
    counts = np.array([np.count_nonzero(said == code, axis=0) for code in range(len(VERDICTS))])
    code = 0
    for first in (2, 1):  # what can be told goes before `unknown`, and that before nothing
        if counts[first:].any():
            code = first + int(np.argmax(counts[first:].max(axis=1)))
            break
    joint = int(np.argmax(counts[code])) + 1 if code else None
    return {"verdict": VERDICTS[code], "verdict_joint": joint}


def pooled_scores(scores: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    """Return the scores of many runs together.

    ``runs``, ``faults``, ``missed``, ``missed_rate`` (null without faults), ``delay_median`` and
    ``delay_q95`` (s, of the detected ones; null without), ``false_alarms``, ``exposure`` (s),
    ``false_alarms_per_hour`` and ``false_alarms_per_hour_95``, its interval of 95 % if false alarms come
    independently (Poisson).
    """
    faults = [fault for one in scores for fault in one["faults"]]
    delays = [f["delay"] for f in faults if f["detected"]]
    isolation: dict[str, dict[str, int]] = {}
    for fault in faults:
        row = isolation.setdefault(fault["type"], dict.fromkeys(VERDICTS, 0))
        if fault["verdict"] is not None:
            row[fault["verdict"]] += 1
    false, exposure = sum(s["false_alarms"] for s in scores), math.fsum(s["exposure"] for s in scores)
    interval = [x / exposure * HOUR for x in poisson_interval(false)] if exposure else None
    return {
        "runs": len(scores),
        "faults": len(faults),
        "missed": len(faults) - len(delays),
        "missed_rate": 1.0 - len(delays) / len(faults) if faults else None,
        "delay_median": float(np.quantile(delays, 0.5)) if delays else None,
        "delay_q95": float(np.quantile(delays, 0.95)) if delays else None,
        "false_alarms": false,
        "exposure": exposure,
        "false_alarms_per_hour": false / exposure * HOUR if exposure else None,
        "false_alarms_per_hour_95": interval,
        "isolation": isolation,
    }


def poisson_interval(count: int, confidence: float = 0.95) -> tuple[float, float]:
    """Exact interval of the expected number of independent events, of which ``count`` came (Garwood 1936).

    Args:
        count: number of events.
        confidence: probability that the interval has the expected number, at least.
    """
    tail = 0.5 * (1.0 - confidence)
    most = count + 10.0 * math.sqrt(count + 1.0) + 40.0
    lower = 0.0 if count == 0 else _root(lambda x: 1.0 - poisson_at_most(count - 1, x) - tail, most)
    return lower, _root(lambda x: tail - poisson_at_most(count, x), most)


def poisson_at_most(count: int, mean: float) -> float:
    """Probability of at most ``count`` events where ``mean`` are expected."""
    if mean == 0.0:
        return 1.0
    return math.fsum(math.exp(k * math.log(mean) - mean - math.lgamma(k + 1)) for k in range(count + 1))


def _root(rising: Callable[[float], float], most: float) -> float:
    """Where a rising function is zero, between 0 and ``most``."""
    low, high = 0.0, most
    for _ in range(100):
        middle = 0.5 * (low + high)
        low, high = (low, middle) if rising(middle) > 0.0 else (middle, high)
    return 0.5 * (low + high)
