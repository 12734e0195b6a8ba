# SPDX-License-Identifier: Apache-2.0
"""The size of a fault that a detector just detects: by halving, between a size missed and one found.

A size counts as detected if the fault is, in a stated share of runs, each with its own seed. It is supposed
that a larger fault is not harder to find; the sizes tried are told, so that one can see whether that holds.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

from ftcm_core.campaign.running import chosen_engine
from ftcm_core.compiled import NotCompilable
from ftcm_core.compiled import simulate as compiled_simulate
from ftcm_core.errors import FtcmError
from ftcm_core.parallel import run_parallel
from ftcm_core.recording.detection import detection_scores
from ftcm_core.scenario import Scenario, apply_override, from_mapping, replace
from ftcm_core.simulation import simulate

MOST_TRIES = 40


def just_detectable(
    scenario: Scenario,
    path: str,
    low: float,
    high: float,
    *,
    runs: int = 1,
    share: float = 0.95,
    precision: float = 0.05,
    engine: str = "auto",
    jobs: int | None = None,
    progress: Callable[[float, int], None] | None = None,
) -> dict[str, Any]:
    """Find the smallest size that is detected.

    Args:
        scenario: with a detector and one fault.
        path: the fault's parameter that says how large it is, e.g. ``injection.faults.0.loss``.
        low: a size that is missed.
        high: a size that is detected; of the same sign, and not zero unless ``low`` is.
        runs: how many of each size, with the seeds from the scenario's on.
        share: of the runs in which it must be detected.
        precision: how near the two sizes come, relative to the larger one.
        engine: as of a campaign.
        jobs: number of processes; the number of cores by default.
        progress: called with each size tried and in how many runs it was detected.

    Returns:
        ``missed`` and ``detected``, the two sizes between which the edge is; ``tried``, one entry per size
        with ``size``, ``detected`` (runs) and ``delay_median`` (s, of those); ``path``, ``runs``, ``share``.

    Raises:
        FtcmError: there is no detector or not one fault, the numbers make no sense, ``low`` is detected, or
            ``high`` is missed.
    """
    if scenario.detector is None:
        raise FtcmError("the scenario has no detector; choose one, e.g. --set detector=cusum")
    if len(scenario.faults) != 1:
        raise FtcmError(f"the scenario has {len(scenario.faults)} faults; expected one, whose size is varied")
    if not path.startswith("injection.faults.0."):
        raise FtcmError(f"{path}: expected a parameter of the fault, e.g. injection.faults.0.severity")
    if not (math.isfinite(low) and math.isfinite(high) and abs(low) < abs(high) and low * high >= 0.0):
        raise FtcmError(
            f"{low:g}:{high:g}: expected a smaller and a larger size of the same sign, e.g. 0.01:1"
        )
    if runs < 1 or not 0.0 < share <= 1.0 or not 0.0 < precision < 1.0:
        raise FtcmError("expected at least 1 run, a share above 0 up to 1, a precision between 0 and 1")
    plain = chosen_engine(engine) == "plain"
    tried: list[dict[str, Any]] = []

    def detected(size: float) -> bool:
        data = scenario.to_mapping()
        apply_override(data, f"{path}={size!r}")
        one = from_mapping(data)
        jobs_to_do = [(replace(one, seed=scenario.seed + k), plain) for k in range(runs)]
        delays = [delay for _, delay in run_parallel(_delay, jobs_to_do, jobs) if delay is not None]
        found = sorted(delays)
        median = 0.5 * (found[(len(found) - 1) // 2] + found[len(found) // 2]) if found else None
        tried.append({"size": size, "detected": len(found), "delay_median": median})
        if progress:
            progress(size, len(found))
        return len(found) >= share * runs

    if not detected(high):
        raise FtcmError(f"{path} = {high:g} is missed; expected a size that is detected as the larger one")
    if detected(low):
        raise FtcmError(f"{path} = {low:g} is detected; expected a size that is missed as the smaller one")
    while abs(high - low) > precision * abs(high) and len(tried) < MOST_TRIES:
        middle = math.copysign(math.sqrt(low * high), high) if low else 0.5 * high
        if detected(middle):
            high = middle
        else:
            low = middle
    tried.sort(key=lambda one: abs(one["size"]))
    return {"path": path, "missed": low, "detected": high, "runs": runs, "share": share, "tried": tried}


def _delay(job: tuple[Scenario, bool]) -> float | None:
    """After what time the fault of a run was detected, s; None if it was missed."""
    scenario, plain = job
    try:
        trace = simulate(scenario) if plain else compiled_simulate(scenario)
    except NotCompilable:
        trace = simulate(scenario)
    scores = detection_scores(trace)
    assert scores is not None
    hits = [fault for fault in scores["faults"] if fault["detected"]]
    return hits[0]["delay"] if hits else None
