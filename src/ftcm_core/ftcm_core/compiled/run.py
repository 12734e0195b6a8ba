# SPDX-License-Identifier: Apache-2.0
"""Whole runs, compiled; see :mod:`ftcm_core.compiled`."""

from __future__ import annotations

import importlib.util
from typing import Any

import numpy as np

from ftcm_core.compiled.program import Program, program_for, put_state, state_of
from ftcm_core.compiled.tracing import numbers, with_numbers
from ftcm_core.errors import FtcmError
from ftcm_core.recording.trace import Array, Trace
from ftcm_core.scenario import Scenario
from ftcm_core.simulation import Loop, to_trace
from ftcm_core.simulation.stages import robot_changes


def require_numba() -> None:
    """Raise an FtcmError if numba is not installed."""
    if importlib.util.find_spec("numba") is None:
        raise FtcmError('compiled runs need numba; pip install "ftcm_core[compiled]", or run plainly')


def prepare(scenario: Scenario) -> None:
    """Compile what a scenario needs, or find it compiled.

    Raises:
        NotCompilable: a component cannot be compiled; the message says why.
        FtcmError: numba is not installed.
    """
    require_numba()
    loop = Loop(scenario)
    if not loop.tick(0, False, lambda row: None):
        program_for(loop)


def simulate(scenario: Scenario) -> Trace:
    """Run a scenario compiled.

    Args:
        scenario: what to run.

    Returns:
        The trace, as of :func:`ftcm_core.simulation.simulate` but for the rounding of single operations.

    Raises:
        NotCompilable: a component cannot be compiled; the message says why.
        FtcmError: numba is not installed.
    """
    require_numba()
    loop, last, dt_ns = Loop(scenario), scenario.last_tick, scenario.dt_ns
    columns = np.empty((len(scenario.columns), last + 1, scenario.robot.joints))
    changes = {time_ns // dt_ns for time_ns, _ in robot_changes(scenario)}
    stops = sorted({k for k in changes if k < last} | {last})
    program: Program | None = None
    parameters: Array | None = None
    reason, k, recorded = "", 0, 0
    while True:

        def record(row: Any, k: int = k) -> None:
            nonlocal recorded
            columns[:, k] = np.reshape(row, columns[:, k].shape)
            recorded = k + 1  # not of a tick in which a law leaves its domain

        reason = loop.tick(k * dt_ns, k == last, record)
        if reason or k == last:
            break
        k += 1
        stop = next(x for x in stops if x >= k)
        if k < stop:
            if program is None or k - 1 in changes:
                program, parameters = program_for(loop)
            k = recorded = _run(program, parameters, loop, k, stop, dt_ns, columns)
    more: dict[str, Any] = {}
    if program is not None:
        compute, given, add = program.accelerations, parameters, program.sums

        def accelerations(positions: Array, torques: Array) -> Array:
            out = np.empty_like(torques)
            compute(given, np.ascontiguousarray(positions), torques, out)
            return out

        def column_sums(values: Array) -> Array:
            out = np.empty(values.shape[1])
            add(np.ascontiguousarray(values), out)
            return out

        more["accelerations"] = accelerations
        if scenario.robot.joints > 1:  # one column numpy adds in pairs
            more["column_sums"] = column_sums
    ended = loop.ended(k * dt_ns, reason)
    loop.look_at_faults(k * dt_ns)
    more["fault_events"] = tuple(loop.fault_events)
    return to_trace(scenario, columns[:, :recorded], *ended, engine="compiled", **more)


def _run(
    program: Program, parameters: Array | None, loop: Loop, k: int, stop: int, dt_ns: int, columns: Array
) -> int:
    """Run compiled ticks from k on; return the first one not run: ``stop``, or one that ends the run."""
    before = state_of(loop)
    reached = np.zeros(1, dtype=np.int64)

    def go(end: int) -> int:
        state = np.array(list(numbers(before)), dtype=np.float64)
        at = program.ticks(parameters, state, k, end, dt_ns, columns, reached)
        put_state(loop, with_numbers(before, iter(state.tolist())))
        return at

    try:
        return go(stop)
    except (
        ArithmeticError,
        ValueError,
    ):  # in the tick reached a law leaves its domain: plain Python says how
        return go(int(reached[0]))
