# SPDX-License-Identifier: Apache-2.0
"""Statistics of a campaign's runs, and their table."""

from __future__ import annotations

import math
from array import array
from collections.abc import Mapping, Sequence
from typing import IO, Any

import numpy as np
import numpy.typing as npt

from ftcm_core.campaign.comparison import by_scenario, comparisons
from ftcm_core.campaign.intervals import median_interval, wilson_interval
from ftcm_core.recording.detection import pooled_scores
from ftcm_core.recording.metrics import METRICS, WINDOWS
from ftcm_core.recording.trace import ENDED_EARLY, Array
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
    """What is kept of the runs of one contender: a row of numbers each, in a temporary file.

    So a campaign takes no more memory the more runs it has; each column is read when its turn comes.
    """

    def __init__(self, rows: IO[bytes]) -> None:
        """Keep nothing yet.

        Args:
            rows: the file, empty; it stays the caller's to close.
        """
        self.states: dict[str, int] = {}
        self.engines: dict[str, int] = {}
        self.scores: list[dict[str, Any]] = []
        self._numbers = array("q")
        """Numbers of the runs that completed."""
        self._windows = array("B")
        """Of each, the windows that it had, a bit each."""
        self._joints = 0
        self._rows = rows

    def add(self, result: dict[str, Any]) -> None:
        """Count a run, and keep its metrics, and the scores of its detector, if it completed."""
        self.states[result["status"]] = self.states.get(result["status"], 0) + 1
        self.engines[result["engine"]] = self.engines.get(result["engine"], 0) + 1
        if result["status"] != "completed":
            return
        if result.get("detection"):
            self.scores.append(result["detection"])
        self._numbers.append(result["run"])
        self._joints = self._joints or len(result["metrics"]["whole"]["iae"])
        absent = dict.fromkeys(METRICS, (None,) * self._joints)
        row, there = array("d"), 0
        for i, window in enumerate(WINDOWS):
            metrics = result["metrics"].get(window) or absent
            there |= (metrics is not absent) << i
            row.extend([math.nan if x is None else x for metric in METRICS for x in metrics[metric]])
        self._windows.append(there)
        row.tofile(self._rows)

    def _with(self, window: str) -> npt.NDArray[np.bool_]:
        """Which of the completed runs had a window."""
        return (np.array(self._windows, dtype=np.uint8) >> WINDOWS.index(window) & 1).astype(bool)

    def _values(self, window: str, metric: str) -> Array:
        """Values of the completed runs that had a window, shape (runs, joints)."""
        self._rows.flush()
        shape = (len(self._numbers), len(WINDOWS), len(METRICS), self._joints)
        table = np.memmap(self._rows, dtype=np.float64, mode="r", shape=shape)
        return np.array(table[:, WINDOWS.index(window), list(METRICS).index(metric)])[self._with(window)]

    def compared(self) -> dict[tuple[str, str], dict[int, Sequence[float]]]:
        """Return of :data:`SHOWN` the values per joint by number of the run."""
        if not self._numbers:
            return {key: {} for key in SHOWN}
        numbers = np.array(self._numbers)
        return {
            (window, metric): dict(
                zip(numbers[self._with(window)].tolist(), self._values(window, metric).tolist())
            )
            for window, metric in SHOWN
        }

    def summary(self) -> dict[str, Any]:
        """Return shares of statuses and quantiles of the metrics, per joint, with intervals of 95 %."""
        count = sum(self.states.values())
        completed = self.states.get("completed", 0)
        metrics: dict[str, dict[str, dict[str, list[Any]]]] = {}
        columns = (
            (window, metric, column)
            for window in WINDOWS
            if self._with(window).any()
            for metric in METRICS
            for column in self._values(window, metric).T
        )
        for window, metric, column in columns:
            values = column[np.isfinite(column)]
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
    several = len(found) > 1
    return {
        "results": {name: one.summary() for name, one in found.items()},
        **(comparisons({name: one.compared() for name, one in found.items()}, runs) if several else {}),
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
