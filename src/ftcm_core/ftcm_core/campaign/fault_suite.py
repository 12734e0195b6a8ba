# SPDX-License-Identifier: Apache-2.0
"""Every fault of the library against every law: one short run each, and what can be said of all of them."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np

from ftcm_core.errors import FtcmError, ScenarioError, suggestion
from ftcm_core.faults import TOPICS, CommunicationFault, Fault, JointFault
from ftcm_core.faults.tip_force import TipFault
from ftcm_core.parallel import Processes, run_parallel
from ftcm_core.params import specs
from ftcm_core.recording.detection import detection_scores
from ftcm_core.recording.metrics import result
from ftcm_core.recording.trace import ENDED_EARLY
from ftcm_core.registry import components
from ftcm_core.scenario import Scenario, load, replace
from ftcm_core.sensors.encoder import Encoder
from ftcm_core.simulation import simulate

MISMATCH = 0.2
"""How wrong the model is in the conditions that have a wrong one: masses and inertias, relative."""
NO_FAULT = "none"
"""Name of the run without a fault."""


def conditions() -> dict[str, Callable[[Scenario], Scenario]]:
    """Return what a suite can be run under: how each changes the scenario."""
    return {
        "ideal": lambda scenario: scenario,
        "encoder": lambda scenario: replace(scenario, sensor=Encoder()),
        "heavier_model": lambda scenario: replace(scenario, model=_scaled(scenario, 1.0 + MISMATCH)),
        "lighter_model": lambda scenario: replace(scenario, model=_scaled(scenario, 1.0 - MISMATCH)),
    }


def _scaled(scenario: Scenario, factor: float) -> Any:
    """The model with all masses and inertias scaled."""
    model = scenario.model
    changes = {
        name: tuple([x * factor for x in value]) if isinstance(value, tuple) else value * factor
        for name, value in model.values.items()
        if specs(type(model))[name].unit in ("kg", "kg·m²") and value is not None
    }
    if not changes:
        raise FtcmError(
            f"robot {model.type_name!r} has no parameter in kg or kg·m²; choose another condition"
        )
    return dataclasses.replace(model, **changes)  # type: ignore[type-var]


@dataclasses.dataclass(frozen=True)
class Suite:
    """What is run: every combination of a fault, a law and a condition."""

    scenario: str = "paper"
    """File or name of a shipped scenario; its faults are left out."""
    controllers: tuple[str, ...] = ("smc", "nftsmc", "ftcm")
    faults: tuple[str, ...] = ()
    """Names of faults; empty: all that suit the robot."""
    joints: tuple[int, ...] = (2,)
    """Joints that break, one in each run, from 1."""
    conditions: tuple[str, ...] = ("ideal",)
    onset: float = 3.0
    """When faults begin, s."""
    duration: float = 6.0
    """Length of each run, s."""
    overrides: tuple[str, ...] = ()


@dataclasses.dataclass(frozen=True)
class _Job:
    fault: str
    joint: int
    controller: str
    condition: str
    scenario: Scenario


def faults_of(suite: Suite, base: Scenario) -> list[tuple[str, int, Fault]]:
    """Return the faults of a suite at their defaults: name, joint (0: none of its own), fault.

    Raises:
        FtcmError: an unknown name, or a fault that does not suit the robot.
    """
    known = components("fault")
    for name in suite.faults:
        if name not in known:
            raise FtcmError(f"no fault {name!r}; {suggestion(name, known)}")
    found: list[tuple[str, int, Fault]] = []
    for name in suite.faults or known:
        cls: Any = known[name]
        if issubclass(cls, JointFault) and not issubclass(cls, TipFault):
            made = [(name, j, cls(start=suite.onset, joint=j)) for j in suite.joints]
        elif issubclass(cls, CommunicationFault):
            made = [(f"{name} ({topic})", 0, cls(start=suite.onset, topic=topic)) for topic in TOPICS]
        else:
            made = [(name, 0, cls(start=suite.onset))]
        for label, joint, fault in made:
            try:
                replace(base, faults=(fault,))
            except ScenarioError as error:
                if suite.faults:
                    raise FtcmError(f"fault {name}: {error}") from None
                continue  # it does not suit this robot
            found.append((label, joint, fault))
    return found


def run_suite(
    suite: Suite, jobs: int | Processes | None = None, progress: Callable[[int, int], None] | None = None
) -> list[dict[str, Any]]:
    """Run a suite over several processes.

    Args:
        suite: what to run.
        jobs: as of a campaign.
        progress: called with the runs done and how many there are.

    Returns:
        One row per run, as of :func:`row`, sorted by condition, fault, joint and law.

    Raises:
        FtcmError: something of the suite makes no sense.
    """
    known = conditions()
    for name in suite.conditions:
        if name not in known:
            raise FtcmError(f"no condition {name!r}; {suggestion(name, known)}")
    if not 0.0 < suite.onset < suite.duration:
        raise FtcmError(f"onset: {suite.onset:g} s; expected between 0 and the duration {suite.duration:g} s")
    planned: list[_Job] = []
    for controller in suite.controllers:
        overrides = [f"duration={suite.duration!r}", "injection.faults=[]", *suite.overrides]
        base = load(suite.scenario, overrides, controller)
        for joint in suite.joints:
            if not 1 <= joint <= base.robot.joints:
                raise FtcmError(f"joint {joint}: expected 1 to {base.robot.joints}")
        for condition in suite.conditions:
            changed = known[condition](base)
            planned.append(_Job(NO_FAULT, 0, controller, condition, changed))
            planned += [
                _Job(name, joint, controller, condition, replace(changed, faults=(fault,)))
                for name, joint, fault in faults_of(suite, changed)
            ]
    rows: dict[int, dict[str, Any]] = {}
    for index, found in run_parallel(_run, planned, jobs):
        rows[index] = {**found, "onset": suite.onset}
        if progress:
            progress(len(rows), len(planned))
    order = {name: i for i, name in enumerate(suite.controllers)}
    return sorted(
        rows.values(),
        key=lambda r: (
            r["condition"],
            r["fault"] != NO_FAULT,
            r["fault"],
            r["joint"],
            order[r["controller"]],
        ),
    )


def _run(job: _Job) -> dict[str, Any]:
    trace = simulate(job.scenario)
    about = {name: getattr(job, name) for name in ("condition", "fault", "joint", "controller")}
    found = result(trace)
    window = found["metrics"]["after_fault"] or found["metrics"]["after_transient"] or {}
    ended = trace.status in ENDED_EARLY

    def worst(metric: str) -> float | None:
        values = window.get(metric) or [None]
        return None if ended or None in values else max(values)

    peak = float(np.max(np.abs(trace.command))) if not ended else math.nan
    seen = (detection_scores(trace) or {}).get("faults") or [{}]
    return {
        **about,
        "site": job.scenario.faults[0].site if job.scenario.faults else "",
        "status": trace.status,
        "rms_error": worst("rms_error"),
        "max_abs_error": worst("max_abs_error"),
        "torque_total_variation": worst("torque_total_variation"),
        "peak_torque": peak if math.isfinite(peak) else None,
        **(
            {"detection_delay": None, "verdict": None, "verdict_joint": None} if job.scenario.detector else {}
        ),
        **{new: seen[0][old] for new, old in SEEN.items() if old in seen[0]},
    }


SEEN = {"detection_delay": "delay", "verdict": "verdict", "verdict_joint": "verdict_joint"}
"""What a row has besides where the scenario has a detector, by its name in the scores of a run."""
METRICS = {
    "rms_error": "RMS of the tracking error after the onset, mrad, of the worst joint",
    "max_abs_error": "Largest tracking error after the onset, mrad, of the worst joint",
    "torque_total_variation": "Total variation of the command after the onset, N·m/s, of the worst joint",
    "peak_torque": "Largest commanded torque of the whole run, N·m, of any joint",
}
"""Numbers of a row, and what they are in the tables; errors are in rad in the rows."""

DETECTION = (
    "After how long the detector told the fault, ms, what it said most of the time, and of which joint"
)


def tables(rows: Sequence[Mapping[str, Any]], metrics: Sequence[str] = tuple(METRICS)) -> str:
    """Return the rows as Markdown: per condition and metric, faults against laws; the best in bold.

    A run that ended early says how.
    """
    lines: list[str] = []
    laws = list(dict.fromkeys(r["controller"] for r in rows))
    for condition in dict.fromkeys(r["condition"] for r in rows):
        mine = [r for r in rows if r["condition"] == condition]
        cells = {(r["fault"], r["joint"], r["controller"]): r for r in mine}
        for metric in metrics:
            lines += [f"**{condition}**: {METRICS[metric]}", ""]
            lines += [f"| fault | joint | {' | '.join(laws)} |", "|---|---|" + "---|" * len(laws)]
            for fault, joint in dict.fromkeys((r["fault"], r["joint"]) for r in mine):
                row = [cells.get((fault, joint, law)) for law in laws]
                values = [r[metric] for r in row if r and r[metric] is not None]
                best = min(values, default=None)
                texts = [_text(r, metric, best) for r in row]
                lines.append(f"| {fault} | {joint or '–'} | {' | '.join(texts)} |")
            lines.append("")
        if any("verdict" in r for r in mine):
            lines += [f"**{condition}**: {DETECTION}", ""]
            lines += [f"| fault | joint | {' | '.join(laws)} |", "|---|---|" + "---|" * len(laws)]
            for fault, joint in dict.fromkeys((r["fault"], r["joint"]) for r in mine):
                texts = [_said(cells.get((fault, joint, law))) for law in laws]
                lines.append(f"| {fault} | {joint or '–'} | {' | '.join(texts)} |")
            lines.append("")
    return "\n".join(lines)


def _said(row: Mapping[str, Any] | None) -> str:
    if row is None or row.get("detection_delay") is None:
        return "–"
    return f"{1000.0 * row['detection_delay']:,.3g}, {row['verdict']} {row['verdict_joint'] or ''}".strip()


def _text(row: Mapping[str, Any] | None, metric: str, best: float | None) -> str:
    if row is None:
        return "–"
    value = row[metric]
    if value is None:
        return str(row["status"]).replace("_", " ")
    text = f"{1000.0 * value if 'error' in metric else value:,.3g}"
    return f"**{text}**" if value == best else text


def summary(rows: Sequence[Mapping[str, Any]]) -> str:
    """Return per condition and law, in Markdown: how many faults it survives, in how many it is the best."""
    lines = [
        "| condition | law | faults | ended early | smallest RMS error | median RMS error, mrad "
        "| median torque variation, N·m/s |",
        "|---|---|---|---|---|---|---|",
    ]
    laws = list(dict.fromkeys(r["controller"] for r in rows))
    for condition in dict.fromkeys(r["condition"] for r in rows):
        mine = [r for r in rows if r["condition"] == condition and r["fault"] != NO_FAULT]
        best: dict[tuple[str, int], float] = {}
        for r in mine:
            if r["rms_error"] is not None:
                key = (r["fault"], r["joint"])
                best[key] = min(best.get(key, math.inf), r["rms_error"])
        for law in laws:
            own = [r for r in mine if r["controller"] == law]
            done = [r for r in own if r["rms_error"] is not None]
            wins = sum(r["rms_error"] == best[r["fault"], r["joint"]] for r in done)
            middle = [
                f"{factor * float(np.median([r[m] for r in done])):,.3g}" if done else "–"
                for m, factor in (("rms_error", 1000.0), ("torque_total_variation", 1.0))
            ]
            cells = (condition, law, len(own), len(own) - len(done), wins, *middle)
            lines.append(f"| {' | '.join(map(str, cells))} |")
    return "\n".join(lines) + "\n"
