# SPDX-License-Identifier: Apache-2.0
"""Every fault of the dynamics by itself: its claim, from the trace of a run or from single steps."""

from __future__ import annotations

import dataclasses
import math
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import puma560_matrix as links
from ftcm_core import compiled
from ftcm_core.errors import ScenarioError
from ftcm_core.faults.collision import half_sine
from ftcm_core.faults.friction_change import FrictionChange, stribeck_friction
from ftcm_core.faults.parameter_change import ParameterChange
from ftcm_core.faults.payload_drop import PayloadDrop
from ftcm_core.params import param
from ftcm_core.recording.trace import Trace
from ftcm_core.robots import Robot
from ftcm_core.robots.puma560 import Puma560
from ftcm_core.scenario import Scenario, from_mapping, load
from ftcm_core.simulation import Loop, simulate
from ftcm_core.simulation.stages import robot_changes
from plugins import ROBOTS, robots_known, scenario_mapping
from traces import close, same
from written_tick import WrittenTick, state_numbers

pytestmark = pytest.mark.pure

START, DT = 0.05, 1e-3
FIRST = 51
"""First tick after the onset."""
RAMP = "profile: ramp, rise: 0.1"
PUMA = Puma560()


def scenario(*faults: str, more: tuple[str, ...] = ()) -> Scenario:
    """The paper's experiment, 0.2 s of it, with faults of its own and no disturbance."""
    entries = ", ".join(
        "{" + fault + ("" if "start:" in fault else f", start: {START}") + "}" for fault in faults
    )
    return load(
        "paper", ["duration=0.2", "injection.disturbances=[]", f"injection.faults=[{entries}]", *more]
    )


def run(*faults: str, more: tuple[str, ...] = ()) -> Trace:
    """Simulate it; there is no disturbance up to the onset."""
    trace = simulate(scenario(*faults, more=more))
    assert trace.status == "completed"
    assert not trace.disturbance[:FIRST].any()
    return trace


def angles(n: int) -> st.SearchStrategy[Any]:
    """Joint positions."""
    return st.tuples(*[st.floats(-math.pi, math.pi)] * n)


# Where the tip is.


def tip(q: Any) -> Any:
    """Position of the PUMA's tip in the base frame, m, by its link frames; also of complex q."""
    rotation, origin = links.frames(q)[-1]
    return origin + rotation @ np.array([0.0, 0.0, PUMA.payload_distance])


@settings(deadline=None, max_examples=100)
@given(angles(3), st.tuples(*[st.floats(-100.0, 100.0)] * 3))
def test_a_force_at_the_tip_does_the_work_that_its_torques_do(q: Any, force: Any) -> None:
    """Virtual work: torque = derivatives of F · x(q), x the forward kinematics."""
    expected = links.gradient(lambda q: np.dot(tip(q), force), np.array(q))
    assert PUMA.tip_torque(q, force) == pytest.approx(expected, abs=1e-12)


@pytest.mark.parametrize("name", ["pendulum", "planar_arm", "puma560"])
@settings(deadline=None, max_examples=50)
@given(data=st.data())
def test_the_weight_of_a_payload_is_a_force_at_the_tip(name: str, data: st.DataObject) -> None:
    """Its gravity torque is minus that of m g downwards."""
    robot = ROBOTS[name]
    q, loaded = data.draw(angles(robot.joints)), robot.loaded(2.0)
    assert loaded is not None
    weight = np.subtract(loaded.gravity(q), robot.gravity(q))
    assert robot.tip_torque(q, (0.0, 0.0, -2.0 * 9.81)) == pytest.approx(-weight, abs=1e-12)


def test_a_force_at_the_tip() -> None:
    """The disturbance is ψ Jᵀ F at the true position."""
    trace = run(f"type: tip_force, force_x: 10, force_y: -20, force_z: 30, {RAMP}")
    for k in range(FIRST, trace.ticks):
        psi = min(1.0, (trace.time[k] - START) / 0.1)
        torque = PUMA.tip_torque(tuple(trace.position[k].tolist()), (10.0, -20.0, 30.0))
        assert trace.disturbance[k] == pytest.approx(psi * np.array(torque), rel=1e-13)


@pytest.mark.parametrize("name", ["tip_force", "collision"])
def test_a_robot_without_a_tip_is_refused_and_a_single_joint_too(name: str) -> None:
    """The arm of six joints does not say where it is."""
    with robots_known(), pytest.raises(ScenarioError, match=r"faults\.0: needs a robot that knows its tip"):
        from_mapping(scenario_mapping("serial_arm", injection={"faults": [name]}))
    with pytest.raises(ScenarioError, match=r"faults\.0\.joint: 2, but a force at the tip loads all joints"):
        scenario(f"type: {name}, joint: 2")


# A collision.


@settings(deadline=None, max_examples=200)
@given(st.integers(10, 200), st.floats(0.0, 1.0))
def test_the_impulse_over_ticks_is_the_one_given(n: int, late: float) -> None:
    """A contact of n ticks, begun at any time within one: within π²/(12 n²)."""
    impulse = sum(half_sine((k - late) * DT, n * DT) for k in range(1, n + 1)) * DT
    assert abs(impulse - 1.0) <= math.pi**2 / (12.0 * n * n) * 1.01


def test_a_collision_throws_the_arm() -> None:
    """A pendulum that falls freely: impulse over mass, but for what is missing of a contact of 20 ticks."""
    with robots_known():
        text = scenario_mapping("pendulum", duration=0.2)
        free = {"type": "free_joint", "start": 0.0}
        hit = {"type": "collision", "start": START, "impulse_x": 0.5, "contact_time": 0.02}
        hit_not, hit_once = [
            simulate(from_mapping({**text, "injection": {"faults": faults}}))
            for faults in ([free], [free, hit])
        ]
    assert same(hit_not, hit_once, slice(FIRST))
    assert hit_once.velocity[FIRST] == hit_not.velocity[FIRST]
    end = FIRST + 20
    assert hit_once.disturbance[FIRST : end - 1].all()
    assert not hit_once.disturbance[end:].any()
    faster = hit_once.velocity[end, 0] - hit_not.velocity[end, 0]
    q = float(hit_not.position[FIRST, 0])
    # m l² v = l cos(q) p, less what gravity takes back within the contact, g / l sin(q) to second order
    assert faster == pytest.approx(0.5 * math.cos(q) / (2.0 * 0.5), rel=0.005)


def test_a_contact_of_few_ticks_is_refused() -> None:
    """What the ticks do not show has another impulse."""
    with pytest.raises(
        ScenarioError, match=r"contact_time: 0\.005 s is less than 10 ticks; expected at least 0\.01$"
    ):
        scenario("type: collision, contact_time: 0.005")
    assert scenario("type: collision, contact_time: 0.01")


# Torques from outside and friction.


def test_an_external_torque() -> None:
    """ψ torque, on one joint or all; as a push of a given length."""
    trace = run(f"type: external_torque, torque: [1, -2, 3], {RAMP}")
    psi = np.minimum(1.0, (trace.time[FIRST:, None] - START) / 0.1)
    assert trace.disturbance[FIRST:] == pytest.approx(psi * [1.0, -2.0, 3.0], rel=1e-13)
    push = run("type: external_torque, torque: 10, joint: 2, profile: one_shot, period: 0.1")
    since = push.time[FIRST:] - START
    expected = np.where(since < 0.1, 10.0 * np.sin(math.pi * since / 0.1) ** 2, 0.0)
    assert push.disturbance[FIRST:, 1] == pytest.approx(expected, abs=1e-12)
    assert not push.disturbance[:, [0, 2]].any()


def test_friction_is_added() -> None:
    """By its formula at the true velocity."""
    trace = run("type: friction_change, viscous: [1, 2, 3], stribeck: 2", more=("sensor=encoder",))
    v = trace.velocity[FIRST:]
    expected = np.array([1.0, 2.0, 3.0]) * v
    expected += (4.0 + 2.0 * np.exp(-((v / 0.2) ** 2))) * np.tanh(v / 0.05)
    assert trace.disturbance[FIRST:] == pytest.approx(-expected, rel=1e-12)


positive = st.floats(0.0, 50.0, allow_subnormal=False)  # below, numbers have too few digits for a ratio
speeds = st.floats(-10.0, 10.0, allow_subnormal=False)


@settings(deadline=None, max_examples=300)
@given(speeds, positive, positive, positive, st.floats(0.01, 1.0), st.floats(0.01, 1.0))
def test_friction_takes_energy(v: float, b: float, c: float, s: float, width: float, slip: float) -> None:
    """Never gives any; odd, zero at rest, nowhere steeper than there."""
    f = stribeck_friction(v, b, c, s, width, slip)
    assert f * v >= 0.0
    assert stribeck_friction(-v, b, c, s, width, slip) == -f
    assert stribeck_friction(0.0, b, c, s, width, slip) == 0.0
    assert abs(f) <= (b + (c + s) / slip) * abs(v) * (1.0 + 1e-12)


def test_friction_at_rest_is_more_than_in_motion() -> None:
    """Stribeck: coulomb + stribeck just off rest, coulomb well beyond v_s."""
    slow, fast = (stribeck_friction(v, 0.0, 4.0, 1.0, 0.2, 0.001) for v in (0.01, 2.0))
    assert slow == pytest.approx(5.0, rel=1e-3)
    assert fast == pytest.approx(4.0, rel=1e-12)


def test_friction_too_steep_for_the_ticks_is_refused() -> None:
    """The severity counts; what is said to do does."""
    assert scenario("type: friction_change, slip_velocity: 0.01")
    with pytest.raises(ScenarioError, match=r"faults\.0\.slip_velocity: .* would shake; expected") as error:
        scenario("type: friction_change, slip_velocity: 0.01, severity: 3")
    limit = float(str(error.value).partition("expected ")[2].partition(" ")[0])
    slope = 3.0 * (2.0 + 5.0 / 0.01)
    fault = FrictionChange(viscous=0.99 * limit, coulomb=0.0, stribeck=0.0)
    assert limit < slope
    assert fault.too_coarse(PUMA, DT) == ""
    assert FrictionChange(viscous=1.05 * limit, coulomb=0.0, stribeck=0.0).too_coarse(PUMA, DT)


# The robot.


def changes(*faults: str, more: tuple[str, ...] = ()) -> list[tuple[int, Robot]]:
    """The robots to come and the ticks in which they do."""
    return [(time_ns // 1_000_000, robot) for time_ns, robot in robot_changes(scenario(*faults, more=more))]


def test_a_payload_is_dropped() -> None:
    """All of it, or as much; what was picked up before too."""
    two = ("robot.payload_mass=2",)
    assert changes("type: payload_drop", more=two) == [(FIRST, PUMA)]
    assert changes("type: payload_drop, mass: 0.5", more=two) == [(FIRST, PUMA.loaded(1.5))]
    assert changes("type: payload_drop, mass: 3", more=two) == [(FIRST, PUMA)]
    picked = changes("type: payload_drop, start: 0.1", "type: payload_pickup, mass: 1", more=two)
    assert picked == [(FIRST, PUMA.loaded(3.0)), (101, PUMA)]
    trace, loaded = run("type: payload_drop", more=two), run(more=two)
    assert same(trace, loaded, slice(FIRST + 1))
    assert not np.array_equal(trace.velocity[FIRST + 1], loaded.velocity[FIRST + 1])
    with robots_known(), pytest.raises(ScenarioError, match=r"faults\.0: needs a robot with the parameter"):
        from_mapping(scenario_mapping("serial_arm", injection={"faults": ["payload_drop"]}))
    assert PayloadDrop().changed(PUMA) == PUMA


def test_a_parameter_changes() -> None:
    """All entries, or that of one joint; the model does not know."""
    assert changes("type: parameter_change") == [(FIRST, Puma560(mass=(0.0, 17.4 * 1.3, 6.05 * 1.3)))]
    one = changes("type: parameter_change, parameter: centre_y, factor: 2, joint: 3")
    assert one == [(FIRST, Puma560(centre_y=(0.0, 0.006, -0.142921 * 2.0)))]
    rubbed = changes("type: parameter_change, parameter: viscous_friction, factor: 3, joint: 2",
                     more=("robot.viscous_friction=2",))  # fmt: skip
    assert rubbed == [(FIRST, Puma560(viscous_friction=(2.0, 6.0, 2.0)))]
    trace = run("type: parameter_change")
    assert trace.scenario is not None
    assert trace.scenario.model == PUMA
    assert not np.array_equal(trace.velocity[FIRST + 1], run().velocity[FIRST + 1])
    less = changes("type: parameter_change, parameter: gravity_acceleration, factor: 0.5, lifetime: timed, "
                   "duration: 0.1")  # fmt: skip
    assert less == [(FIRST, Puma560(gravity_acceleration=9.81 * 0.5)), (151, PUMA)]


@pytest.mark.parametrize(
    ("fault", "words"),
    [
        ("parameter: mas", r"faults\.0: parameter: the robot has no number 'mas'; did you mean 'mass'\?"),
        ("parameter: joint", r"the robot has no number 'joint'; "),
        ("parameter: payload_mass", "parameter: 'payload_mass' of the robot is 0; expected one that"),
        ("parameter: mass, joint: 1", "parameter: 'mass' of the robot is 0; expected one that"),
        ("parameter: mass, joint: 4", "joint: 4 is out of range; expected 0"),
        ("parameter: gravity_acceleration, joint: 1", "joint: 1, but 'gravity_acceleration' is no parameter"),
        ("factor: 1.0e+300", r"faults\.0: makes a robot that cannot be: "),
        ("parameter: centre_x, factor: 100", r"makes a robot that cannot be: centre_x: 6\.8 is out of range"),
        ("factor: 2, trigger: condition, trigger_above: 1, trigger_joint: 7", "trigger_joint: 7 is out of"),
    ],
)
def test_a_parameter_that_cannot_change_so_is_refused(fault: str, words: str) -> None:
    """In one line, before the run."""
    with pytest.raises(ScenarioError, match=words) as error:
        scenario(f"type: parameter_change, {fault}")
    assert len(str(error.value).splitlines()) == 1


def test_parameters_that_together_cannot_be_are_refused() -> None:
    """Each by itself could."""
    once = "type: parameter_change, parameter: payload_distance, factor: 10"
    assert scenario(once)
    with pytest.raises(ScenarioError, match=r"faults\.1: makes a robot that cannot be: payload_distance: "):
        scenario(once, once)


@dataclasses.dataclass(frozen=True, kw_only=True)
class Odd(Puma560):
    """A robot with a number that may be null."""

    spare: float | None = param(None, unit="-", optional=True, kind="float", doc="nothing", source="test")


def test_a_null_parameter_does_not_change() -> None:
    """A factor has nothing to change."""
    change = ParameterChange(parameter="spare")
    assert change.unsuited(Odd()) == "parameter: 'spare' of the robot is null; expected one that has a value"
    assert change.unsuited(Odd(spare=2.0)) == ""
    assert change.changed(Odd(spare=2.0)) == Odd(spare=2.6)


# All of them.

EVERY = (
    "type: payload_drop, start: 0.12",
    "type: payload_pickup, start: 0.08, mass: 1",
    "type: parameter_change",
    "type: friction_change",
    f"type: tip_force, {RAMP}",
    "type: collision, impulse_y: 1, severity: 0.3",
    "type: external_torque, torque: [1, -2, 3], profile: intermittent, period: 0.01",
    "type: vo_kang_fault",
)
CARRYING = ("robot.payload_mass=1",)


def test_all_at_once_written() -> None:
    """The source of a compiled tick, run by Python, is the plain tick bit for bit."""
    found = scenario(*[x for x in EVERY if "payload" not in x and "parameter" not in x], more=CARRYING)
    loop, plain = Loop(found), Loop(found)
    rows: list[list[float]] = []
    for k in range(3):
        loop.tick(k * found.dt_ns, False, lambda row: None)
        plain.tick(k * found.dt_ns, False, lambda row: None)
    written = WrittenTick(loop)
    assert written.run(3, 200) == 200
    for k in range(3, 200):
        assert not plain.tick(k * found.dt_ns, False, lambda row: rows.append(list(row)))
    assert written.rows == rows
    assert written.state == state_numbers(plain)


@pytest.mark.slow
def test_all_at_once_compiled(monkeypatch: pytest.MonkeyPatch, tmp_path: Any) -> None:
    """As plainly, closely."""
    pytest.importorskip("numba")
    monkeypatch.setenv(compiled.CACHE, str(tmp_path))
    found = scenario(*EVERY, more=CARRYING)
    assert [k for k, _ in changes(*EVERY, more=CARRYING)] == [51, 81, 121]
    trace = compiled.simulate(found)
    assert trace.engine == "compiled"
    close(trace, simulate(found), rtol=1e-7, atol=1e-7)
