# SPDX-License-Identifier: Apache-2.0
"""A thousand scenarios whose values are all within their bounds: each runs and ends with a stated status."""

from __future__ import annotations

import functools
import json
import warnings
from typing import Any
from unittest import mock

import numpy as np
import pytest
from hypothesis import strategies as st

from ftcm_core import compiled
from ftcm_core.compiled import program, written
from ftcm_core.errors import ScenarioError
from ftcm_core.params import ParamSpec, specs
from ftcm_core.recording.metrics import result
from ftcm_core.registry import components
from ftcm_core.report.results import labelled, report, to_json
from ftcm_core.scenario import InitialState, Scenario, from_mapping, parse_yaml
from ftcm_core.simulation import Loop, simulate
from ftcm_core.simulation.stages import robot_changes
from inputs import NOT_BAD, inputs, promised
from traces import close
from written_tick import WrittenTick, state_numbers

pytestmark = pytest.mark.pure

JOINTS = 3


def number(spec: ParamSpec, bound: float) -> st.SearchStrategy[float]:
    """A valid number, of a size up to a bound where the parameter has none."""
    low, high = max(spec.lower, -bound), min(spec.upper, bound)
    if spec.kind == "int":
        return st.integers(int(low), int(high))
    return st.floats(
        low, high, exclude_min=spec.lower_open, exclude_max=spec.upper_open and high == spec.upper
    )


def value(spec: ParamSpec, bound: float) -> st.SearchStrategy[Any]:
    """A valid value of a parameter."""
    if spec.choices:
        return st.sampled_from(spec.choices)
    if spec.kind in ("bool", "str"):
        return st.booleans() if spec.kind == "bool" else st.text(max_size=5)
    one = number(spec, bound)
    lists = [st.lists(one, min_size=JOINTS, max_size=JOINTS)] if spec.per_joint else []
    return st.one_of(one, *lists, *([st.none()] if spec.optional else []))


def parameters(cls: type, bound: float) -> st.SearchStrategy[dict[str, Any]]:
    """Some of a record's parameters, valid one by one."""
    return st.fixed_dictionaries({}, optional={name: value(spec, bound) for name, spec in specs(cls).items()})


def component(kind: str, bound: float) -> st.SearchStrategy[dict[str, Any]]:
    """Any of the suite's own components of a kind, whatever other tests have registered."""
    return st.one_of(
        [
            parameters(cls, bound).map(lambda p, name=name: {"type": name, **p})
            for name, cls in components(kind).items()
            if cls.__module__.startswith("ftcm_core.")
        ]
    )


def robots(bound: float) -> st.SearchStrategy[dict[str, Any]]:
    """A robot at its defaults, with a payload, or with any values, of which most are no bodies."""
    loaded = st.integers(0, 20).map(lambda n: {"type": "puma560", "payload_mass": n / 10})
    return st.one_of(st.just({"type": "puma560"}), loaded, component("robot", bound))


def beliefs(bound: float) -> st.SearchStrategy[dict[str, Any]]:
    """A model: a robot of its own, or the true one with some values changed in percent."""
    percent = st.tuples(st.sampled_from(["mass", "inertia_zz", "motor_inertia"]), st.integers(-30, 30))
    return st.one_of(robots(bound), percent.map(lambda p: {p[0]: f"{p[1]:+d} %"}))


@functools.cache  # they would be made anew for every scenario
def scenarios(
    bound: float, most: int = 100, **given: st.SearchStrategy[Any]
) -> st.SearchStrategy[dict[str, Any]]:
    """Mappings whose values are all within their declared bounds; 20 ticks or more."""
    parts = {kind: component(kind, bound) for kind in ("reference", "controller", "observer")}
    parts["robot"] = robots(bound)
    injection = {
        "disturbances": st.lists(component("disturbance", bound), max_size=2),
        "faults": st.lists(component("fault", bound), max_size=2),
    }
    more = {
        "name": st.text(max_size=20),
        "sensor": component("sensor", bound),
        "plant": component("plant", bound),
        "detector": component("detector", bound),
        "policies": st.lists(component("policy", bound), max_size=2),
        "model": beliefs(bound),
        "initial_state": parameters(InitialState, bound),
        "injection": st.fixed_dictionaries({}, optional=injection),
        "torque_limits": value(specs(Scenario)["torque_limits"], bound),
        "torque_delay": st.integers(0, 30),
        "transient": value(specs(Scenario)["transient"], bound),
        "seed": st.integers(0, 2**63 - 1),
    }
    timing = st.builds(
        lambda dt, n: {"dt": dt, "duration": dt * n},
        st.sampled_from([1e-5, 3e-4, 1e-3, 0.1]),
        st.integers(20, most),
    )
    return st.builds(
        lambda a, b, c: {**a, **b, **c},
        st.fixed_dictionaries(parts, optional=more),
        timing,
        st.fixed_dictionaries(given),
    )


sizes = st.sampled_from([10.0, 10.0, 1e6, 1e300])


def made(data: dict[str, Any]) -> Scenario | None:
    """The scenario; None if values exclude each other, which is said in one line."""
    try:
        return from_mapping(data)
    except ScenarioError as error:
        message = str(error)
        assert len(message.splitlines()) == 1
        assert len(message) < 500
        return None


LINE_BREAK = {
    "robot": {"type": "puma560"}, "reference": {"type": "vo_kang_cosine"}, "controller": {"type": "ctc"},
    "observer": {"type": "none"}, "name": "\x85", "dt": 1e-5, "duration": 2.5e-4,
}  # fmt: skip
"""Its name did not read back."""

ONLY_A_PAYLOAD: dict[str, Any] = {
    "robot": {
        "type": "puma560", "mass": 0.0, "motor_inertia": 0.0, "centre_y": 0.0, "inertia_zz": 0.0,
        "payload_mass": 1.0, "payload_distance": 0.0,
    },
    "reference": {"type": "constant"}, "controller": {"type": "ctc"}, "observer": {"type": "none"},
    "dt": 1e-5, "duration": 2e-4,
}  # fmt: skip
"""That its model, the robot without payload, cannot be, was not said in a line."""


@pytest.mark.slow
@inputs(
    1000, of=1700, examples=({"data": LINE_BREAK}, {"data": ONLY_A_PAYLOAD}), data=sizes.flatmap(scenarios)
)
def test_every_run_ends_with_a_status(data: dict[str, Any]) -> object:
    """Completed with all its ticks and finite, or diverged with the time and finite until then.

    The scenario reads back from its own file; the result is JSON; nothing warns.
    """
    scenario = made(data)
    if scenario is None:
        return NOT_BAD
    again, _ = parse_yaml(scenario.to_yaml(), "written")
    assert from_mapping(again) == scenario
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        trace = simulate(scenario)
        found = labelled("run", trace)
        tables = report([found])
    assert trace.status in ("completed", "diverged")
    assert tuple(trace.columns) == scenario.columns
    if trace.status == "completed":
        assert trace.ticks == scenario.last_tick + 1
    else:
        assert trace.detail.startswith("at t = ")
        assert len(trace.detail.splitlines()) == 1
        assert trace.ticks <= scenario.last_tick + 1
    for name, column in trace.columns.items():
        assert column.shape == (trace.ticks, JOINTS)
        if name in ("disturbance_estimate", "residual") and not scenario.controller.needs_observer:
            continue  # an observer that nothing follows may overflow by itself
        # The tick that makes a run diverge is recorded as it is.
        assert np.isfinite(column if trace.status == "completed" else column[:-1]).all(), name
    assert trace.sliding_variable.shape == (trace.ticks, JOINTS)
    json.dumps(result(trace), allow_nan=False)
    json.loads(to_json(found), parse_constant=pytest.fail)
    assert not [line for line in tables.splitlines() if line.startswith("|") and "nan" in line]
    return trace


def test_most_moderate_scenarios_complete() -> None:
    """The property above is not empty."""
    ends: list[str] = []

    @inputs(60, data=scenarios(10.0, most=25))
    def run(data: dict[str, Any]) -> None:
        scenario = made(data)
        ends.append(simulate(scenario).status if scenario else "refused")

    run()
    assert ends.count("completed") > len(ends) / 2


@inputs(40, of=120, data=scenarios(10.0, most=40))
def test_the_written_tick_is_the_plain_one(data: dict[str, Any]) -> object:
    """What a compiled run compiles, run by Python itself: bit for bit the plain run, until it hands back."""
    scenario = made(data)
    if scenario is None:
        return NOT_BAD
    loop, plain = Loop(scenario), Loop(scenario)
    rows: list[list[float]] = []
    for k in range(3):
        if plain.tick(k * scenario.dt_ns, False, lambda row: None):
            return NOT_BAD
        loop.tick(k * scenario.dt_ns, False, lambda row: None)
    try:
        tick = WrittenTick(loop)
    except compiled.NotCompilable:  # such a run is a plain one
        return NOT_BAD
    last = min([scenario.last_tick, *(time_ns // scenario.dt_ns for time_ns, _ in robot_changes(scenario))])
    if last <= 3:
        return NOT_BAD
    try:
        reached = tick.run(3, last)
    except (ArithmeticError, ValueError):  # found again, and stated, by the plain run
        reached = tick.reached[0]
        assert plain_to(plain, scenario, reached, rows)
        assert_same(tick.rows[: reached - 3], rows)
        return rows or NOT_BAD
    reason = plain_to(plain, scenario, reached, rows)
    assert_same(tick.rows, rows)
    if reached < last:  # it hands back a tick in which the run ends
        assert reason
        return rows or NOT_BAD
    assert_same(tick.state, state_numbers(plain))
    return rows


@inputs(60, of=160, data=sizes.flatmap(scenarios))
def test_a_run_that_is_written_is_that_of_the_stages(data: dict[str, Any]) -> object:
    """Bit for bit, however it ends."""
    scenario = made(data)
    if scenario is None:
        return NOT_BAD
    with mock.patch.object(written, "WORTH", 0), mock.patch.object(written, "_written", []) as found:
        trace = simulate(scenario)
    stages = simulate(scenario, written=False)
    for field in ("status", "detail", "ended_at", "ticks", "fault_events", "decisions"):
        assert getattr(trace, field) == getattr(stages, field), field
    for name, column in stages.columns.items():
        np.testing.assert_array_equal(trace.columns[name], column, name)
    return trace if found else NOT_BAD


def assert_same(a: list[Any], b: list[Any]) -> None:
    """Equal number for number, and not-a-number, to which an observer that nothing follows may come, too."""
    np.testing.assert_array_equal(np.array(a), np.array(b), strict=True)


def plain_to(plain: Loop, scenario: Scenario, last: int, rows: list[list[float]]) -> str:
    """Run plainly from tick 3 to before ``last``; what the next tick says if the run has not ended."""
    for k in range(3, last):
        assert not plain.tick(k * scenario.dt_ns, False, lambda row: rows.append(list(row)))
    return plain_reason(plain, last * scenario.dt_ns)


def plain_reason(plain: Loop, time_ns: int) -> str:
    """Why a run ends in a tick; it is left as it was before it."""
    kept = program.state_of(plain)
    reason = plain.tick(time_ns, False, lambda row: None)
    program.put_state(plain, kept)
    return reason


fixed = {
    "robot": st.just("puma560"),
    "model": st.none(),
    "plant": st.none(),
    "detector": st.none(),
    "policies": st.just([]),
    "observer": st.builds(
        lambda k1, k2: {"type": "do", "k1": k1, "k2": k2}, st.floats(10.0, 1e5), st.floats(1.0, 500.0)
    ),
    "controller": st.builds(
        lambda c, u: {"type": "ftcm", "gamma1": c, "upsilon1": u}, st.floats(0.1, 10.0), st.floats(0.1, 50.0)
    ),
    "reference": st.just("vo_kang_cosine"),
    "sensor": st.just("ideal"),
    "dt": st.just(1e-3),
    "duration": st.integers(20, 60).map(lambda n: n * 1e-3),
    "torque_limits": st.none(),
    "torque_delay": st.just(0),
    "injection": st.floats(0.0, 0.05).map(
        lambda t: {"disturbances": ["vo_kang_friction"], "faults": [{"type": "vo_kang_fault", "start": t}]}
    ),
    "initial_state": st.builds(
        lambda q, v: {"position": [*q], "velocity": [*v]}, *[st.tuples(*[st.floats(-1.0, 1.0)] * JOINTS)] * 2
    ),
}


@pytest.mark.slow
def test_compiled_runs_are_the_plain_ones() -> None:
    """Two dozen scenarios of one structure, compiled once."""
    pytest.importorskip("numba")

    @inputs(24, data=scenarios(10.0, **fixed))
    def run(data: dict[str, Any]) -> None:
        scenario = from_mapping(data)
        trace, plain = compiled.simulate(scenario), simulate(scenario)
        assert trace.engine == "compiled"
        assert (trace.status, trace.ticks) == (plain.status, plain.ticks)
        close(trace, plain, rtol=1e-6, atol=1e-6)

    run()


def test_a_thousand_good_scenarios() -> None:
    """The tests above fail if they have had fewer than they say."""
    assert promised(globals()) >= 1000
