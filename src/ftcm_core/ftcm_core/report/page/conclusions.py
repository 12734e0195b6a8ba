# SPDX-License-Identifier: Apache-2.0
"""What can be said of some runs in plain sentences. Each number in them is one of the results."""

from __future__ import annotations

import json
import math
from collections.abc import Sequence

from ftcm_core.recording.detection import pooled_scores
from ftcm_core.report.table import Result, large, pooled_text, run_name, status, values

EQUAL = 1.05
"""Means that differ by less than this factor are called about equal (chosen)."""
_SEVERAL = 4
"""So many runs, or scenarios, are named one by one."""
_OF_THE_RUN = ("name", "seed", "controller", "observer", "detector", "policies")
"""What may differ between runs whose tracking is compared."""


def conclusions(results: Sequence[Result], onsets: Sequence[float | None]) -> list[str]:
    """Return what the results say: completed or not, who tracked best, detection, accommodation.

    Args:
        results: objects of :func:`ftcm_core.recording.metrics.result`.
        onsets: when the first fault of each run set in, s; None without.
    """
    told = [completion(results)]
    groups: dict[str, list[int]] = {}
    for place, result in enumerate(results):
        groups.setdefault(_conditions(result), []).append(place)
    if len(groups) > _SEVERAL:
        told.append(
            f"The runs are of {len(groups)} different experiments; no law is ranked over all of them."
        )
    else:
        for places in groups.values():
            told += tracking([results[k] for k in places], onsets[places[0]])
    return [*told, *detection(results), *accommodation(results)]


def completion(results: Sequence[Result]) -> str:
    """Say whether every run completed."""
    failed = [f"{run_name(r)} {status(r).replace('_', ' ')}" for r in results if r["status"] != "completed"]
    if not failed:
        return "The run completed." if len(results) == 1 else f"All {len(results)} runs completed."
    return f"{len(failed)} of {len(results)} runs did not complete: {listed(failed)}."


def tracking(results: Sequence[Result], onset: float | None) -> list[str]:
    """Say which of some runs of the same experiment tracked best, and whose torque varied least.

    Args:
        results: runs whose conditions are the same.
        onset: of the first fault, s.
    """
    window = "after_transient" if onset is None else "after_fault"
    when = "After the transient" if onset is None else f"After {_first_fault(results)} at {onset:g} s"
    ranked = _ranked(results, window, "mean_abs_error")
    if not ranked:
        return []
    best, name = ranked[0]
    if len(results) == 1:
        text = f"{when} the mean |e| of {name} is {best:.3g} rad (mean of the joints)"
        before = _mean(results[0], "before_fault", "mean_abs_error")
        if onset is not None and before:
            text += f"; before it, {before:.3g} rad"
        return [f"{text}."]
    if len(ranked) == 1:
        return [f"{when} only {name} can be judged: mean |e| {best:.3g} rad (mean of the joints)."]
    equal = [other for mean, other in ranked[1:] if mean < EQUAL * best]
    if equal:
        text = f"{when} {listed([name, *equal])} tracked best, about equally: mean |e| {best:.3g} rad"
    else:
        text = f"{when} {name} tracked best: mean |e| {best:.3g} rad"
    rest = [
        f"{times(mean / best)} less than {other} ({mean:.3g} rad)"
        for mean, other in ranked[1 + len(equal) :][:_SEVERAL]
        if best
    ]
    text += " (mean of the joints)" + (f", {listed(rest)}" if rest else "")
    told = [f"{text}."]
    told += _better_joints(results, window, name)
    moved = _ranked(results, "after_transient", "torque_total_variation")
    if len(moved) > 1:
        others = listed([f"{other} {large(x)}" for x, other in moved[1:][:_SEVERAL]])
        least, who = moved[0]
        told.append(f"Torque varied least with {who}: {large(least)} N·m/s after the transient; {others}.")
    return told


def detection(results: Sequence[Result]) -> list[str]:
    """Say which faults were detected, after what time, and how many alarms were false."""
    having = [(run_name(r), r["detection"]) for r in results if r.get("detection")]
    if not having:
        return ["No run has a detector: nothing is said about detection."]
    if len(having) > _SEVERAL:
        return [f"Detection. {pooled_text(pooled_scores([one for _, one in having]))}"]
    told = []
    for name, one in having:
        faults = one["faults"]
        delays = sorted(f["delay"] for f in faults if f["detected"])
        if not faults:
            text = "no fault acted"
        elif len(faults) == 1:
            text = (
                f"the fault was detected {delays[0]:.3g} s after its onset"
                if delays
                else "the fault was missed"
            )
        else:
            text = f"{len(delays)} of {len(faults)} faults were detected"
            if delays:
                text += f", {delays[0]:.3g} to {delays[-1]:.3g} s after their onsets"
        count = one["false_alarms"]
        alarms = "no false alarm" if not count else f"{count} false alarm{'s' * (count > 1)}"
        if one["exposure"]:
            text += f"; {alarms} in {one['exposure']:.4g} s without a fault"
        told.append(f"{name}, detector {one['detector']}: {text}.")
    return told


def accommodation(results: Sequence[Result]) -> list[str]:
    """Say what policies did."""
    told = []
    for result in results:
        if result["decisions"] and result["configuration"]:
            policies = listed(list(dict.fromkeys(d["policy"] for d in result["decisions"])))
            first = min(d["tick"] for d in result["decisions"]) * result["configuration"]["dt"]
            told.append(f"{run_name(result)}: {policies} acted, first from {first:.6g} s on.")
    return told


def listed(texts: Sequence[str]) -> str:
    """Join texts with commas and an "and"."""
    return texts[0] if len(texts) == 1 else f"{', '.join(texts[:-1])} and {texts[-1]}" if texts else ""


def times(factor: float) -> str:
    """Return a factor in words."""
    return f"{large(float(f'{factor:.3g}'))} times"


def _conditions(result: Result) -> str:
    """What must be the same for runs to be compared, as text."""
    configuration = result["configuration"]
    if configuration is None:
        return ""
    return json.dumps({k: v for k, v in configuration.items() if k not in _OF_THE_RUN}, sort_keys=True)


def _first_fault(results: Sequence[Result]) -> str:
    configuration = results[0]["configuration"]
    return (
        "the first fault" if configuration and len(configuration["injection"]["faults"]) > 1 else "the fault"
    )


def _mean(result: Result, window: str, metric: str) -> float | None:
    """Mean of a metric over the joints; None where a joint has none."""
    found = values(result, window, metric)
    if not found:
        return None
    known = [x for x in found if x is not None and math.isfinite(x)]
    return sum(known) / len(known) if len(known) == len(found) else None


def _ranked(results: Sequence[Result], window: str, metric: str) -> list[tuple[float, str]]:
    """Completed runs by the mean of a metric over the joints, the smallest first."""
    means = [(_mean(r, window, metric), run_name(r)) for r in results if r["status"] == "completed"]
    return sorted((mean, name) for mean, name in means if mean is not None)


def _better_joints(results: Sequence[Result], window: str, best: str) -> list[str]:
    """Joints in which another run tracked better than the best one."""
    rows = {
        run_name(r): values(r, window, "mean_abs_error") or [] for r in results if r["status"] == "completed"
    }
    told = []
    for joint, own in enumerate(rows[best]):
        other = min(
            (row[joint], name) for name, row in rows.items() if joint < len(row) and row[joint] is not None
        )
        if own is not None and other[0] is not None and other[0] < own:
            told.append(f"Of joint {joint + 1} alone, {other[1]} tracked better ({other[0]:.3g} rad).")
    return told
