# SPDX-License-Identifier: Apache-2.0
"""Traces: derived columns, the controllers in force, and traces that know less than a simulated one."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from ftcm_core.controllers.ctc import CTC
from ftcm_core.controllers.smc import SMC
from ftcm_core.recording.trace import Change, Trace
from ftcm_core.scenario import load
from ftcm_core.signals import COLUMNS
from ftcm_core.simulation import simulate
from robot_matrices import mass_matrix
from traces import same

CHANGES = (Change(10, "controller", CTC()), Change(20, "controller", SMC(c=[1, 2, 3])))


@pytest.fixture(scope="module")
def trace() -> Trace:
    """Thirty ticks: FTCM, then computed torque, which has no sliding variable, then SMC."""
    return simulate(load("paper", ["duration=0.029"]), changes=CHANGES)


def test_columns_are_fields_with_units(trace: Trace) -> None:
    """Every column is a field of the trace and has an SI unit; a trace has those that its scenario says."""
    fields = {f.name for f in dataclasses.fields(Trace)}
    assert set(COLUMNS) < fields
    assert {column.unit for column in COLUMNS.values()} == {"rad", "rad/s", "N·m", "-"}
    assert all(column.meaning for column in COLUMNS.values())
    assert trace.scenario is not None
    assert list(trace.columns) == list(trace.scenario.columns)
    assert {column.shape for column in trace.columns.values()} == {(30, 3)}
    assert all(getattr(trace, name) is None for name in set(COLUMNS) - set(trace.columns))
    bare = dataclasses.replace(trace, residual=trace.effort)
    assert [*bare.columns] == [*trace.columns, "residual"]


def test_two_runs_are_the_same_if_every_column_is(trace: Trace) -> None:
    """What the other tests compare with: a bit, a tick, a stamp or a column more is another run."""
    assert same(trace, dataclasses.replace(trace))
    assert not same(trace, dataclasses.replace(trace, joint_torque=trace.effort))
    assert not same(trace, dataclasses.replace(trace, time_ns=trace.time_ns + 1))
    for name, column in trace.columns.items():
        other = column.copy()
        other[29, 2] = np.nextafter(other[29, 2], np.inf)
        changed = dataclasses.replace(trace, **{name: other})
        assert not same(trace, changed)
        assert same(trace, changed, slice(29))
        assert not same(trace, dataclasses.replace(trace, **{name: column[:-1]}))
    zeros = np.zeros_like(trace.alarm) if trace.alarm is not None else np.zeros((30, 3))
    assert not same(dataclasses.replace(trace, alarm=zeros), dataclasses.replace(trace, alarm=-zeros))


def test_errors_are_measured_minus_desired(trace: Trace) -> None:
    """E = q - q_ref; the first is that of the paper."""
    assert np.array_equal(trace.error, trace.position - trace.reference_position)
    assert np.array_equal(trace.velocity_error, trace.velocity - trace.reference_velocity)
    assert trace.error[0].tolist() == [-0.5] * 3
    assert trace.time.tolist() == [k / 1000 for k in range(30)]


def test_lumped_uncertainty_is_eq_6(trace: Trace) -> None:
    """Δ = -M⁻¹ d, Δ̂ = M⁻¹ tau_hat; the estimate is of the same sign."""
    assert trace.model is not None
    m = mass_matrix(trace.model, tuple(trace.position[7].tolist()))
    assert m @ trace.lumped_uncertainty[7] == pytest.approx(-trace.disturbance[7], abs=1e-14)
    assert m @ trace.lumped_uncertainty_estimate[7] == pytest.approx(trace.disturbance_estimate[7], abs=1e-14)


@pytest.mark.parametrize("order", [1, -1], ids=["by tick", "backwards"])
def test_controllers_in_force(trace: Trace, order: int) -> None:
    """Rows of each law, however the changes are listed; its own sliding variable on them."""
    trace = dataclasses.replace(trace, changes=CHANGES[::order])
    assert trace.scenario is not None
    ftcm = trace.scenario.controller
    assert trace.controllers() == [
        (0, 10, ftcm),
        (10, 20, CHANGES[0].component),
        (20, 30, CHANGES[1].component),
    ]
    s, e, de = trace.sliding_variable, trace.error, trace.velocity_error
    assert s[5, 1] == ftcm.sliding_variable(float(e[5, 1]), float(de[5, 1]), 1)
    assert np.isnan(s[10:20]).all()
    assert s[20:] == pytest.approx(de[20:] + np.array([1, 2, 3]) * e[20:], rel=1e-14)


def test_controllers_of_part_of_a_run(trace: Trace) -> None:
    """Rows count from the first tick there is; changes before it are in force from the start."""
    part = {name: getattr(trace, name)[15:] for name in [*trace.columns, "time_ns"]}
    tail = dataclasses.replace(trace, **part)
    assert [(a, b, law.type_name) for a, b, law in tail.controllers()] == [(0, 5, "ctc"), (5, 15, "smc")]
    assert np.array_equal(tail.sliding_variable, trace.sliding_variable[15:], equal_nan=True)


def test_two_changes_at_one_tick(trace: Trace) -> None:
    """The last one counts, as in the run."""
    both = [Change(10, "controller", SMC()), Change(10, "controller", CTC())]
    run = simulate(load("paper", ["duration=0.029"]), changes=both)
    assert [(a, b, law.type_name) for a, b, law in run.controllers()] == [(0, 10, "ftcm"), (10, 30, "ctc")]
    assert run.command[10:20].tobytes() == trace.command[10:20].tobytes()


def test_trace_without_a_scenario(trace: Trace) -> None:
    """Neither robot nor law: what needs them is NaN."""
    bare = dataclasses.replace(trace, scenario=None, changes=())
    assert bare.model is None
    assert bare.controllers() == []
    for column in (bare.sliding_variable, bare.lumped_uncertainty, bare.lumped_uncertainty_estimate):
        assert column.shape == (30, 3)
        assert np.isnan(column).all()
