# SPDX-License-Identifier: Apache-2.0
"""Results of runs as files: JSON without NaN, a results folder, a trace on disk."""

from __future__ import annotations

import contextlib
import json
import math
import os
import re
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from ftcm_core.errors import FtcmError
from ftcm_core.recording.detection import pooled_scores
from ftcm_core.recording.metrics import result
from ftcm_core.recording.provenance import provenance
from ftcm_core.recording.table_file import write_table
from ftcm_core.recording.trace import Trace
from ftcm_core.report.figures import write_figures
from ftcm_core.report.page.of_runs import NOTHING, Background, runs_page, write_page
from ftcm_core.report.table import (
    accommodation_table,
    comparison_table,
    detection_table,
    paper_table,
    settling_table,
)


def to_json(value: Any, indent: int | None = None) -> str:
    """Return plain data as JSON; floats that are not finite become null."""
    return json.dumps(_finite(value), allow_nan=False, indent=indent)


def new_folder(path: str | Path) -> Path:
    """Make a folder for results and its parents.

    Raises:
        FtcmError: it exists already, or cannot be made.
    """
    folder = Path(path)
    try:
        folder.mkdir(parents=True)
    except (OSError, ValueError) as error:  # ValueError: a name that no file can have
        if os.path.lexists(folder):
            raise FtcmError(f"output {str(folder)!r} exists already; choose a new folder") from None
        reason = getattr(error, "strerror", None) or str(error)
        raise FtcmError(f"output {str(folder)!r} cannot be made: {reason}; choose another folder") from None
    return folder


def write_results(
    folder: Path,
    traces: Sequence[tuple[str, Trace]],
    extra: Mapping[str, Any] | None = None,
    more: str = "",
    *,
    figures: bool = True,
    formats: Sequence[str] = ("png",),
    tables: Sequence[str] = (),
    background: Background = NOTHING,
) -> None:
    """Write ``summary.json``, ``table.md``, ``report.html``, the scenarios and ``figures/`` of some runs.

    One run's complete scenario is ``scenario.yaml``; of several, each has ``scenario-<label>.yaml``. The
    signals of a run are in ``tables/<label>.csv`` or ``.parquet``, if that is asked for.

    Args:
        folder: where to; it is made if it does not exist, files of the same name are replaced.
        traces: the runs with their labels.
        extra: more keys of ``summary.json``.
        more: what follows the tables in ``table.md``, in Markdown.
        figures: whether to draw the figures.
        formats: their file formats.
        tables: file formats of the signals, of :data:`~ftcm_core.recording.table_file.TABLE_FORMATS`.
        background: what else ``report.html`` says.

    Raises:
        FtcmError: matplotlib, for the figures, is not installed, and the other files are written before; or a
            file cannot be written.
    """
    results = [labelled(label, trace) for label, trace in traces]
    seeds = {t.scenario.seed for _, t in traces if t.scenario}
    seed = seeds.pop() if len(seeds) == 1 else None  # each result's configuration has its own
    scores = [one["detection"] for one in results if one["detection"]]
    detection = {"detection": pooled_scores(scores)} if scores else {}
    summary = {"results": results, **detection, "provenance": {**provenance(), "seed": seed}, **(extra or {})}
    with writing(folder):
        folder.mkdir(parents=True, exist_ok=True)
        (folder / "summary.json").write_text(to_json(summary, indent=1) + "\n", encoding="utf-8")
        (folder / "table.md").write_text(report(results, more), encoding="utf-8")
        files = {}
        for label, trace in traces:
            if trace.scenario:
                name = "scenario" if len(traces) == 1 else f"scenario-{_slug(label)}"
                files[label] = f"{name}.yaml"
                (folder / files[label]).write_text(trace.scenario.to_yaml(), encoding="utf-8")
        for suffix in tables:
            (folder / "tables").mkdir(exist_ok=True)
            for label, trace in traces:
                write_table(folder / "tables" / f"{_slug(label)}.{suffix}", trace)
        write_page(folder, runs_page(summary, traces, files, more, background))
        if figures:
            write_figures(traces, folder / "figures", formats)


@contextlib.contextmanager
def writing(folder: Path) -> Iterator[None]:
    """Say in one line where results could not be written, and why: a full disk, say.

    Raises:
        FtcmError: instead of an OSError.
    """
    try:
        yield
    except OSError as error:
        raise FtcmError(f"results cannot be written to {str(folder)!r}: {error.strerror or error}") from None


def labelled(label: str, trace: Trace) -> dict[str, Any]:
    """Return a run's result with its label and what its controller and observer warn of."""
    warnings = trace.scenario.warnings() if trace.scenario else []
    return {"label": label, **result(trace), "warnings": warnings}


def report(results: Sequence[dict[str, Any]], more: str = "") -> str:
    """Return every table of some results, in Markdown, and what else is to be said."""
    tables = (
        comparison_table(results),
        settling_table(results),
        detection_table(results),
        accommodation_table(results),
        paper_table(results),
        more,
    )
    return "\n".join(text for text in tables if text)


def _finite(value: Any) -> Any:
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    if isinstance(value, Mapping):
        return {str(k): _finite(v) for k, v in value.items()}
    if isinstance(value, (list, tuple)):
        return [_finite(v) for v in value]
    return value


def _slug(label: str) -> str:
    return re.sub(r"[^A-Za-z0-9._-]+", "-", label).strip("-.") or "run"
