# SPDX-License-Identifier: Apache-2.0
"""The threshold of a detector for a stated rate of false alarms, from runs without faults.

A detector compares a statistic with its threshold. An alarm begins where the statistic, held (its smallest
value over the last ``hold`` seconds), passes the threshold upwards. So the alarms of a run at *any*
threshold can be counted afterwards, from one run. The transient of the scenario is left out.

The stated rate is that of the whole robot, shared equally among the joints. With c alarms of a joint
expected in all the runs together, its threshold is

- *counted* where c is at least :data:`PEAKS`: the lowest level from which on no level is passed more than c
  times;
- else from the *exponential tail*: the level h0 that is passed :data:`PEAKS` times, plus β ln(N(h0) / c), β
  being the mean by which the peaks exceed h0 (peaks over threshold, Davison and Smith 1990, with the shape
  0 of light-tailed noise). That is an extrapolation: where c is below one, beyond everything that was seen.
"""

from __future__ import annotations

import datetime
import functools
import hashlib
import math
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np

from ftcm_core import compiled
from ftcm_core.campaign.running import chosen_engine
from ftcm_core.detectors.residual_detector import ResidualDetector
from ftcm_core.errors import FtcmError
from ftcm_core.parallel import run_parallel
from ftcm_core.params import joint_parameters
from ftcm_core.recording.detection import HOUR
from ftcm_core.recording.provenance import provenance
from ftcm_core.recording.trace import Array, Trace
from ftcm_core.scenario import Scenario, replace
from ftcm_core.simulation import simulate

PEAKS = 30
"""Crossings from which on a level is counted, and peaks from which the tail is taken (chosen: β to 18 %)."""
FEWEST = 10
"""Peaks without which there is no tail (chosen: β to 32 %)."""
SILENT = 1e9
"""A threshold that nothing passes."""


class Level(NamedTuple):
    """A threshold and how it was found."""

    threshold: float
    method: str
    """``counted`` or ``exponential tail``."""
    expected: float
    """Alarms of this joint to be expected in all the runs together, at the stated rate."""
    peaks: int
    """Crossings of the level that was counted, or of the level from which the tail is taken."""


def fault_free(scenario: Scenario) -> Scenario:
    """Return a scenario without its faults, its detector made silent.

    Raises:
        FtcmError: it has no detector with a statistic.
    """
    detector = scenario.detector
    if not isinstance(detector, ResidualDetector):
        what = (
            f"detector {detector.type_name!r} has no statistic"
            if detector
            else "the scenario has no detector"
        )
        raise FtcmError(f"{what}; expected one that tests a residual, e.g. --detector cusum")
    silent = type(detector)(**{**detector.values, "threshold": SILENT})
    return replace(scenario, faults=(), detector=silent)


def held_statistic(trace: Trace) -> Array:
    """Return what is compared with the threshold, shape (1 + ticks, joints): the ticks after the transient.

    The first row is the one before them; before the first tick of a run, -inf.

    Args:
        trace: a run of :func:`fault_free`.
    """
    scenario, residual = trace.scenario, trace.residual
    assert scenario is not None
    assert residual is not None
    detector = scenario.detector
    assert isinstance(detector, ResidualDetector)
    velocity = trace.velocity if trace.measured_velocity is None else trace.measured_velocity
    columns = []
    for joint, p in enumerate(joint_parameters(detector, residual.shape[1])):
        memory, found = detector.memory(), np.empty(trace.ticks)
        rows = (x[:, joint].tolist() for x in (residual, velocity, trace.command))
        for k, (r, v, u) in enumerate(zip(*rows)):
            found[k], memory = detector.statistic(p, trace.dt, r, v, u, memory)
        ticks = _ticks_longer_than(p.hold, trace.dt)
        padded = np.concatenate([np.full(ticks - 1, -math.inf), found])
        columns.append(np.lib.stride_tricks.sliding_window_view(padded, ticks).min(axis=1))
    before = np.full((1, residual.shape[1]), -math.inf)
    return np.vstack([before, np.column_stack(columns)])[np.searchsorted(trace.time, scenario.transient) :]


def _ticks_longer_than(hold: float, dt: float) -> int:
    """For how many ticks a statistic is above its threshold when the alarm comes."""
    above, ticks = 0.0, 0
    while above <= hold:
        above, ticks = above + dt, ticks + 1
    return ticks


def level_for(runs: Sequence[Array], expected: float) -> Level:
    """Return the threshold of one joint that is passed ``expected`` times in some runs.

    Args:
        runs: held statistics, each of shape (ticks,).
        expected: c, above 0.

    Raises:
        FtcmError: there are too few peaks.
    """
    lows, highs = (np.concatenate([x[rows] for x in runs]) for rows in (slice(-1), slice(1, None)))
    rises = highs > lows
    lows, highs = np.sort(lows[rises]), np.sort(highs[rises])
    if expected >= PEAKS:
        level = _lowest(lows, highs, expected)
        return Level(level, "counted", expected, _passed(lows, highs, level))
    start = _lowest(lows, highs, PEAKS)
    peaks = np.array([peak for run in runs for peak in _peaks(run, start)])
    if len(peaks) < FEWEST:
        raise FtcmError(
            f"only {len(peaks)} peaks of the statistic in all runs, expected {FEWEST}: a threshold cannot be "
            "found; take more runs, longer ones, or a sensor with noise"
        )
    crossings = _passed(lows, highs, start)
    beta = float(np.mean(peaks - start))
    return Level(start + beta * math.log(crossings / expected), "exponential tail", expected, crossings)


def _passed(lows: Array, highs: Array, level: float) -> int:
    """How often a level is passed upwards, of the sorted ends of all rises."""
    return int(np.searchsorted(lows, level, side="right") - np.searchsorted(highs, level, side="right"))


def _lowest(lows: Array, highs: Array, count: float) -> float:
    """The lowest level from which on no level is passed more often than ``count`` times."""
    if not len(highs):
        return 0.0
    passed = np.searchsorted(lows, highs, side="left") - np.searchsorted(highs, highs, side="left")
    often = np.flatnonzero(passed > count)  # just below each upper end
    return float(highs[often[-1]]) if len(often) else float(highs[0])


def _peaks(run: Array, level: float) -> list[float]:
    """The largest value of each time that a run spends above a level."""
    above = np.flatnonzero(run > level)
    pieces = np.split(above, np.flatnonzero(np.diff(above) > 1) + 1)
    return [float(run[piece].max()) for piece in pieces if len(piece)]


def calibrate(
    scenario: Scenario,
    rate: float,
    runs: int = 20,
    *,
    seed: int = 0,
    engine: str = "auto",
    jobs: int | None = None,
    progress: Callable[[int, int], None] | None = None,
    note: Callable[[str], None] = lambda text: None,
) -> dict[str, Any]:
    """Find the thresholds of a scenario's detector.

    Args:
        scenario: its detector, whatever its threshold, is the one; its faults are left out.
        rate: false alarms per hour of the whole robot, all joints together.
        runs: how many.
        seed: the runs have the seeds ``seed + 1`` to ``seed + runs``.
        engine: as of a campaign.
        jobs: number of processes.
        progress: called with the runs done and their number.
        note: told what the user should know, in one line each.

    Returns:
        ``detector``, its mapping with the thresholds, and ``calibration``, where they come from.

    Raises:
        FtcmError: the detector has no statistic, a run ends early, or there are too few peaks.
    """
    if not (math.isfinite(rate) and rate > 0.0):
        raise FtcmError(f"false alarms per hour: {rate:g}; expected a number above 0")
    if runs < 1:
        raise FtcmError(f"runs: {runs}; expected at least 1")
    healthy, engine = fault_free(scenario), chosen_engine(engine)
    if engine != "plain":
        try:
            compiled.prepare(healthy)
        except compiled.NotCompilable as error:
            if engine == "compiled":
                raise
            note(f"runs plainly: {error}")
            engine = "plain"
    jobs_to_do = [replace(healthy, seed=seed + 1 + k) for k in range(runs)]
    found: dict[int, Array] = {}
    for index, statistic in run_parallel(functools.partial(_run, plain=engine == "plain"), jobs_to_do, jobs):
        found[index] = statistic
        if progress:
            progress(len(found), runs)
    ordered = [found[k] for k in range(runs)]
    if runs > 1 and np.array_equal(ordered[0], ordered[1]):
        note("all runs are alike, nothing in the scenario is random: the rate is that of one run repeated")
    exposure = sum(len(x) - 1 for x in ordered) * healthy.dt
    joints = healthy.robot.joints
    expected = rate / joints * exposure / HOUR
    levels = []
    for joint, name in enumerate(healthy.robot.joint_names):
        try:
            levels.append(level_for([x[:, joint] for x in ordered], expected))
        except FtcmError as error:
            raise FtcmError(f"{name}: {error}") from None
    if expected < 1.0:
        note(
            f"extrapolated: {expected:.2g} alarms of a joint are expected in {exposure:g} s of runs; the "
            f"thresholds are beyond what was seen. {math.ceil(runs / expected)} runs would show one"
        )
    detector = scenario.detector
    assert detector is not None
    mapping = {**detector.to_mapping(), "threshold": [max(x.threshold, 1e-9) for x in levels]}
    text = replace(scenario, faults=(), detector=None).to_yaml()
    return {
        "detector": mapping,
        "calibration": {
            "false_alarms_per_hour": float(rate),
            "scenario": scenario.name,
            "scenario_sha256": hashlib.sha256(text.encode()).hexdigest(),
            "runs": runs,
            "seeds": [seed + 1, seed + runs],
            "exposure": exposure,
            "engine": "plain" if engine == "plain" else "compiled",
            "joints": [level._asdict() for level in levels],
            "date": datetime.datetime.now(datetime.timezone.utc).isoformat(timespec="seconds"),
            **provenance(),
        },
    }


def _run(scenario: Scenario, plain: bool) -> Array:
    trace = simulate(scenario) if plain else compiled.simulate(scenario)
    if trace.status != "completed":
        raise FtcmError(
            f"a run without faults {trace.status}: {trace.detail}; expected a scenario that holds"
        )
    return held_statistic(trace)
