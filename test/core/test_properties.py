# SPDX-License-Identifier: Apache-2.0
"""Whatever a user writes ends in a scenario or one line; whatever a scenario says ends in a status."""

from __future__ import annotations

import copy
import json
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, example, given, settings
from hypothesis import strategies as st

from ftcm_core.errors import FtcmError, ScenarioError
from ftcm_core.metrics import result
from ftcm_core.params import ParamSpec, specs
from ftcm_core.registry import components
from ftcm_core.scenario import InitialState, Scenario, apply_override, from_mapping, load, parse_yaml
from ftcm_core.simulation import simulate
from ftcm_core.trace import COLUMNS

PAPER = load("paper").to_mapping()
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
    """Any component of a kind."""
    return st.one_of(
        [
            parameters(cls, bound).map(lambda p, name=name: {"type": name, **p})
            for name, cls in components(kind).items()
        ]
    )


def scenarios(bound: float, ticks: int = 40) -> st.SearchStrategy[dict[str, Any]]:
    """Mappings whose values are all within their declared bounds; short."""
    parts = {kind: component(kind, bound) for kind in ("robot", "reference", "controller", "observer")}
    injection = {
        "disturbances": st.lists(component("disturbance", bound), max_size=2),
        "faults": st.lists(component("fault", bound), max_size=2),
    }
    more = {
        "initial_state": parameters(InitialState, bound),
        "injection": st.fixed_dictionaries({}, optional=injection),
        "torque_limits": value(specs(Scenario)["torque_limits"], bound),
        "transient": value(specs(Scenario)["transient"], bound),
        "seed": st.integers(0, 2**63 - 1),
    }
    timing = st.builds(
        lambda dt, n: {"dt": dt, "duration": dt * n},
        st.sampled_from([1e-5, 3e-4, 1e-3, 0.1]),
        st.integers(1, ticks),
    )
    return st.builds(lambda a, b: {**a, **b}, st.fixed_dictionaries(parts, optional=more), timing)


sizes = st.sampled_from([10.0, 1e6, 1e300])
mappings = sizes.flatmap(scenarios)


def one_line(error: FtcmError) -> None:
    """Check what a user gets to read."""
    assert len(str(error).splitlines()) == 1
    assert len(str(error)) < 500


@settings(deadline=None, max_examples=150, suppress_health_check=[HealthCheck.too_slow])
@given(mappings)
def test_valid_values_make_a_scenario_or_are_refused_in_one_line(data: dict[str, Any]) -> None:
    """What loads, reads back from its own file to an equal scenario."""
    try:
        scenario = from_mapping(data)
    except ScenarioError as error:
        one_line(error)
        return
    again, _ = parse_yaml(scenario.to_yaml(), "written")
    assert from_mapping(again) == scenario


@settings(deadline=None, max_examples=150, suppress_health_check=[HealthCheck.too_slow])
@given(mappings)
def test_every_run_ends_with_a_status(data: dict[str, Any]) -> None:
    """Completed with all its ticks and finite, or diverged with the time; its result can be written."""
    try:
        scenario = from_mapping(data)
    except ScenarioError:
        return
    trace = simulate(scenario)
    assert trace.status in ("completed", "diverged")
    if trace.status == "completed":
        assert trace.ticks == scenario.last_tick + 1
        assert all(np.isfinite(getattr(trace, name)).all() for name in ("position", "velocity", "effort"))
    else:
        assert trace.detail.startswith("at t = ")
        assert len(trace.detail.splitlines()) == 1
        assert trace.ticks <= scenario.last_tick + 1
    assert all(getattr(trace, name).shape == (trace.ticks, JOINTS) for name in COLUMNS)
    json.dumps(result(trace), allow_nan=False)
    assert trace.sliding_variable.shape == (trace.ticks, JOINTS)


def test_most_moderate_scenarios_run() -> None:
    """The properties above are not empty: most scenarios with moderate values load and complete."""
    ends: list[str] = []

    @settings(
        deadline=None,
        max_examples=60,
        database=None,
        derandomize=True,
        suppress_health_check=[HealthCheck.too_slow],
    )
    @given(scenarios(10.0, ticks=5))
    def run(data: dict[str, Any]) -> None:
        try:
            ends.append(simulate(from_mapping(data)).status)
        except ScenarioError:
            ends.append("refused")

    run()
    assert ends.count("completed") > len(ends) / 2


# Garbage.

atoms = st.one_of(
    st.none(),
    st.booleans(),
    st.integers(),
    st.sampled_from([10**400, -1, math.nan, math.inf, -math.inf, b"x", "type", "ftcm", "null"]),
    st.floats(),
    st.text(max_size=8),
    st.dates(),
)
keys = st.one_of(
    st.sampled_from(["type", "k1", "faults", "start", "position", "name"]), st.text(max_size=4), atoms
)
garbage = st.recursive(
    atoms,
    lambda inner: st.one_of(st.lists(inner, max_size=4), st.dictionaries(keys, inner, max_size=4)),
    max_leaves=8,
)


def places(node: Any, path: tuple[Any, ...] = ()) -> list[tuple[Any, ...]]:
    """Every path in nested plain data."""
    inner = node.items() if isinstance(node, dict) else enumerate(node) if isinstance(node, list) else ()
    return [path, *(p for key, child in inner for p in places(child, (*path, key)))]


def refused_or_loaded(data: Any) -> None:
    """Neither a traceback nor a page."""
    try:
        from_mapping(data)
    except FtcmError as error:
        one_line(error)


@settings(deadline=None, max_examples=400)
@given(place=st.sampled_from(places(PAPER)[1:]), value=garbage)
def test_garbage_in_one_place(place: tuple[Any, ...], value: Any) -> None:
    """A good scenario with one value replaced by anything."""
    data: Any = copy.deepcopy(PAPER)
    node = data
    for key in place[:-1]:
        node = node[key]
    node[place[-1]] = value
    refused_or_loaded(data)


@settings(deadline=None, max_examples=300)
@given(
    place=st.sampled_from(
        [(), ("controller",), ("initial_state",), ("injection",), ("injection", "faults", 0)]
    ),
    key=keys,
)
def test_garbage_key(place: tuple[Any, ...], key: Any) -> None:
    """A good scenario with one key too many."""
    data: Any = copy.deepcopy(PAPER)
    node = data
    for step in place:
        node = node[step]
    node[key] = 1
    refused_or_loaded(data)


@settings(deadline=None, max_examples=200)
@given(st.dictionaries(st.one_of(st.sampled_from(list(PAPER)), keys), garbage, max_size=6))
def test_garbage_mapping(data: dict[Any, Any]) -> None:
    """Anything at all."""
    refused_or_loaded(data)


SYNTAX = [
    "{", "}", "[", "]", ":", ",", "- ", "? ", "&a ", "*a", "<<", "!", "|", ">", "'", '"', "\\", "#", "%",
    "@", "`", "---", "...", "~", "=", "!!int ", "!!float ", "!!bool ", "!!timestamp ", "!!map ", "!!set ",
    "!!omap ", "!x ", "!!binary ", "1e4", "0x1f", "1:30", "2020-13-01", "2020-01-01", ".nan", "-.inf",
    "robot", "type", "ftcm", "k1",
]  # fmt: skip
SPACE = ["\n", "\n  ", " ", ": ", ", ", "\t", "\0", "\x85", "\u2028", "\ufeff"]
words = st.sampled_from([*SYNTAX, *SPACE, *SPACE[:5]])
texts = st.one_of(st.text(max_size=30), st.lists(words, max_size=15).map("".join))


@settings(deadline=None, max_examples=600)
@given(texts)
@example("a: !!timestamp soon")
@example("!!int ''")
@example("? [a]\n: b")
@example("!!set {a: b}")
def test_garbage_yaml(text: str) -> None:
    """Plain data, or one line."""
    try:
        data, _ = parse_yaml(text, "text")
    except ScenarioError as error:
        one_line(error)
        return
    if isinstance(data, dict):
        refused_or_loaded(data)


@settings(deadline=None, max_examples=60, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(text=st.one_of(st.binary(max_size=30), texts.map(lambda s: s.encode(errors="surrogatepass"))))
def test_garbage_file(tmp_path: Path, text: bytes) -> None:
    """A file with any bytes."""
    path = tmp_path / "garbage.yaml"
    path.write_bytes(text)
    with pytest.raises(ScenarioError) as error:
        load(str(path))
    one_line(error.value)


paths = st.lists(
    st.one_of(
        st.sampled_from(
            ["observer", "k1", "controller", "type", "injection", "faults", "0", "start", "torque_limits"]
        ),
        st.text(max_size=3),
        st.just("9" * 5000),
    ),
    max_size=4,
).map(".".join)


@settings(deadline=None, max_examples=600)
@given(st.lists(st.one_of(texts, st.builds("{}={}".format, paths, texts)), min_size=1, max_size=3))
@example(["injection.faults." + "9" * 5000 + "=3"])
@example(["observer.k1=!!int ''"])
@example(["a\nb=1"])
@example(["k" * 5000 + "=1", "k" * 5000 + ".x=1"])
@example(["k" * 5000 + "=", "k" * 5000 + ".x=1"])
def test_garbage_overrides(overrides: list[str]) -> None:
    """One to three --set texts on a good scenario."""
    data = copy.deepcopy(PAPER)
    try:
        for text in overrides:
            apply_override(data, text)
        from_mapping(data)
    except FtcmError as error:
        one_line(error)
