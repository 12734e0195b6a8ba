# SPDX-License-Identifier: Apache-2.0
"""A trace as a file: a compressed NumPy archive of its columns, with the scenario in it."""

from __future__ import annotations

import json
import zipfile
from pathlib import Path
from typing import Any

import numpy as np

from ftcm_core.errors import FtcmError
from ftcm_core.recording.trace import Change, Decision, FaultEvent, FaultOrder, Trace
from ftcm_core.registry import find
from ftcm_core.scenario import from_mapping
from ftcm_core.signals import COLUMNS


def save_trace(path: Path, trace: Trace) -> None:
    """Write a trace to a compressed NumPy archive, with its scenario, status and changes as JSON in it."""
    about = {
        "format": 1,
        "joint_names": trace.joint_names,
        "dt": trace.dt,
        "status": trace.status,
        "detail": trace.detail,
        "ended_at": trace.ended_at,
        "engine": trace.engine,
        "scenario": trace.scenario.to_mapping() if trace.scenario else None,
        "changes": [
            {"tick": c.tick, "kind": c.kind, "component": c.component.to_mapping(), "by": c.by}
            for c in trace.changes
        ],
        "fault_events": trace.fault_events,
        "decisions": trace.decisions,
    }
    columns: dict[str, Any] = trace.columns
    np.savez_compressed(path, about=np.array(json.dumps(about)), time_ns=trace.time_ns, **columns)


def load_trace(path: Path) -> Trace:
    """Read a trace that :func:`save_trace` wrote; plug-ins that its components come from must be loaded.

    Raises:
        FtcmError: it cannot be read or is not a trace.
    """
    try:
        with np.load(path, allow_pickle=False) as archive:
            about = json.loads(str(archive["about"]))
            columns = {name: archive[name] for name in COLUMNS if name in archive or not COLUMNS[name].when}
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
        component: Any
        if change["kind"] == "fault":
            component = FaultOrder(**parameters)
        else:
            component = find(change["kind"], parameters.pop("type"))(**parameters)
        changes.append(Change(change["tick"], change["kind"], component, change.get("by", "")))
    return Trace(
        joint_names=tuple(about["joint_names"]),
        dt=about["dt"],
        time_ns=time_ns,
        **columns,
        scenario=from_mapping(about["scenario"], origin=str(path)) if about["scenario"] else None,
        status=about["status"],
        detail=about["detail"],
        ended_at=about.get("ended_at"),
        engine=about.get("engine", "plain"),
        changes=tuple(changes),
        fault_events=tuple([FaultEvent(*event) for event in about.get("fault_events", ())]),
        decisions=tuple([Decision(*decision) for decision in about.get("decisions", ())]),
    )
