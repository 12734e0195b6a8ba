# SPDX-License-Identifier: Apache-2.0
"""Every registered component, of every kind, through the same checks."""

from __future__ import annotations

import copy
import dataclasses
import importlib.util
import inspect
import math
import re
from collections.abc import Iterator
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from ftcm_core.controllers import FeedbackLaw
from ftcm_core.disturbances import Disturbance
from ftcm_core.errors import ParameterError, ScenarioError
from ftcm_core.faults import ActuatorFault, AdditiveFault, CommunicationFault, Fault, RobotFault, SensorFault
from ftcm_core.params import ParamSpec, specs
from ftcm_core.plants import Plant
from ftcm_core.policies import Policy
from ftcm_core.registry import KINDS, components
from ftcm_core.robots import Robot
from ftcm_core.robots.puma560 import Puma560
from ftcm_core.scenario import InitialState, Scenario, from_mapping
from ftcm_core.signals import Measurement, ReferencePoint, Vector
from plugins import ROBOTS

pytestmark = pytest.mark.pure

DT, KEY = 1e-3, 12345.0
ROBOT = Puma560()
SITES = {
    ActuatorFault: "actuator", SensorFault: "sensor", AdditiveFault: "dynamics", RobotFault: "dynamics",
    CommunicationFault: "communication",
}  # fmt: skip
MUJOCO = importlib.util.find_spec("mujoco")
BY_JOINTS = {robot.joints: robot for robot in ROBOTS.values()}
assert sorted(BY_JOINTS) == [1, 2, 3, 6]
ALL = [(kind, name) for kind in KINDS for name in components(kind)]
every_number = pytest.mark.parametrize("robot", BY_JOINTS.values(), ids=[f"{n} joints" for n in BY_JOINTS])


def fitting(cls: type, robot: Robot, **given: Any) -> Any:
    """A component whose per-joint lists have an entry for each joint; the first one's, repeated."""
    lists = {s.name: s.default for s in specs(cls).values() if isinstance(s.default, tuple)}
    fits = {name: v for name, v in lists.items() if len(v) != robot.joints}
    return cls(**{**{name: (v[0],) * robot.joints for name, v in fits.items()}, **given})


def suits(cls: type, robot: Robot) -> bool:
    """Whether a component can be used with a robot at all."""
    if issubclass(cls, Robot):
        return False
    component = fitting(cls, robot)
    if isinstance(component, (Fault, Policy)):
        return not component.unsuited(robot)
    if isinstance(component, Plant):
        return not component.unsuited(robot, False)
    return not (isinstance(component, Disturbance) and component.supports(robot.joints))


def own(cls: type) -> list[ParamSpec]:
    """The parameters that a class declares itself; of a fault, not those of every fault of its site."""
    shared = {name for base in SITES if issubclass(cls, base) for name in specs(base)}
    return [s for s in specs(cls).values() if s.name not in shared]


VARIANTS = [  # every component at its defaults, and with every other choice of what it lets one choose
    pytest.param(
        kind, fitting(cls, robot, **given), robot, id="-".join([kind, name, *given.values(), str(n)])
    )
    for kind in KINDS
    for name, cls in components(kind).items()
    for n, robot in sorted(BY_JOINTS.items())
    if suits(cls, robot)
    for given in [{}, *({s.name: c} for s in own(cls) for c in s.choices if c != s.default)]
] + [pytest.param("robot", robot, robot, id=f"robot-{name}") for name, robot in ROBOTS.items()]
every_variant = pytest.mark.parametrize(("kind", "component", "robot"), VARIANTS)
every_component = pytest.mark.parametrize(("kind", "name"), ALL)
DECLARED = [
    pytest.param(cls, spec, id=f"{cls.__name__}-{spec.name}")
    for cls in [InitialState, *(components(kind)[name] for kind, name in ALL)]
    for spec in specs(cls).values()
]
every_parameter = pytest.mark.parametrize(("cls", "spec"), DECLARED)
JOINTS = 3


def of_kind(kind: str) -> pytest.MarkDecorator:
    """Parametrise a test by the names registered for a kind."""
    return pytest.mark.parametrize("name", components(kind))


def faults_of(site: type) -> pytest.MarkDecorator:
    """Parametrise a test by the names of the faults of a site."""
    return pytest.mark.parametrize(
        "name", [name for name, cls in components("fault").items() if issubclass(cls, site)]
    )


def vectors(bound: float, joints: int = 3) -> st.SearchStrategy[Vector]:
    """Joint vectors of floats up to a bound."""
    return st.tuples(*[st.floats(-bound, bound)] * joints)


@dataclasses.dataclass(frozen=True)
class Sample:
    """Two consecutive measurements, a reference point, an estimate and a time."""

    t: float
    before: Measurement
    now: Measurement
    reference: ReferencePoint
    estimate: Vector


def samples(joints: int = 3) -> st.SearchStrategy[Sample]:
    """Any sample of a robot with that many joints."""
    measurements = st.builds(
        Measurement, vectors(2 * math.pi, joints), vectors(5.0, joints), vectors(200.0, joints)
    )
    reference = st.builds(
        ReferencePoint, vectors(2 * math.pi, joints), vectors(5.0, joints), vectors(20.0, joints)
    )
    return st.builds(
        Sample, st.floats(0.0, 100.0), measurements, measurements, reference, vectors(100.0, joints)
    )


def control(law: Any, robot: Robot, y: Measurement, r: ReferencePoint, estimate: Vector, state: Any) -> Any:
    """One tick of a law, prepared as the stage does it."""
    prepared = law.prepare(robot, DT, y, r, state)
    return law.step(robot, DT, y, r, estimate, state, prepared)


def outputs(kind: str, component: Any, robot: Robot, s: Sample) -> tuple[list[Vector], list[Any]]:
    """Run a component for a tick or two: the joint vectors it gives and the states it passes through."""
    (q, v, u), joints = s.now, robot.joints
    if kind == "robot":
        a, c = s.reference.acceleration, component
        vectors = [c.inverse_dynamics(q, v, a), c.forward_dynamics(q, v, u), c.inertia_acceleration(q, u)]
        return [*vectors, c.inertia_torque(q, a), c.inertia_rate_torque(q, v), c.gravity(q)], []
    if kind == "plant":
        first = component.init(robot, q, v)
        second = component.step(robot, DT, u, first)
        third = component.step(robot, DT, s.estimate, second)
        return [x for state in (first, second, third) for x in component.motion(state)], [
            first,
            second,
            third,
        ]
    if kind == "reference":
        return list(component.at(s.t, joints)), []
    if kind == "controller":
        first = component.init(joints)
        u1, second = control(component, robot, s.before, s.reference, s.estimate, first)
        u2, third = control(component, robot, s.now, s.reference, s.estimate, second)
        assert [len(x) for x in (first, second, third)] == [joints] * 3, "a state has one entry per joint"
        return [u1, u2], [first, second, third]
    if kind == "sensor":
        first = component.init(joints, 7)
        q1, v1, second = component.step(DT, *s.before[:2], first)
        q2, v2, third = component.step(DT, q, v, second)
        return [q1, v1, q2, v2], [first, second, third]
    if kind == "observer":
        first = component.init(robot, s.before)
        estimate, second = component.step(robot, DT, s.now, first)
        again, third = component.step(robot, DT, s.before, second)
        return [estimate, again], [first, second, third]
    if kind == "detector":
        first = component.init(joints)
        one, second = component.step(robot, DT, s.before, u, s.estimate, first)
        two, third = component.step(robot, DT, s.now, u, s.estimate, second)
        return [*one, *two], [first, second, third]
    if kind == "policy":
        first, whole, broken = component.memory(joints), (0.0,) * joints, (1.0,) * joints
        one, second = component.measured(DT, s.before, whole, first)
        two, third = component.measured(DT, s.now, broken, second)
        assert one == s.before, "nothing is replaced before a decision"
        return [*one, *two], [first, second, third]
    return stepped(component, robot, s)


def stepped(component: Any, robot: Robot, s: Sample) -> tuple[list[Vector], list[Any]]:
    """The same for a disturbance or a fault."""
    (q, v, u), t = s.now, s.t
    if isinstance(component, RobotFault):
        changed = component.changed(robot)
        return outputs("robot", changed, changed, s)
    first = component.init(robot.joints, KEY)
    if isinstance(component, SensorFault):
        q1, v1, second = component.step(t, DT, *s.before[:2], first)
        q2, v2, third = component.step(t + DT, DT, q, v, second)
        return [q1, v1, q2, v2], [first, second, third]
    if isinstance(component, CommunicationFault):
        one, second = component.step(t, DT, s.before, first)
        two, third = component.step(t + DT, DT, s.now, second)
        return [*one, *two], [first, second, third]
    if isinstance(component, ActuatorFault):
        one, second = component.step(t, DT, u, *s.before[:2], first)
        two, third = component.step(t + DT, DT, s.estimate, q, v, second)
        return [one, two], [first, second, third]
    if isinstance(component, AdditiveFault):
        one, second = component.step(robot, t, *s.before[:2], u, first)
        two, third = component.step(robot, t + DT, q, v, s.estimate, second)
        return [one, two], [first, second, third]
    one, second = component.step(t, DT, *s.before[:2], u, first)
    two, third = component.step(t + DT, DT, q, v, s.estimate, second)
    return [one, two], [first, second, third]


def leaves(value: Any) -> Iterator[Any]:
    """Everything inside nested tuples."""
    if isinstance(value, tuple):
        for item in value:
            yield from leaves(item)
    else:
        yield value


def key_of(kind: str) -> str:
    """Where a scenario has a component of a kind."""
    return {"disturbance": "disturbances", "fault": "faults", "policy": "policies"}.get(kind, kind)


def scenario_with(kind: str, entry: Any) -> dict[str, Any]:
    """A scenario's mapping with one component in it, for a robot of three joints."""
    data: dict[str, Any] = {
        "robot": "puma560",
        "reference": "constant",
        "controller": "ctc",
        "observer": "none",
    }
    if kind in ("disturbance", "fault"):
        data["injection"] = {key_of(kind): [entry]}
    elif kind == "policy":
        data |= {"policies": [entry], "detector": "isolating"}
    else:
        data[kind] = entry
    if kind in ("controller", "detector"):
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
        wrong += ["1", math.nan, math.inf, -math.inf, 10**400]
        wrong += [] if spec.kind == "bool" else [True, False]
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
    foreign = kind == "plant" and components(kind)[name].foreign
    if foreign and not MUJOCO:
        pytest.skip("MuJoCo is not installed (pip install mujoco)")
    for entry in (mapping, name):  # the short form is the type alone
        data = scenario_with(kind, entry)
        if foreign:
            data["robot"] = "urdf"
        scenario = from_mapping(data)
        found = getattr(scenario, key_of(kind))
        assert (found if kind == key_of(kind) else found[0]) == component
    assert from_mapping(scenario.to_mapping()) == scenario


# Steps.


@every_variant
@settings(deadline=None, max_examples=20)
@given(data=st.data())
def test_step_is_pure(kind: str, component: Any, robot: Robot, data: st.DataObject) -> None:
    """Twice the same inputs give the same finite floats, one per joint; states are immutable values."""
    s = data.draw(samples(robot.joints))
    inputs = copy.deepcopy(s)
    first, states = outputs(kind, component, robot, s)
    second, states_again = outputs(kind, copy.deepcopy(component), copy.deepcopy(robot), s)
    assert repr((first, states)) == repr((second, states_again))
    assert repr(inputs) == repr(s)
    assert all(isinstance(v, tuple) and len(v) == robot.joints for v in first)
    assert all(type(x) is float and math.isfinite(x) for v in first for x in v)
    for state in states:
        hash(state)
        assert all(type(x) is float and math.isfinite(x) for x in leaves(state))


@every_variant
@settings(deadline=None, max_examples=10)
@given(data=st.data())
def test_equal_per_joint_values_are_the_scalar(
    kind: str, component: Any, robot: Robot, data: st.DataObject
) -> None:
    """A list of equal numbers gives bit for bit what the one number gives."""
    cls, s = type(component), data.draw(samples(robot.joints))
    if kind == "robot":  # where all links are alike there may be no such body
        scalar = {k: v for k, v in component.values.items() if not isinstance(v, tuple)}
    else:
        scalar = {k: v[0] if isinstance(v, tuple) else v for k, v in component.values.items()}
    listed = {
        k: (v,) * robot.joints if specs(cls)[k].per_joint and v is not None else v for k, v in scalar.items()
    }
    one, other = cls(**scalar), cls(**listed)
    if kind == "robot":
        assert repr(outputs(kind, one, one, s)) == repr(outputs(kind, other, other, s))
    else:
        assert repr(outputs(kind, one, robot, s)) == repr(outputs(kind, other, robot, s))


@every_variant
def test_what_fits_makes_a_scenario(kind: str, component: Any, robot: Robot) -> None:
    """Which reads back; a list of another length is refused by its place, whatever the robot."""
    fields: dict[str, Any] = {
        "robot": robot,
        "reference": components("reference")["constant"](),
        "controller": components("controller")["ctc"](),
        "observer": components("observer")["do"](),
    }
    key = key_of(kind)
    fields[key] = (component,) if key != kind else component
    if kind == "policy":
        fields["detector"] = components("detector")["isolating"]()
    scenario = Scenario(**fields)
    assert scenario.columns
    for spec in specs(type(component)).values():
        if spec.per_joint:
            value = getattr(component, spec.name)
            one = value[0] if isinstance(value, tuple) else (value if value is not None else 1.0)
            with pytest.raises(ParameterError, match=rf"{spec.name}: .*one per joint \({robot.joints}\)"):
                Scenario(**_with(fields, key, spec.name, [one] * (robot.joints + 1)))


def _with(fields: dict[str, Any], key: str, name: str, value: Any) -> dict[str, Any]:
    """The fields of a scenario with one parameter of one component changed."""
    old = fields[key]
    if isinstance(old, tuple):
        return {**fields, key: (dataclasses.replace(old[0], **{name: value}),)}
    return {**fields, key: dataclasses.replace(old, **{name: value})}


@every_component
def test_per_joint_list_must_fit_the_robot(kind: str, name: str) -> None:
    """One entry too few is refused by the scenario, which names the parameter."""
    cls = components(kind)[name]
    for spec in specs(cls).values():
        if spec.per_joint:
            value = spec.default[0] if isinstance(spec.default, tuple) else spec.default
            value = 1.0 if value is None else value
            entry = {"type": name, spec.name: [value] * (JOINTS - 1)}
            with pytest.raises(ParameterError, match=spec.name):
                cls(**{spec.name: [value] * (JOINTS - 1)}).check_joints(JOINTS)
            with pytest.raises(
                ScenarioError, match=rf"{key_of(kind)}(\.0)?\.{spec.name}: .*one .*per joint \(3\)"
            ):
                from_mapping(scenario_with(kind, entry))


@of_kind("controller")
@every_number
@settings(deadline=None, max_examples=20)
@given(data=st.data())
def test_controller_on_its_reference(name: str, robot: Robot, data: st.DataObject) -> None:
    """Without error and with zero state the torque is finite, and every law holds a robot at rest."""
    n = robot.joints
    q, v, a = (data.draw(vectors(bound, n)) for bound in (2 * math.pi, 5.0, 20.0))
    law = fitting(components("controller")[name], robot)
    zero, start = (0.0,) * n, law.init(n)
    u, _ = control(law, robot, Measurement(q, v, zero), ReferencePoint(q, v, a), zero, start)
    assert all(map(math.isfinite, u))
    held, _ = control(law, robot, Measurement(q, zero, zero), ReferencePoint(q, zero, zero), zero, start)
    assert held == pytest.approx(robot.gravity(q), abs=1e-12)


@of_kind("controller")
@every_number
@settings(deadline=None, max_examples=20)
@given(data=st.data())
def test_controller_sees_the_estimate_only_if_it_says_so(
    name: str, robot: Robot, data: st.DataObject
) -> None:
    """A law that needs no observer ignores the estimate; what is prepared knows nothing of it."""
    s, n = data.draw(samples(robot.joints)), robot.joints
    law = fitting(components("controller")[name], robot)
    zero, start = (0.0,) * n, law.init(n)
    u, state = control(law, robot, s.now, s.reference, s.estimate, start)
    without, state_without = control(law, robot, s.now, s.reference, zero, start)
    if not law.needs_observer:
        assert repr((u, state)) == repr((without, state_without))
    elif isinstance(law, FeedbackLaw):
        assert (u, state) == (tuple(map(float.__add__, without, s.estimate)), state_without)


@of_kind("observer")
@every_number
def test_observer_starts_from_zero_and_stays_finite(name: str, robot: Robot) -> None:
    """Its estimate is zero while nothing has been seen; later one finite number per joint."""
    n, q = robot.joints, (0.3, -0.4, 0.7, 0.2, -0.1, 0.5)[: robot.joints]
    observer, rest = fitting(components("observer")[name], robot), (0.0,) * robot.joints
    y = Measurement(q, rest, robot.gravity(q))
    state = observer.init(robot, y)
    estimate, state = observer.step(robot, DT, y, state)
    assert estimate == pytest.approx(rest, abs=1e-9), "held at rest by its weight alone: no disturbance"
    pushed = Measurement(q, rest, tuple(x + 3.0 for x in y.effort))
    for _ in range(200):
        estimate, state = observer.step(robot, DT, pushed, state)
        assert len(estimate) == n
        assert all(map(math.isfinite, estimate))


@of_kind("sensor")
@settings(deadline=None, max_examples=40)
@given(s=samples())
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
@pytest.mark.parametrize("joints", [1, 2, 3, 6])
def test_reference_fits_any_number_of_joints(name: str, joints: int) -> None:
    """One entry per joint."""
    assert [len(x) for x in components("reference")[name]().at(1.0, joints)] == [joints] * 3


PLANTS = [
    pytest.param(name, robot, id=f"{name}-{place}")
    for name, cls in components("plant").items()
    for place, robot in ROBOTS.items()
    if not cls().unsuited(robot, False)
]


def test_every_plant_moves_some_robot() -> None:
    assert {p.values[0] for p in PLANTS} == set(components("plant")) - (set() if MUJOCO else {"mujoco"})


@pytest.mark.parametrize(("name", "robot"), PLANTS)
@settings(deadline=None, max_examples=20)
@given(data=st.data())
def test_plant_starts_where_it_is_put_and_moves_on_from_its_state(
    name: str, robot: Robot, data: st.DataObject
) -> None:
    """Motion of the first state as given; a step moves by about dt v; the state before stays usable."""
    s, plant = data.draw(samples(robot.joints)), fitting(components("plant")[name], robot)
    q, v, u = s.now
    first = plant.init(robot, q, v)
    assert plant.motion(first) == (q, v)
    second = plant.step(robot, 1e-6, u, first)
    again = plant.step(robot, 1e-6, u, first)
    assert plant.motion(second) == plant.motion(again)
    assert plant.motion(second)[0] == pytest.approx([x + 1e-6 * d for x, d in zip(q, v)], abs=1e-6)
    assert plant.motion(first) == (q, v)


@pytest.mark.parametrize(("name", "robot"), PLANTS)
def test_plant_holds_a_robot_that_is_held(name: str, robot: Robot) -> None:
    """Under its weight's own torque a robot at rest stays; under more it moves that way."""
    q, rest = (0.3, -0.4, 0.7, 0.2, -0.1, 0.5)[: robot.joints], (0.0,) * robot.joints
    plant = fitting(components("plant")[name], robot)
    state = pushed = plant.init(robot, q, rest)
    for _ in range(20):
        state = plant.step(robot, DT, robot.gravity(q), state)
    for _ in range(20):
        push = robot.inertia_torque(q, (1.0,) * robot.joints)
        pushed = plant.step(robot, DT, tuple(map(float.__add__, robot.gravity(q), push)), pushed)
    assert plant.motion(state)[0] == pytest.approx(q, abs=1e-9)
    assert plant.motion(pushed)[1] == pytest.approx((0.02,) * robot.joints, rel=0.05)


@of_kind("detector")
@every_number
def test_detector_is_quiet_about_a_robot_at_rest(name: str, robot: Robot) -> None:
    """Held by its weight, without any disturbance seen: one residual per joint and no alarm."""
    n, q = robot.joints, (0.3, -0.4, 0.7, 0.2, -0.1, 0.5)[: robot.joints]
    rest, detector = (0.0,) * robot.joints, fitting(components("detector")[name], robot)
    held = robot.gravity(q)
    state = detector.init(n)
    for _ in range(100):
        found, state = detector.step(robot, DT, Measurement(q, rest, held), held, rest, state)
        assert len(found.residual) == n
        assert found.alarm == rest


@of_kind("detector")
@every_number
@settings(deadline=None, max_examples=20)
@given(data=st.data())
def test_alarms_are_zero_or_one(name: str, robot: Robot, data: st.DataObject) -> None:
    """Whatever is measured; one that needs no observer does not look at the estimate."""
    s, detector = data.draw(samples(robot.joints)), fitting(components("detector")[name], robot)
    zero, state, blind = (0.0,) * robot.joints, detector.init(robot.joints), detector.init(robot.joints)
    for y in (s.before, s.now, s.now):
        found, state = detector.step(robot, 0.1, y, s.estimate, s.estimate, state)
        unseeing, blind = detector.step(robot, 0.1, y, s.estimate, zero, blind)
        assert set(found.alarm) <= {0.0, 1.0}
        assert detector.needs_observer or found == unseeing


# Faults, site by site: nothing up to the onset, something after it.


@of_kind("fault")
def test_fault_has_a_site_and_acts_after_its_onset(name: str) -> None:
    """One of the four; the class belongs to one of the kinds that stages know."""
    cls = components("fault")[name]
    (base,) = [b for b in SITES if issubclass(cls, b)]
    assert cls.site == SITES[base]
    assert cls(start=3.0).start == 3.0


FRACTION = st.floats(0.0, 1.0)
PROFILE = st.sampled_from(["abrupt", "incipient", "ramp", "periodic", "intermittent", "one_shot"])
START = 10.0


@faults_of(AdditiveFault)
@every_number
@settings(deadline=None, max_examples=20)
@given(data=st.data(), fraction=FRACTION, profile=PROFILE)
def test_additive_fault_is_zero_up_to_its_onset(
    name: str, robot: Robot, data: st.DataObject, fraction: float, profile: str
) -> None:
    """Exactly zero at every t <= T_f; the severity scales what comes after."""
    cls, s = components("fault")[name], data.draw(samples(robot.joints))
    (q, v, u), zero = s.now, (0.0,) * robot.joints

    def torque(t: float, **given: Any) -> Vector:
        fault = fitting(cls, robot, start=START, **given)
        found: Vector = fault.step(robot, t, q, v, u, fault.init(robot.joints, KEY))[0]
        return found

    if fitting(cls, robot).unsuited(robot):
        return
    assert torque(fraction * START, profile=profile) == zero
    one, three = (torque(START + 0.1, profile=profile, severity=x) for x in (1.0, 3.0))
    assert three == pytest.approx(tuple(3.0 * x for x in one), rel=1e-14)
    assert torque(START + 0.1, severity=0.0) == zero


@faults_of(ActuatorFault)
@every_number
@settings(deadline=None, max_examples=20)
@given(data=st.data(), fraction=FRACTION, profile=PROFILE)
def test_actuator_fault_changes_nothing_up_to_its_onset(
    name: str, robot: Robot, data: st.DataObject, fraction: float, profile: str
) -> None:
    """The torque goes through bit for bit, also at T_f itself and with severity zero; later it does not."""
    cls, s = components("fault")[name], data.draw(samples(robot.joints))
    (q, v, u), n = s.now, robot.joints
    for t, severity in ((fraction * START, 1.0), (START, 1.0), (START + 1.0, 0.0)):
        fault = fitting(cls, robot, start=START, profile=profile, severity=severity)
        torque, _ = fault.step(t, DT, u, q, v, fault.init(n, KEY))
        assert repr(torque) == repr(u)
    fault = fitting(cls, robot, start=START)
    state, changed = fault.init(n, KEY), [False] * n
    for k in range(1, 10):  # at one place it may be zero, e.g. a ripple
        turned = tuple(x + 0.03 * k for x in q)
        torque, state = fault.step(START + k * DT, DT, (50.0,) * n, turned, v, state)
        changed = [before or x != 50.0 for before, x in zip(changed, torque)]
    assert all(changed)


@faults_of(SensorFault)
@every_number
@settings(deadline=None, max_examples=20)
@given(data=st.data(), fraction=FRACTION, profile=PROFILE)
def test_sensor_fault_changes_nothing_up_to_its_onset(
    name: str, robot: Robot, data: st.DataObject, fraction: float, profile: str
) -> None:
    """What is measured is reported, also at T_f itself and with severity zero."""
    cls, s = components("fault")[name], data.draw(samples(robot.joints))
    (q, v, _), n = s.now, robot.joints
    for t, severity in ((fraction * START, 1.0), (START, 1.0), (START + 1.0, 0.0)):
        fault = fitting(cls, robot, start=START, profile=profile, severity=severity)
        state = fault.init(n, KEY)
        for _ in range(2):
            *reported, state = fault.step(t, DT, q, v, state)
            assert repr(reported) == repr([q, v])


@faults_of(SensorFault)
@every_number
def test_sensor_fault_shows_in_a_motion_after_its_onset(name: str, robot: Robot) -> None:
    """Of a second of a sine, something is reported otherwise than it is measured, and nothing before."""
    fault, n = fitting(components("fault")[name], robot, start=START), robot.joints
    state, off = fault.init(n, KEY), []
    for k in range(-10, 1000):
        q, v = (math.sin(0.01 * k),) * n, (10.0 * math.cos(0.01 * k),) * n
        *reported, state = fault.step(START + k * DT, DT, q, v, state)
        off += [k] if reported != [q, v] else []
    assert off
    assert off[0] > 0


@faults_of(RobotFault)
def test_robot_fault_makes_another_robot_of_the_same_joints(name: str) -> None:
    """The one that is given stays; one that cannot be changed is said so."""
    fault = components("fault")[name]()
    changed = 0
    for empty in BY_JOINTS.values():
        robot = empty.loaded(1.0) or empty
        before = repr(robot)
        if fault.unsuited(robot):
            assert len(fault.unsuited(robot).splitlines()) == 1
            continue
        other = fault.changed(robot)
        assert type(other) is type(robot)
        assert other.joint_names == robot.joint_names
        assert (other != robot, repr(robot)) == (True, before)
        changed += 1
    assert changed


@faults_of(CommunicationFault)
@every_number
@settings(deadline=None, max_examples=20)
@given(data=st.data(), fraction=FRACTION)
def test_communication_fault_lets_every_message_through_up_to_its_onset(
    name: str, robot: Robot, data: st.DataObject, fraction: float
) -> None:
    """Also at T_f itself; whatever is received later has been sent before."""
    cls, n = components("fault")[name], robot.joints
    sent = [data.draw(samples(n)).now for _ in range(4)]
    fault = fitting(cls, robot, start=START)
    state = fault.init(n, KEY)
    for t, message in zip((fraction * START, START), sent):
        received, state = fault.step(t, DT, tuple(message), state)
        assert repr(received) == repr(tuple(message))
    for k, message in enumerate(sent[2:]):
        received, state = fault.step(START + (k + 1) * DT, DT, tuple(message), state)
        assert received in [tuple(x) for x in sent]
