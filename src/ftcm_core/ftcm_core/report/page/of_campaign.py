# SPDX-License-Identifier: Apache-2.0
"""The page of a campaign: who tracked better in the same draws, distributions, cost, sensitivity, table."""

from __future__ import annotations

import json
import math
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import numpy as np

from ftcm_core.campaign.fields import EFFORT, Field, fields_of, quantiles
from ftcm_core.campaign.sensitivity import FEWEST, MOST, Correlation, correlations, drawn_numbers
from ftcm_core.errors import FtcmError
from ftcm_core.recording.metrics import METRICS
from ftcm_core.report.page.conclusions import listed
from ftcm_core.report.page.curves import encoded
from ftcm_core.report.page.markup import from_markdown, table
from ftcm_core.report.page.of_runs import NO_SCRIPT, again, provenance_pairs
from ftcm_core.report.page.shell import details, document, pre

QUANTILES = (0.0, 0.05, 0.25, 0.5, 0.75, 0.95, 1.0)
"""What a box shows."""
SAMPLE = 400
"""So many values of a distribution are drawn at most, at even distances in their order."""
DOTS = 200
"""So many runs of a contender are dots at most, the first ones."""
WINDOWS = ("after_fault", "after_transient", "whole")
"""Windows whose metrics can be looked at."""


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
    fields = fields_of(summary["results"], runs)
    laws = list(dict.fromkeys(law for field in fields for law in field.laws))
    about = summary["campaign"]
    vary = about.get("vary") or {}
    count = max((found["runs"] for found in summary["results"].values()), default=0)
    note = (
        "Boxes: quarter, median, three quarters; whiskers: 5 % and 95 %; dots: smallest and largest; of the "
        f"completed runs. Of each distribution at most {SAMPLE} values are drawn, the extremes among them. "
        "A share that ends below 1: the other runs have no such value, most often as they did not complete; "
        "how many stands beside the box."
    )
    found, sensitivity = _sensitivity(fields, vary)
    groups = [
        {
            "name": field.scenario,
            "columns": _columns(field, laws),
            "tradeoff": _tradeoff(field, laws),
            "sensitivity": [
                {"title": f"{path}, {vary[path]}", "marks": marks}
                for path, marks in _marks(found[field.scenario], field, laws).items()
            ],
        }
        for field in fields
    ]
    plots = f'<div id="campaign-here"></div>{NO_SCRIPT}'
    varied = [[str(path), str(how)] for path, how in vary.items()]
    drawn = table(["value", "drawn from"], varied) if varied else ""
    some = any(group["columns"] for group in groups)
    sections = [
        ("plots", "Distributions", plots if some else ""),
        ("tradeoff", "Error against torque effort", _tradeoff_text(fields) if some else ""),
        ("sensitivity", "What the error follows", sensitivity if some else ""),
        ("tables", "Table", from_markdown(table_text)),
        ("scenario", "What was drawn", drawn + pre(json.dumps(about, indent=1, ensure_ascii=False))),
        ("provenance", "Where it comes from", provenance_pairs(summary["provenance"])),
        ("again", "How to repeat it", again(command)),
    ]
    data = {"runs": [{"label": law} for law in laws], "campaign": {"groups": groups, "note": note}}
    scenarios = listed(list(about["scenarios"])) if about.get("scenarios") else about.get("scenario", "")
    heading = f"Campaign {scenarios}: {', '.join(laws)}"
    said = f"{count:,} draws{', the same for every law' if len(laws) > 1 else ''}."
    return document(heading, said, verdict(summary, fields), sections, data)


def verdict(summary: Mapping[str, Any], fields: Sequence[Field]) -> list[str]:
    """Say how many runs completed, and which law tracked better in how many of the same draws."""
    failed = [
        f"{count:,} of {found['runs']:,} of {law}"
        for law, found in summary["results"].items()
        if (count := round((1.0 - found["completed"]) * found["runs"]))
    ]
    told = [f"Runs that did not complete: {listed(failed)}." if failed else "Every run completed."]
    for field in fields:
        told += _tracked(field)
    for law, found in summary["results"].items():
        if found.get("detection"):
            one = found["detection"]
            text = f"{law}: {one['faults'] - one['missed']:,} of {one['faults']:,} faults were detected"
            if one["delay_median"] is not None:
                text += f", in the median {one['delay_median']:.3g} s after their onset"
            told.append(
                f"{text}; {one['false_alarms']:,} false alarms in {one['exposure']:.6g} s without a fault."
            )
    return told


def _tracked(field: Field) -> list[str]:
    """Who had the smallest mean |e|, the mean of the joints, in how many draws; and its medians."""
    when = "After the fault" if field.window == "after_fault" else "After the transient"
    if field.scenario:
        when = f"{field.scenario}: {when[0].lower()}{when[1:]}"
    told = []
    means = {law: field.errors(law) for law in field.laws}
    full = [n for n in next(iter(means.values()), {}) if all(n in own for own in means.values())]
    if len(means) > 1 and full:
        best = [min((own[n], law) for law, own in means.items())[1] for n in full]
        ranked = sorted(means, key=best.count, reverse=True)
        others = [f"{law} in {best.count(law):,}" for law in ranked[1:]]
        told.append(
            f"{when} {ranked[0]} had the smallest mean |e| (mean of the joints) in "
            f"{best.count(ranked[0]):,} of {len(full):,} draws that every law completed; {listed(others)}."
        )
    known = [f"{law} {float(np.median(list(own.values()))):.3g} rad" for law, own in means.items() if own]
    if known:
        told.append(
            f"{when} the median of the mean |e| (mean of the joints), of each law over the draws that it "
            f"completed, is: {listed(known)}."
        )
    return told


# ---- distributions ----


def _columns(field: Field, laws: Sequence[str]) -> list[dict[str, Any]]:
    """What can be chosen: name, unit, and per joint of each law its box and a sample of its values."""
    columns = []
    for window in WINDOWS:
        for metric, (_, unit) in METRICS.items():
            own = {law: _per_joint(results, window, metric) for law, results in field.laws.items()}
            joints = max(map(len, own.values()))
            if joints:
                drawn = [
                    [
                        _drawn(laws.index(law), found[j] if found else [], len(field.laws[law]))
                        for law, found in own.items()
                    ]
                    for j in range(joints)
                ]
                name = f"{window}: {metric}, {unit}".replace("_", " ")
                columns.append({"name": name, "unit": unit, "perJoint": True, "joints": drawn})
    faults = {
        law: [(one["status"], f) for one in results for f in (one.get("detection") or {}).get("faults", [])]
        for law, results in field.laws.items()
    }
    delays = {
        law: [f["delay"] for status, f in found if f["detected"] and status == "completed"]
        for law, found in faults.items()
    }
    if any(delays.values()):
        boxes = [_drawn(laws.index(law), delays[law], len(faults[law])) for law in field.laws]
        columns.append({"name": "detection: delay, s", "unit": "s", "perJoint": False, "joints": [boxes]})
    return columns


def _per_joint(results: Sequence[Mapping[str, Any]], window: str, metric: str) -> list[list[float]]:
    """Values of completed runs, per joint; empty if there is none."""
    completed = [one["metrics"].get(window) or {} for one in results if one["status"] == "completed"]
    rows = [metrics[metric] for metrics in completed if metric in metrics]
    found = [[x for x in column if x is not None and math.isfinite(x)] for column in zip(*rows)]
    return found if any(found) else []


def _drawn(run: int, values: Sequence[float], count: int) -> dict[str, Any]:
    """Box and sample of a law's values, which so many could have."""
    ordered = np.sort(np.array(values, dtype=float))
    ranks = np.unique(np.linspace(0, len(ordered) - 1, min(SAMPLE, len(ordered))).round().astype(int))
    return {
        "run": run,
        "count": len(ordered),
        "of": count,
        "box": [float(x) for x in np.quantile(ordered, QUANTILES)] if values else None,
        "sample": encoded(ordered[ranks], "f4"),
    }


# ---- error against torque effort ----


def _tradeoff(field: Field, laws: Sequence[str]) -> list[dict[str, Any]]:
    """Per panel, the mean of the joints and each joint, each law's runs, medians and spread."""
    errors = {law: field.rows(law, field.window, "mean_abs_error") for law in field.laws}
    efforts = {law: field.rows(law, *EFFORT) for law in field.laws}
    rows = [row for law, own in errors.items() for n, row in own.items() if n in efforts[law]]
    joints = max(map(len, rows), default=0)
    panels: list[tuple[str, Any]] = [(f"joint {j + 1}", lambda row, j=j: row[j]) for j in range(joints)]
    if joints > 1:
        panels.insert(0, ("mean of the joints", lambda row: sum(row) / len(row)))
    found = []
    for title, of in panels:
        points: list[dict[str, Any]] = []
        medians = []
        for law in field.laws:
            both = sorted(errors[law].keys() & efforts[law].keys())
            missing = [math.inf] * (len(field.laws[law]) - len(both))
            x, y = (np.array([of(own[law][n]) for n in both]) for own in (efforts, errors))
            spread = [quantiles(np.append(values, missing), (0.05, 0.5, 0.95)) for values in (x, y)]
            medians.append((spread[0][1], spread[1][1]))
            dots = {"x": encoded(x[:DOTS], "f4"), "y": encoded(y[:DOTS], "f4")}
            finite = [[x if math.isfinite(x) else None for x in three] for three in spread]
            points.append({"run": laws.index(law), **dots, "spread": finite})
        for point, on_front in zip(points, pareto_front(medians)):
            point["front"] = on_front
        found.append({"title": title, "laws": points})
    return found


def pareto_front(points: Sequence[tuple[float, float]]) -> list[bool]:
    """Return which points are on the front: no other is smaller in one value and not larger in the other.

    A point that is not finite is not on it.
    """
    return [
        all(map(math.isfinite, point))
        and not any(other != point and other[0] <= point[0] and other[1] <= point[1] for other in points)
        for point in points
    ]


def _tradeoff_text(fields: Sequence[Field]) -> str:
    note = (
        f"Upwards the mean |e| {fields[0].window.replace('_', ' ')}, to the right the torque's variation "
        "after the transient. Large marks: medians over all draws; bars: 5 % to 95 %; a run that did not "
        "complete counts as larger than all others (dotted to the edge: more than 5 % did not). Small dots: "
        f"at most {DOTS} runs of each. Ringed, on the grey line: the Pareto front, those that no other beats "
        "in both medians."
    )
    texts = []
    for field in fields:
        missing = []
        for law, results in field.laws.items():
            both = field.rows(law, field.window, "mean_abs_error").keys() & field.rows(law, *EFFORT).keys()
            if len(both) < len(results):
                share = ", so without a mark" if 2 * len(both) <= len(results) else ""
                missing.append(f"{law} {len(results) - len(both):,} of {len(results):,}{share}")
        scenario = f"{field.scenario}: " if field.scenario else ""
        off = f"off the axes are the runs that did not complete: {'; '.join(missing)}."
        texts.append(f"- {scenario}{off if missing else 'all runs completed, none is off the axes.'}")
    lines = from_markdown("\n".join(texts))
    return f'<p class="note">{note}</p><div id="tradeoff-here"></div>{lines}'


# ---- what the error follows ----


def _sensitivity(
    fields: Sequence[Field], vary: Mapping[str, str]
) -> tuple[dict[str, dict[str, dict[str, Correlation | None]]], str]:
    """Scenario, to law, to path, to correlation; and the section's text."""
    found: dict[str, dict[str, dict[str, Correlation | None]]] = {field.scenario: {} for field in fields}
    if not vary:
        return found, ""
    drawn = drawn_numbers(vary, (one for field in fields for own in field.laws.values() for one in own))
    unordered = [path for path in vary if path not in drawn]
    parts = []
    if unordered:
        parts.append(f"Not shown, as the values have no order: {listed(unordered)}.")
    try:
        for field in fields if drawn else ():
            errors = {law: field.errors(law) for law in field.laws}
            found[field.scenario] = correlations(drawn, errors)
    except FtcmError as error:
        return found, from_markdown(f"Not computed: {error}")
    if drawn and not any(found.values()):
        parts.append(f"Not computed: fewer than {FEWEST} draws.")
    tables = []
    for scenario, laws in found.items():
        if laws:
            rows = [[path, *(_cell(laws[law][path]) for law in laws)] for path in drawn]
            tables.append(from_markdown(scenario) + table(["value", *laws], rows))
    note = (
        "Spearman's rank correlation of what was drawn with the mean |e| (mean of the joints), and its "
        "bootstrap interval of 95 %. 1: the larger the value, the larger the error, in all pairs of runs; "
        "-1: the smaller; around 0: neither, or an error that goes up and down with the value. A run that "
        f"did not complete has the largest error, so all draws count (at most the first {MOST:,})."
    )
    plots = f'<p class="note">{note}</p><div id="sensitivity-here"></div>' if tables else ""
    return found, plots + from_markdown("\n\n".join(parts)) + (
        details("As a table", "".join(tables)) if tables else ""
    )


def _marks(
    found: Mapping[str, Mapping[str, Correlation | None]], field: Field, laws: Sequence[str]
) -> dict[str, list[dict[str, Any]]]:
    """Per drawn path the correlations of the laws, as they are plotted."""
    paths = list(next(iter(found.values()), {}))
    return {
        path: [{"run": laws.index(law), "values": found[law][path]} for law in field.laws] for path in paths
    }


def _cell(one: Correlation | None) -> str:
    return "the same in every run" if one is None else f"{one.value:.2f} ({one.low:.2f} to {one.high:.2f})"
