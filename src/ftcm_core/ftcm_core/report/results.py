# SPDX-License-Identifier: Apache-2.0
"""Results of runs as files: JSON without NaN, a results folder, a trace on disk."""

from __future__ import annotations

import contextlib
import json
import math
import os
import re
import zipfile
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from ftcm_core.errors import FtcmError
from ftcm_core.metrics import result
from ftcm_core.provenance import provenance
from ftcm_core.registry import find
from ftcm_core.report.figures import write_figures
from ftcm_core.report.table import comparison_table, paper_table, settling_table
from ftcm_core.scenario import from_mapping
from ftcm_core.trace import COLUMNS, Change, Trace


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
) -> None:
    """Write ``summary.json``, ``table.md``, the scenarios and ``figures/`` of some runs.

    One run's complete scenario is ``scenario.yaml``; of several, each has ``scenario-<label>.yaml``.

    Args:
        folder: where to; it is made if it does not exist, files of the same name are replaced.
        traces: the runs with their labels.
        extra: more keys of ``summary.json``.
        more: what follows the tables in ``table.md``, in Markdown.
        figures: whether to draw the figures.

    Raises:
        FtcmError: matplotlib, for the figures, is not installed, and the other files are written before; or a
            file cannot be written.
    """
    results = [labelled(label, trace) for label, trace in traces]
    seeds = {t.scenario.seed for _, t in traces if t.scenario}
    seed = seeds.pop() if len(seeds) == 1 else None  # each result's configuration has its own
    summary = {"results": results, "provenance": {**provenance(), "seed": seed}, **(extra or {})}
    with writing(folder):
        folder.mkdir(parents=True, exist_ok=True)
        (folder / "summary.json").write_text(to_json(summary, indent=1) + "\n", encoding="utf-8")
        (folder / "table.md").write_text(report(results, more), encoding="utf-8")
        for label, trace in traces:
            if trace.scenario:
                name = "scenario" if len(traces) == 1 else f"scenario-{_slug(label)}"
                (folder / f"{name}.yaml").write_text(trace.scenario.to_yaml(), encoding="utf-8")
        if figures:
            write_figures(traces, folder / "figures")


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
    """Return a run's result with its label and what its controller warns of."""
    warnings = trace.scenario.controller.warnings() if trace.scenario else []
    return {"label": label, **result(trace), "warnings": warnings}


def report(results: Sequence[dict[str, Any]], more: str = "") -> str:
    """Return every table of some results, in Markdown, and what else is to be said."""
    tables = (comparison_table(results), settling_table(results), paper_table(results), more)
    return "\n".join(text for text in tables if text)


def save_trace(path: Path, trace: Trace) -> None:
    """Write a trace to a compressed NumPy archive, with its scenario, status and changes as JSON in it."""
    about = {
        "format": 1,
        "joint_names": trace.joint_names,
        "dt": trace.dt,
        "status": trace.status,
        "detail": trace.detail,
        "scenario": trace.scenario.to_mapping() if trace.scenario else None,
        "changes": [
            {"tick": c.tick, "kind": c.kind, "component": c.component.to_mapping()} for c in trace.changes
        ],
    }
    columns = {name: getattr(trace, name) for name in COLUMNS}
    np.savez_compressed(path, about=np.array(json.dumps(about)), time_ns=trace.time_ns, **columns)


def load_trace(path: Path) -> Trace:
    """Read a trace that :func:`save_trace` wrote.

    Raises:
        FtcmError: it cannot be read or is not a trace.
    """
    try:
        with np.load(path, allow_pickle=False) as archive:
            about = json.loads(str(archive["about"]))
            columns = {name: archive[name] for name in COLUMNS}
            time_ns = archive["time_ns"]
    except OSError as error:
        raise FtcmError(f"trace {str(path)!r} cannot be read: {error.strerror or error}") from None
    except (KeyError, ValueError, EOFError, zipfile.BadZipFile):
        raise FtcmError(
            f"{str(path)!r} is not a trace; expected a trace.npz of ftcm simulate --output"
        ) from None
    changes = []
    for change in about["changes"]:
        parameters = dict(change["component"])
        component = find(change["kind"], parameters.pop("type"))(**parameters)
        changes.append(Change(change["tick"], change["kind"], component))
    return Trace(
        joint_names=tuple(about["joint_names"]),
        dt=about["dt"],
        time_ns=time_ns,
        **columns,
        scenario=from_mapping(about["scenario"], origin=str(path)) if about["scenario"] else None,
        status=about["status"],
        detail=about["detail"],
        changes=tuple(changes),
    )


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
