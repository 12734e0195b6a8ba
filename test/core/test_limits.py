# SPDX-License-Identifier: Apache-2.0
"""Limits of drives and joints: torque and its rate are bounded, motion beyond a limit ends the run."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from ftcm_core.errors import ScenarioError
from ftcm_core.limits import Limits, command_beyond
from ftcm_core.recording.metrics import result
from ftcm_core.report.table import comparison_table
from ftcm_core.scenario import Scenario, load
from ftcm_core.signals import TrueDisturbance, Vector
from ftcm_core.simulation import simulate
from ftcm_core.simulation.drive import drive_torque
from ftcm_core.simulation.stages import PlantStage
from traces import same

NAMES = ("joint1", "joint2", "joint3")
ZERO = (0.0,) * 3
RATE = ["torque_limits=[60, 90, 40]", "torque_rate_limits=[4000, 2000, 1000]", "duration=0.3"]
TRIPS = {
    "velocity_limits=[0.3, 0.5, 0.5]": "velocity",
    "position_upper_limits=[9, 0.05, 9]": "position",
    "position_lower_limits=[-9, 0.52, -9]": "position",
}
vectors = st.tuples(*[st.floats(-1e6, 1e6)] * 3)
bounds = st.none() | st.tuples(*[st.floats(1e-3, 1e5)] * 3)


def start_of(overrides: list[str]) -> list[str]:
    """Start above the reference, which begins at 0.5 rad, to come down to a lower limit."""
    return ["initial_state.position=0.6", *overrides] if "lower" in overrides[0] else overrides


@settings(deadline=None)
@given(bounds, bounds, st.lists(vectors, min_size=1, max_size=20))
def test_the_drive_stays_within_its_limits_and_does_what_it_can(
    torque: Vector | None, step: Vector | None, commands: list[Vector]
) -> None:
    """Never beyond a limit; at the command where that is within reach, else as near as it may be."""
    limits, applied = Limits(torque, step), ZERO
    for u in commands:
        before, applied = applied, drive_torque(limits, applied, u)
        for j in range(3):
            most = torque[j] if torque else math.inf
            change = step[j] if step else math.inf
            wanted = max(-most, min(most, u[j]))
            assert abs(applied[j]) <= most
            assert abs(applied[j] - before[j]) <= change + 1e-9 * abs(before[j])
            if abs(wanted - before[j]) < 0.999 * change:
                assert applied[j] == wanted
            else:
                assert applied[j] in (wanted, before[j] + change, before[j] - change)
                assert abs(wanted - applied[j]) <= abs(wanted - before[j])


def test_the_effort_of_a_run_keeps_torque_and_rate_limits() -> None:
    trace, free = simulate(load("paper", RATE)), simulate(load("paper", ["duration=0.3"]))
    steps = np.abs(np.diff(trace.effort, axis=0))
    assert trace.status == "completed"
    assert (np.abs(trace.effort) <= [60, 90, 40]).all()
    assert (steps <= np.array([4.0, 2.0, 1.0]) * (1 + 1e-9)).all()
    assert (steps.max(axis=0) > np.array([4.0, 2.0, 1.0]) * (1 - 1e-9)).all(), "each rate limit was reached"
    assert not same(trace, free)


def test_limits_that_are_never_reached_change_nothing() -> None:
    wide = ["torque_limits=1e9", "torque_rate_limits=1e12", "velocity_limits=900"]
    wide += ["position_lower_limits=-50", "position_upper_limits=50", "stop_damping=1", "duration=0.3"]
    assert same(simulate(load("paper", wide)), simulate(load("paper", ["duration=0.3"])))


def test_the_injector_sees_the_command_whatever_the_drive_applies() -> None:
    """The fault on joint 2 is 0.3 sin(t) u2 (eq 47) of the command, not of what limits and delay leave."""
    overrides = [*RATE, "injection.disturbances=[]", "injection.faults.0.start=0", "torque_delay=2"]
    trace = simulate(load("paper", overrides))
    expected = 0.3 * np.sin(trace.time[1:-1]) * trace.command[1:-1, 1]
    assert np.allclose(trace.disturbance[1:-1, 1], expected, rtol=1e-12, atol=0)
    assert np.abs(expected).max() > 0.1
    assert np.abs(trace.command[1:-1, 1] - trace.effort[2:, 1]).max() > 10.0, "the drive applies another"


@pytest.mark.parametrize(("override", "what"), TRIPS.items())
def test_motion_beyond_a_limit_ends_the_run_with_a_status_of_its_own(override: str, what: str) -> None:
    """Joint, value, limit and time are named; the rows before are those of the free run."""
    overrides = start_of([override, "duration=2"])
    trace = simulate(load("paper", overrides))
    free = simulate(load("paper", [x for x in overrides if x != override]))
    assert trace.status == "limit_exceeded"
    assert trace.detail.startswith(f"at t = {trace.ticks * 1e-3:g} s: joint")
    assert f": {what} " in trace.detail
    joint = int(trace.detail.split("joint")[1][0]) - 1
    assert f"{getattr(free, what)[trace.ticks, joint]:g} rad" in trace.detail
    assert 10 < trace.ticks < 2000
    limit = float(trace.detail.split("limit of ")[1].split()[0])
    column = getattr(trace, what)[:, joint]
    assert column.min() >= limit if "below" in trace.detail else np.abs(column).max() <= limit
    assert same(trace, free, slice(trace.ticks))
    table = comparison_table([result(trace)])
    assert f"limit_exceeded at {trace.ticks * 1e-3:g} s" in table


@settings(deadline=None)
@given(bounds, bounds, vectors, vectors)
def test_a_command_is_beyond_the_limits_if_and_only_if_the_drive_changes_it(
    torque: Vector | None, step: Vector | None, previous: Vector, u: Vector
) -> None:
    """With the last command applied as it was; equal but for the rounding of the step."""
    limits = Limits(torque, step)
    said = command_beyond(limits, NAMES, previous, u)
    allowed = drive_torque(limits, previous, u)
    off = max(abs(a - b) for a, b in zip(allowed, u))
    assert (off > 0.0) == bool(said) or off <= 1e-9 * max(map(abs, (*previous, *u)))
    assert not said or said.startswith("joint")


@pytest.mark.parametrize(
    ("overrides", "text"),
    [
        (["position_lower_limits=1", "position_upper_limits=[2, 2, 1]"], "1 is not below position_upper"),
        (["position_upper_limits=[1, -1, 1]"], "initial_state: joint2: position 0 rad is above its limit"),
        (["velocity_limits=2", "initial_state.velocity=[0, 0, 3]"], "joint3: velocity 3 rad/s is beyond"),
        (["velocity_limits=0"], "velocity_limits: 0 is out of range"),
        (["torque_rate_limits=[1, 2]"], "torque_rate_limits: [1.0, 2.0] has 2 entries"),
        (["position_upper_limits=inf"], "position_upper_limits"),
        (["stop_damping=-1"], "stop_damping: -1 is out of range"),
    ],
)  # fmt: skip
def test_limits_that_make_no_sense_are_refused_in_one_line(overrides: list[str], text: str) -> None:
    with pytest.raises(ScenarioError) as caught:
        load("paper", overrides)
    assert text in str(caught.value)
    assert len(str(caught.value).splitlines()) == 1


# The safe stop.


def stopped(scenario: Scenario, ticks: int) -> tuple[list[Vector], list[Vector]]:
    """Velocities before, and efforts over, each tick of a safe stop."""
    plant, velocities, efforts = PlantStage(scenario), [], []
    for k in range(ticks):
        velocities.append(plant.motion[1])
        plant.safe_stop(k * scenario.dt_ns, TrueDisturbance(ZERO))
        assert plant.reason == ""
        assert plant.measure().effort == plant.state.drive.effort == plant.state.joint_torque
        efforts.append(plant.measure().effort)
    return velocities, efforts


def test_a_safe_stop_damps_the_motion_and_reports_its_torque() -> None:
    scenario = load("paper", ["initial_state.velocity=[3, -3, 3]", "stop_damping=[90, 100, 80]"])
    velocities, efforts = stopped(scenario, 3000)
    assert efforts[0] == (-270.0, 300.0, -240.0)
    assert efforts == [tuple(-c * x for c, x in zip((90.0, 100.0, 80.0), v)) for v in velocities]
    assert max(map(abs, velocities[-1])) < 0.4, "the arm sinks slowly under its weight"


def test_a_safe_stop_keeps_the_limits_of_the_drives_and_is_not_delayed() -> None:
    scenario = load("paper", [*RATE, "initial_state.velocity=[1, -3, 1]", "torque_delay=5"])
    _, efforts = stopped(scenario, 200)
    assert efforts[0] == (-4.0, 2.0, -1.0)
    assert (np.abs(efforts) <= [60, 90, 40]).all()
    assert (np.abs(np.diff(efforts, axis=0)) <= np.array([4.0, 2.0, 1.0]) * (1 + 1e-9)).all()


def test_after_a_safe_stop_no_command_from_before_it_comes_out() -> None:
    plant = PlantStage(load("paper", ["torque_delay=3"]))
    for k in range(5):
        plant.step(k * 1_000_000, (7.0,) * 3, TrueDisturbance(ZERO))
    assert plant.measure().effort == (7.0,) * 3
    for k in range(5, 8):
        plant.safe_stop(k * 1_000_000, TrueDisturbance(ZERO))
    for k in range(8, 11):
        plant.step(k * 1_000_000, ZERO, TrueDisturbance(ZERO))
        assert 7.0 not in plant.measure().effort


def test_a_safe_stop_of_a_weak_drive_is_weak_too() -> None:
    """An actuator fault acts while it brakes as well; the drive reports what it believes."""
    fault = "injection.faults=[{type: loss_of_effectiveness, loss: 0.5, start: 0}]"
    plant = PlantStage(load("paper", ["initial_state.velocity=1", "stop_damping=10", fault]))
    plant.safe_stop(1_000_000, TrueDisturbance((1.0, 0.0, 0.0)))
    assert plant.measure().effort == (-10.0,) * 3
    assert plant.state.joint_torque == (-4.0, -5.0, -5.0)
