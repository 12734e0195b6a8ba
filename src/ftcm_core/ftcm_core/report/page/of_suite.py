# SPDX-License-Identifier: Apache-2.0
"""The page of a suite of faults: who copes with how many of them, each fault at a glance, the tables."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from ftcm_core.report.page.conclusions import listed
from ftcm_core.report.page.markup import from_markdown
from ftcm_core.report.page.of_runs import NO_SCRIPT, again, provenance_pairs
from ftcm_core.report.page.shell import details, document, pre


def suite_page(
    suite: Mapping[str, Any],
    rows: Sequence[Mapping[str, Any]],
    tables: tuple[str, str],
    provenance: Mapping[str, Any],
    command: Sequence[str],
) -> str:
    """Return the page as HTML.

    Args:
        suite: what was run.
        rows: one per run.
        tables: the one of the laws and those of all faults, in Markdown.
        provenance: where the numbers come from.
        command: the command that made it, word by word.
    """
    laws = list(dict.fromkeys(r["controller"] for r in rows))
    conditions = list(dict.fromkeys(r["condition"] for r in rows))
    plots = [
        _plot(condition, [r for r in rows if r["condition"] == condition], laws) for condition in conditions
    ]
    sections = [
        ("plots", "Each fault", f'<div id="suite-here"></div>{NO_SCRIPT}'),
        ("tables", "Tables", from_markdown(tables[0]) + details("Every fault", from_markdown(tables[1]))),
        ("scenario", "What was run", pre(json.dumps(suite, indent=1, ensure_ascii=False))),
        ("provenance", "Where it comes from", provenance_pairs(provenance)),
        ("again", "How to repeat it", again(command)),
    ]
    faults = len({(r["fault"], r["joint"]) for r in rows if r["site"]})
    return document(
        f"Faults of the library: {', '.join(laws)}",
        f"Scenario {suite['scenario']}; {faults} faults, one in each run, from {suite['onset']:g} s on.",
        verdict(rows),
        sections,
        {"runs": [{"label": law} for law in laws], "suite": plots},
    )


def verdict(rows: Sequence[Mapping[str, Any]]) -> list[str]:
    """Say of each condition who has the smallest error in how many faults, and whose runs ended early."""
    told = []
    for condition in dict.fromkeys(r["condition"] for r in rows):
        cases: dict[tuple[str, int], dict[str, float | None]] = {}
        for r in rows:
            if r["condition"] == condition and r["site"]:
                cases.setdefault((r["fault"], r["joint"]), {})[r["controller"]] = r["rms_error"]
        laws = list(dict.fromkeys(law for case in cases.values() for law in case))
        wins, ended = dict.fromkeys(laws, 0), dict.fromkeys(laws, 0)
        for case in cases.values():
            known = {law: x for law, x in case.items() if x is not None}
            for law in case:
                ended[law] += law not in known
                wins[law] += law in known and known[law] == min(known.values())
        first, *rest = sorted(laws, key=lambda law: -wins[law])
        others = "".join(f", {law} in {wins[law]}" for law in rest)
        told.append(
            f"{condition}: {first} has the smallest RMS error after the onset in {wins[first]} of "
            f"{len(cases)} faults{others}."
        )
        early = [f"{count} of {law}" for law, count in ended.items() if count]
        told.append(f"{condition}: runs that ended early: {listed(early) if early else 'none'}.")
        told += _detected(condition, [r for r in rows if r["condition"] == condition and r["site"]])
    return told


def _detected(condition: str, rows: Sequence[Mapping[str, Any]]) -> list[str]:
    """Say how many faults the detector told, where there was one."""
    having = [r for r in rows if "detection_delay" in r]
    texts = []
    for law in dict.fromkeys(r["controller"] for r in having):
        own = [r["detection_delay"] for r in having if r["controller"] == law]
        delays = [delay for delay in own if delay is not None]
        median = f", in the median after {float(np.median(delays)):.3g} s" if delays else ""
        texts.append(f"{len(delays)} of {len(own)} with {law}{median}")
    return [f"{condition}: faults detected: {'; '.join(texts)}."] if texts else []


def _plot(condition: str, rows: Sequence[Mapping[str, Any]], laws: Sequence[str]) -> dict[str, Any]:
    cases = list(dict.fromkeys((r["fault"], r["joint"]) for r in rows))
    curves = []
    for run, law in enumerate(laws):
        own = [r for r in rows if r["controller"] == law and r["rms_error"]]
        curves.append(
            {
                "run": run,
                "x": [1000.0 * r["rms_error"] for r in own],
                "row": [cases.index((r["fault"], r["joint"])) for r in own],
            }
        )
    return {
        "title": f"{condition}: RMS of the tracking error after the onset, mrad, of the worst joint; "
        "without a mark: the run ended early, or before an onset",
        "cases": [f"{fault}, joint {joint}" if joint else fault for fault, joint in cases],
        "curves": curves,
    }
