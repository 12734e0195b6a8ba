# SPDX-License-Identifier: Apache-2.0
"""The page of a campaign: who tracked better in the same draws, distributions, the table."""

from __future__ import annotations

import json
import math
from collections import defaultdict
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import numpy as np

from ftcm_core.recording.metrics import METRICS
from ftcm_core.report.page.conclusions import listed
from ftcm_core.report.page.curves import encoded
from ftcm_core.report.page.markup import from_markdown, table
from ftcm_core.report.page.of_runs import NO_SCRIPT, again, provenance_pairs
from ftcm_core.report.page.shell import document, pre

QUANTILES = (0.0, 0.05, 0.25, 0.5, 0.75, 0.95, 1.0)
"""What a box shows."""
SAMPLE = 400
"""So many values of a distribution are drawn at most, at even distances in their order."""
WINDOWS = ("after_fault", "after_transient", "whole")
"""Windows whose metrics can be looked at."""
_DELAY = ("detection", "delay")

Values = dict[tuple[str, str], dict[tuple[str, int], list[float]]]
"""Window and metric -> law and joint from 0 -> values of the completed runs."""


def campaign_page(
    summary: Mapping[str, Any], runs: Iterable[Mapping[str, Any]], table_text: str, command: Sequence[str]
) -> str:
    """Return the page as HTML.

    Args:
        summary: of the campaign.
        runs: the results in ``runs.jsonl``.
        table_text: the campaign's table, in Markdown.
        command: the command that made it, word by word.
    """
    results = list(runs)
    laws = list(summary["results"])
    columns = _columns(_values(results), laws)
    about = summary["campaign"]
    count = max((found["runs"] for found in summary["results"].values()), default=0)
    note = (
        "Boxes: quarter, median, three quarters; whiskers: 5 % and 95 %; dots: smallest and largest; of the "
        f"completed runs. Of each distribution at most {SAMPLE} values are drawn, the extremes among them."
    )
    plots = f'<div id="campaign-here"></div>{NO_SCRIPT}'
    varied = [[str(path), str(how)] for path, how in (about.get("vary") or {}).items()]
    drawn = table(["value", "drawn from"], varied) if varied else ""
    sections = [
        ("plots", "Distributions", plots if columns else ""),
        ("tables", "Table", from_markdown(table_text)),
        ("scenario", "What was drawn", drawn + pre(json.dumps(about, indent=1, ensure_ascii=False))),
        ("provenance", "Where it comes from", provenance_pairs(summary["provenance"])),
        ("again", "How to repeat it", again(command)),
    ]
    data = {"runs": [{"label": law} for law in laws], "campaign": {"columns": columns, "note": note}}
    heading = f"Campaign {about.get('scenario', '')}: {', '.join(laws)}"
    said = f"{count:,} draws{', the same for every law' if len(laws) > 1 else ''}."
    return document(heading, said, verdict(summary, results), sections, data)


def verdict(summary: Mapping[str, Any], results: Sequence[Mapping[str, Any]]) -> list[str]:
    """Say how many runs completed, and which law tracked better in how many of the same draws."""
    laws = summary["results"]
    failed = [
        f"{count:,} of {found['runs']:,} of {law}"
        for law, found in laws.items()
        if (count := round((1.0 - found["completed"]) * found["runs"]))
    ]
    told = [f"Runs that did not complete: {listed(failed)}." if failed else "Every run completed."]
    faulty = any((r["metrics"] or {}).get("after_fault") for r in results)
    window, when = (
        ("after_fault", "After the fault") if faulty else ("after_transient", "After the transient")
    )
    draws: dict[Any, dict[str, float]] = {}
    for one in results:
        entry = (one["metrics"] or {}).get(window)
        errors = entry["mean_abs_error"] if entry and one["status"] == "completed" else [None]
        if None not in errors:
            draws.setdefault(one["run"], {})[one["controller"]] = sum(errors) / len(errors)
    if len(laws) > 1:
        full = [means for means in draws.values() if len(means) == len(laws)]
        wins = {law: sum(min(means, key=means.__getitem__) == law for means in full) for law in laws}
        ranked = sorted(wins, key=wins.__getitem__, reverse=True)
        if full:
            others = [f"{law} in {wins[law]:,}" for law in ranked[1:]]
            told.append(
                f"{when} {ranked[0]} had the smallest mean |e| (mean of the joints) in "
                f"{wins[ranked[0]]:,} of {len(full):,} draws that every law completed; {listed(others)}."
            )
    medians = {law: [means[law] for means in draws.values() if law in means] for law in laws}
    known = [f"{law} {float(np.median(means)):.3g} rad" for law, means in medians.items() if means]
    if known:
        told.append(
            f"{when} the median over the draws of the mean |e| (mean of the joints) is: {listed(known)}."
        )
    for law, found in laws.items():
        if found.get("detection"):
            one = found["detection"]
            text = f"{law}: {one['faults'] - one['missed']:,} of {one['faults']:,} faults were detected"
            if one["delay_median"] is not None:
                text += f", in the median {one['delay_median']:.3g} s after their onset"
            told.append(
                f"{text}; {one['false_alarms']:,} false alarms in {one['exposure']:.6g} s without a fault."
            )
    return told


def _values(results: Iterable[Mapping[str, Any]]) -> Values:
    found: Values = defaultdict(lambda: defaultdict(list))
    for one in results:
        if one["status"] != "completed":
            continue
        law = one["controller"]
        for window in WINDOWS:
            for metric, row in (one["metrics"].get(window) or {}).items():
                for joint, x in enumerate(row):
                    if x is not None and math.isfinite(x):
                        found[window, metric][law, joint].append(x)
        for fault in (one.get("detection") or {}).get("faults", []):
            if fault["detected"]:
                found[_DELAY][law, 0].append(fault["delay"])
    return found


def _columns(values: Values, laws: Sequence[str]) -> list[dict[str, Any]]:
    """What can be chosen: name, unit, and per joint of each law its box and a sample of its values."""
    columns = []
    for key in [*((window, metric) for window in WINDOWS for metric in METRICS), _DELAY]:
        if key not in values:
            continue
        unit = "s" if key == _DELAY else METRICS[key[1]][1]
        own = values[key]
        joints = [
            [_drawn(k, own[law, joint]) for k, law in enumerate(laws) if (law, joint) in own]
            for joint in range(1 + max(joint for _, joint in own))
        ]
        name = f"{key[0]}: {key[1]}, {unit}".replace("_", " ")
        columns.append({"name": name, "unit": unit, "perJoint": key != _DELAY, "joints": joints})
    return columns


def _drawn(run: int, values: Sequence[float]) -> dict[str, Any]:
    ordered = np.sort(np.array(values))
    ranks = np.unique(np.linspace(0, len(ordered) - 1, min(SAMPLE, len(ordered))).round().astype(int))
    return {
        "run": run,
        "count": len(ordered),
        "box": [float(x) for x in np.quantile(ordered, QUANTILES)],
        "sample": encoded(ordered[ranks], "f4"),
    }
