# SPDX-License-Identifier: Apache-2.0
"""Write the tables of docs/questioned.md from what `ftcm suite faults --output DIR` has written.

Usage: python tools/suite_page.py docs/questioned.md --detected DIR DIR [DIR ...]
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

BEGIN, END = "<!-- tables: begin -->\n", "<!-- tables: end -->\n"
LAW = "ftcm"
ERRORS = """## Fault by fault

RMS of the tracking error after the onset, mrad, of the worst joint: of FTCM, and, where another law is more
than 5 % better, of the best. Bold: FTCM is the best, or within 5 % of it.
"""
COSTS = """## What it took, and what was seen of it

Of the first column above: largest torque of FTCM, the variation of its torque and of the law's with the
smallest error; what the detector `isolating` told with FTCM; and which laws could not go on.
"""
NEAR = 1.05
"""Errors within this factor of the smallest count as equal to it (chosen)."""


def main() -> int:
    """Put the tables between the page's markers."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("page", type=Path)
    parser.add_argument("--detected", type=Path, required=True, metavar="DIR", help="suite with a detector")
    parser.add_argument("folders", type=Path, nargs="+", metavar="DIR")
    arguments = parser.parse_args()
    text = arguments.page.read_text(encoding="utf-8")
    head, _, rest = text.partition(BEGIN)
    _, _, tail = rest.partition(END)
    found = [
        json.loads((folder / "summary.json").read_text(encoding="utf-8")) for folder in arguments.folders
    ]
    seen = json.loads((arguments.detected / "summary.json").read_text(encoding="utf-8"))
    body = "\n".join([overview(found), ERRORS, errors(found), COSTS, costs(found[0], seen)])
    arguments.page.write_text(f"{head}{BEGIN}\n{body}\n{END}{tail}", encoding="utf-8")
    return 0


def title(suite: Mapping[str, Any]) -> str:
    """Condition and joint of a suite."""
    (condition,), (joint,) = suite["suite"]["conditions"], suite["suite"]["joints"]
    return f"{condition}, joint {joint}"


def overview(suites: Sequence[Mapping[str, Any]]) -> str:
    """Laws against suites: median error, and how often each ended early or came nearest."""
    laws = suites[0]["suite"]["controllers"]
    lines = [
        f"| law | {' | '.join(map(title, suites))} | torque variation, {title(suites[0])} |",
        "|---|" + "---|" * (len(suites) + 1),
    ]
    for law in laws:
        cells = []
        for suite in suites:
            faults = cells_of(suite)
            mine = [row[law] for (fault, _), row in faults.items() if fault != "none"]
            done = sorted(r["rms_error"] for r in mine if r["rms_error"] is not None)
            wins = sum(1 for (f, _), row in faults.items() if f != "none" and is_best(row, law))
            ended = len(mine) - len(done)
            text = f"{1000 * middle(done):.3g}, {wins}"
            cells.append(text + (f", {ended} ended" if ended else ""))
        own = [row[law]["torque_total_variation"] for row in cells_of(suites[0]).values()]
        cells.append(f"{middle(sorted(x for x in own if x is not None)):,.3g}")
        lines.append(f"| `{law}` | {' | '.join(cells)} |")
    return "\n".join(lines) + "\n"


def errors(suites: Sequence[Mapping[str, Any]]) -> str:
    """Every fault against suites: the error of the paper's law, and of the one that came nearest."""
    lines = [
        f"| fault | {' | '.join(map(title, suites))} |",
        "|---|" + "---|" * len(suites),
    ]
    tables = [{fault: row for (fault, _), row in cells_of(suite).items()} for suite in suites]
    for fault in tables[0]:
        cells = []
        for rows in tables:
            row = rows[fault]
            error = row[LAW]["rms_error"]
            own = "ended early" if error is None else f"{1000 * error:.3g}"
            best = best_of(row)
            near = is_best(row, LAW)
            cells.append(f"**{own}**" if near else f"{own}; {best} {1000 * row[best]['rms_error']:.3g}")
        lines.append(f"| {fault} | {' | '.join(cells)} |")
    return "\n".join(lines) + "\n"


def costs(suite: Mapping[str, Any], seen: Mapping[str, Any]) -> str:
    """Every fault in one suite: what torque it took, who ended early, what a detector told."""
    told = {fault: row[LAW] for (fault, _), row in cells_of(seen).items()}
    lines = [
        "| fault | FTCM: peak torque, N·m | its variation, N·m/s | nearest law's | detected after, ms | as "
        "| ended early |",
        "|---|---|---|---|---|---|---|",
    ]
    for (fault, _), row in cells_of(suite).items():
        own, variation = row[LAW], row[best_of(row)]["torque_total_variation"]
        ended = [law for law, r in row.items() if r["rms_error"] is None]
        numbers = [
            "–" if own[key] is None else f"{own[key]:,.3g}"
            for key in ("peak_torque", "torque_total_variation")
        ]
        said = told[fault]
        after = "–" if said["detection_delay"] is None else f"{1000 * said['detection_delay']:,.3g}"
        verdict = "–" if after == "–" else f"{said['verdict']} {said['verdict_joint'] or ''}".strip()
        cells = [fault, *numbers, f"{variation:,.3g}", after, verdict, ", ".join(ended) or "–"]
        lines.append(f"| {' | '.join(cells)} |")
    return "\n".join(lines) + "\n"


def cells_of(suite: Mapping[str, Any]) -> dict[tuple[str, int], dict[str, Any]]:
    """Rows of a suite by fault and joint, then by law."""
    found: dict[tuple[str, int], dict[str, Any]] = {}
    for row in suite["rows"]:
        found.setdefault((row["fault"], row["joint"]), {})[row["controller"]] = row
    return found


def best_of(row: Mapping[str, Any]) -> str:
    """The law with the smallest error."""
    return min(
        (law for law, r in row.items() if r["rms_error"] is not None), key=lambda x: row[x]["rms_error"]
    )


def is_best(row: Mapping[str, Any], law: str) -> bool:
    """Whether a law's error is the smallest, or near it."""
    error = row[law]["rms_error"]
    return error is not None and error <= NEAR * float(row[best_of(row)]["rms_error"])


def middle(values: Sequence[float]) -> float:
    """Median of sorted values."""
    n = len(values)
    return (values[(n - 1) // 2] + values[n // 2]) / 2


if __name__ == "__main__":
    raise SystemExit(main())
