# SPDX-License-Identifier: Apache-2.0
"""Choosing candidates with Optuna: TPE (Bergstra et al. 2011; Ozaki et al. 2022 for several objectives).

Candidates come in batches of a fixed size, and every batch has a sampler of its own, seeded with its number.
So the search depends neither on the number of processes nor on whether it was ended and resumed in between:
of an ended search the complete batches are kept. A candidate that failed is not run again. With one
objective, one that is worse than the median after as many runs is not either (Optuna's MedianPruner). The
first candidate is the start, as far as it lies in the ranges.

Optuna gets the logarithms of the objectives. With several of them it is told, as a constraint, to be in none
worse than the start: what lies beyond is a front without end.
"""

from __future__ import annotations

import math
import os
import warnings
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

from ftcm_core.campaign.variation import Variation
from ftcm_core.errors import FtcmError
from ftcm_core.parallel import Processes
from ftcm_core.random_streams import stream_key
from ftcm_core.tuning.plan import Tuning, value_at
from ftcm_core.tuning.trials import Candidate, measure

JOURNAL = "journal.log"
NAME = "tune"
OUTCOME = "outcome"
"""Attribute of a trial in the journal: objectives, constraints, runs, why not more."""


SMALLEST = 1e-300
"""Objectives that are smaller, or zero, count as this."""


def search(
    tuning: Tuning,
    folder: Path,
    workers: Processes,
    engine: str,
    start: Sequence[float],
    *,
    resume: bool,
    progress: Callable[[int, int], None] | None = None,
) -> list[dict[str, Any]]:
    """Search; the trials are kept in the folder's ``journal.log``, which Optuna and its dashboard read.

    Args:
        tuning: what is tuned.
        folder: where the journal is or will be.
        workers: who runs.
        engine: as of a campaign.
        start: objectives of the start.
        resume: whether a journal of the same search is there.
        progress: called with the trials done and their number, first before the first.

    Returns:
        The trials: ``number``, ``parameters`` (path to value), ``state`` (``complete`` or ``stopped``),
        ``objectives``, ``constraints``, ``feasible``, ``runs`` (how many were run), ``said`` (why not more).
    """
    import optuna

    optuna.logging.set_verbosity(optuna.logging.WARNING)
    study = _study(tuning, folder / JOURNAL, resume)
    space = {p.path: _distribution(p) for p in tuning.parameters}
    one = len(tuning.objectives) == 1
    done = len(study.trials)
    if done == 0:
        study.enqueue_trial(_start(tuning, space))
    if progress:
        progress(done, tuning.trials)
    while done < tuning.trials:
        study.sampler = _sampler(tuning, done // tuning.batch)
        asked = [study.ask(space) for _ in range(min(tuning.batch, tuning.trials - done))]
        candidates = [Candidate(settings_of(trial.params)) for trial in asked]
        trial_of = {id(c): trial for c, trial in zip(candidates, asked)}

        def prune(step: int, still: list[Candidate], trial_of: Any = trial_of) -> None:
            for candidate in still if one and step + 1 < tuning.training.runs else ():
                trial = trial_of[id(candidate)]
                trial.report(_scale(candidate.objectives(tuning.objectives))[0], step)
                candidate.stopped = bool(trial.should_prune())

        measure(tuning, candidates, workers, engine, prune)
        for candidate, trial in zip(candidates, asked):
            outcome: dict[str, Any] = {
                "objectives": candidate.objectives(tuning.objectives),
                "constraints": candidate.constraints(tuning.limits),
                "runs": len(candidate.results),
                "said": "; ".join(candidate.warnings) or candidate.failure,
                "stopped": candidate.stopped,
            }
            trial.set_user_attr(OUTCOME, outcome)
            for name, value in zip(_constraint_names(tuning), outcome["constraints"]):
                trial.set_constraint(name, value)
            for metric, x, x0 in zip(tuning.objectives, *map(_scale, (outcome["objectives"], start))):
                if not one:
                    trial.set_constraint(f"{'.'.join(metric)} as at the start", x - x0)
            state = optuna.trial.TrialState.PRUNED if candidate.stopped else None
            study.tell(trial, None if state else _scale(outcome["objectives"]), state=state)
        done += len(asked)
        if progress:
            progress(done, tuning.trials)
    return [_plain(trial) for trial in study.trials]


def _scale(objectives: Sequence[float]) -> list[float]:
    """Objectives as the search sees them: their decades, as those of a front span several."""
    return [math.log10(max(x, SMALLEST)) for x in objectives]


def _start(tuning: Tuning, space: Mapping[str, Any]) -> dict[str, Any]:
    """What the first candidate takes over of the start: the parameters that lie in their ranges."""
    found: dict[str, Any] = {}
    start = tuning.start
    for path, distribution in space.items():
        value = value_at(start, path)
        text = str(value)
        if isinstance(value, (int, float)) and hasattr(distribution, "low"):
            if distribution.low <= value <= distribution.high:
                found[path] = value
        elif text in getattr(distribution, "choices", ()):
            found[path] = text
    return found


def settings_of(parameters: dict[str, Any]) -> tuple[str, ...]:
    """Return parameters as of ``--set``."""
    return tuple(f"{path}={x if isinstance(x, str) else repr(x)}" for path, x in parameters.items())


def importances(tuning: Tuning, trials: list[dict[str, Any]]) -> dict[str, dict[str, float]]:
    """Return by objective how much each parameter matters, as shares (PED-ANOVA, Watanabe et al. 2023).

    Of the feasible trials; empty for fewer than ten.
    """
    import optuna

    space = {p.path: _distribution(p) for p in tuning.parameters}
    feasible = [t for t in trials if t["feasible"]]
    found: dict[str, dict[str, float]] = {}
    if len(feasible) < 10:
        return found
    for i, metric in enumerate(tuning.objectives):
        study = optuna.create_study()
        study.add_trials(
            [
                optuna.trial.create_trial(
                    params=t["parameters"], distributions=space, value=t["objectives"][i]
                )
                for t in feasible
            ]
        )
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            evaluator = optuna.importance.PedAnovaImportanceEvaluator()
            shares = optuna.importance.get_param_importances(study, evaluator=evaluator)
        found[".".join(metric)] = {path: float(share) for path, share in shares.items()}
    return found


def _study(tuning: Tuning, path: Path, resume: bool) -> Any:
    """The study in a journal; of one that was ended, with its complete batches."""
    import optuna
    from optuna.storages import JournalStorage
    from optuna.storages.journal import JournalFileBackend

    kept: list[Any] = []
    if resume and path.exists():
        for lock in path.parent.glob(f"{path.name}.lock*"):  # of a process that was killed
            lock.unlink()
        try:
            trials = optuna.load_study(
                study_name=NAME, storage=JournalStorage(JournalFileBackend(str(path)))
            ).trials
        except KeyError:
            trials = []
        except ValueError as error:
            raise FtcmError(f"{path.name} cannot be read: {error}; begin in a new folder") from None
        count = next((i for i, t in enumerate(trials) if not t.state.is_finished()), len(trials))
        if count < tuning.trials:
            count -= count % tuning.batch
        kept = trials[:count]
    new = path.with_name(f"{path.name}.part")
    new.unlink(missing_ok=True)
    study = _new_study(tuning, JournalStorage(JournalFileBackend(str(new))))
    study.add_trials(kept)
    os.replace(new, path)
    return optuna.load_study(
        study_name=NAME, storage=JournalStorage(JournalFileBackend(str(path))), pruner=_pruner()
    )


def _new_study(tuning: Tuning, storage: Any) -> Any:
    import optuna

    study = optuna.create_study(
        study_name=NAME, storage=storage, directions=["minimize"] * len(tuning.objectives)
    )
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", optuna.exceptions.ExperimentalWarning)
        study.set_metric_names([".".join(metric) for metric in tuning.objectives])
    return study


def _constraint_names(tuning: Tuning) -> list[str]:
    return ["conditions", "failure", *(".".join(metric) for metric, _ in tuning.limits)]


def _pruner() -> Any:
    import optuna

    return optuna.pruners.MedianPruner(n_startup_trials=20, n_warmup_steps=1)


def _sampler(tuning: Tuning, batch: int) -> Any:
    import optuna

    with warnings.catch_warnings():
        warnings.simplefilter("ignore", optuna.exceptions.ExperimentalWarning)
        return optuna.samplers.TPESampler(
            seed=int(stream_key(tuning.seed, f"tune.{batch}")) % 2**32,
            n_startup_trials=max(20, 4 * len(tuning.parameters)),
            multivariate=True,
            constant_liar=True,
        )


def _distribution(parameter: Variation) -> Any:
    import optuna

    if parameter.kind == "choice":
        return optuna.distributions.CategoricalDistribution(parameter.arguments)
    if parameter.kind == "integer":
        low, high = map(int, parameter.arguments)
        return optuna.distributions.IntDistribution(low, high)
    first, last = map(float, parameter.arguments)
    return optuna.distributions.FloatDistribution(first, last, log=parameter.kind == "loguniform")


def _plain(trial: Any) -> dict[str, Any]:
    outcome = trial.user_attrs[OUTCOME]
    stopped = outcome["stopped"]
    return {
        "number": trial.number,
        "parameters": dict(trial.params),
        "state": "stopped" if stopped else "complete",
        "objectives": None if stopped else outcome["objectives"],
        "constraints": outcome["constraints"],
        "feasible": not stopped and max(outcome["constraints"]) <= 0.0,
        "runs": outcome["runs"],
        "said": outcome["said"],
    }
