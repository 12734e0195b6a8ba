# SPDX-License-Identifier: Apache-2.0
"""Running a campaign over several processes."""

from __future__ import annotations

import importlib.util
import json
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from ftcm_core import compiled
from ftcm_core.campaign.plan import Campaign, Run
from ftcm_core.campaign.statistics import Statistics, table
from ftcm_core.parallel import run_parallel
from ftcm_core.recording.detection import detection_scores
from ftcm_core.recording.metrics import METRICS, evaluate
from ftcm_core.recording.provenance import provenance
from ftcm_core.report.results import to_json
from ftcm_core.simulation import simulate

ENGINES = ("auto", "compiled", "plain")
_CHUNK = 5
"""Runs that a process is given at a time."""


def chosen_engine(engine: str) -> str:
    """Return the engine that can be had: ``auto`` is plain where numba is not installed.

    Raises:
        FtcmError: compiled was asked for and numba is not installed.
    """
    if engine == "auto":
        return "auto" if importlib.util.find_spec("numba") else "plain"
    if engine == "compiled":
        compiled.require_numba()
    return engine


@dataclass(frozen=True)
class _Work:
    """Runs that one process does in one go."""

    campaign: Campaign
    runs: tuple[Run, ...]
    engine: str

    def __call__(self) -> list[dict[str, Any]]:
        return [run_one(self.campaign, run, self.engine) for run in self.runs]


def _do(work: _Work) -> list[dict[str, Any]]:
    return work()


def run_one(campaign: Campaign, run: Run, engine: str) -> dict[str, Any]:
    """Run one run and return its result; the trace is not kept.

    Args:
        campaign: the campaign.
        run: one of its runs.
        engine: one of :data:`ENGINES`; with ``auto``, a run that cannot be compiled is run plainly and its
            result says why.

    Raises:
        NotCompilable: with the engine ``compiled``.
    """
    scenario = campaign.scenario(run)
    ran = "plain"
    if engine == "plain":
        trace = simulate(scenario)
    else:
        try:
            trace, ran = compiled.simulate(scenario), "compiled"
        except compiled.NotCompilable as error:
            if engine == "compiled":
                raise
            trace, ran = simulate(scenario), f"plain: {error}"
    return {
        "run": run.number,
        "controller": run.controller,
        "set": campaign.settings(run),
        "status": trace.status,
        "detail": trace.detail,
        "engine": ran,
        "metrics": evaluate(trace),
        **({"detection": detection_scores(trace)} if scenario.detector else {}),
    }


def run_campaign(
    campaign: Campaign,
    *,
    engine: str = "auto",
    jobs: int | None = None,
    folder: Path | None = None,
    progress: Callable[[int, int], None] | None = None,
    note: Callable[[str], None] = lambda text: None,
) -> dict[str, Any]:
    """Run a campaign.

    Args:
        campaign: what to run; all its scenarios are checked before the first run.
        engine: one of :data:`ENGINES`.
        jobs: number of processes; the number of cores by default.
        folder: where ``runs.jsonl``, ``summary.json`` and ``table.md`` go.
        progress: called with the runs done and their number.
        note: told before the first run, in one line each, what is run plainly and why.

    Returns:
        The summary.

    Raises:
        FtcmError: a scenario is not valid, numba is missing, or ``compiled`` is impossible.
    """
    engine = chosen_engine(engine)
    runs = campaign.run_list()
    for run in runs:
        campaign.scenario(run)
    if engine != "plain":  # once here, so that the processes find it compiled
        for run in runs[: len(runs) // campaign.runs]:
            try:
                compiled.prepare(campaign.scenario(run))
            except compiled.NotCompilable as error:
                if engine == "compiled":
                    raise
                note(f"{run.controller} runs plainly: {error}")
    chunk = max(1, min(_CHUNK, len(runs) // (4 * (jobs or 1))))
    work = [_Work(campaign, tuple(runs[i : i + chunk]), engine) for i in range(0, len(runs), chunk)]
    found: dict[str, Statistics] = {}
    waiting: dict[int, list[dict[str, Any]]] = {}
    done = following = 0
    lines = (folder / "runs.jsonl").open("w", encoding="utf-8") if folder else None
    try:
        for index, results in run_parallel(_do, work, jobs):
            waiting[index] = results
            done += len(results)
            if progress:
                progress(done, len(runs))
            while following in waiting:  # written and counted in order, so that files do not depend on luck
                for result in waiting.pop(following):
                    found.setdefault(result["controller"], Statistics()).add(result)
                    if lines:
                        lines.write(to_json(result) + "\n")
                following += 1
    finally:
        if lines:
            lines.close()
    summary = {
        "campaign": campaign.to_mapping(),
        "results": {name: statistics.summary() for name, statistics in found.items()},
        "units": {name: unit for name, (_, unit) in METRICS.items()},
        "provenance": {**provenance(), "engine": engine},
    }
    if folder:
        (folder / "summary.json").write_text(to_json(summary, indent=1) + "\n", encoding="utf-8")
        (folder / "table.md").write_text(table(summary), encoding="utf-8")
    return summary


def read_runs(path: Path) -> Iterator[dict[str, Any]]:
    """Yield the results in a ``runs.jsonl``."""
    with path.open(encoding="utf-8") as lines:
        for line in lines:
            yield json.loads(line)
