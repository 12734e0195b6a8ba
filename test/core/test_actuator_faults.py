# SPDX-License-Identifier: Apache-2.0
"""Every fault of the actuators by itself: its claim, from the trace of a run or from single steps."""

from __future__ import annotations

import math
from itertools import pairwise
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from ftcm_core import compiled
from ftcm_core.errors import ParameterError, ScenarioError
from ftcm_core.faults import ActuatorFault, Moment
from ftcm_core.faults.actuator_delay import ActuatorDelay
from ftcm_core.faults.backlash import Backlash
from ftcm_core.faults.locked_joint import LockedJoint
from ftcm_core.faults.stability import steepness
from ftcm_core.recording.trace import Trace
from ftcm_core.registry import components
from ftcm_core.scenario import Scenario, from_mapping, load
from ftcm_core.simulation import Loop, simulate
from plugins import ROBOTS, robots_known, scenario_mapping
from traces import close, same
from written_tick import WrittenTick, state_numbers

pytestmark = pytest.mark.pure

START, DT = 0.05, 1e-3
FIRST = 51
"""First tick after the onset."""
RAMP = "profile: ramp, rise: 0.1"
ACTUATOR = [name for name, cls in components("fault").items() if issubclass(cls, ActuatorFault)]


def scenario(*faults: str, more: tuple[str, ...] = ()) -> Scenario:
    """The paper's experiment, 0.2 s of it, with faults of its own and no disturbance."""
    entries = ", ".join(
        "{" + fault + ("" if "start:" in fault else f", start: {START}") + "}" for fault in faults
    )
    return load(
        "paper", ["duration=0.2", "injection.disturbances=[]", f"injection.faults=[{entries}]", *more]
    )


def run(*faults: str, more: tuple[str, ...] = ()) -> tuple[Trace, Any, Any]:
    """Simulate it: the trace, the torques asked for and those on the joints, for each tick but the last."""
    trace = simulate(scenario(*faults, more=more))
    assert trace.status == "completed"
    assert trace.joint_torque is not None
    asked, applied = trace.effort[1:], trace.joint_torque[1:]
    assert np.array_equal(asked, trace.command[:-1]), "the drives do not notice"
    assert np.array_equal(applied[:FIRST], asked[:FIRST])
    assert not np.array_equal(applied[FIRST:], asked[FIRST:])
    return trace, asked, applied


def grown(trace: Trace, rise: float = 0.0) -> Any:
    """ψ of a ramp, abrupt without rise, for each tick from the first after the onset, of shape (ticks, 1)."""
    since = trace.time[FIRST:-1, None] - START
    return np.minimum(1.0, since / rise) if rise else np.ones_like(since)


# What belongs to the command.


def test_the_torque_comes_late() -> None:
    """That of 10 ticks before, also right after the onset; what was on its way then is known."""
    _, asked, applied = run("type: actuator_delay, delay: 10")
    assert np.array_equal(applied[FIRST:], asked[FIRST - 10 : -10])


def test_a_delay_grows_by_whole_ticks() -> None:
    """Round(10 ψ) ticks."""
    trace, asked, applied = run(f"type: actuator_delay, delay: 10, {RAMP}")
    ticks = [FIRST + k - math.floor(10.0 * psi + 0.5) for k, (psi,) in enumerate(grown(trace, 0.1))]
    assert np.array_equal(applied[FIRST:], asked[ticks])


def test_a_delay_longer_than_the_run_is_no_torque_after_the_onset() -> None:
    """Zero torque is what was there before the first tick."""
    trace = simulate(scenario("type: actuator_delay, delay: 100", more=("duration=0.09",)))
    assert trace.joint_torque is not None
    assert not trace.joint_torque[FIRST + 1 :].any()


@pytest.mark.parametrize(("more", "rise"), [("", 0.0), (f", {RAMP}", 0.1)])
def test_a_dead_zone(more: str, rise: float) -> None:
    """No torque within ψ width, beyond it less by that."""
    trace, asked, applied = run(f"type: dead_zone, width: [1, 20, 30]{more}")
    width = np.array([1.0, 20.0, 30.0]) * grown(trace, rise)
    u = asked[FIRST:]
    expected = np.where(np.abs(u) <= width, 0.0, u - np.sign(u) * width)
    assert applied[FIRST:] == pytest.approx(expected, abs=1e-13)
    assert (expected == 0.0).any()
    assert (expected != 0.0).any()


def played(gap: float, u: list[float], size: float = 1.0) -> list[float]:
    """Backlash of one joint, from u[0] on."""
    y, s = [], (u[0],)
    for x in u:
        torque, s = Backlash.act(
            Backlash(gap=gap), size, Moment(1.0, DT, 0.5, 0.0, 0.0), x, 0.0, 0.0, s
        )  # fmt: skip
        y.append(torque)
    return y


@settings(deadline=None, max_examples=200)
@given(st.floats(0.01, 10.0), st.lists(st.floats(-50.0, 50.0), min_size=2, max_size=30))
def test_backlash_is_the_play_operator(gap: float, u: list[float]) -> None:
    """Within the gap of the torque; it moves only where it is at its end, and then with the torque."""
    y = [u[0], *played(gap, u)[1:]]
    for (_, x), (before, now) in zip(pairwise(u), pairwise(y)):
        assert abs(now - x) <= gap * (1.0 + 1e-12)
        if now != before:
            assert now in (x - gap, x + gap)
            assert (now > before) == (x > before)
        else:
            assert abs(x - before) <= gap * (1.0 + 1e-12)


@settings(deadline=None, max_examples=100)
@given(st.floats(0.01, 10.0), st.lists(st.floats(-50.0, 50.0), min_size=2, max_size=15), st.integers(1, 5))
def test_backlash_does_not_depend_on_the_rate(gap: float, u: list[float], slower: int) -> None:
    """The same torques, each held: the same path."""
    assert played(gap, [x for x in u for _ in range(slower)])[slower - 1 :: slower] == played(gap, u)


def test_backlash_in_a_run() -> None:
    """It starts from the torque of the last tick before; nothing of it follows until the gap is crossed."""
    _, asked, applied = run("type: backlash, gap: [0.5, 2, 1]")
    gap, y = np.array([0.5, 2.0, 1.0]), asked[FIRST - 1]
    for u, found in zip(asked[FIRST:], applied[FIRST:]):
        y = np.clip(y, u - gap, u + gap)
        assert np.array_equal(found, y)
    assert (applied[FIRST] == asked[FIRST - 1]).any()


@pytest.mark.parametrize(("more", "rise"), [("", 0.0), (f", {RAMP}", 0.1), (", severity: 2", 0.0)])
def test_reduced_saturation(more: str, rise: float) -> None:
    """At most limit / ψ; the drive says what it was asked for."""
    trace, asked, applied = run(f"type: reduced_saturation, limit: [0.5, 20, 5]{more}")
    psi = grown(trace, rise) * (2.0 if "severity" in more else 1.0)
    limit = np.array([0.5, 20.0, 5.0]) / psi
    assert np.array_equal(applied[FIRST:], np.clip(asked[FIRST:], -limit, limit))


# What is added.


def test_a_bias() -> None:
    """Torque + ψ bias."""
    trace, asked, applied = run(f"type: actuator_bias, bias: [1, -2, 3], {RAMP}")
    expected = np.array([1.0, -2.0, 3.0]) * grown(trace, 0.1)
    assert applied[FIRST:] - asked[FIRST:] == pytest.approx(expected, abs=1e-13)


def test_a_ripple_follows_the_position() -> None:
    """A sin(n q + φ) at the true position; the same one turn of the joint further."""
    trace, asked, applied = run(
        "type: torque_ripple, amplitude: [1, 2, 3], cycles: [24, 100, 7], phase_angle: [0, 1, 2]",
        more=("sensor={type: encoder, noise: 0.001}",),
    )
    q = trace.position[FIRST:-1]
    for turned in (q, q + 2.0 * math.pi):
        expected = np.array([1.0, 2.0, 3.0]) * np.sin(np.array([24.0, 100.0, 7.0]) * turned + [0.0, 1.0, 2.0])
        assert applied[FIRST:] - asked[FIRST:] == pytest.approx(expected, abs=1e-12)
    assert np.abs(applied - asked).max(axis=0).min() > 0.5


def test_an_oscillation_follows_the_time() -> None:
    """A sin(2π f (t - T_f))."""
    trace, asked, applied = run("type: torque_oscillation, amplitude: [1, 2, 3], frequency: [5, 20, 400]")
    since = trace.time[FIRST:-1, None] - START
    expected = np.array([1.0, 2.0, 3.0]) * np.sin(2.0 * math.pi * np.array([5.0, 20.0, 400.0]) * since)
    assert applied[FIRST:] - asked[FIRST:] == pytest.approx(expected, abs=1e-11)


def test_an_oscillation_too_fast_for_the_ticks_is_refused() -> None:
    """It would be another frequency."""
    with pytest.raises(ScenarioError, match=r"faults\.0\.frequency: 600 Hz is too fast .* less than 500"):
        scenario("type: torque_oscillation, frequency: [5, 600, 5]")


# What takes the place of the torque.


def test_a_torque_sticks_at_the_onset() -> None:
    """At that of the last tick before; or at a given one."""
    _, asked, applied = run("type: stuck_torque")
    assert np.array_equal(applied[FIRST:], np.tile(asked[FIRST - 1], (200 - FIRST, 1)))
    _, _, applied = run("type: stuck_torque, level: [1, -2, 3]")
    assert np.array_equal(applied[FIRST:], np.tile([1.0, -2.0, 3.0], (200 - FIRST, 1)))


def test_a_torque_sticks_anew_each_time() -> None:
    """With 20 ticks on and 20 ticks off: at that of the last tick in which it did not."""
    _, asked, applied = run("type: stuck_torque, profile: periodic, period: 0.0401, duty: 0.5")
    stuck = ~(applied == asked).all(axis=1)
    begins = [k for k in range(FIRST, 200) if stuck[k] and not stuck[k - 1]]
    assert len(begins) == 4
    for k in range(FIRST, 200):
        if stuck[k]:
            assert np.array_equal(applied[k], asked[max(b for b in begins if b <= k) - 1])


def test_hard_over() -> None:
    """Full torque to one side, at once or running away to it."""
    _, _, applied = run("type: hard_over, level: [60, -90, 60]")
    assert np.array_equal(applied[FIRST:], np.tile([60.0, -90.0, 60.0], (200 - FIRST, 1)))
    trace, asked, applied = run(f"type: hard_over, level: [60, -90, 60], {RAMP}")
    psi = grown(trace, 0.1)
    expected = (1.0 - psi) * asked[FIRST:] + psi * [60.0, -90.0, 60.0]
    assert applied[FIRST:] == pytest.approx(expected, rel=1e-13)


def test_a_joint_swings_free() -> None:
    """No torque at all on joint 2; the others go on."""
    _, asked, applied = run("type: free_joint, joint: 2")
    assert not applied[FIRST:, 1].any()
    assert np.array_equal(applied[:, [0, 2]], asked[:, [0, 2]])


@pytest.mark.parametrize("name", ["actuator_delay", "stuck_torque", "hard_over", "free_joint"])
def test_more_than_the_whole_is_refused(name: str) -> None:
    """Of what takes the place of something."""
    with pytest.raises(
        ParameterError, match=r"severity: 1\.5 is more than the whole of it; expected at most 1"
    ):
        components("fault")[name](severity=1.5)


# The brake.


def test_a_locked_joint_is_held_against_its_drive() -> None:
    """Off by what full torque and the weight make of the spring, once it has rung out; then let go."""
    still = ("duration=1", "reference=constant", "reference.position=0.5", "initial_state.position=0.5")
    faults = ("type: locked_joint, lifetime: timed, duration: 0.9", "type: hard_over, level: [80, -80, 60]")
    trace = simulate(scenario(*faults, more=still))
    assert trace.status == "completed"
    assert trace.joint_torque is not None
    applied, level = trace.joint_torque[1:], np.array([80.0, -80.0, 60.0])
    z, closed, end = trace.position[FIRST - 1], slice(FIRST, 951), slice(900, 951)
    spring = 20_000.0 * (trace.position[:-1] - z) + 100.0 * trace.velocity[:-1]
    assert np.abs(spring[closed]).max() < 250.0, "it does not slip"
    assert applied[closed] == pytest.approx((level - spring)[closed], abs=1e-9)
    assert np.array_equal(applied[951:], np.tile(level, (49, 1)))
    weight = ROBOTS["puma560"].gravity(tuple(z.tolist()))
    assert spring[end] == pytest.approx(np.tile(level - weight, (51, 1)), abs=0.5)
    assert np.abs(trace.position[end] - z).max() < math.radians(0.4)


def brake(duration: float, **parameters: Any) -> Trace:
    """A pendulum of 2 kg at 0.5 m, held horizontally until its drive lets go and its brake closes."""
    more = {
        "reference": {"type": "constant", "position": math.pi / 2},
        "initial_state": {"position": math.pi / 2},
        "injection": {
            "faults": [
                {"type": "free_joint", "start": START},
                {"type": "locked_joint", "start": START, **parameters},
            ]
        },
    }
    with robots_known():
        return simulate(from_mapping(scenario_mapping("pendulum", duration=duration, **more)))


WEIGHT = 2.0 * 9.81 * 0.5
"""Torque of the pendulum's weight, N·m; its inertia is 0.5 kg·m²."""


def test_the_spring_of_the_brake_gives_way_by_load_over_stiffness() -> None:
    """And by no more later: it does not creep."""
    trace = brake(4.0, stiffness=1000.0, damping=20.0)
    off = math.pi / 2 - trace.position[:, 0]
    assert off[2000] == pytest.approx(WEIGHT / 1000.0, rel=1e-3)
    assert off[4000] == pytest.approx(off[2000], rel=1e-9)


def test_the_brake_slips_beyond_its_holding_torque() -> None:
    """Then it brakes with just that; it falls by weight less holding torque."""
    trace = brake(0.3, holding_torque=5.0)
    assert trace.joint_torque is not None
    assert trace.joint_torque[100:, 0] == pytest.approx(5.0)
    acceleration = np.diff(trace.velocity[100:, 0]) / DT
    expected = (5.0 - WEIGHT * np.sin(trace.position[100:-1, 0])) / 0.5
    assert acceleration == pytest.approx(expected, abs=0.02)


def test_a_brake_that_slips_holds_where_it_stopped() -> None:
    """Half closed it slips; closed it takes the joint where it then is, with the spring where it can be."""
    trace = brake(2.0, holding_torque=20.0, profile="ramp", rise=0.5)
    assert trace.joint_torque is not None
    assert np.abs(trace.velocity[-100:]).max() < 1e-6
    assert trace.position[-1, 0] < math.pi / 2 - 0.01
    held = WEIGHT * math.sin(trace.position[-1, 0])
    assert trace.joint_torque[-1, 0] == pytest.approx(held, abs=1e-4)


@settings(deadline=None, max_examples=300)
@given(st.integers(1, 4), st.integers(0, 2**32 - 1), st.floats(0.01, 3.0), st.floats(0.01, 3.0))
def test_when_held_springs_and_dampers_are_stable(n: int, seed: int, d: float, k: float) -> None:
    """The eigenvalues of the ticks say so too; for one joint the condition is also necessary."""
    draw = np.random.default_rng(seed)
    root = draw.normal(size=(n, n))
    m = root @ root.T + 0.3 * np.eye(n)
    damping = np.diag(draw.uniform(0.2, 1.0, n)) * d / np.linalg.norm(np.linalg.inv(m), 2)
    stiffness = np.diag(draw.uniform(0.2, 1.0, n) * np.diag(damping)) * k  # dt = 1
    answer = np.linalg.solve(m, np.hstack([stiffness, damping]))
    step = np.eye(2 * n)
    step[:n, n:] += np.eye(n)
    step[:n] -= 0.5 * answer
    step[n:] -= answer
    radius = np.abs(np.linalg.eigvals(step)).max()
    smallest = min(np.linalg.eigvalsh(m - damping / 2).min(), np.diag(damping - stiffness / 2).min())
    if smallest > 1e-9:
        assert radius < 1.0
    elif n == 1 and smallest < -1e-9:
        assert radius > 1.0


@settings(deadline=None, max_examples=25)
@given(st.sampled_from(sorted(ROBOTS)), st.data())
def test_the_bound_of_the_inertia_holds_anywhere_with_room(name: str, data: st.DataObject) -> None:
    """Twice what is found at some joint positions is enough at any."""
    robot = ROBOTS[name]
    n = robot.joints
    q = tuple(data.draw(st.floats(-math.pi, math.pi)) for _ in range(n))
    damping = np.diag([data.draw(st.floats(0.0, 100.0)) for _ in range(n)])
    m = np.array([robot.inertia_torque(q, tuple(row)) for row in np.eye(n).tolist()])
    largest = np.abs(np.linalg.eigvals(np.linalg.solve(m, damping))).max()
    assert largest <= 2.0 * steepness(robot, tuple(np.diag(damping).tolist()))


def test_a_brake_too_stiff_for_the_ticks_is_refused() -> None:
    """By its place, with what would do; and what would do does."""
    words = (
        r"faults\.0\.damping: 100 N·m·s/rad is too little for a stiffness of 20000 .* expected at least 200"
    )
    with pytest.raises(ScenarioError, match=words):
        scenario("type: locked_joint", more=("dt=0.01",))
    soft = "type: locked_joint, stiffness: 100, damping: "
    with pytest.raises(ScenarioError, match=r"is too much for ticks of 0\.01 s") as error:
        scenario(soft + "300", more=("dt=0.01",))
    limit = float(str(error.value).partition("expected ")[2].partition(" ")[0])
    assert scenario(soft + str(0.99 * limit), more=("dt=0.01",))
    with pytest.raises(ScenarioError, match="is too much"):
        scenario(soft + str(1.05 * limit), more=("dt=0.01",))
    assert LockedJoint(joint=2, damping=[1, 100, 1]).too_coarse(ROBOTS["puma560"], 1e-3) == ""


# All of them.


@pytest.mark.parametrize("name", ACTUATOR)
@settings(deadline=None, max_examples=50)
@given(x=st.floats(-100.0, 100.0), q=st.floats(-7.0, 7.0), v=st.floats(-5.0, 5.0), t=st.floats(0.0, 30.0))
def test_of_size_zero_the_torque_is_as_it_was(name: str, x: float, q: float, v: float, t: float) -> None:
    """Bit for bit, whatever is remembered."""
    fault: Any = components("fault")[name]()
    (s,) = fault.memory(1)
    for torque in (x, 0.0, -0.0):
        found, s = fault.act(fault, 0.0, Moment(t, DT, t - 10.0, 0.0, 0.0), torque, q, v, s)
        assert repr(found) == repr(torque)


def test_the_last_word_has_what_overrides() -> None:
    """Whatever their order in the scenario: a free joint has no bias, a locked one is held nevertheless."""
    faults = ["type: free_joint", "type: actuator_bias", "type: hard_over", "type: loss_of_effectiveness"]
    trace, _, applied = run(*faults)
    assert not applied[FIRST:].any()
    assert same(trace, simulate(scenario(*reversed(faults))))
    _, _, applied = run(*faults[1:])
    assert np.array_equal(applied[FIRST:], np.full((200 - FIRST, 3), 80.0))
    ranks = {name: components("fault")[name].rank for name in ACTUATOR}
    assert sorted(ranks, key=lambda name: ranks[name])[:5] == [
        "actuator_delay", "dead_zone", "backlash", "reduced_saturation", "loss_of_effectiveness",
    ]  # fmt: skip


EVERY = (
    "type: actuator_delay, delay: 3, joint: 1",
    "type: dead_zone, width: 1",
    "type: backlash, gap: 1",
    f"type: reduced_saturation, limit: [5, 30, 20], {RAMP}",
    "type: loss_of_effectiveness",
    "type: actuator_bias, bias: [1, -1, 1]",
    "type: torque_ripple",
    "type: torque_oscillation",
    "type: stuck_torque, joint: 3, lifetime: timed, duration: 0.03",
    "type: hard_over, joint: 1, level: 20, profile: one_shot, period: 0.1",
    "type: free_joint, joint: 2, start: 0.15",
    "type: locked_joint, joint: 3, start: 0.12",
)


def test_all_at_once_written() -> None:
    """The source of a compiled tick, run by Python, is the plain tick bit for bit."""
    assert {x.split(",")[0].removeprefix("type: ") for x in EVERY} == set(ACTUATOR)
    found = scenario(*EVERY)
    loop, plain, rows = Loop(found), Loop(found), []
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
    found = scenario(*EVERY)
    trace = compiled.simulate(found)
    assert trace.engine == "compiled"
    close(trace, simulate(found), rtol=1e-7, atol=1e-7)


def test_a_delay_remembers_as_many_ticks_as_it_has() -> None:
    """Their number is part of the structure; per joint."""
    assert ActuatorDelay(delay=3).memory(2) == ((0.0, 0.0, 0.0),) * 2
