# SPDX-License-Identifier: Apache-2.0
"""Statistics of a campaign's runs, and their table."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from ftcm_core.campaign.comparison import by_scenario, comparisons
from ftcm_core.campaign.intervals import median_interval, wilson_interval
from ftcm_core.recording.detection import pooled_scores
from ftcm_core.recording.trace import ENDED_EARLY
from ftcm_core.report.table import markdown, pooled_text

QUANTILES = {"median": 0.5, "q05": 0.05, "q95": 0.95}
SHOWN = (
    ("after_fault", "mean_abs_error"),
    ("after_fault", "max_abs_error"),
    ("after_transient", "torque_total_variation"),
)
"""What the table shows, and what contenders are compared in; ``summary.json`` has the quantiles of all."""
MOST_IN_FULL = 3
"""Of so many contenders of a scenario the table compares each with each, of more each with the first."""


class Statistics:
    """What is kept of the runs of one contender: a row of numbers each."""

    def __init__(self) -> None:
        self.states: dict[str, int] = {}
        self.engines: dict[str, int] = {}
        self.columns: dict[tuple[str, str, int], list[float]] = {}
        self.scores: list[dict[str, Any]] = []
        self.compared: dict[tuple[str, str], dict[int, tuple[float, ...]]] = {key: {} for key in SHOWN}
        """Of :data:`SHOWN`, values per joint by number of the run."""

    def add(self, result: dict[str, Any]) -> None:
        """Count a run, and keep its metrics, and the scores of its detector, if it completed."""
        self.states[result["status"]] = self.states.get(result["status"], 0) + 1
        self.engines[result["engine"]] = self.engines.get(result["engine"], 0) + 1
        if result["status"] != "completed":
            return
        if result.get("detection"):
            self.scores.append(result["detection"])
        for window, metrics in result["metrics"].items():
            for metric, values in (metrics or {}).items():
                numbers = tuple([math.nan if x is None else x for x in values])
                for joint, x in enumerate(numbers):
                    self.columns.setdefault((window, metric, joint), []).append(x)
                if (window, metric) in SHOWN:
                    self.compared[window, metric][result["run"]] = numbers

    def summary(self) -> dict[str, Any]:
        """Return shares of statuses and quantiles of the metrics, per joint, with intervals of 95 %."""
        count = sum(self.states.values())
        completed = self.states.get("completed", 0)
        metrics: dict[str, dict[str, dict[str, list[Any]]]] = {}
        for (window, metric, _), column in self.columns.items():
            values = np.array(column)
            values = values[np.isfinite(values)]
            entry = metrics.setdefault(window, {}).setdefault(
                metric, {name: [] for name in (*QUANTILES, "median_95")}
            )
            for name, q in QUANTILES.items():
                entry[name].append(float(np.quantile(values, q)) if len(values) else None)
            entry["median_95"].append(median_interval(values))
        return {
            "runs": count,
            "completed": completed / count,
            "completed_95": wilson_interval(completed, count),
            **{status: self.states.get(status, 0) / count for status in ENDED_EARLY},
            "engines": self.engines,
            "metrics": metrics,
            **({"detection": pooled_scores(self.scores)} if self.scores else {}),
        }


def summary_of(found: Mapping[str, Statistics], runs: int) -> dict[str, Any]:
    """Return the parts of a summary that are statistics.

    Args:
        found: by contender.
        runs: number of draws.
    """
    compared = {name: one.compared for name, one in found.items()}
    return {
        "results": {name: one.summary() for name, one in found.items()},
        **(comparisons(compared, runs) if len(found) > 1 else {}),
    }


def table(summary: Mapping[str, Any]) -> str:
    """Return the tables of a summary, in Markdown: each contender's metrics, then how they compare."""
    lines = []
    for name, found in summary["results"].items():
        exceeded = (
            f", {100 * found['limit_exceeded']:.4g} % limit_exceeded" if found["limit_exceeded"] else ""
        )
        low, high = (100 * x for x in found["completed_95"])
        lines += [
            f"{name}: {found['runs']} runs, {100 * found['completed']:.4g} % completed "
            f"({low:.4g} to {high:.4g}), {100 * found['diverged']:.4g} % diverged{exceeded}. Of the "
            "completed: median (its interval of 95 %), below it their 5 % and 95 % quantiles:",
            "",
        ]
        for engine, count in found["engines"].items():
            if engine not in ("compiled", "plain"):
                lines += [f"{count} of them ran {engine}", ""]
        rows = []
        for window, metric in SHOWN:
            entry = found["metrics"].get(window, {}).get(metric)
            if entry:
                middle = [_with_interval(*x) for x in zip(entry["median"], entry["median_95"])]
                spread = [
                    "-" if a is None else f"{a:.3g} … {b:.3g}" for a, b in zip(entry["q05"], entry["q95"])
                ]
                rows += [[window, f"{metric} ({summary['units'][metric]})", *middle], ["", "", *spread]]
        if rows:
            lines += [_per_joint(["window", "metric"], rows), ""]
        if "detection" in found:
            lines += [pooled_text(found["detection"]), ""]
    return "\n".join(lines + _comparison_lines(summary))


def _comparison_lines(summary: Mapping[str, Any]) -> list[str]:
    fields = by_scenario(summary["results"]).values()
    firsts = {name for field in fields for name in (field if len(field) <= MOST_IN_FULL else field[:1])}
    shown = [pair for pair in summary.get("comparisons", ()) if pair["contenders"][0] in firsts]
    lines = []
    if shown:
        rows = []
        for pair in shown:
            who = [pair["window"], pair["metric"], " / ".join(pair["contenders"]), str(pair["pairs"])]
            rows.append([*who, *map(_paired_cell, pair["joints"])])
        lines += [
            "Over the same draws, those that both completed: median ratio (its interval of 95 %); r, the "
            "rank-biserial correlation, -1 where the first is smaller in every draw; p of Wilcoxon's test, "
            "corrected for all comparisons (Holm):",
            "",
            _per_joint(["window", "metric", "contenders", "draws"], rows),
            "",
        ]
    ranked = []
    for one in summary.get("ranking", ()):
        least = "-" if one["critical_difference"] is None else f"{one['critical_difference']:.3g}"
        for i, name in enumerate(one["contenders"]):
            cells = [f"{joint['mean_ranks'][i]:.3g}" for joint in one["joints"]]
            ranked.append([one["window"], one["metric"], name, least, *cells])
    if ranked:
        lines += [
            "Mean rank over the draws, 1 is the smallest value; ranks nearer than the critical difference "
            "(Nemenyi, 5 %) are not told apart:",
            "",
            _per_joint(["window", "metric", "contender", "critical difference"], ranked),
            "",
        ]
    return lines


def _paired_cell(joint: Mapping[str, Any]) -> str:
    if joint["rank_biserial"] is None:
        return "-"
    value, interval = joint["ratio"], joint["ratio_95"]
    text = f"differ by {_with_interval(joint['difference'], joint['difference_95'])}"
    if value is not None:
        text = _with_interval(value, interval)
    p = joint["p_holm"]
    return f"{text}, r {joint['rank_biserial']:.2f}" + ("" if p is None else f", p {p:.2g}")


def _with_interval(value: float | None, interval: Sequence[float] | None) -> str:
    if value is None:
        return "-"
    return f"{value:.3g}" + (f" ({interval[0]:.3g} to {interval[1]:.3g})" if interval else "")


def _per_joint(head: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    width = max(map(len, rows))  # robots of several scenarios may have other numbers of joints
    joints = [f"joint {j + 1}" for j in range(width - len(head))]
    return markdown([[*head, *joints], *([*row, *[""] * (width - len(row))] for row in rows)])
