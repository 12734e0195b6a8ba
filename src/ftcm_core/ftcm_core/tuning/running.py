# SPDX-License-Identifier: Apache-2.0
"""A whole tuning: search, choice, and the comparison on runs that the search has not seen."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

from ftcm_core import compiled
from ftcm_core.campaign import statistics
from ftcm_core.campaign.folder import IDENTITY, begin, check_same, fingerprint, locked
from ftcm_core.campaign.running import chosen_engine, run_campaign
from ftcm_core.errors import FtcmError
from ftcm_core.extras import need
from ftcm_core.parallel import Processes, processes_of
from ftcm_core.recording.metrics import METRICS
from ftcm_core.recording.provenance import provenance
from ftcm_core.report.results import to_json
from ftcm_core.report.table import markdown
from ftcm_core.scenario import Scenario
from ftcm_core.scenario.yaml_text import dump_yaml
from ftcm_core.tuning.plan import Tuning
from ftcm_core.tuning.search import importances, search, settings_of
from ftcm_core.tuning.trials import Candidate, measure

TUNE = "tune.json"
BEST = "best.yaml"
HEAD = "# Parameters by ftcm tune; use them with: ftcm simulate SCENARIO --params THIS_FILE\n"
START, TUNED = "start", "tuned"


def run_tuning(
    tuning: Tuning,
    folder: Path,
    *,
    name: str = "",
    engine: str = "auto",
    jobs: int | Processes | None = None,
    resume: bool = False,
    progress: Callable[[int, int], None] | None = None,
    note: Callable[[str], None] = lambda text: None,
) -> dict[str, Any]:
    """Tune, and compare before and after.

    The folder has then ``best.yaml`` (a parameter file), ``summary.json``, ``trials.jsonl``, ``table.md``,
    ``journal.log`` (Optuna's) and ``held_out/``, the campaign of the comparison.

    Args:
        tuning: what is tuned.
        folder: where all goes; it must be there.
        name: what the result is called, e.g. the file's name.
        engine: as of a campaign.
        jobs: as of a campaign.
        resume: whether the folder has a beginning of the same tuning.
        progress: called with the trials done and their number, first before the first.
        note: told in one line each what runs plainly and why.

    Returns:
        The summary.

    Raises:
        FtcmError: Optuna is missing, nothing can be resumed, or no candidate met every condition.
    """
    need("optuna", "tune", "tuning")
    engine = chosen_engine(engine)
    about = {**provenance(), "engine": engine}
    identity = {
        "tuning": {k: v for k, v in tuning.to_mapping().items() if k not in ("training", "held_out")},
        **{
            key: {k: v for k, v in campaign.to_mapping().items() if k != "scenario"}
            for key, campaign in (("training", tuning.training), ("held_out", tuning.held_out))
        },
        "scenario_sha256": fingerprint(tuning.training.mapping()),
        "provenance": about,
    }
    if resume:
        for text in check_same(folder, identity, TUNE):
            note(f"warning: {text}; the trials that are there were made with the former")
    else:
        begin(folder, identity, TUNE)
    with locked(folder / TUNE), processes_of(jobs) as workers:
        if engine != "plain":
            _prepare(tuning, engine, note)
        start = Candidate(())
        measure(tuning, [start], workers, engine)
        objectives = start.objectives(tuning.objectives)
        trials = search(tuning, folder, workers, engine, objectives, resume=resume, progress=progress)
    (folder / "trials.jsonl").write_text("".join(to_json(t) + "\n" for t in trials), encoding="utf-8")
    before: dict[str, Any] = {
        "objectives": objectives,
        "feasible": max(start.constraints(tuning.limits)) <= 0.0,
        "constraints": start.constraints(tuning.limits),
        "said": "; ".join(start.warnings) or start.failure,
    }
    front = pareto([t for t in trials if t["feasible"]])
    if not front:
        said = sorted({t["said"] for t in trials if t["said"]})
        raise FtcmError(
            f"none of {len(trials)} trials met every condition"
            f"{f', e.g. {said[0]}' if said else ''}; widen the ranges or the limits, or take more trials"
        )
    best = choose(front, before["objectives"])
    settings = settings_of(best["parameters"])
    held_out = _compare(tuning, settings, folder / "held_out", engine, jobs, note)
    summary = {
        "tuning": tuning.to_mapping(),
        "start": before,
        "best": best,
        "pareto": front,
        "importances": importances(tuning, trials),
        "trials": {
            "complete": sum(t["state"] == "complete" for t in trials),
            "feasible": sum(t["feasible"] for t in trials),
            "stopped": sum(t["state"] == "stopped" for t in trials),
        },
        "held_out": {k: held_out[k] for k in ("results", "comparisons", "ranking", "units")},
        "provenance": about,
    }
    (folder / BEST).write_text(_parameter_file(tuning, summary, settings, name), encoding="utf-8")
    (folder / "summary.json").write_text(to_json(summary, indent=1) + "\n", encoding="utf-8")
    (folder / "table.md").write_text(table(summary), encoding="utf-8")
    return summary


def pareto(trials: Sequence[dict[str, Any]]) -> list[dict[str, Any]]:
    """Return the trials that no other beats in one objective without losing in another, by the first."""
    kept = [
        t
        for t in trials
        if not any(
            all(x <= y for x, y in zip(o["objectives"], t["objectives"]))
            and o["objectives"] != t["objectives"]
            for o in trials
        )
    ]
    return sorted(kept, key=lambda t: (t["objectives"], t["number"]))


def choose(front: Sequence[dict[str, Any]], start: Sequence[float]) -> dict[str, Any]:
    """Return the trial of a front that is best in the first objective and in no other worse than the start.

    If there is none: the one that is the least worse than the start in the others, as a ratio.
    """

    def worse(trial: dict[str, Any]) -> float:
        ratios = [x / y if y > 0.0 else math.inf for x, y in zip(trial["objectives"][1:], start[1:])]
        return max(1.0, *ratios) if ratios else 1.0

    return min(front, key=lambda t: (worse(t), t["objectives"], t["number"]))


def _prepare(tuning: Tuning, engine: str, note: Callable[[str], None]) -> None:
    try:
        compiled.prepare(tuning.start)
    except compiled.NotCompilable as error:
        if engine == "compiled":
            raise
        note(f"runs plainly: {error}")


def _compare(
    tuning: Tuning,
    settings: tuple[str, ...],
    folder: Path,
    engine: str,
    jobs: int | Processes | None,
    note: Callable[[str], None],
) -> dict[str, Any]:
    """Run start and result over the same draws, which the search has not seen."""
    contenders = ((START, tuning.settings), (TUNED, (*tuning.settings, *settings)))
    campaign = dataclasses.replace(tuning.held_out, contenders=contenders, _read={})
    folder.mkdir(exist_ok=True)
    return run_campaign(
        campaign, engine=engine, jobs=jobs, folder=folder, resume=(folder / IDENTITY).exists(), note=note
    )


def _parameter_file(tuning: Tuning, summary: Mapping[str, Any], settings: tuple[str, ...], name: str) -> str:
    """The parameters, every default written out, and where they come from."""
    scenario: Scenario = tuning.training.scenario(tuning.runs(settings)[0])
    found: dict[str, Any] = {"controller": scenario.controller.to_mapping()}
    if scenario.controller.needs_observer:
        found["observer"] = scenario.observer.to_mapping()
    best, mapping = summary["best"], tuning.to_mapping()
    found["tuning"] = {
        "file": name,
        "scenario": scenario.name,
        "trial": best["number"],
        **{key: mapping[key] for key in ("trials", "batch", "seed", "parameters", "limits")},
        "training": {key: mapping["training"][key] for key in ("runs", "seed", "vary", "set")},
        "objectives": {
            metric: {"start": before, "tuned": after}
            for metric, before, after in zip(
                mapping["objectives"], summary["start"]["objectives"], best["objectives"]
            )
        },
        **summary["provenance"],
    }
    return HEAD + dump_yaml(found, unicode=False)


def table(summary: Mapping[str, Any]) -> str:
    """Return the tables of a summary, in Markdown: the choice, the front, importances, and the comparison."""
    metrics = summary["tuning"]["objectives"]
    heads = [f"{m} ({METRICS[m.partition('.')[2]][1]})" for m in metrics]
    best, start, counts = summary["best"], summary["start"], summary["trials"]
    rows = [
        [START if not start["said"] else f"{START}: {start['said']}", *_numbers(start["objectives"])],
        [f"{TUNED} (trial {best['number']})", *_numbers(best["objectives"])],
    ]
    lines = [
        f"{summary['tuning']['trials']} trials, {counts['feasible']} of them meet every condition, "
        f"{counts['stopped']} were stopped early. In the training runs, mean over joints and runs:",
        "",
        markdown([["", *heads], *rows]),
        "",
        markdown([["parameter", "value"], *([k, _number(v)] for k, v in best["parameters"].items())]),
        "",
    ]
    if len(metrics) > 1:
        front = summary["pareto"]
        shown = front if len(front) <= 12 else [front[round(i * (len(front) - 1) / 11)] for i in range(12)]
        lines += [
            f"Pareto front, {len(shown)} of {len(front)} trials:",
            "",
            markdown([["trial", *heads], *([str(t["number"]), *_numbers(t["objectives"])] for t in shown)]),
            "",
        ]
    if summary["importances"]:
        names = list(best["parameters"])
        rows = [
            [n, *(f"{100 * summary['importances'][m].get(n, 0.0):.0f} %" for m in metrics)] for n in names
        ]
        lines += [
            "How much each parameter matters (PED-ANOVA):",
            "",
            markdown([["parameter", *heads], *rows]),
            "",
        ]
    return "\n".join([*lines, "In the runs held out:", "", statistics.table(summary["held_out"])])


def _numbers(values: Sequence[float]) -> list[str]:
    return [_number(x) for x in values]


def _number(value: float | int | str) -> str:
    return value if isinstance(value, str) else f"{value:.4g}"
