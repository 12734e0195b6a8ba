# SPDX-License-Identifier: Apache-2.0
"""Campaigns: one scenario many times, some of its values drawn at random; statistics of the metrics.

Every varied path has a random stream of its own, seeded from (campaign seed, path), and run n takes its
n-th number: a further variation shifts no other, and every controller meets the same draws. A run is
reproduced exactly by ``ftcm simulate SCENARIO --controller NAME --set ...`` with the list it reports.
"""

from __future__ import annotations

import copy
import importlib.util
import json
import math
import os
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from ftcm_core import compiled
from ftcm_core.errors import FtcmError, ScenarioError, shown, suggestion
from ftcm_core.metrics import METRICS, evaluate
from ftcm_core.parallel import run_parallel
from ftcm_core.provenance import provenance
from ftcm_core.registry import find
from ftcm_core.report.results import to_json
from ftcm_core.scenario import Scenario, apply_override, from_mapping, read_mapping
from ftcm_core.simulation import simulate
from ftcm_core.streams import gaussian, stream_key, uniform
from ftcm_core.trace import ENDED_EARLY

MAX_RUNS = 1_000_000
ENGINES = ("auto", "compiled", "plain")
QUANTILES = {"median": 0.5, "q05": 0.05, "q95": 0.95}
SHOWN = (
    ("after_fault", "mean_abs_error"),
    ("after_fault", "max_abs_error"),
    ("after_transient", "torque_total_variation"),
)
"""What the table shows; ``summary.json`` has everything."""
_CHUNK = 5
"""Runs that a process is given at a time."""


@dataclass(frozen=True)
class Variation:
    """One varied value of the scenario."""

    path: str
    """Dotted path, as of ``--set``."""
    kind: str
    """One of :data:`DISTRIBUTIONS`."""
    arguments: tuple[str, ...]

    def __str__(self) -> str:
        return f"{self.path}={self.kind}({', '.join(self.arguments)})"

    def draw(self, seed: int, run: int) -> str:
        """Return the value of one run as YAML.

        Args:
            seed: the campaign's.
            run: number of the run, from 0.
        """
        return DISTRIBUTIONS[self.kind][1](self.arguments, stream_key(seed, f"campaign.{self.path}"), run)


def _uniform(arguments: Sequence[str], key: float, run: int) -> str:
    low, high = map(float, arguments)
    return repr(low + (high - low) * uniform(key, run))


def _loguniform(arguments: Sequence[str], key: float, run: int) -> str:
    low, high = (math.log(float(x)) for x in arguments)
    return repr(math.exp(low + (high - low) * uniform(key, run)))


def _normal(arguments: Sequence[str], key: float, run: int) -> str:
    mean, deviation = map(float, arguments)
    return repr(mean + deviation * gaussian(key, run))


def _integer(arguments: Sequence[str], key: float, run: int) -> str:
    low, high = map(int, arguments)
    return str(min(high, low + int((high - low + 1) * uniform(key, run))))


def _choice(arguments: Sequence[str], key: float, run: int) -> str:
    return arguments[min(len(arguments) - 1, int(len(arguments) * uniform(key, run)))]


DISTRIBUTIONS: dict[str, tuple[str, Callable[[Sequence[str], float, int], str]]] = {
    "uniform": ("uniform(LOW, HIGH)", _uniform),
    "loguniform": ("loguniform(LOW, HIGH), LOW > 0", _loguniform),
    "normal": ("normal(MEAN, DEVIATION), DEVIATION >= 0", _normal),
    "integer": ("integer(LOW, HIGH), both included", _integer),
    "choice": ("choice(VALUE, VALUE, ...)", _choice),
}
"""Distributions by name: how to write one, and its draw."""


def parse_variation(text: str) -> Variation:
    """Parse ``path=distribution(...)``.

    Raises:
        FtcmError: it is not one, with what was expected.
    """
    path, equals, rest = text.partition("=")
    match = re.fullmatch(r"\s*([A-Za-z_]+)\s*\((.*)\)\s*", rest, re.DOTALL)
    if not equals or not path.strip() or match is None:
        raise FtcmError(
            f"--vary {shown(text)}: expected path=distribution(...), e.g. observer.k1=uniform(1e4, 2e4)"
        )
    kind, inner = match[1], match[2]
    if kind not in DISTRIBUTIONS:
        raise FtcmError(f"--vary {path}: no distribution {shown(kind)}; {suggestion(kind, DISTRIBUTIONS)}")
    arguments = tuple(_split(inner))
    variation = Variation(path.strip(), kind, arguments)
    if not _fits(kind, arguments):
        raise FtcmError(f"--vary {path}: {shown(rest.strip())} is not {DISTRIBUTIONS[kind][0]}")
    return variation


def _split(text: str) -> Iterator[str]:
    """Arguments between commas that are in no bracket."""
    depth, begin = 0, 0
    for i, character in enumerate(text + ","):
        depth += (character in "([{") - (character in ")]}")
        if character == "," and depth == 0:
            yield text[begin:i].strip()
            begin = i + 1


def _fits(kind: str, arguments: Sequence[str]) -> bool:
    if kind == "choice":
        return len(arguments) > 0 and all(arguments)
    try:
        first, second = (int(x) if kind == "integer" else float(x) for x in arguments)
    except ValueError:
        return False
    if not (math.isfinite(first) and math.isfinite(second)) or abs(first) > 2**52 or abs(second) > 2**52:
        return False
    if kind == "normal":
        return second >= 0.0
    return first <= second and (kind != "loguniform" or first > 0.0)


@dataclass(frozen=True)
class Run:
    """One run of a campaign, small enough to send to another process."""

    number: int
    controller: str
    drawn: dict[str, str]
    """Path to value, as YAML."""


@dataclass(frozen=True)
class Campaign:
    """A scenario, what varies, and how often."""

    source: str
    """Scenario file or name of a shipped one."""
    runs: int = 100
    seed: int = 0
    variations: tuple[Variation, ...] = ()
    overrides: tuple[str, ...] = ()
    """The same in every run, as of ``--set``."""
    controllers: tuple[str, ...] = ()
    """Each runs with every draw; the scenario's own by default."""
    _read: list[Any] = field(default_factory=list, repr=False, compare=False)

    def __post_init__(self) -> None:
        """Check what can be checked without the scenario."""
        for name, value, low, high in (("runs", self.runs, 1, MAX_RUNS), ("seed", self.seed, 0, 2**63 - 1)):
            if isinstance(value, bool) or not isinstance(value, int) or not low <= value <= high:
                raise FtcmError(f"{name}: {shown(value)} is not a whole number in [{low}, {high}]")
        paths = [v.path for v in self.variations]
        for path in paths:
            if paths.count(path) > 1:
                raise FtcmError(f"--vary {path}: is varied twice")
        for name in self.controllers:
            find("controller", name)

    def run_list(self) -> list[Run]:
        """Return all runs: of each draw, one with each controller."""
        names = self.controllers or (self.scenario(Run(0, "", {})).controller.type_name,)
        return [
            Run(number, name, {v.path: v.draw(self.seed, number) for v in self.variations})
            for number in range(self.runs)
            for name in dict.fromkeys(names)
        ]

    def settings(self, run: Run) -> list[str]:
        """Return the ``--set`` list that reproduces a run."""
        return [*self.overrides, *(f"{path}={value}" for path, value in run.drawn.items())]

    def scenario(self, run: Run) -> Scenario:
        """Return the scenario of a run.

        Raises:
            ScenarioError: a value does not fit; the message names the run.
        """
        if not self._read:
            self._read.append(read_mapping(self.source))
        data, _, origin = self._read[0]
        data = copy.deepcopy(data)
        settings = self.settings(run)
        try:
            for text in [f"controller.type={run.controller}"] * bool(run.controller) + settings:
                apply_override(data, text)
            return from_mapping(data, origin=origin)
        except ScenarioError as error:
            if not run.drawn:
                raise
            drawn = " ".join(f"{path}={value}" for path, value in run.drawn.items())
            raise ScenarioError(f"run {run.number} (drawn {drawn}): {error}") from None

    def to_mapping(self) -> dict[str, Any]:
        """Return the campaign as plain data: what a campaign file has."""
        return {
            "scenario": self.source,
            "runs": self.runs,
            "seed": self.seed,
            "vary": {v.path: str(v).partition("=")[2] for v in self.variations},
            "set": list(self.overrides),
            "controllers": list(self.controllers),
        }


def is_campaign(data: Mapping[str, Any]) -> bool:
    """Whether the plain data of a YAML file are a campaign, not a scenario."""
    return "scenario" in data


def from_file(source: str) -> Campaign:
    """Return the campaign of a file, or of a scenario by itself.

    Raises:
        FtcmError: it is neither.
    """
    data, _, origin = read_mapping(source)
    if not is_campaign(data):
        return Campaign(source)
    known = ("scenario", "runs", "seed", "vary", "set", "controllers")
    data = {k: v for k, v in data.items() if k != "name" and v is not None}
    for key in data:
        if key not in known:
            raise FtcmError(f"{origin}: {shown(key)}: unknown key; {suggestion(shown(key), known)}")
    vary = data.get("vary", {})
    if not isinstance(vary, dict) or not all(isinstance(x, str) for v in vary.items() for x in v):
        raise FtcmError(f"{origin}: vary: expected a mapping of paths to distributions, e.g. uniform(1, 2)")
    for key in ("set", "controllers"):
        if not isinstance(data.get(key, []), list) or not all(isinstance(v, str) for v in data.get(key, [])):
            raise FtcmError(f"{origin}: {key}: {shown(data[key])} is not a list of texts")
    scenario = data.get("scenario")
    if not isinstance(scenario, str):
        raise FtcmError(f"{origin}: scenario: {shown(scenario)} is not a path or name")
    beside = Path(source).parent / scenario
    try:
        return Campaign(
            source=str(beside) if os.path.isfile(beside) else scenario,
            runs=data.get("runs", 100),
            seed=data.get("seed", 0),
            variations=tuple(parse_variation(f"{path}={text}") for path, text in vary.items()),
            overrides=tuple(data.get("set", ())),
            controllers=tuple(data.get("controllers", ())),
        )
    except FtcmError as error:
        raise FtcmError(f"{origin}: {error}") from None


# ---- running ----


def chosen_engine(engine: str) -> str:
    """Return ``compiled`` or ``plain``; ``auto`` is compiled where numba is installed.

    Raises:
        FtcmError: compiled was asked for and numba is not installed.
    """
    if engine == "auto":
        return "compiled" if importlib.util.find_spec("numba") else "plain"
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
        engine: ``compiled`` or ``plain``.
    """
    scenario = campaign.scenario(run)
    trace = compiled.simulate(scenario) if engine == "compiled" else simulate(scenario)
    return {
        "run": run.number,
        "controller": run.controller,
        "set": campaign.settings(run),
        "status": trace.status,
        "detail": trace.detail,
        "engine": getattr(trace, "engine", "plain"),
        "metrics": evaluate(trace),
    }


def run_campaign(
    campaign: Campaign,
    *,
    engine: str = "auto",
    jobs: int | None = None,
    folder: Path | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> dict[str, Any]:
    """Run a campaign.

    Args:
        campaign: what to run; all its scenarios are checked before the first run.
        engine: one of :data:`ENGINES`.
        jobs: number of processes; the number of cores by default.
        folder: where ``runs.jsonl``, ``summary.json`` and ``table.md`` go.
        progress: called with the runs done and their number.

    Returns:
        The summary.

    Raises:
        FtcmError: a scenario is not valid, or numba is missing.
    """
    engine = chosen_engine(engine)
    runs = campaign.run_list()
    for run in runs:
        campaign.scenario(run)
    if engine == "compiled":  # once here, so that the processes find it compiled
        for run in runs[: len(runs) // campaign.runs]:
            compiled.prepare(campaign.scenario(run))
    chunk = max(1, min(_CHUNK, len(runs) // (4 * (jobs or 1))))
    work = [_Work(campaign, tuple(runs[i : i + chunk]), engine) for i in range(0, len(runs), chunk)]
    found: dict[str, _Statistics] = {}
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
                    found.setdefault(result["controller"], _Statistics()).add(result)
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


class _Statistics:
    """What is kept of the runs of one controller: a row of numbers each."""

    def __init__(self) -> None:
        self.states: dict[str, int] = {}
        self.engines: dict[str, int] = {}
        self.columns: dict[tuple[str, str, int], list[float]] = {}

    def add(self, result: dict[str, Any]) -> None:
        self.states[result["status"]] = self.states.get(result["status"], 0) + 1
        self.engines[result["engine"]] = self.engines.get(result["engine"], 0) + 1
        if result["status"] != "completed":
            return
        for window, metrics in result["metrics"].items():
            for metric, values in (metrics or {}).items():
                for joint, x in enumerate(values):
                    column = self.columns.setdefault((window, metric, joint), [])
                    column.append(math.nan if x is None else x)

    def summary(self) -> dict[str, Any]:
        count = sum(self.states.values())
        metrics: dict[str, dict[str, dict[str, list[float | None]]]] = {}
        for (window, metric, _), column in self.columns.items():
            values = np.array(column)
            values = values[np.isfinite(values)]
            entry = metrics.setdefault(window, {}).setdefault(metric, {name: [] for name in QUANTILES})
            for name, q in QUANTILES.items():
                entry[name].append(float(np.quantile(values, q)) if len(values) else None)
        return {
            "runs": count,
            "completed": self.states.get("completed", 0) / count,
            **{status: self.states.get(status, 0) / count for status in ENDED_EARLY},
            "engines": self.engines,
            "metrics": metrics,
        }


def table(summary: Mapping[str, Any]) -> str:
    """Return the table of a summary, in Markdown: median [5 %, 95 %] over the completed runs."""
    lines = []
    for name, found in summary["results"].items():
        exceeded = (
            f", {100 * found['limit_exceeded']:.4g} % limit_exceeded" if found["limit_exceeded"] else ""
        )
        lines += [
            f"{name}: {found['runs']} runs, {100 * found['completed']:.4g} % completed, "
            f"{100 * found['diverged']:.4g} % diverged{exceeded}; median [5 %, 95 %] of the completed:",
            "",
        ]
        for engine, count in found["engines"].items():
            if engine not in ("compiled", "plain"):
                lines += [f"{count} of them ran {engine}", ""]
        rows = []
        for window, metric in SHOWN:
            entry = found["metrics"].get(window, {}).get(metric)
            if entry:
                cells = [
                    "-" if m is None else f"{m:.3g} [{a:.3g}, {b:.3g}]"
                    for m, a, b in zip(entry["median"], entry["q05"], entry["q95"])
                ]
                rows.append([window, f"{metric} ({summary['units'][metric]})", *cells])
        if rows:
            head = ["window", "metric", *(f"joint {j + 1}" for j in range(len(rows[0]) - 2))]
            lines += _aligned([head, *rows])
            lines.append("")
    return "\n".join(lines)


def _aligned(rows: list[list[str]]) -> list[str]:
    widths = [max(map(len, column)) for column in zip(*rows)]
    text = ["| " + " | ".join(x.ljust(w) for x, w in zip(row, widths)) + " |" for row in rows]
    return [text[0], "|" + "|".join("-" * (w + 2) for w in widths) + "|", *text[1:]]


def read_runs(path: Path) -> Iterator[dict[str, Any]]:
    """Yield the results in a ``runs.jsonl``."""
    with path.open(encoding="utf-8") as lines:
        for line in lines:
            yield json.loads(line)
