# SPDX-License-Identifier: Apache-2.0
"""Statistics of a campaign's runs, and their table."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import numpy as np

from ftcm_core.recording.detection import pooled_scores
from ftcm_core.recording.trace import ENDED_EARLY
from ftcm_core.report.table import markdown, pooled_text

QUANTILES = {"median": 0.5, "q05": 0.05, "q95": 0.95}
SHOWN = (
    ("after_fault", "mean_abs_error"),
    ("after_fault", "max_abs_error"),
    ("after_transient", "torque_total_variation"),
)
"""What the table shows; ``summary.json`` has everything."""


class Statistics:
    """What is kept of the runs of one controller: a row of numbers each."""

    def __init__(self) -> None:
        self.states: dict[str, int] = {}
        self.engines: dict[str, int] = {}
        self.columns: dict[tuple[str, str, int], list[float]] = {}
        self.scores: list[dict[str, Any]] = []

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
                for joint, x in enumerate(values):
                    column = self.columns.setdefault((window, metric, joint), [])
                    column.append(math.nan if x is None else x)

    def summary(self) -> dict[str, Any]:
        """Return shares of statuses and quantiles of the metrics, per joint."""
        count = sum(self.states.values())
        metrics: dict[str, dict[str, dict[str, list[float | None]]]] = {}
        for (window, metric, _), column in self.columns.items():
            values = np.array(column)
            values = values[np.isfinite(values)]
            entry = metrics.setdefault(window, {}).setdefault(metric, {name: [] for name in QUANTILES})
            for name, q in QUANTILES.items():
                entry[name].append(float(np.quantile(values, q)) if len(values) else None)
        return {
            "runs": count,
            "completed": self.states.get("completed", 0) / count,
            **{status: self.states.get(status, 0) / count for status in ENDED_EARLY},
            "engines": self.engines,
            "metrics": metrics,
            **({"detection": pooled_scores(self.scores)} if self.scores else {}),
        }


def table(summary: Mapping[str, Any]) -> str:
    """Return the table of a summary, in Markdown: median [5 %, 95 %] over the completed runs."""
    lines = []
    for name, found in summary["results"].items():
        exceeded = (
            f", {100 * found['limit_exceeded']:.4g} % limit_exceeded" if found["limit_exceeded"] else ""
        )
        lines += [
            f"{name}: {found['runs']} runs, {100 * found['completed']:.4g} % completed, "
            f"{100 * found['diverged']:.4g} % diverged{exceeded}; median [5 %, 95 %] of the completed:",
            "",
        ]
        for engine, count in found["engines"].items():
            if engine not in ("compiled", "plain"):
                lines += [f"{count} of them ran {engine}", ""]
        rows = []
        for window, metric in SHOWN:
            entry = found["metrics"].get(window, {}).get(metric)
            if entry:
                cells = [
                    "-" if m is None else f"{m:.3g} [{a:.3g}, {b:.3g}]"
                    for m, a, b in zip(entry["median"], entry["q05"], entry["q95"])
                ]
                rows.append([window, f"{metric} ({summary['units'][metric]})", *cells])
        if rows:
            head = ["window", "metric", *(f"joint {j + 1}" for j in range(len(rows[0]) - 2))]
            lines.append(markdown([head, *rows]))
            lines.append("")
        if "detection" in found:
            lines += [pooled_text(found["detection"]), ""]
    return "\n".join(lines)
