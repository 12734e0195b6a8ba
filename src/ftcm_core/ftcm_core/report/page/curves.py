# SPDX-License-Identifier: Apache-2.0
"""The curves and the timeline of some runs, as data for the page."""

from __future__ import annotations

import base64
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from ftcm_core.detectors import VERDICTS
from ftcm_core.recording.detection import alarms, beginnings
from ftcm_core.recording.trace import ENDED_EARLY, Array, Trace
from ftcm_core.report.page.decimation import AFTER, BEFORE, Rows, intervals, kept

Run = tuple[str, Trace]

INTERVALS = 1500
"""Into so many intervals a run is divided: more than a panel has pixels."""
FEWEST = 200
POINTS = 350_000
"""So many points all curves have together, about; with more curves, intervals are longer (chosen: 4 MB)."""
EVENTS = 8
"""Near so many events of a run every tick is kept, or near fewer."""
CURVES = 9
"""Each joint of a run has so many, at most."""
BARS = 500
"""So many alarms of a run are shown at most; those that follow each other soonest are joined."""
_LARGEST = float(np.finfo(np.float32).max)


def encoded(values: npt.NDArray[Any], kind: str) -> str:
    """Return numbers as base64 of their bytes, little-endian: ``f4`` or ``u4``."""
    return base64.b64encode(values.astype(f"<{kind}").tobytes()).decode("ascii")


def single(values: Array) -> npt.NDArray[np.float32]:
    """Return values as they are drawn: in single precision, NaN where they are not finite."""
    finite = np.where(np.isfinite(values), np.clip(values, -_LARGEST, _LARGEST), np.nan)
    return finite.astype(np.float32)


def page_data(traces: Sequence[Run]) -> dict[str, Any]:
    """Return everything that the page draws of some runs.

    ``runs``: label, tick length (s), and whether it ended early. ``joints``: names. ``quantities``: title,
    unit, and one entry per curve with its run, joint, tick numbers and values. ``faults``: onset, end, label.
    ``rows``: the timeline. ``spans``: ranges of time worth a look. ``interval``: length of the
    intervals of which the smallest and the largest value are kept, s; 0 where every tick is.
    """
    with np.errstate(over="ignore", invalid="ignore"):  # runs that diverge may overflow
        return _page_data(traces)


def _page_data(traces: Sequence[Run]) -> dict[str, Any]:
    first = min((float(t.time[0]) for _, t in traces if t.ticks), default=0.0)
    last = max((float(t.time[-1]) for _, t in traces if t.ticks), default=1.0)
    joints = max((len(t.joint_names) for _, t in traces), default=1)
    each = POINTS // max(1, CURVES * sum(len(t.joint_names) for _, t in traces))
    count = max(FEWEST, min(INTERVALS, each // 2))
    near = max(2, min(EVENTS, each // (2 * (BEFORE + AFTER))))
    begins = [
        intervals(t.ticks, count, np.searchsorted(t.time, events(t)[:near]).tolist()) for _, t in traces
    ]
    longest = max((len(t.time) // count * t.dt for _, t in traces if t.ticks > 2 * count), default=0.0)
    return {
        "runs": [
            {
                "label": label,
                "dt": trace.dt,
                "first": float(trace.time[0]) if trace.ticks else 0.0,
                "status": trace.status,
                "ended": float(trace.time[-1]) if trace.ticks and trace.status in ENDED_EARLY else None,
            }
            for label, trace in traces
        ],
        "joints": [_joint(traces, j) for j in range(joints)],
        "quantities": _quantities(traces, begins),
        "faults": faults(traces),
        "rows": timeline(traces),
        "spans": _spans(traces, first, last),
        "first": first,
        "last": last,
        "interval": longest,
    }


def events(trace: Trace) -> list[float]:
    """Return the begin of a run and what happens in it, s: onsets and ends of faults, alarms, decisions."""
    if not trace.ticks:
        return []
    found = [t for x in trace.fault_intervals for t in (x.onset, x.end)]
    found += [d.tick * trace.dt for d in trace.decisions]
    found += [t for t in _first_alarms(trace) if t is not None]
    inside = [t for t in dict.fromkeys(found) if trace.time[0] < t <= trace.time[-1]]
    return [float(trace.time[0]), *sorted(inside)]


def faults(traces: Sequence[Run]) -> list[dict[str, Any]]:
    """Return when which fault acts: onset, end (null: does not end), label, and in which runs."""
    found: dict[tuple[float, float, str], list[int]] = {}
    for number, (_, trace) in enumerate(traces):
        if trace.scenario is None or not trace.ticks:
            continue
        for fault, onset, end in trace.fault_intervals:
            if onset < trace.time[-1]:
                found.setdefault((onset, end, trace.scenario.fault_labels[fault]), []).append(number)
    latest = max((float(t.time[-1]) for _, t in traces if t.ticks), default=0.0)
    return [
        {"onset": onset, "end": end if end < latest else None, "label": label, "runs": runs}
        for (onset, end, label), runs in sorted(found.items())
    ]


def timeline(traces: Sequence[Run]) -> list[dict[str, Any]]:
    """Return the rows of the timeline below the faults: of each run its alarms, decisions and changes."""
    rows: list[dict[str, Any]] = []
    for number, (label, trace) in enumerate(traces):
        flags = alarms(trace)
        if flags is not None:
            bars = [bar for joint in range(flags.shape[1]) for bar in _bars(trace, flags[:, joint], joint)]
            rows.append({"run": number, "name": f"{label}: alarms", "bars": bars, "marks": []})
        marks = []
        for d in trace.decisions:
            policy = trace.scenario.policy_labels[d.number] if trace.scenario else "policy"
            marks.append([d.tick * trace.dt, f"{policy}: joint {d.joint}, {d.verdict}"])
        for c in trace.changes:
            what = c.component.to_mapping()
            by = f" by {c.by}" if c.by else ""
            said = f"{what['action']} {what['number']}" if c.kind == "fault" else what["type"]
            marks.append([c.tick * trace.dt, f"{c.kind}: {said}{by}"])
        if marks:
            rows.append({"run": number, "name": f"{label}: decisions, changes", "bars": [], "marks": marks})
        if trace.status in ENDED_EARLY and trace.ticks:
            end = [[float(trace.time[-1]), trace.detail or trace.status]]
            about = {"run": number, "name": f"{label}: {trace.status}", "end": True}
            rows.append({**about, "bars": [], "marks": end})
    return rows


def _bars(trace: Trace, flags: npt.NDArray[np.bool_], joint: int) -> list[list[Any]]:
    """Begin and end of each alarm of a joint, s; at most :data:`BARS`, those closest together joined."""
    edges = np.diff(np.concatenate([[0], flags.astype(np.int8), [0]]))
    begins, ends = np.flatnonzero(edges == 1), np.flatnonzero(edges == -1) - 1
    if len(begins) > BARS:
        pauses = begins[1:] - ends[:-1]
        apart = np.sort(np.argsort(pauses, kind="stable")[len(pauses) - BARS + 1 :])
        begins, ends = np.append(begins[:1], begins[apart + 1]), np.append(ends[apart], ends[-1:])
    found = []
    for begin, end in zip(begins.tolist(), ends.tolist()):
        text = f"joint {joint + 1}"
        if trace.verdict is not None and np.isfinite(trace.verdict[end, joint]):
            text += f", {VERDICTS[int(trace.verdict[end, joint])]}"
        found.append([float(trace.time[begin]), float(trace.time[end]), text])
    return found


def _first_alarms(trace: Trace) -> list[float | None]:
    """When the first alarm begins after the onset of each fault, s."""
    flags = alarms(trace)
    if flags is None:
        return []
    begun = trace.time[beginnings(flags).any(axis=1)]
    after = [begun[begun > x.onset] for x in trace.fault_intervals]
    return [float(found[0]) if len(found) else None for found in after]


def _joint(traces: Sequence[Run], joint: int) -> str:
    return next(t.joint_names[joint] for _, t in traces if joint < len(t.joint_names))


def _spans(traces: Sequence[Run], first: float, last: float) -> list[list[Any]]:
    """Ranges of time that the page offers: name, begin, end."""
    found: list[list[Any]] = [["whole run", first, last]]
    settled = max((t.scenario.transient if t.scenario else 1.0 for _, t in traces), default=1.0)
    if first + settled < last:
        found.append(["start", first, first + settled])
        found.append(["after the start", first + settled, last])
    for fault in faults(traces)[:3]:
        near = 0.02 * (last - first)
        found.append(
            [fault["label"], max(first, fault["onset"] - near), min(last, fault["onset"] + 2.0 * near)]
        )
    return found


class _Quantity(NamedTuple):
    """What is drawn in a panel of each joint."""

    key: str
    title: str
    unit: str
    column: Callable[[Trace], Array | None]
    """What is drawn as a line."""
    dots: Callable[[Trace], Array | None] = lambda trace: None
    """What it is compared with."""


_QUANTITIES = (
    _Quantity("error", "Tracking error e = q − q_ref", "rad", lambda t: t.error),
    _Quantity("torque", "Torque command u", "N·m", lambda t: t.command),
    _Quantity(
        "uncertainty",
        "Lumped uncertainty Δ: estimated (lines) and true (dots)",
        "rad/s²",
        lambda t: t.lumped_uncertainty_estimate,
        lambda t: t.lumped_uncertainty,
    ),
    _Quantity("residual", "Residual of the detector", "N·m; of the motion, rad/s", lambda t: t.residual),
    _Quantity(
        "sliding", "Sliding variable σ", "rad/s; of nftsmc and its kin, rad", lambda t: t.sliding_variable
    ),
    _Quantity("velocity", "Velocity error", "rad/s", lambda t: t.velocity_error),
    _Quantity(
        "position",
        "Position q (lines) and reference (dots)",
        "rad",
        lambda t: t.position,
        lambda t: t.reference_position,
    ),
)


def _quantities(traces: Sequence[Run], begins: Sequence[Rows]) -> list[dict[str, Any]]:
    """Every quantity that some run has: name, title, unit, curves."""
    observed = [t for _, t in traces if t.scenario and t.scenario.controller.needs_observer]
    estimating = [id(t) for t in observed or [t for _, t in traces]]
    found = []
    for quantity in _QUANTITIES:
        curves = []
        for number, (_, trace) in enumerate(traces):
            if not trace.ticks or (quantity.key == "uncertainty" and id(trace) not in estimating):
                continue
            for dotted, values in ((True, quantity.dots(trace)), (False, quantity.column(trace))):
                if values is None:
                    continue
                for joint in range(values.shape[1]):
                    rows = kept(values[:, joint], begins[number])
                    if np.isfinite(values[rows, joint]).any():
                        curves.append(_curve(trace, values[:, joint], rows, number, joint, dotted))
        if curves:
            about = {"key": quantity.key, "title": quantity.title, "unit": quantity.unit}
            found.append({**about, "curves": curves})
    return found


def _curve(trace: Trace, values: Array, rows: Rows, run: int, joint: int, dotted: bool) -> dict[str, Any]:
    ticks = np.rint((trace.time_ns[rows] - trace.time_ns[0]) / (trace.dt * 1e9))
    return {
        "run": run,
        "joint": joint,
        "dotted": dotted,
        "ticks": encoded(ticks, "u4"),
        "values": encoded(single(values[rows]), "f4"),
    }
