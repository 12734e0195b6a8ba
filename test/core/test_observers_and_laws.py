# SPDX-License-Identifier: Apache-2.0
"""Every observer with every law that uses one, on several robots; what all observers have in common."""

from __future__ import annotations

from typing import cast

import numpy as np
import pytest

from ftcm_core.controllers import Controller
from ftcm_core.observers import Observer
from ftcm_core.observers.do import DO, observer_step
from ftcm_core.params import specs
from ftcm_core.registry import components
from ftcm_core.robots import Robot
from ftcm_core.scenario import from_mapping, load
from ftcm_core.signals import Measurement
from ftcm_core.simulation import simulate
from observing import DT, estimates, held, moved
from plugins import ROBOTS, robots_known, scenario_mapping

pytestmark = pytest.mark.pure

LAWS = [
    name
    for name, law in components("controller").items()
    if issubclass(law, Controller) and law.needs_observer
]
OBSERVERS = {
    name: cast(type[Observer], cls) for name, cls in components("observer").items() if name != "none"
}
every_law = pytest.mark.parametrize("law", LAWS)
every_observer = pytest.mark.parametrize("name", OBSERVERS)


def chattering(name: str) -> float:
    """What sampling leaves of the estimate of a sliding mode, rad/s²: 3.5 L dt at most; of others nothing."""
    return 3.5 * DT * float(getattr(OBSERVERS[name](), "lipschitz", 0.0))


@every_law
@every_observer
def test_friction_that_the_model_does_not_know_is_found_and_compensated(law: str, name: str) -> None:
    """On the PUMA, with that of eq 43 and the joints' own, up to 6 N·m, which turns with the velocity.

    The linear observers lag by 8 to 11 ms, and the low-pass of one by 20 ms.
    """
    overrides = [
        f"observer={name}",
        "plant={robot: {viscous_friction: 3, coulomb_friction: [3, 4, 1.5], slip_velocity: 0.1}}",
        "reference={type: sine, amplitude: 0.4, frequency: 0.5}",
        "injection.faults=[]",
        "duration=2",
    ]
    trace = simulate(load("paper", overrides, law))
    assert trace.status == "completed"
    assert np.abs(trace.error[1000:]).max() < 1e-5
    delta = trace.lumped_uncertainty
    off = np.abs(trace.lumped_uncertainty_estimate - delta)[1000:-1].max(axis=0)
    rate = np.abs(np.diff(delta, axis=0) / DT)[950:-1].max(axis=0)
    assert (np.abs(delta)[1000:].max(axis=0) > 0.9).all()
    assert (off < 0.02 * rate + chattering(name)).all()


@every_law
@every_observer
@pytest.mark.parametrize("robot", [name for name, r in ROBOTS.items() if r.joints != 3])
def test_works_on_any_number_of_joints(law: str, name: str, robot: str) -> None:
    """One, two and six: the motion stays on its reference."""
    with robots_known():
        scenario = from_mapping(scenario_mapping(robot, controller=law, observer=name, duration=0.3))
    trace = simulate(scenario)
    assert trace.status == "completed"
    assert np.abs(trace.error).max() < 0.05
    assert np.isfinite(trace.disturbance_estimate).all()


@every_observer
@pytest.mark.parametrize("robot", ROBOTS.values(), ids=ROBOTS)
def test_one_that_needs_no_velocity_does_not_look_at_it(name: str, robot: Robot) -> None:
    """Not at the start either: with others its estimates are the same bit for bit; and only then."""
    observer = OBSERVERS[name]()
    ys = moved(robot, lambda k, q: (1.0,) * robot.joints, 0.02)
    others = [y._replace(velocity=tuple(v + 0.5 * k for v in y.velocity)) for k, y in enumerate(ys)]
    same = np.array_equal(estimates(observer, robot, ys), estimates(observer, robot, others))
    assert same == (not observer.needs_velocity)


def test_four_observers_need_positions_only() -> None:
    """Those of which the page says so."""
    found = [name for name, cls in OBSERVERS.items() if not cls.needs_velocity]
    assert found == ["eso", "kalman", "levant", "third_order_smo"]


@every_observer
def test_the_estimate_has_the_sign_of_what_a_law_must_add(name: str) -> None:
    """A torque added to the drives' is estimated with its sign turned, on a joint at rest."""
    robot = ROBOTS["pendulum"]
    up, down = (estimates(OBSERVERS[name](), robot, [held(robot, (d,))] * 600)[-1, 0] for d in (2.0, -2.0))
    assert -2.5 < up < -1.5
    assert 1.5 < down < 2.5


@every_observer
def test_ticks_that_were_skipped_do_no_harm(name: str) -> None:
    """It is called once for each, with the newest measurement; then it finds the disturbance again."""
    robot, observer = ROBOTS["puma560"], OBSERVERS[name]()
    ys = moved(robot, lambda k, q: (0.0,) * 3, 1.2)
    seen = [*ys[:300], *[ys[304]] * 5, *ys[305:]]
    off = np.abs(estimates(observer, robot, seen)).max(axis=1)
    q = ys[-1].position
    inertia = max(sum(map(abs, robot.inertia_torque(q, unit))) for unit in np.eye(3).tolist())
    assert off[1000:].max() < 0.02 + inertia * chattering(name)


@every_observer
@pytest.mark.parametrize("robot", ROBOTS.values(), ids=ROBOTS)
def test_one_that_starts_while_the_arm_moves_makes_no_jolt(name: str, robot: Robot) -> None:
    """As one that is swapped in: without a disturbance Δ̂ stays within 0.02 rad/s² from the first tick on."""
    ys = moved(robot, lambda k, q: (0.0,) * robot.joints, 0.4)[150:]
    assert max(map(abs, ys[0].velocity)) > 0.3
    found = np.abs(estimates(OBSERVERS[name](), robot, ys)).max(axis=0)
    units = np.eye(robot.joints).tolist()
    inertia = sum(np.abs(robot.inertia_torque(ys[0].position, tuple(unit))) for unit in units)
    assert (found < inertia * (0.02 + chattering(name))).all()


@pytest.mark.parametrize("name", OBSERVERS)
def test_defaults_have_no_warnings_at_1_khz(name: str) -> None:
    """On any of the robots."""
    for robot in ROBOTS.values():
        assert OBSERVERS[name]().warnings(robot, DT) == []


@every_observer
@pytest.mark.parametrize("size", [5e-324, 1e-300, 1e300, 1.7e308])
def test_warnings_of_any_numbers_are_lines(name: str, size: float) -> None:
    """Also where squares and products overflow, or vanish."""
    cls = OBSERVERS[name]
    for given in [s.name for s in specs(cls).values() if s.kind == "float"]:
        for line in cls(**{given: size}).warnings(ROBOTS["puma560"], DT):
            assert line.startswith(f"observer {name}")
            assert len(line.splitlines()) == 1


@pytest.mark.parametrize(
    ("k1", "k2", "stable"),
    [(20000.0, 200.0, True), (198e3, 200.0, True), (202e3, 200.0, False), (1e4, 2003.0, True),
     (1e4, 2007.0, False)],
)  # fmt: skip
def test_the_papers_observer_warns_where_its_step_is_unstable(k1: float, k2: float, stable: bool) -> None:
    """Its two limits, k1 dt < k2 and k2 dt < 2 + k1 dt²/2: at 1 kHz just inside, and just outside."""
    omega = delta = 1.0
    for _ in range(10_000):
        omega, delta = observer_step(k1, k2, omega, delta, 0.0, 0.0, DT)
    assert (max(abs(omega), abs(delta)) < 1.0) == stable
    lines = DO(k1=k1, k2=k2).warnings(ROBOTS["pendulum"], DT)
    assert (lines == []) == stable
    if not stable:
        assert lines[0].startswith(
            f"observer do, all joints: k1={k1:g} and k2={k2:g} are unstable with ticks of"
        )


def test_a_scenario_warns_of_its_observer_and_of_its_controller() -> None:
    """By its own tick, in the order of the files."""
    scenario = load("paper", ["dt=0.02", "controller.upsilon2=1"])
    first, second = scenario.warnings()
    assert first.startswith("controller ftcm, all joints: the gain condition")
    assert second.startswith("observer do, all joints: k1=20000 and k2=200 are unstable with ticks of 0.02 s")
    assert load("paper").warnings() == []


def test_a_measurement_is_all_they_see() -> None:
    """Positions, velocities, efforts: the type has no more."""
    assert Measurement._fields == ("position", "velocity", "effort")
