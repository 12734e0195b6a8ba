# SPDX-License-Identifier: Apache-2.0
"""The tick loop: its contract, determinism, swaps, limits, divergence as a result, and the integrator."""

from __future__ import annotations

import json
import math
from collections.abc import Callable
from typing import Any, ClassVar

import numpy as np
import pytest

from ftcm_core import registry
from ftcm_core.controllers import AccelerationLaw, Controller
from ftcm_core.controllers.ctc import CTC
from ftcm_core.controllers.ftcm import FTCM
from ftcm_core.controllers.smc import SMC
from ftcm_core.errors import ScenarioError
from ftcm_core.metrics import result
from ftcm_core.observers.do import DO
from ftcm_core.observers.none import NoObserver
from ftcm_core.references.vo_kang_cosine import VoKangCosine
from ftcm_core.registry import components, register
from ftcm_core.robots import Robot
from ftcm_core.robots.puma560 import Puma560
from ftcm_core.scenario import Scenario, from_mapping, load
from ftcm_core.signals import Measurement, State, TrueDisturbance, Vector, saturate, seconds
from ftcm_core.simulation import simulate
from ftcm_core.stages import ControllerStage, ObserverStage, PlantStage, rk4
from ftcm_core.trace import COLUMNS, Change, Trace

ROBOT, DT, ZERO = Puma560(), 1e-3, (0.0, 0.0, 0.0)
Q, V = (0.3, -0.4, 0.7), (0.5, -0.6, 0.8)


def paper(*overrides: str, duration: float = 0.3) -> Scenario:
    """The paper's experiment, shortened, its fault moved to 0.1 s."""
    return load("paper", [f"duration={duration}", "injection.faults.0.start=0.1", *overrides])


def columns(trace: Trace) -> dict[str, np.ndarray]:
    """The recorded columns."""
    return {name: getattr(trace, name) for name in COLUMNS}


def same(a: Trace, b: Trace, rows: slice = slice(None)) -> bool:
    """Whether two runs are equal bit for bit."""
    return all(
        x[rows].tobytes() == y[rows].tobytes() for x, y in zip(columns(a).values(), columns(b).values())
    )


@pytest.fixture
def registered(monkeypatch: pytest.MonkeyPatch) -> None:
    """What a test registers is gone after it."""
    for kind in registry.KINDS:
        monkeypatch.setitem(registry._components, kind, registry.components(kind))


# The tick contract.


def test_tick_contract() -> None:
    """Each recorded row follows from the one before by the five steps, bit for bit."""
    scenario = paper("torque_limits=[30, 80, 20]")
    trace = simulate(scenario)
    assert (trace.status, trace.detail, trace.ticks) == ("completed", "", 301)
    assert np.array_equal(trace.time_ns, np.arange(301) * 1_000_000)
    assert all(c.shape == (301, 3) and c.dtype == np.float64 for c in columns(trace).values())
    observer, controller, injector = (
        scenario.observer_stage(),
        scenario.controller_stage(),
        scenario.injector_stage(),
    )
    rows = [
        dict(zip(COLUMNS, map(tuple, row))) for row in np.stack([*columns(trace).values()], axis=1).tolist()
    ]
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
    stage = ControllerStage(FTCM(), VoKangCosine(), ROBOT, DT)
    run_stage(stage, 10)
    eta = stage.state
    assert [len(x) for x in eta] == [1, 1, 1]
    assert all(x != 0.0 for (x,) in eta)
    stage.swap(FTCM(upsilon1=5.0))
    assert stage.state == eta
    stage.swap(SMC())
    assert stage.state == SMC().init(3)
    stage.swap(FTCM())
    assert stage.state == ((0.0,),) * 3


@pytest.mark.parametrize("name", components("controller"))
def test_what_is_prepared_changes_no_float(name: str) -> None:
    """Prepared for this tick, for another tick or motion, or before a swap: the torque is the same."""
    law, other = components("controller")[name](), FTCM(upsilon1=5.0)
    one, prepared = (ControllerStage(law, VoKangCosine(), ROBOT, DT) for _ in range(2))
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
        u, _ = smc.step(ROBOT, DT, y, VoKangCosine().at(k * DT, 3), ZERO, smc.init(3))
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
    class Fails(Controller):
        """Fails: holds the robot, then does not."""

        def init(self, joints: int) -> State:
            return ((0.0,),) * joints

        def feedback(self, robot, dt, y, reference, state):
            following = tuple((n + 1.0,) for (n,) in state)
            return (robot.gravity(y.position) if state[0][0] < 7.0 else (outcome(),) * 3), following

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
    plant = PlantStage(ROBOT, DT, Q, V, None)
    kinetic = [0.5 * np.dot(V, ROBOT.inertia_torque(Q, V))]
    for _ in range(2000):
        plant.step(ZERO, TrueDisturbance(ZERO))
        kinetic.append(0.5 * np.dot(plant.velocity, ROBOT.inertia_torque(plant.position, plant.velocity)))
    assert max(kinetic) > 30.0
    assert kinetic[-1] - kinetic[0] + gravity_work(np.array(Q), np.array(plant.position)) == pytest.approx(
        0.0, abs=3e-8
    )


def test_command_and_disturbance_add() -> None:
    """The plant moves under their sum; only the command is its effort."""
    one, other = PlantStage(ROBOT, DT, Q, V, None), PlantStage(ROBOT, DT, Q, V, None)
    one.step((5.0, 6.0, 7.0), TrueDisturbance((1.0, -2.0, 0.5)))
    other.step((6.0, 4.0, 7.5), TrueDisturbance(ZERO))
    assert (one.position, one.velocity) == (other.position, other.velocity)
    assert (one.effort, other.effort) == ((5.0, 6.0, 7.0), (6.0, 4.0, 7.5))


# Any number of joints.


@pytest.mark.parametrize("law", ["ftcm", "ftsmc", "smc", "nftsmc", "ctc"])
def test_laws_and_loop_fit_another_robot(registered: None, law: str) -> None:
    """A pendulum, one joint: every law of scalars tracks with it; what is made for three joints says so."""

    @register("robot", "pendulum")
    class Pendulum(Robot):
        """Pendulum: a + 5 sin q = tau."""

        joint_names: ClassVar[tuple[str, ...]] = ("swing",)

        def mass_matrix(self, q: Vector) -> tuple[Vector, ...]:
            return ((1.0,),)

        def coriolis_matrix(self, q: Vector, v: Vector) -> tuple[Vector, ...]:
            return ((0.0,),)

        def velocity_torque(self, q: Vector, v: Vector) -> Vector:
            return (0.0,)

        def gravity(self, q: Vector) -> Vector:
            return (5.0 * math.sin(q[0]),)

        def inertia_torque(self, q: Vector, a: Vector) -> Vector:
            return a

        def inverse_dynamics(self, q: Vector, v: Vector, a: Vector) -> Vector:
            return (a[0] + 5.0 * math.sin(q[0]),)

        def forward_dynamics(self, q: Vector, v: Vector, tau: Vector) -> Vector:
            return (tau[0] - 5.0 * math.sin(q[0]),)

        def inertia_acceleration(self, q: Vector, tau: Vector) -> Vector:
            return tau

    data: dict[str, Any] = {"robot": "pendulum", "reference": "sine", "controller": law, "observer": "do"}
    friction = {"type": "vo_kang_friction", "a": 1.5, "b": [1.2]}
    trace = simulate(from_mapping({**data, "duration": 4, "injection": {"disturbances": [friction]}}))
    assert trace.position.shape == (4001, 1)
    assert np.abs(trace.error[3000:]).max() < 0.02
    for path, entry in (("disturbances", "vo_kang_friction"), ("faults", "vo_kang_fault")):
        with pytest.raises(ScenarioError, match=rf"injection\.{path}\.0(\.a)?: .*3.*1"):
            from_mapping({**data, "injection": {path: [entry]}})
    with pytest.raises(ScenarioError, match=r"controller\.kp: .*has 3 entries.*\(1\)"):
        from_mapping({**data, "controller": "pid"})


def test_component_without_estimate_in_its_signature_is_typed() -> None:
    """Ground truth never reaches a law: no step of a controller or observer takes a TrueDisturbance."""
    for function in (Controller.step, AccelerationLaw.step, DO.step, NoObserver.step):
        assert not any("TrueDisturbance" in str(a) for a in function.__annotations__.values())
