# SPDX-License-Identifier: Apache-2.0
"""The tick loop: its contract, determinism, swaps, limits, divergence as a result, and the integrator."""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Iterator
from itertools import pairwise
from typing import Any

import numpy as np
import pytest

from ftcm_core.controllers import AccelerationLaw, Controller, FeedbackLaw
from ftcm_core.controllers.ctc import CTC
from ftcm_core.controllers.ftcm import FTCM
from ftcm_core.controllers.smc import SMC
from ftcm_core.errors import ScenarioError
from ftcm_core.observers.do import DO
from ftcm_core.observers.none import NoObserver
from ftcm_core.plants.rigid_body import RigidBody, rk4, semi_implicit_euler
from ftcm_core.recording.metrics import result
from ftcm_core.recording.trace import Change, Trace
from ftcm_core.references.vo_kang_cosine import VoKangCosine
from ftcm_core.registry import components, register
from ftcm_core.robots.puma560 import Puma560
from ftcm_core.scenario import Scenario, from_mapping, load
from ftcm_core.signals import Measurement, State, TrueDisturbance, Vector, saturate, seconds
from ftcm_core.simulation import simulate
from ftcm_core.simulation.stages import ControllerStage, InjectorStage, ObserverStage, PlantStage
from plugins import ROBOTS, registry_kept, robots_known, scenario_mapping
from traces import rows_of, same

ROBOT, DT, ZERO = Puma560(), 1e-3, (0.0, 0.0, 0.0)
Q, V = (0.3, -0.4, 0.7), (0.5, -0.6, 0.8)


def paper(*overrides: str, duration: float = 0.3) -> Scenario:
    """The paper's experiment, shortened, its fault moved to 0.1 s."""
    return load("paper", [f"duration={duration}", "injection.faults.0.start=0.1", *overrides])


@pytest.fixture
def registered() -> Iterator[None]:
    """What a test registers is gone after it."""
    with registry_kept():
        yield


def started(position: Vector = Q, velocity: Vector = V, *overrides: str) -> PlantStage:
    """The paper's plant, moving."""
    initial = f"initial_state={{position: {list(position)}, velocity: {list(velocity)}}}"
    return PlantStage(load("paper", [initial, *overrides]))


def step(law: Controller, y: Measurement, reference: Any, tau_hat: Vector, state: Any) -> Any:
    """One tick of a law, prepared as the stage does it."""
    return law.step(ROBOT, DT, y, reference, tau_hat, state, law.prepare(ROBOT, DT, y, reference, state))


# The tick contract.


def test_tick_contract() -> None:
    """Each recorded row follows from the one before by the five steps, bit for bit."""
    scenario = paper("torque_limits=[30, 80, 20]")
    trace = simulate(scenario)
    assert (trace.status, trace.detail, trace.ticks) == ("completed", "", 301)
    assert np.array_equal(trace.time_ns, np.arange(301) * 1_000_000)
    assert all(c.shape == (301, 3) and c.dtype == np.float64 for c in trace.columns.values())
    observer = ObserverStage(scenario.observer, scenario.model, scenario.dt)
    controller, injector, rows = ControllerStage(scenario), InjectorStage(scenario), rows_of(trace)
    assert rows[0]["effort"] == rows[0]["position"] == rows[0]["velocity"] == ZERO
    for k, row in enumerate(rows):
        y = Measurement(row["position"], row["velocity"], row["effort"])
        assert observer.step(y) == row["disturbance_estimate"]
        u, reference = controller.step(k * 1_000_000, y, row["disturbance_estimate"])
        assert u == row["command"]
        assert reference[:2] == (row["reference_position"], row["reference_velocity"])
        assert injector.step(k * 1_000_000, *y[:2], u).torque == row["disturbance"]
        if k < 300:
            applied = saturate(u, scenario.limits.torque)
            tau = tuple(map(float.__add__, applied, row["disturbance"]))
            assert rows[k + 1]["effort"] == applied
            assert rk4(ROBOT, DT, *y[:2], tau) == (rows[k + 1]["position"], rows[k + 1]["velocity"])


def test_runs_are_deterministic() -> None:
    """Twice the same scenario, bit for bit; and reading it back from its own file changes nothing."""
    scenario = paper("controller.type=smc")
    first, second = simulate(scenario), simulate(scenario)
    assert same(first, second)
    assert same(first, simulate(from_mapping(scenario.to_mapping())))


def test_time_is_counted_not_accumulated() -> None:
    """Stamps are k dt_ns exactly, at any dt; seconds are correctly rounded."""
    trace = simulate(load("paper", ["dt=0.0003", "duration=0.3"]))
    assert trace.time_ns.tolist() == [k * 300_000 for k in range(1001)]
    assert trace.time_ns.dtype == np.int64
    assert seconds(300_000 * 3) == 0.0009
    assert trace.reference_position[-1].tolist() == list(VoKangCosine().at(0.3, 3).position)


def test_progress_is_reported() -> None:
    """About every thousand ticks, with the last tick's number."""
    calls: list[tuple[int, int]] = []
    simulate(paper(duration=2.5), progress=lambda k, n: calls.append((k, n)))
    assert calls == [(0, 2500), (1000, 2500), (2000, 2500)]


def test_torque_limits_are_honoured() -> None:
    """The effort is the command clipped; without limits it is the command."""
    limits = np.array([20.0, 60.0, 10.0])
    trace = simulate(paper("torque_limits=[20, 60, 10]"))
    assert (np.abs(trace.command) > limits).any(axis=0).all(), "every drive was asked for more"
    assert np.array_equal(trace.effort[1:], np.clip(trace.command[:-1], -limits, limits))
    assert not trace.effort[0].any()
    free = simulate(paper())
    assert np.array_equal(free.effort[1:], free.command[:-1])
    assert same(free, simulate(paper("torque_limits=1e9")))


# Swaps.


def run_stage(stage: ControllerStage, ticks: int) -> Vector:
    """Step at a fixed motion; the last torque."""
    for k in range(ticks):
        u, _ = stage.step(k * 1_000_000, Measurement(Q, V, ZERO), ZERO)
    return u


def test_controller_swap_keeps_the_state_of_the_same_law_only() -> None:
    """Other parameters keep η; another law starts afresh, also when the first one comes back."""
    stage = ControllerStage(load("paper"))
    run_stage(stage, 10)
    eta = stage.state.law
    assert [len(x) for x in eta] == [1, 1, 1]
    assert all(x != 0.0 for (x,) in eta)
    stage.swap(FTCM(upsilon1=5.0))
    assert stage.state.law == eta
    stage.swap(SMC())
    assert stage.state.law == SMC().init(3)
    stage.swap(FTCM())
    assert stage.state.law == ((0.0,),) * 3


@pytest.mark.parametrize("name", components("controller"))
def test_what_is_prepared_changes_no_float(name: str) -> None:
    """Prepared for this tick, for another tick or motion, or before a swap: the torque is the same."""
    law, other = components("controller")[name](), FTCM(upsilon1=5.0)
    one, prepared = (ControllerStage(load("paper"), law) for _ in range(2))
    y, moved = Measurement(Q, V, ZERO), Measurement(V, Q, ZERO)
    early: list[tuple[int, Measurement]] = [(0, y), (0, moved), (10**6, y), (10**6, moved)]
    for k in range(40):
        time_ns, tau_hat = k * 1_000_000, (0.1 * k, -0.2, 0.3)
        time_ahead, motion = early[k % 4]
        prepared.prepare(time_ns + time_ahead, motion)
        if k in (20, 32):
            for stage in (one, prepared):
                stage.swap(other if k == 20 else law)
        assert repr(prepared.step(time_ns, y, tau_hat)) == repr(one.step(time_ns, y, tau_hat))
        assert repr(prepared.state) == repr(one.state)


def test_observer_swap_keeps_the_state_of_the_same_kind_only() -> None:
    """Another kind starts at the next measurement, its estimate from zero."""
    stage, y = ObserverStage(DO(), ROBOT, DT), Measurement(Q, V, ZERO)
    estimates = [stage.step(y) for _ in range(5)]
    assert all(x != 0.0 for x in estimates[-1])
    kept = stage.state
    stage.swap(DO(k1=100.0))
    assert stage.state == kept
    stage.swap(NoObserver())
    assert stage.step(y) == ZERO
    stage.swap(DO())
    assert stage.step(y) == ZERO
    assert [stage.step(y) for _ in range(4)] == estimates[1:]


def test_swap_takes_effect_at_its_tick() -> None:
    """Rows before it are those of the run without it; from its tick on the other law acts."""
    scenario = paper()
    plain = simulate(scenario)
    smc = SMC(c=3)
    trace = simulate(scenario, changes=[Change(150, "controller", smc)])
    assert same(plain, trace, slice(150))
    for k in (150, 200):
        y = Measurement(*(tuple(getattr(trace, c)[k].tolist()) for c in ("position", "velocity", "effort")))
        u, _ = step(smc, y, VoKangCosine().at(k * DT, 3), ZERO, smc.init(3))
        assert tuple(trace.command[k].tolist()) == u
    assert trace.changes == (Change(150, "controller", smc),)


@pytest.mark.parametrize("change", [Change(150, "controller", FTCM()), Change(150, "observer", DO())])
def test_swap_for_an_equal_component_changes_nothing(change: Change) -> None:
    """Its state is kept."""
    assert same(simulate(paper()), simulate(paper(), changes=[change]))


def test_observer_swap_in_a_run() -> None:
    """Without observer the estimate is zero; a new one starts from zero and converges again."""
    trace = simulate(paper(), changes=[Change(150, "observer", NoObserver()), Change(160, "observer", DO())])
    assert trace.disturbance_estimate[149].all()
    assert not trace.disturbance_estimate[150:161].any()
    off, plain = (np.abs(x.disturbance_estimate + x.disturbance) for x in (trace, simulate(paper())))
    assert (off[161] / plain[161])[1:].min() > 3.0
    assert off[300] == pytest.approx(plain[300], rel=0.01)


def test_order_of_changes_does_not_matter() -> None:
    """A change says its tick."""
    changes = [Change(100, "controller", SMC()), Change(200, "controller", CTC())]
    assert same(simulate(paper(), changes=changes), simulate(paper(), changes=changes[::-1]))


# Divergence.


def check_diverged(trace: Trace, when: float | None = None) -> None:
    """A status, one line with the time, the rows up to then, and a result that programs can read."""
    assert trace.status == "diverged"
    assert trace.detail.startswith("at t = ")
    assert len(trace.detail.splitlines()) == 1
    t = float(trace.detail.split()[3])
    assert trace.scenario is not None
    assert trace.ticks <= trace.scenario.last_tick
    assert t == pytest.approx(trace.ticks * trace.dt, rel=1e-5)
    if when is not None:
        assert t == pytest.approx(when, rel=1e-9)
    json.dumps(result(trace), allow_nan=False)


@pytest.mark.parametrize(
    ("overrides", "reason"),
    [
        (["controller.upsilon1=1e6", "dt=0.1", "duration=10"], "joint velocity"),
        (["initial_state.velocity=[999, 999, -999]", "duration=1"], "joint velocity"),
        (["controller.upsilon1=1e308", "controller.upsilon2=1e308", "duration=1"], ""),
        (["controller.gamma1=1e200", "controller.mu1=1e200"], ""),
        (["observer.k1=1e9", "duration=1"], "joint velocity"),
        (
            ["injection.faults.0.start=0.05", "injection.faults.0.severity=1e6", "duration=1"],
            "joint velocity",
        ),
        (["reference={type: sine, frequency: 1e308}"], ""),
        (["reference={type: quintic, duration: 1e-300}"], ""),
        (["reference={type: constant, position: 1e308}", "duration=1"], ""),
        (["injection.disturbances.0.a=1e308", "initial_state.velocity=1"], ""),
    ],
)
def test_divergence_is_a_status(overrides: list[str], reason: str) -> None:
    """Never an exception; the joint velocity or the torque is named where one ran away."""
    trace = simulate(load("paper", overrides))
    check_diverged(trace)
    assert reason in trace.detail


@pytest.mark.parametrize(
    ("outcome", "reason"),
    [
        (lambda: math.exp(1000.0), "math range error"),
        (lambda: 1.0 / 0.0, "division by zero"),
        (lambda: math.log(-1.0), ""),
        (lambda: math.nan, "torque is not finite: command [nan, nan, nan] N·m"),
        (lambda: -math.inf, "torque is not finite: command [-inf, -inf, -inf] N·m"),
    ],
)
@pytest.mark.parametrize("limits", ["null", "10"])
def test_law_out_of_its_domain(
    registered: None, outcome: Callable[[], float], reason: str, limits: str
) -> None:
    """A law that raises, or returns no number, in its eighth tick; the drive's limits hide neither."""

    @register("controller", "fails")
    class Fails(FeedbackLaw):
        """Fails: holds the robot, then does not."""

        def init(self, joints: int) -> State:
            return ((0.0,),) * joints

        def feedback(self, model, dt, y, reference, state):
            following = tuple((n + 1.0,) for (n,) in state)
            return (model.gravity(y.position) if state[0][0] < 7.0 else (outcome(),) * 3), following

    trace = simulate(load("paper", ["controller.type=fails", "duration=0.1", f"torque_limits={limits}"]))
    raised = "torque" not in reason
    check_diverged(trace, when=0.007 if raised else 0.008)
    assert trace.ticks == (7 if raised else 8)
    assert reason in trace.detail
    assert np.isfinite(trace.command[:7]).all()


def test_divergence_in_the_first_tick() -> None:
    """No rows at all is a trace too."""
    trace = simulate(load("paper", ["reference={type: sine, frequency: 1e308}"]))
    assert trace.ticks in (0, 1)
    assert trace.position.shape == (trace.ticks, 3)
    assert trace.sliding_variable.shape == (trace.ticks, 3)
    assert trace.lumped_uncertainty.shape == (trace.ticks, 3)
    assert result(trace)["metrics"]["whole"] is None


# The plant.


def test_rk4_converges_with_order_4() -> None:
    """Free motion of the robot over 0.5 s: halving the step divides the error by 16."""

    def end(steps: int) -> np.ndarray:
        q, v = Q, V
        for _ in range(steps):
            q, v = rk4(ROBOT, 0.5 / steps, q, v, (3.0, -20.0, 1.0))
        return np.array([*q, *v])

    exact = end(640)
    errors = [np.abs(end(n) - exact).max() for n in (10, 20, 40)]
    orders = np.log2(np.divide(errors[:-1], errors[1:]))
    assert orders == pytest.approx([4.0, 4.0], abs=0.25)


def gravity_work(a: np.ndarray, b: np.ndarray) -> float:
    """Potential energy gained from a to b, J: G along a straight line; G is a gradient, any path will do."""
    nodes, weights = np.polynomial.legendre.leggauss(40)
    points = [a + 0.5 * (x + 1) * (b - a) for x in nodes]
    return float(sum(0.5 * w * np.dot(ROBOT.gravity(tuple(p)), b - a) for w, p in zip(weights, points)))


def test_free_plant_conserves_energy() -> None:
    """Two seconds of fall at 1 kHz; kinetic and potential energy add up to 1e-9 of what is exchanged."""
    plant = started()
    kinetic = [0.5 * np.dot(V, ROBOT.inertia_torque(Q, V))]
    for k in range(2000):
        plant.step(k * 1_000_000, ZERO, TrueDisturbance(ZERO))
        q, v = plant.motion
        kinetic.append(0.5 * np.dot(v, ROBOT.inertia_torque(q, v)))
    assert max(kinetic) > 30.0
    assert kinetic[-1] - kinetic[0] + gravity_work(np.array(Q), np.array(q)) == pytest.approx(0.0, abs=3e-8)


def test_command_and_disturbance_add() -> None:
    """The plant moves under their sum; only the command is its effort."""
    one, other = started(), started()
    one.step(0, (5.0, 6.0, 7.0), TrueDisturbance((1.0, -2.0, 0.5)))
    other.step(0, (6.0, 4.0, 7.5), TrueDisturbance(ZERO))
    assert one.motion == other.motion
    assert one.motion != (Q, V)
    assert (one.measure().effort, other.measure().effort) == ((5.0, 6.0, 7.0), (6.0, 4.0, 7.5))
    assert one.state.joint_torque == other.state.joint_torque == (6.0, 4.0, 7.5)


def test_a_stage_is_its_state_and_nothing_else() -> None:
    """Put back into a state it goes the same way, bit for bit; put into another it goes on from there."""
    plant = started(Q, V, "torque_delay=2", "sensor={type: encoder, noise: 0.001}")
    push = TrueDisturbance((1.0, 0.0, -1.0))
    for k in range(5):
        plant.step(k * 1_000_000, (10.0, 20.0, 3.0), push)
    kept = plant.state

    def onwards() -> list[Any]:
        found = []
        for k in range(5, 15):
            plant.step(k * 1_000_000, (9.0, 9.0, 9.0), push)
            found.append((plant.state, plant.measure(), plant.motion))
        return found

    first = onwards()
    plant.state = kept
    assert repr(onwards()) == repr(first)
    plant.state = kept._replace(motion=(V, Q))
    assert plant.motion == (V, Q)
    assert onwards()[-1] != first[-1]


# The plant's integrators.


@pytest.mark.parametrize(
    ("integrator", "advance", "order"), [("rk4", rk4, 4.0), ("semi_implicit_euler", semi_implicit_euler, 1.0)]
)
def test_substeps_are_so_many_steps(integrator: str, advance: Any, order: float) -> None:
    """N substeps are N steps of dt/N, bit for bit; they converge with the order of the integrator."""
    tau, exact = (3.0, -20.0, 1.0), (Q, V)
    for _ in range(4000):
        exact = rk4(ROBOT, 0.1 / 4000, *exact, tau)
    errors = []
    for n in (1, 2, 4, 8, 16):
        plant, expected = RigidBody(integrator=integrator, substeps=n), (Q, V)
        for _ in range(n):
            expected = advance(ROBOT, 0.1 / n, *expected, tau)
        found = plant.motion(plant.step(ROBOT, 0.1, tau, plant.init(ROBOT, Q, V)))
        assert found == expected
        errors.append(float(np.abs(np.subtract(found, exact)).max()))
    orders = np.log2(np.divide(errors[1:-1], errors[2:]))
    assert orders == pytest.approx([order] * 3, abs=0.35)


def test_the_scenario_chooses_the_integrator() -> None:
    """In a run it moves the plant: each row follows from the one before by it."""
    trace = simulate(paper("plant={integrator: semi_implicit_euler, substeps: 3}", duration=0.05))
    rows = rows_of(trace)
    for now, after in pairwise(rows):
        tau = tuple(map(float.__add__, after["effort"], now["disturbance"]))
        motion = (now["position"], now["velocity"])
        for _ in range(3):
            motion = semi_implicit_euler(ROBOT, DT / 3, *motion, tau)
        assert motion == (after["position"], after["velocity"])


# Any number of joints.


@pytest.mark.parametrize("robot", [name for name, r in ROBOTS.items() if r.joints != 3])
@pytest.mark.parametrize("law", components("controller"))
def test_laws_and_loop_fit_another_robot(law: str, robot: str) -> None:
    """1, 2 and 6 joints: every law tracks with disturbed drives; what is made for three joints says so."""
    n = ROBOTS[robot].joints
    duration = 4.0 if n < 6 else 1.5
    apart: dict[str, Any] = {"reference": "sine", "initial_state": {"position": -0.1}}
    if n == 6:  # its equations are many: once a tick, not four times
        apart["plant"] = {"integrator": "semi_implicit_euler"}
    friction = {"type": "vo_kang_friction", "a": 1.5, "b": [1.2] * n}
    with robots_known():
        data = scenario_mapping(robot, controller=law, duration=duration, **apart)
        trace = simulate(from_mapping({**data, "injection": {"disturbances": [friction]}}))
        assert trace.status == "completed"
        assert trace.position.shape == (round(duration * 1000) + 1, n)
        late = np.abs(trace.error[int(0.75 * len(trace.error)) :]).max()
        assert late < (1e-5 if law == "ftcm" else 0.02), late
        assert np.abs(trace.error[0]).min() > 0.09, "it has something to make up for"
        for path, entry in (("disturbances", "vo_kang_friction"), ("faults", "vo_kang_fault")):
            with pytest.raises(ScenarioError, match=rf"injection\.{path}\.0(\.a)?: .*3.*{n}"):
                from_mapping({**data, "injection": {path: [entry]}})
        with pytest.raises(ScenarioError, match=rf"controller\.kp: .*has 3 entries.*\({n}\)"):
            from_mapping({**data, "controller": {"type": "pid"}})


@pytest.mark.parametrize("robot", ROBOTS)
@pytest.mark.parametrize("observer", components("observer"))
def test_observers_and_loop_fit_another_robot(observer: str, robot: str) -> None:
    """Each with a law that needs none: finite estimates, one per joint, from zero on."""
    with robots_known():
        trace = simulate(from_mapping(scenario_mapping(robot, controller="smc", observer=observer)))
    assert trace.status == "completed"
    assert trace.disturbance_estimate.shape == trace.position.shape
    assert np.isfinite(trace.disturbance_estimate).all()
    assert not trace.disturbance_estimate[0].any()


def test_component_without_estimate_in_its_signature_is_typed() -> None:
    """Ground truth never reaches a law: no step of a controller or observer takes a TrueDisturbance."""
    for function in (Controller.step, AccelerationLaw.step, DO.step, NoObserver.step):
        assert not any("TrueDisturbance" in str(a) for a in function.__annotations__.values())
