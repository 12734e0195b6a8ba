# SPDX-License-Identifier: Apache-2.0
"""The page of some runs: verdict, plots, tables, timing, scenarios, provenance, how to repeat them."""

from __future__ import annotations

import dataclasses
import datetime
import shlex
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from ftcm_core.recording.trace import Trace
from ftcm_core.report.page.conclusions import conclusions
from ftcm_core.report.page.curves import page_data
from ftcm_core.report.page.decimation import AFTER, BEFORE
from ftcm_core.report.page.markup import from_markdown, pairs
from ftcm_core.report.page.shell import details, document, pre
from ftcm_core.report.table import (
    accommodation_table,
    comparison_table,
    detection_table,
    paper_table,
    settling_table,
)

_SEVERAL = 5
"""So many runs are named in the heading."""
NO_SCRIPT = "<noscript><p>The plots need JavaScript.</p></noscript>"
_MADE_ANEW = ("--output", "--name")
"""Options whose value is a name that must be a new one each time."""


@dataclasses.dataclass(frozen=True)
class Background:
    """What a page says beside the results."""

    command: tuple[str, ...] = ()
    """The command that made it, word by word."""
    sentences: tuple[str, ...] = ()
    """What else the verdict says: of real time, damage, a replay."""
    timing: tuple[Mapping[str, Any], ...] = ()
    """Distributions of jitter and latencies: ``title``, ``unit``, ``logX``, ``logY``, and ``curves``, each
    with ``run`` (its place), ``x`` and ``y``."""


NOTHING = Background()


def runs_page(
    summary: Mapping[str, Any],
    traces: Sequence[tuple[str, Trace]],
    scenarios: Mapping[str, str],
    more: str,
    background: Background,
) -> str:
    """Return the page as HTML.

    Args:
        summary: what ``summary.json`` has.
        traces: the runs with their labels, in the order of the results.
        scenarios: the name of the scenario file of each run that has one, beside the page, by label.
        more: what follows the tables, in Markdown.
        background: what else is said.
    """
    results = summary["results"]
    onsets = [t.fault_intervals[0].onset if t.fault_intervals else None for _, t in traces]
    data = page_data(traces)
    tables = (
        comparison_table(results), settling_table(results), detection_table(results),
        accommodation_table(results), paper_table(results),
    )  # fmt: skip
    timing = '<div id="timing-here"></div>' if background.timing else ""
    sections = [
        ("plots", "Over time", f'<div id="plots-here"></div>{NO_SCRIPT}{_drawn(data["interval"])}'),
        ("tables", "Tables", "\n".join(from_markdown(text) for text in tables if text)),
        ("timing", "Over the graph", from_markdown(more) + timing if more or timing else ""),
        ("scenario", "Scenario", _scenarios(traces, scenarios)),
        ("provenance", "Where it comes from", provenance_pairs(summary["provenance"])),
        ("again", "How to repeat it", _again(traces, scenarios, background.command, summary["provenance"])),
    ]
    verdict = [*conclusions(results, onsets), *background.sentences]
    return document(
        _title(traces), _about(traces), verdict, sections, {**data, "timing": list(background.timing)}
    )


def repeatable(command: Sequence[str]) -> str:
    """Return a command as one line for a shell; a folder that it makes is called NEW."""
    words = list(command)
    for place, word in enumerate(words):
        option, equals, _ = word.partition("=")
        if option in _MADE_ANEW and equals:
            words[place] = f"{option}=NEW"
        elif option in _MADE_ANEW and place + 1 < len(words):
            words[place + 1] = "NEW"
    return shlex.join(words)


def again(command: Sequence[str]) -> str:
    """Return the command that made a page, as HTML; nothing where it is not known."""
    if not command:
        return ""
    line = repeatable(command)
    where = f"<p>In the folder where it was run{', with a new folder NEW' if 'NEW' in line else ''}:</p>"
    return f'{where}<div class="command">{pre(line)}</div>'


def provenance_pairs(values: Mapping[str, Any]) -> str:
    """Return where numbers come from, as HTML."""
    return pairs({name: value for name, value in values.items() if value not in (None, "")})


def _again(
    traces: Sequence[tuple[str, Trace]],
    scenarios: Mapping[str, str],
    command: Sequence[str],
    provenance: Mapping[str, Any],
) -> str:
    plugins = [w for key in provenance if key.startswith("plug-in ") for w in ("--plugin", key[8:])]
    lines = []
    for label, trace in traces:
        if label in scenarios and not any(change.by == "" for change in trace.changes):
            engine = ["--engine", "compiled"] if trace.engine == "compiled" else []
            lines.append(shlex.join(["ftcm", "simulate", scenarios[label], *engine, *plugins]))
    if not lines:
        return again(command)
    recorded = any(trace.engine == "graph" for _, trace in traces)
    what = "The same experiment in process" if recorded else "The same numbers"
    own = f"<p>{what}, in the folder of this page, from the complete scenario:</p>"
    return again(command) + own + pre("\n".join(lines))


def _title(traces: Sequence[tuple[str, Trace]]) -> str:
    names = list(dict.fromkeys(t.scenario.name for _, t in traces if t.scenario))
    labels = [label for label, _ in traces]
    runs = ", ".join(labels) if len(labels) <= _SEVERAL else f"{len(labels)} runs"
    return f"{' and '.join(names)}: {runs}" if 0 < len(names) <= 2 else runs


def _about(traces: Sequence[tuple[str, Trace]]) -> str:
    found = []
    for _, trace in traces:
        if trace.scenario is None:
            continue
        s = trace.scenario
        faults = ", ".join(s.fault_labels) or "none"
        text = f"Robot {s.robot.type_name}, {s.duration:g} s at {1 / s.dt:g} Hz, faults: {faults}."
        found.append(text)
    several = list(dict.fromkeys(found))
    about = several[0] if len(several) == 1 else f"{len(several)} scenarios." if several else ""
    return f"{about} Written {datetime.datetime.now(datetime.timezone.utc):%Y-%m-%d %H:%M} UTC.".strip()


def _drawn(interval: float) -> str:
    """Say how curves are drawn."""
    if not interval:
        return '<p class="note">Every tick is drawn.</p>'
    return (
        f'<p class="note">Of every {1000 * interval:.3g} ms the tick with the smallest and the one with the '
        f"largest value are drawn, as they were recorded, so no peak is lost; from {BEFORE} ticks before to "
        f"{AFTER} ticks after the start, the onset of a fault, its first alarm and a decision (the first few "
        "of each run), every tick. What goes up and down many times within a pixel is drawn as an area.</p>"
    )


def _scenarios(traces: Sequence[tuple[str, Trace]], files: Mapping[str, str]) -> str:
    return "\n".join(
        details(f"{label} ({files.get(label, 'scenario')})", pre(trace.scenario.to_yaml()))
        for label, trace in traces
        if trace.scenario
    )


def write_page(folder: Path, html: str) -> None:
    """Write ``report.html``."""
    (folder / "report.html").write_text(html, encoding="utf-8")
