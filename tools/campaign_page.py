# SPDX-License-Identifier: Apache-2.0
"""Write the tables of docs/suites.md from what `ftcm campaign FILE --output DIR` has written.

They stand between the page's markers `<!-- NAME: begin -->` and `<!-- NAME: end -->`; NAME is that of DIR.

Usage: python tools/campaign_page.py docs/suites.md DIR [DIR ...]
"""

from __future__ import annotations

import argparse
import json
import math
from collections.abc import Iterable, Mapping
from pathlib import Path

import numpy as np

from ftcm_core.campaign import read_runs
from ftcm_core.campaign.comparison import ranks
from ftcm_core.campaign.fields import EFFORT, Field, fields_of, mean_of_joints, quantiles
from ftcm_core.campaign.intervals import median_interval, wilson_interval
from ftcm_core.campaign.sensitivity import Correlation, correlations, drawn_numbers
from ftcm_core.recording.trace import Array

HEAD = (
    "contender", "completed, %", "error, mrad", "of 95 % below, mrad", "the best, % of draws", "mean rank",
    "RMS, mrad", "peak, mrad", "torque variation, N·m/s", "the error follows",
)  # fmt: skip
FOLLOWED = 2
"""So many drawn values are named, those with the largest correlations whose interval leaves out zero."""


def main() -> int:
    """Put the tables between the page's markers."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("page", type=Path)
    parser.add_argument("folders", type=Path, nargs="+", metavar="DIR")
    arguments = parser.parse_args()
    text = arguments.page.read_text(encoding="utf-8")
    for folder in arguments.folders:
        begin, end = (f"<!-- {folder.name}: {which} -->\n" for which in ("begin", "end"))
        head, found, rest = text.partition(begin)
        _, closed, tail = rest.partition(end)
        if not (found and closed):
            parser.error(f"{arguments.page} has no place {begin.strip()} … {end.strip()}")
        text = f"{head}{begin}\n{tables(folder)}\n{end}{tail}"
    arguments.page.write_text(text, encoding="utf-8")
    return 0


def tables(folder: Path) -> str:
    """The tables of a campaign, one of each scenario, as Markdown."""
    summary = json.loads((folder / "summary.json").read_text(encoding="utf-8"))
    vary = summary["campaign"]["vary"]
    parts = []
    for field in fields_of(summary["results"], read_runs(folder / "runs.jsonl")):
        drawn = drawn_numbers(vary, next(iter(field.laws.values())))
        heading = f"`{field.scenario}`:\n\n" if field.scenario else ""
        parts.append(heading + table(field, drawn))
    return "\n".join(parts)


def table(field: Field, drawn: Mapping[str, Mapping[int, float]]) -> str:
    """One row per contender of a scenario; a run that did not complete is worse than all others."""
    numbers = sorted({one["run"] for own in field.laws.values() for one in own})
    errors = {law: field.errors(law) for law in field.laws}
    matrix = np.array([[own.get(n, math.inf) for own in errors.values()] for n in numbers])
    mean_ranks = np.mean([ranks(row) for row in matrix], axis=0)
    best = matrix.argmin(axis=1)[np.isfinite(matrix).any(axis=1)]
    followed = correlations(drawn, errors)
    lines = [f"| {' | '.join(HEAD)} |", "|---" * len(HEAD) + "|"]
    for k, law in enumerate(field.laws):
        others = [
            mean_of_joints(field.rows(law, *which))
            for which in ((field.window, "rms_error"), (field.window, "max_abs_error"), EFFORT)
        ]
        rms, peak, effort = (middle(np.array([one.get(n, math.inf) for n in numbers])) for one in others)
        own = 1000.0 * matrix[:, k]
        cells = [
            f"`{law}`",
            share(len(errors[law]), len(numbers)),
            f"{number(middle(own))} ({interval(own)})",
            number(quantiles(own, [0.95])[0]),
            share(int(np.sum(best == k)), len(numbers)),
            f"{mean_ranks[k]:.2f}",
            number(1000.0 * rms),
            number(1000.0 * peak),
            number(effort),
            follows(followed.get(law, {})),
        ]
        lines.append(f"| {' | '.join(cells)} |")
    return "\n".join(lines) + "\n"


def middle(values: Array) -> float:
    """Median, of which half may be infinite."""
    return quantiles(values, [0.5])[0]


def interval(values: Array) -> str:
    """Bootstrap interval of the median, 95 %."""
    found = median_interval(np.nan_to_num(values, posinf=1e300)) or (math.nan, math.nan)
    return " to ".join(number(x if x < 1e299 else math.inf) for x in found)


def number(x: float) -> str:
    """Three digits; what is not finite is the runs that did not complete."""
    if not math.isfinite(x):
        return "–"
    return f"{x:,.0f}" if x >= 1000 else f"{x:.3g}"


def share(count: int, of: int) -> str:
    """A share in per cent, with Wilson's interval."""
    low, high = (100.0 * x for x in wilson_interval(count, of))
    return f"{100.0 * count / of:.3g} ({low:.3g} to {high:.3g})"


def follows(found: Mapping[str, Correlation | None]) -> str:
    """The drawn values that the error follows most."""
    sure = [(path, one) for path, one in found.items() if one and (one.low > 0.0 or one.high < 0.0)]
    ordered: Iterable[tuple[str, Correlation]] = sorted(sure, key=lambda x: -abs(x[1].value))
    texts = [
        f"`{path.rpartition('.')[2]}` {one.value:.2f} ({one.low:.2f} to {one.high:.2f})"
        for path, one in ordered
    ]
    return ", ".join(texts[:FOLLOWED]) or "–"


if __name__ == "__main__":
    raise SystemExit(main())
