# SPDX-License-Identifier: Apache-2.0
"""Running a campaign over several processes."""

from __future__ import annotations

import collections
import contextlib
import importlib
import json
import tempfile
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from ftcm_core import compiled
from ftcm_core.campaign.folder import RUNS, begin, check_same, fingerprint, kept_results, locked
from ftcm_core.campaign.parquet import write_parquet
from ftcm_core.campaign.plan import Campaign, Run
from ftcm_core.campaign.statistics import Statistics, summary_of, table
from ftcm_core.extras import has
from ftcm_core.parallel import Processes, processes_of
from ftcm_core.recording.detection import detection_scores
from ftcm_core.recording.metrics import METRICS, evaluate
from ftcm_core.recording.provenance import provenance
from ftcm_core.recording.trace import Trace
from ftcm_core.report.results import to_json
from ftcm_core.scenario import Scenario
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
        return "auto" if has("numba") else "plain"
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


def _get_ready(engine: str) -> None:
    """Import what the runs need, while they are still being checked."""
    if engine != "plain":
        compiled.require_numba()
        importlib.import_module("numba")


def simulated(scenario: Scenario, engine: str) -> tuple[Trace, str]:
    """Run a scenario; return its trace and what ran it.

    Args:
        scenario: what to run.
        engine: one of :data:`ENGINES`; with ``auto``, a run that cannot be compiled is run plainly.

    Returns:
        The trace, and ``compiled``, ``plain``, or ``plain: `` and why it is.

    Raises:
        NotCompilable: with the engine ``compiled``.
    """
    if engine == "plain":
        return simulate(scenario), "plain"
    try:
        return compiled.simulate(scenario), "compiled"
    except compiled.NotCompilable as error:
        if engine == "compiled":
            raise
        return simulate(scenario), f"plain: {error}"


def run_one(campaign: Campaign, run: Run, engine: str) -> dict[str, Any]:
    """Run one run and return its result; the trace is not kept.

    Args:
        campaign: the campaign.
        run: one of its runs.
        engine: as of :func:`simulated`.

    Raises:
        NotCompilable: with the engine ``compiled``.
    """
    scenario = campaign.scenario(run)
    return result_of(campaign, run, *simulated(scenario, engine))


def result_of(campaign: Campaign, run: Run, trace: Trace, ran: str) -> dict[str, Any]:
    """Return the result of a run that was made: a line of ``runs.jsonl``.

    Args:
        campaign: the campaign.
        run: one of its runs.
        trace: what came out.
        ran: what ran it.
    """
    scored = trace.scenario and trace.scenario.detector
    return {
        **_identity(campaign, run),
        "status": trace.status,
        "detail": trace.detail,
        "engine": ran,
        "metrics": evaluate(trace),
        **({"detection": detection_scores(trace)} if scored else {}),
    }


def _identity(campaign: Campaign, run: Run) -> dict[str, Any]:
    """What a result says of which run it is."""
    return {
        "run": run.number,
        "contender": run.contender,
        "controller": run.controller,
        "set": campaign.settings(run),
    }


def run_campaign(
    campaign: Campaign,
    *,
    engine: str = "auto",
    jobs: int | Processes | None = None,
    folder: Path | None = None,
    resume: bool = False,
    progress: Callable[[int, int], None] | None = None,
    note: Callable[[str], None] = lambda text: None,
) -> dict[str, Any]:
    """Run a campaign.

    Args:
        campaign: what to run; all its scenarios are checked before the first run.
        engine: one of :data:`ENGINES`.
        jobs: number of processes; the number of cores by default. Or those of a cluster.
        folder: where ``runs.jsonl``, ``summary.json``, ``table.md`` and, with pyarrow, ``runs.parquet`` go.
        resume: whether the folder has a beginning of the same campaign, of which only the rest is run.
        progress: called with the runs done and their number, first before the first run.
        note: told before the first run, in one line each, what is run plainly and why.

    Returns:
        The summary.

    Raises:
        FtcmError: a scenario is not valid, numba is missing, ``compiled`` is impossible, or there is
            nothing to resume.
    """
    engine = chosen_engine(engine)
    runs = campaign.run_list()
    campaign.mapping()  # loads the plug-ins that it names
    about = {**provenance(), "engine": engine}
    with contextlib.ExitStack() as stack:
        workers = stack.enter_context(processes_of(jobs, len(runs)))
        if not resume:
            workers.begin(_get_ready, engine)
        for run in runs:
            campaign.scenario(run)
        lines = None
        if folder:
            identity = {
                "campaign": {k: v for k, v in campaign.to_mapping().items() if k != "scenario"},
                "engine": engine,
                "scenario_sha256": fingerprint(campaign.mapping()),
                "provenance": about,
            }
            if resume:
                for text in check_same(folder, identity):
                    note(f"warning: {text}; the runs that are there were made with the former")
            else:
                begin(folder, identity)
            lines = stack.enter_context(locked(folder / RUNS))
        found: dict[str, Statistics] = collections.defaultdict(
            lambda: Statistics(stack.enter_context(tempfile.TemporaryFile(dir=folder)))
        )
        following = 0
        if lines and not resume:
            lines.truncate()
        for result in kept_results(lines, (_identity(campaign, run) for run in runs)) if lines else ():
            found[result["contender"]].add(result)
            following += 1
        if following < len(runs):
            _prepare(campaign, runs, engine, note)
        if progress:
            progress(following, len(runs))
        for result in _results(campaign, runs, following, engine, workers, progress):
            found[result["contender"]].add(result)
            if lines:
                lines.write((to_json(result) + "\n").encode())
                lines.flush()
        summary = {
            "campaign": campaign.to_mapping(),
            **summary_of(found, campaign.runs),
            "units": {name: unit for name, (_, unit) in METRICS.items()},
            "provenance": about,
        }
        if folder:
            (folder / "summary.json").write_text(to_json(summary, indent=1) + "\n", encoding="utf-8")
            (folder / "table.md").write_text(table(summary), encoding="utf-8")
            if has("pyarrow"):
                said = {"campaign": campaign.to_mapping(), "provenance": about}
                write_parquet(folder / "runs.parquet", campaign, runs, read_runs(folder / RUNS), said)
    return summary


def _prepare(campaign: Campaign, runs: list[Run], engine: str, note: Callable[[str], None]) -> None:
    """Compile what each contender needs, once here, so that the processes find it compiled."""
    if engine == "plain":
        return
    for run in runs[: len(runs) // campaign.runs]:
        try:
            compiled.prepare(campaign.scenario(run))
        except compiled.NotCompilable as error:
            if engine == "compiled":
                raise
            note(f"{run.contender} runs plainly: {error}")


def _results(
    campaign: Campaign,
    runs: list[Run],
    first: int,
    engine: str,
    workers: Processes,
    progress: Callable[[int, int], None] | None,
) -> Iterator[dict[str, Any]]:
    """Run the runs from ``first`` on; yield their results in order, so that files do not depend on luck."""
    chunk = max(1, min(_CHUNK, len(runs) // (4 * max(1, workers.count))))
    work = [_Work(campaign, tuple(runs[i : i + chunk]), engine) for i in range(first, len(runs), chunk)]
    waiting: dict[int, list[dict[str, Any]]] = {}
    done, following = first, 0
    for index, results in workers.each(_do, work):
        waiting[index] = results
        done += len(results)
        if progress:
            progress(done, len(runs))
        while following in waiting:
            yield from waiting.pop(following)
            following += 1


def read_runs(path: Path) -> Iterator[dict[str, Any]]:
    """Yield the results in a ``runs.jsonl``."""
    with path.open(encoding="utf-8") as lines:
        for line in lines:
            yield json.loads(line)
