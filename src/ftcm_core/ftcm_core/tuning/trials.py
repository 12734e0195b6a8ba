# SPDX-License-Identifier: Apache-2.0
"""What a candidate is worth: its training runs, one after the other, while they hold what they must."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field

from ftcm_core.campaign.plan import Campaign, Run
from ftcm_core.campaign.running import simulated
from ftcm_core.errors import ScenarioError
from ftcm_core.parallel import Processes
from ftcm_core.recording.metrics import METRICS, windows
from ftcm_core.tuning.plan import Metric, Tuning

FAILED = 1e9
"""Objective of a candidate that has none, as one of its runs did not complete."""


@dataclass
class Candidate:
    """A set of parameters and what is known of it."""

    settings: tuple[str, ...]
    warnings: list[str] = field(default_factory=list)
    """Conditions that its parameters do not meet; then it is not run."""
    failure: str = ""
    """Why a run did not complete; then no further one is run."""
    results: list[dict[Metric, list[float]]] = field(default_factory=list)
    """Values per joint, of each run."""
    stopped: bool = False
    """Whether it is not worth another run."""

    @property
    def open(self) -> bool:
        """Whether another run is worth it."""
        return not (self.warnings or self.failure or self.stopped)

    def objectives(self, metrics: Sequence[Metric]) -> list[float]:
        """Return the means over joints and the runs so far."""
        if self.failure or not self.results:
            return [FAILED] * len(metrics)
        return [_mean(_mean(result[metric]) for result in self.results) for metric in metrics]

    def constraints(self, limits: Sequence[tuple[Metric, tuple[float, ...]]]) -> list[float]:
        """Return what must not be above zero: unmet conditions, failures, shares of limits exceeded."""
        found = [float(len(self.warnings)), 1.0 if self.failure else 0.0]
        for metric, most in limits:
            shares = [
                x / (most[joint] if len(most) > 1 else most[0]) - 1.0
                for result in self.results
                for joint, x in enumerate(result[metric])
            ]
            found.append(max(shares, default=1.0))
        return found


@dataclass(frozen=True)
class _Measurement:
    """One run of one candidate, for another process."""

    campaign: Campaign
    run: Run
    wanted: tuple[Metric, ...]
    engine: str


def _measure(job: _Measurement) -> tuple[str, dict[Metric, list[float]]]:
    """Why the run failed, empty if it did not, and its metrics."""
    trace, _ = simulated(job.campaign.scenario(job.run), job.engine)
    if trace.status != "completed":
        return f"run {job.run.number}: {trace.status}: {trace.detail}", {}
    rows, found = windows(trace), {}
    for window, metric in job.wanted:
        part = rows[window]
        values = [math.nan] if part is None else METRICS[metric][0](trace, part).tolist()
        if not all(map(math.isfinite, values)):
            return f"run {job.run.number}: has no {window}.{metric}", {}
        found[window, metric] = values
    return "", found


def measure(
    tuning: Tuning,
    candidates: Sequence[Candidate],
    workers: Processes,
    engine: str,
    after: Callable[[int, list[Candidate]], None] = lambda step, open: None,
) -> None:
    """Run the training runs of candidates, run by run, and note the results in them.

    Args:
        tuning: what is tuned.
        candidates: new ones.
        workers: who runs them.
        engine: as of a campaign.
        after: called after the first run of each, the second, and so on, with those that are still open; it
            may stop some.
    """
    runs = [tuning.runs(candidate.settings) for candidate in candidates]
    for candidate, planned in zip(candidates, runs):
        try:
            candidate.warnings = tuning.training.scenario(planned[0]).warnings()
        except ScenarioError as error:  # parameters that do not go together
            candidate.warnings = [str(error)]
    for step in range(tuning.training.runs):
        rest = [(c, planned[step]) for c, planned in zip(candidates, runs) if c.open]
        jobs = [_Measurement(tuning.training, run, tuning.wanted, engine) for _, run in rest]
        for index, (failure, found) in workers.each(_measure, jobs):
            candidate = rest[index][0]
            candidate.failure = failure
            if not failure:
                candidate.results.append(found)
        after(step, [c for c, _ in rest if c.open])


def _mean(values: Iterable[float]) -> float:
    found = list(values)
    return math.fsum(found) / len(found)
