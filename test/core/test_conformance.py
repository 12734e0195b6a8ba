# SPDX-License-Identifier: Apache-2.0
"""Every registered component, of every kind, through the same checks."""

from __future__ import annotations

import copy
import dataclasses
import inspect
import math
import re
from collections.abc import Iterator
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from ftcm_core.errors import ParameterError, ScenarioError
from ftcm_core.params import ParamSpec, specs
from ftcm_core.registry import KINDS, components
from ftcm_core.robots.puma560 import Puma560
from ftcm_core.scenario import InitialState, Scenario, from_mapping
from ftcm_core.signals import Measurement, ReferencePoint, Vector
from ftcm_core.stages import PlantStage

ROBOT, DT, JOINTS = Puma560(), 1e-3, 3
ALL = [(kind, name) for kind in KINDS for name in components(kind)]
VARIANTS = [  # every component at its defaults, and with every other choice of what it lets one choose
    pytest.param(kind, cls(**given), id="-".join([kind, name, *given.values()]))
    for kind in KINDS
    for name, cls in components(kind).items()
    for given in [{}, *({s.name: c} for s in specs(cls).values() for c in s.choices if c != s.default)]
]
every_variant = pytest.mark.parametrize(("kind", "component"), VARIANTS)
every_component = pytest.mark.parametrize(("kind", "name"), ALL)
DECLARED = [
    pytest.param(cls, spec, id=f"{cls.__name__}-{spec.name}")
    for cls in [InitialState, *(components(kind)[name] for kind, name in ALL)]
    for spec in specs(cls).values()
]
every_parameter = pytest.mark.parametrize(("cls", "spec"), DECLARED)


def of_kind(kind: str) -> pytest.MarkDecorator:
    """Parametrise a test by the names registered for a kind."""
    return pytest.mark.parametrize("name", components(kind))


def vectors(bound: float) -> st.SearchStrategy[Vector]:
    """Joint vectors of floats up to a bound."""
    return st.tuples(*[st.floats(-bound, bound)] * JOINTS)


@dataclasses.dataclass(frozen=True)
class Sample:
    """Two consecutive measurements, a reference point, an estimate and a time."""

    t: float
    before: Measurement
    now: Measurement
    reference: ReferencePoint
    estimate: Vector


measurements = st.builds(Measurement, vectors(2 * math.pi), vectors(5.0), vectors(200.0))
samples = st.builds(
    Sample,
    st.floats(0.0, 100.0),
    measurements,
    measurements,
    st.builds(ReferencePoint, vectors(2 * math.pi), vectors(5.0), vectors(20.0)),
    vectors(100.0),
)


def outputs(kind: str, component: Any, s: Sample) -> tuple[list[Vector], list[Any]]:
    """Run a component for a tick or two: the joint vectors it gives and the states it passes through."""
    q, v, u = s.now
    if kind == "robot":
        a, c = s.reference.acceleration, component
        vectors = [c.inverse_dynamics(q, v, a), c.forward_dynamics(q, v, u), c.inertia_acceleration(q, u)]
        vectors += [c.inertia_torque(q, a), c.velocity_torque(q, v), c.gravity(q)]
        return [*vectors, *c.mass_matrix(q), *c.coriolis_matrix(q, v)], []
    if kind == "reference":
        return list(component.at(s.t, JOINTS)), []
    if kind == "controller":
        first = component.init(JOINTS)
        u1, second = component.step(ROBOT, DT, s.before, s.reference, s.estimate, first)
        u2, third = component.step(ROBOT, DT, s.now, s.reference, s.estimate, second)
        assert [len(x) for x in (first, second, third)] == [JOINTS] * 3, "a state has one entry per joint"
        return [u1, u2], [first, second, third]
    if kind == "sensor":
        first = component.init(JOINTS, 7)
        q1, v1, second = component.step(DT, *s.before[:2], first)
        q2, v2, third = component.step(DT, q, v, second)
        return [q1, v1, q2, v2], [first, second, third]
    if kind == "observer":
        first = component.init(ROBOT, s.before)
        estimate, second = component.step(ROBOT, DT, s.now, first)
        again, third = component.step(ROBOT, DT, s.before, second)
        return [estimate, again], [first, second, third]
    return [component.torque(s.t, q, v, u)], []


def leaves(value: Any) -> Iterator[Any]:
    """Everything inside nested tuples."""
    if isinstance(value, tuple):
        for item in value:
            yield from leaves(item)
    else:
        yield value


def key_of(kind: str) -> str:
    """Where a scenario has a component of a kind."""
    return {"disturbance": "disturbances", "fault": "faults"}.get(kind, kind)


def scenario_with(kind: str, entry: Any) -> dict[str, Any]:
    """A scenario's mapping with one component in it."""
    data: dict[str, Any] = {
        "robot": "puma560",
        "reference": "constant",
        "controller": "ctc",
        "observer": "none",
    }
    if kind in ("disturbance", "fault"):
        data["injection"] = {key_of(kind): [entry]}
    else:
        data[kind] = entry
    if kind == "controller":
        data["observer"] = "do"
    return data


# Parameters.


@every_parameter
def test_parameter_is_documented(cls: type, spec: ParamSpec) -> None:
    """Unit, one-line description and source are there; the default is canonical and within bounds."""
    assert spec.unit.strip()
    assert spec.doc.strip()
    assert spec.source.strip()
    assert "\n" not in spec.doc
    assert not spec.doc.endswith(".")
    assert spec.check(spec.default) == spec.default
    assert getattr(cls(), spec.name) == spec.default


@every_parameter
def test_parameter_refuses_values_out_of_bounds(cls: type, spec: ParamSpec) -> None:
    """Just outside a bound is refused, by name; a closed bound itself is accepted."""
    step = 1 if spec.kind == "int" else 0
    for bound, is_open, away in (
        (spec.lower, spec.lower_open, -math.inf),
        (spec.upper, spec.upper_open, math.inf),
    ):
        if math.isinf(bound):
            continue
        outside = bound + math.copysign(step, away) if step else math.nextafter(bound, away)
        for bad in [outside, *([bound] if is_open else [])]:
            with pytest.raises(ParameterError, match=rf"^{spec.name}: .*out of range; expected .*\d"):
                cls(**{spec.name: bad})
        if not is_open:
            assert spec.check(bound) == bound


@every_parameter
def test_parameter_refuses_wrong_values(cls: type, spec: ParamSpec) -> None:
    """Other types, NaN, infinities, numbers beyond floats, empty lists, lists of texts: refused by name."""
    wrong: list[Any] = [{}, [], (), ["1"], [True], [math.nan], b"1", 1j, object()]
    if spec.kind == "str":
        wrong += [3, True]
    else:
        wrong += ["1", True, False, math.nan, math.inf, -math.inf, 10**400]
    wrong += ["no such choice"] if spec.choices else []
    wrong += [1.5] if spec.kind == "int" else []
    wrong += [] if spec.optional else [None]
    wrong += [] if spec.per_joint else [[spec.default] * JOINTS]
    for bad in wrong:
        with pytest.raises(ParameterError, match=f"^{spec.name}: ") as error:
            cls(**{spec.name: bad})
        assert len(str(error.value).splitlines()) == 1


@every_component
def test_refusals_between_parameters_name_one(kind: str, name: str) -> None:
    """Every refusal begins with the name of a parameter, also that of a condition between several."""
    cls = components(kind)[name]
    declared = specs(cls)
    for spec in declared.values():
        if spec.kind == "int":
            for value in (1, 2, 99, 100):
                try:
                    cls(**{spec.name: value})
                except ParameterError as error:
                    assert str(error).partition(": ")[0] in declared  # noqa: PT017


def test_scenario_parameters_are_documented() -> None:
    """The scenario's own parameters too."""
    for spec in specs(Scenario).values():
        assert spec.unit.strip()
        assert spec.doc.strip()
        assert spec.source.strip()
        assert spec.check(spec.default) == spec.default


# Records.


@every_component
def test_component_is_a_frozen_value(kind: str, name: str) -> None:
    """It constructs with defaults, equals another such one, hashes, and cannot be changed."""
    cls = components(kind)[name]
    component = cls()
    assert (component.kind, component.type_name) == (kind, name)
    assert component == cls()
    assert hash(component) == hash(cls())
    for field in [*specs(cls), "anything"]:
        with pytest.raises(dataclasses.FrozenInstanceError):
            setattr(component, field, 1)
    with pytest.raises(TypeError):
        cls(1.0)  # positional


@every_component
def test_component_is_documented(kind: str, name: str) -> None:
    """Its own one-line summary, which gives or cites its equation or model; its methods have one too."""
    cls = components(kind)[name]
    text = cls.__dict__["__doc__"]
    assert not text.startswith(f"{cls.__name__}("), "that is the one dataclasses make up"
    assert re.search(r"\beqs? \d+|\S = \S|\(\d{4}\)", text)
    assert text.splitlines()[0].endswith(".")
    if kind == "controller":
        assert re.search(r"\beqs? \d+|baseline", f"{inspect.getdoc(inspect.getmodule(cls))} {text}")
    for method, function in vars(cls).items():
        if inspect.isfunction(function) and not method.startswith("_"):
            assert function.__doc__, method


@every_component
def test_component_round_trips_through_a_scenario(kind: str, name: str) -> None:
    """Its mapping, with every default written out, reads back to an equal component."""
    component = components(kind)[name]()
    mapping = component.to_mapping()
    assert list(mapping) == ["type", *specs(type(component))]
    for entry in (mapping, name):  # the short form is the type alone
        scenario = from_mapping(scenario_with(kind, entry))
        found = getattr(scenario, key_of(kind))
        assert (found if kind == key_of(kind) else found[0]) == component
    assert from_mapping(scenario.to_mapping()) == scenario


# Steps.


@every_variant
@settings(deadline=None, max_examples=40)
@given(s=samples)
def test_step_is_pure(kind: str, component: Any, s: Sample) -> None:
    """Twice the same inputs give the same finite floats, one per joint; states are immutable values."""
    inputs = copy.deepcopy(s)
    first, states = outputs(kind, component, s)
    second, states_again = outputs(kind, copy.deepcopy(component), s)
    assert repr((first, states)) == repr((second, states_again))
    assert repr(inputs) == repr(s)
    assert all(isinstance(v, tuple) and len(v) == JOINTS for v in first)
    assert all(type(x) is float and math.isfinite(x) for v in first for x in v)
    for state in states:
        hash(state)
        assert all(type(x) is float and math.isfinite(x) for x in leaves(state))


@every_variant
@settings(deadline=None, max_examples=20)
@given(s=samples)
def test_equal_per_joint_values_are_the_scalar(kind: str, component: Any, s: Sample) -> None:
    """A list of equal numbers gives bit for bit what the one number gives."""
    cls = type(component)
    scalar = {k: v[0] if isinstance(v, tuple) else v for k, v in component.values.items()}
    listed = {k: (v,) * JOINTS if specs(cls)[k].per_joint else v for k, v in scalar.items()}
    assert repr(outputs(kind, cls(**scalar), s)) == repr(outputs(kind, cls(**listed), s))


@every_component
def test_per_joint_list_must_fit_the_robot(kind: str, name: str) -> None:
    """One entry too few is refused by the scenario, which names the parameter."""
    cls = components(kind)[name]
    for spec in specs(cls).values():
        if spec.per_joint:
            value = spec.default[0] if isinstance(spec.default, tuple) else spec.default
            entry = {"type": name, spec.name: [value] * (JOINTS - 1)}
            with pytest.raises(ParameterError, match=spec.name):
                cls(**{spec.name: [value] * (JOINTS - 1)}).check_joints(JOINTS)
            with pytest.raises(
                ScenarioError, match=rf"{key_of(kind)}(\.0)?\.{spec.name}: .*one .*per joint \(3\)"
            ):
                from_mapping(scenario_with(kind, entry))


@of_kind("controller")
@settings(deadline=None, max_examples=40)
@given(q=vectors(2 * math.pi), v=vectors(5.0), a=vectors(20.0))
def test_controller_on_its_reference(name: str, q: Vector, v: Vector, a: Vector) -> None:
    """Without error and with zero state the torque is finite, and every law holds a robot at rest."""
    law = components("controller")[name]()
    zero, start = (0.0,) * JOINTS, law.init(JOINTS)
    u, _ = law.step(ROBOT, DT, Measurement(q, v, zero), ReferencePoint(q, v, a), zero, start)
    assert all(map(math.isfinite, u))
    held, _ = law.step(ROBOT, DT, Measurement(q, zero, zero), ReferencePoint(q, zero, zero), zero, start)
    assert held == pytest.approx(ROBOT.gravity(q), abs=1e-13)


@of_kind("controller")
@settings(deadline=None, max_examples=40)
@given(s=samples)
def test_controller_sees_the_estimate_only_if_it_says_so(name: str, s: Sample) -> None:
    """The estimate is added as a torque by a law that needs an observer, ignored by one that does not."""
    law = components("controller")[name]()
    zero, start = (0.0,) * JOINTS, law.init(JOINTS)
    u, state = law.step(ROBOT, DT, s.now, s.reference, s.estimate, start)
    without, state_without = law.step(ROBOT, DT, s.now, s.reference, zero, start)
    assert state == state_without
    if law.needs_observer:
        assert u == tuple(map(float.__add__, without, s.estimate))
    else:
        assert repr(u) == repr(without)


@of_kind("observer")
def test_observer_finds_a_constant_disturbance(name: str) -> None:
    """A robot held at rest against a constant disturbance d: the estimate becomes -d within half a second."""
    q, d = (0.3, -0.4, 0.7), (5.0, -8.0, 2.0)
    u = tuple(g - x for g, x in zip(ROBOT.gravity(q), d))
    plant = PlantStage(ROBOT, DT, q, (0.0,) * JOINTS, None)
    observer = components("observer")[name]()
    state = observer.init(ROBOT, plant.measure())
    for _ in range(500):
        plant.position, plant.velocity, plant.effort = q, (0.0,) * JOINTS, u
        estimate, state = observer.step(ROBOT, DT, plant.measure(), state)
    expected = (0.0,) * JOINTS if name == "none" else tuple(-x for x in d)
    assert estimate == pytest.approx(expected, abs=1e-9)


@of_kind("sensor")
@settings(deadline=None, max_examples=40)
@given(s=samples)
def test_exact_sensor_reports_the_true_motion(name: str, s: Sample) -> None:
    """One that says so gives back what it is given."""
    sensor = components("sensor")[name]()
    q, v, _ = sensor.step(DT, *s.now[:2], sensor.init(JOINTS, 0))
    if sensor.exact:
        assert (q, v) == s.now[:2]


@of_kind("reference")
@settings(deadline=None, max_examples=100)
@given(t=st.floats(0.0, 60.0))
def test_reference_rates_are_its_derivatives(name: str, t: float) -> None:
    """Central differences; where the jerk of the quintic jumps they are off by 6e-7 rad/s²."""
    reference, later, earlier = components("reference")[name](), t + 1e-5, t - 1e-5
    ahead, now, behind = (reference.at(x, JOINTS) for x in (later, t, earlier))
    for j in range(JOINTS):
        assert now.velocity[j] == pytest.approx((ahead[0][j] - behind[0][j]) / (later - earlier), abs=1e-9)
        assert now.acceleration[j] == pytest.approx(
            (ahead[1][j] - behind[1][j]) / (later - earlier), abs=1e-6
        )


@of_kind("reference")
@pytest.mark.parametrize("joints", [1, 2, 6])
def test_reference_fits_any_number_of_joints(name: str, joints: int) -> None:
    """One entry per joint."""
    assert [len(x) for x in components("reference")[name]().at(1.0, joints)] == [joints] * 3


@of_kind("fault")
@settings(deadline=None, max_examples=40)
@given(s=samples, fraction=st.floats(0.0, 1.0), profile=st.sampled_from(["abrupt", "incipient"]))
def test_fault_is_zero_up_to_its_onset(name: str, s: Sample, fraction: float, profile: str) -> None:
    """Exactly zero at every t <= T_f; the severity scales what comes after."""
    cls = components("fault")[name]
    q, v, u = s.now
    start = 10.0
    assert cls(start=start, profile=profile).torque(fraction * start, q, v, u) == (0.0,) * JOINTS
    one, three = (
        cls(start=start, profile=profile, severity=x).torque(start + 1.0, q, v, u) for x in (1.0, 3.0)
    )
    assert three == pytest.approx(tuple(3.0 * x for x in one), rel=1e-14)
    assert cls(start=start, severity=0.0).torque(start + 1.0, q, v, u) == (0.0,) * JOINTS
