# SPDX-License-Identifier: Apache-2.0
"""Commands that run something: ``simulate``, ``compare``, ``reproduce``, ``campaign``."""

from __future__ import annotations

import argparse
import dataclasses
import functools
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from ftcm_core import campaign, compiled
from ftcm_core.cli.calibration import detector_overrides
from ftcm_core.cli.machines import chosen_machines
from ftcm_core.cli.output import note, progress
from ftcm_core.errors import FtcmError, ScenarioError
from ftcm_core.parallel import run_parallel
from ftcm_core.recording.metrics import result
from ftcm_core.recording.table_file import table_formats
from ftcm_core.recording.trace import Trace
from ftcm_core.recording.trace_file import save_trace
from ftcm_core.registry import components, find
from ftcm_core.report.figures import figure_formats
from ftcm_core.report.page.of_campaign import campaign_page
from ftcm_core.report.page.of_runs import Background, write_page
from ftcm_core.report.results import labelled, new_folder, report, to_json, write_results, writing
from ftcm_core.report.table import PUBLISHED, status
from ftcm_core.scenario import Scenario, load, read_mapping, shipped_scenarios, with_plugins
from ftcm_core.scenario.parameter_files import parameter_overrides
from ftcm_core.simulation import simulate

Job = tuple[str, Scenario]
"""A label and what to run."""


def simulate_command(arguments: argparse.Namespace) -> int:
    """Run one scenario."""
    overrides = list(arguments.overrides)
    sources = _sources([arguments.scenario] if arguments.scenario else [], overrides)
    if len(sources) != 1:
        raise FtcmError(
            f"simulate runs one scenario, got {', '.join(sources) or 'none'}; expected e.g. paper"
        )
    _load_plugins(sources)
    if arguments.controller is not None:
        find("controller", arguments.controller)
    if arguments.observer is not None:
        find("observer", arguments.observer)
        overrides.insert(0, f"observer.type={arguments.observer}")
    overrides[:0] = [*parameter_overrides(arguments.params), *detector_overrides(arguments.detector_file)]
    scenario = load(sources[0], overrides, arguments.controller)
    figure_formats(arguments.figure_format)
    _tables(arguments)
    folder = new_folder(arguments.output) if arguments.output is not None else None
    label = scenario.controller.type_name
    _warn([(label, scenario)])
    if arguments.engine == "compiled":
        trace = compiled.simulate(scenario)
    elif sys.stderr is not None and sys.stderr.isatty():
        with progress("tick") as show:
            trace = simulate(scenario, progress=show)
    else:
        trace = simulate(scenario)
    found = result(trace)
    _print_results(found if arguments.json else [found])
    if folder:
        save_trace(folder / "trace.npz", trace)
        _write(folder, [(label, trace)], arguments)
    return 0


def compare_command(arguments: argparse.Namespace) -> int:
    """Run several controllers on one or more scenarios."""
    sources = _sources(arguments.scenarios, arguments.overrides)
    if not sources:
        raise FtcmError("compare runs one scenario or more; expected e.g. paper")
    _load_plugins(sources)
    overrides = [*detector_overrides(arguments.detector_file), *arguments.overrides]
    names: list[str] = arguments.controllers or list(components("controller"))
    for name in names:
        find("controller", name)
    jobs: list[Job] = []
    for source in sources:
        for name in dict.fromkeys(names):
            try:
                scenario = load(source, overrides, name)
            except ScenarioError as error:
                if arguments.controllers or not error.unsuited:
                    raise ScenarioError(f"with controller {name}: {error}") from None
                note(f"left out: {error}")
                continue
            jobs.append((name if len(sources) == 1 else f"{scenario.name}/{name}", scenario))
    return _run_all(jobs, arguments)


def reproduce_command(arguments: argparse.Namespace) -> int:
    """Repeat the paper's experiment."""
    paper = str(shipped_scenarios()["paper"])
    return _run_all([(name, load(paper, controller=name)) for name in PUBLISHED], arguments)


def _run_all(jobs: Sequence[Job], arguments: argparse.Namespace) -> int:
    """Run jobs in parallel, then print and write their results in the order of the jobs."""
    figure_formats(arguments.figure_format)
    _tables(arguments)
    folder = new_folder(arguments.output) if arguments.output is not None else None
    _warn(jobs)
    found: dict[int, tuple[dict[str, Any], Trace | None]] = {}
    for index, outcome in run_parallel(functools.partial(_run_job, keep_trace=folder is not None), jobs):
        found[index] = outcome
        note(f"[{len(found)}/{len(jobs)}] {jobs[index][0]}: {status(outcome[0])}")
    results = [found[i][0] for i in range(len(jobs))]
    _print_results({"results": results} if arguments.json else results)
    if folder:
        traces = [(label, found[i][1]) for i, (label, _) in enumerate(jobs)]
        kept = [(label, trace) for label, trace in traces if trace is not None]
        _write(folder, kept, arguments)
    return 0


def _tables(arguments: argparse.Namespace) -> tuple[str, ...]:
    if arguments.export is not None and arguments.output is None:
        raise FtcmError("--export needs a folder; expected --output DIR too")
    return table_formats(arguments.export)


def _write(folder: Path, traces: Sequence[tuple[str, Trace]], arguments: argparse.Namespace) -> None:
    """Write the results of runs, and say where the report is."""
    write_results(
        folder,
        traces,
        figures=not arguments.no_figures,
        formats=figure_formats(arguments.figure_format),
        tables=_tables(arguments),
        background=Background(command=arguments.command),
    )
    note(f"report: {folder / 'report.html'}")


def _print_results(found: dict[str, Any] | list[dict[str, Any]]) -> None:
    """Print one JSON object, or the tables of a list of results."""
    if isinstance(found, dict):
        print(to_json(found), flush=True)
    else:
        print(report(found), end="", flush=True)


def _run_job(job: Job, keep_trace: bool) -> tuple[dict[str, Any], Trace | None]:
    label, scenario = job
    trace = simulate(scenario)
    return labelled(label, trace), trace if keep_trace else None


def campaign_command(arguments: argparse.Namespace) -> int:
    """Run one scenario many times, values drawn at random."""
    overrides = list(arguments.overrides)
    sources = _sources([arguments.source] if arguments.source else [], overrides)
    if len(sources) != 1:
        raise FtcmError(
            f"campaign takes one scenario or campaign file, got {', '.join(sources) or 'none'}; "
            "expected e.g. paper"
        )
    planned = campaign.from_file(sources[0])
    varied = tuple(campaign.parse_variation(text) for text in arguments.vary)
    again = {v.path for v in varied}
    planned = dataclasses.replace(
        planned,
        runs=planned.runs if arguments.runs is None else arguments.runs,
        seed=planned.seed if arguments.seed is None else arguments.seed,
        variations=(*(v for v in planned.variations if v.path not in again), *varied),
        overrides=(
            *planned.overrides,
            *parameter_overrides(arguments.params),
            *detector_overrides(arguments.detector_file),
            *overrides,
        ),
        sampling=arguments.sampling or planned.sampling,
        controllers=tuple(arguments.controllers or planned.controllers),
        observers=tuple(arguments.observers or planned.observers),
        detectors=tuple(arguments.detectors or planned.detectors),
    )
    campaign.chosen_engine(arguments.engine)
    with chosen_machines(arguments) as jobs, progress("run") as show:
        folder = results_folder(arguments)
        summary = campaign.run_campaign(
            planned,
            engine=arguments.engine,
            jobs=jobs,
            folder=folder,
            resume=arguments.resume,
            progress=show,
            note=note,
        )
    text = campaign.table(summary)
    print(to_json(summary) if arguments.json else text, flush=True)
    if folder:
        with writing(folder):
            runs = campaign.read_runs(folder / "runs.jsonl")
            write_page(folder, campaign_page(summary, runs, text, arguments.command))
        note(f"report: {folder / 'report.html'}")
    return 0


def results_folder(arguments: argparse.Namespace) -> Path | None:
    """Return the folder of ``--output``, a new one unless ``--resume`` goes on with it.

    Raises:
        FtcmError: as of :func:`new_folder`, or ``--resume`` has no folder.
    """
    if arguments.output is None:
        if arguments.resume:
            raise FtcmError("--resume: expected --output DIR, the folder to go on with")
        return None
    return Path(arguments.output) if arguments.resume else new_folder(arguments.output)


def _load_plugins(sources: Sequence[str]) -> None:
    """Load what the scenario files name, before components are looked up by name."""
    for source in sources:
        data, _, origin = read_mapping(source)
        with_plugins(data, source, origin)


def _sources(named: Sequence[str], overrides: list[str]) -> list[str]:
    """Scenarios of a command; those written after ``--set`` are taken out of the overrides."""
    if named:
        return list(named)
    found: list[str] = []
    while overrides and "=" not in overrides[-1]:
        found.insert(0, overrides.pop())
    return found


def _warn(jobs: Sequence[Job]) -> None:
    for text in dict.fromkeys(w for _, scenario in jobs for w in scenario.warnings()):
        note(f"warning: {text}")
