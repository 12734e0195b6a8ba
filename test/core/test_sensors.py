# SPDX-License-Identifier: Apache-2.0
"""Sensor models, the delay of the drive, and the random streams they draw from."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
import pytest

from ftcm_core.disturbances import Disturbance
from ftcm_core.faults import ActuatorFault, Moment
from ftcm_core.limits import Limits
from ftcm_core.random_streams import gaussian, stream_key, uniform
from ftcm_core.recording.metrics import evaluate
from ftcm_core.recording.trace import Trace
from ftcm_core.scenario import from_mapping, load, replace
from ftcm_core.sensors.encoder import Encoder, encode, low_pass
from ftcm_core.sensors.ideal import Ideal
from ftcm_core.signals import COLUMNS, TrueDisturbance, Vector
from ftcm_core.simulation import simulate
from ftcm_core.simulation.drive import Drive
from ftcm_core.simulation.fault_chain import FaultChain
from ftcm_core.simulation.stages import InjectorStage, PlantStage
from traces import same

DT, Q, V, ZERO = 1e-3, (0.3, -0.4, 0.7), (0.5, -0.6, 0.8), (0.0, 0.0, 0.0)
QUIET = TrueDisturbance(ZERO)


def run(*overrides: str) -> Trace:
    """The paper's experiment, 0.2 s of it."""
    return simulate(load("paper", ["duration=0.2", *overrides]))


# Scenario.


def test_default_is_the_ideal_sensor_without_delay() -> None:
    """A file need not say so; written out, it does; the trace has no columns of its own for it."""
    scenario = load("paper")
    assert scenario.sensor == Ideal()
    assert scenario.torque_delay == 0
    assert scenario.to_mapping()["sensor"] == {"type": "ideal"}
    assert scenario.to_mapping()["torque_delay"] == 0
    assert same(run(), run("sensor=ideal", "torque_delay=0"))
    optional = [name for name, column in COLUMNS.items() if column.when]
    assert [getattr(run(), name) for name in optional] == [None] * 6
    assert list(run().columns) == list(scenario.columns) == [n for n in COLUMNS if n not in optional]


def test_round_trip() -> None:
    """An encoder survives being written out."""
    scenario = load("paper", ["sensor={type: encoder, noise: [1e-5, 0, 0]}", "torque_delay=2"])
    assert from_mapping(scenario.to_mapping()) == scenario


# Random streams.


def test_stream_is_standard_normal() -> None:
    """Moments of 20,000 numbers, and no correlation between neighbours."""
    key = stream_key(3, "sensor.encoder")
    x = np.array([gaussian(key, float(n)) for n in range(20_000)])
    assert abs(x.mean()) < 0.03
    assert x.std() == pytest.approx(1.0, abs=0.02)
    assert np.mean(x**4) == pytest.approx(3.0, abs=0.2)
    assert abs(np.mean(x[1:] * x[:-1])) < 0.03


def test_stream_is_fixed() -> None:
    """The same on every machine and in every version: recorded runs are replayed from their seed."""
    key = stream_key(0, "sensor.encoder")
    assert key == 4699931881046814.0
    assert uniform(key, 0.0) == 0.4210923864840591


def test_streams_are_independent() -> None:
    """Another seed or another name is another stream."""
    keys = {stream_key(seed, name) for seed in range(50) for name in ("sensor.encoder", "sensor.other")}
    assert len(keys) == 100
    assert all(0.0 < uniform(k, float(n)) < 1.0 for k in keys for n in range(20))


# Encoder.


def test_positions_are_whole_steps() -> None:
    """Within half a step of the truth."""
    encoder = Encoder(resolution=1e-3)
    q, _, _ = encoder.step(DT, Q, V, encoder.init(3, 0))
    assert q == pytest.approx(Q, abs=0.5e-3)
    assert encode(0.12345, 1e-3) == pytest.approx(0.123)
    assert encode(0.12345, 0.0) == 0.12345
    assert encode(1e300, 1e-300) == 1e300
    assert encode(-0.0004, 1e-3) == 0.0


def test_velocity_is_the_difference() -> None:
    """Without filter: exactly; the first one is zero, as there is nothing to difference with."""
    encoder = Encoder(resolution=0.0, cutoff=0.0)
    _, v, state = encoder.step(DT, Q, V, encoder.init(3, 0))
    assert v == ZERO
    q, v, _ = encoder.step(DT, tuple(x + DT * y for x, y in zip(Q, V)), V, state)
    assert v == pytest.approx(V, abs=1e-12)
    assert q == tuple(x + DT * y for x, y in zip(Q, V))


def test_low_pass_has_its_time_constant() -> None:
    """After 1/(2 π f) a step has come through to 1 - 1/e; with no cutoff at once."""
    v = 0.0
    for _ in range(10):
        v = low_pass(v, 1.0, 1.0 / (2.0 * math.pi * 0.01), DT)
    assert v == pytest.approx(1.0 - math.exp(-1.0), abs=1e-12)
    assert low_pass(0.3, 1.0, 0.0, DT) == 1.0


def test_noise_has_its_deviation_and_its_seed() -> None:
    """Each joint has its own; another seed gives other noise, the same seed the same."""
    encoder = Encoder(resolution=0.0, noise=(1e-3, 1e-3, 0.0))

    def noise(seed: int) -> np.ndarray:
        state, rows = encoder.init(3, seed), []
        for _ in range(5000):
            q, _, state = encoder.step(DT, ZERO, ZERO, state)
            rows.append(q)
        return np.array(rows)

    one = noise(1)
    assert one.std(axis=0) == pytest.approx([1e-3, 1e-3, 0.0], rel=0.05)
    assert abs(np.corrcoef(one[:, 0], one[:, 1])[0, 1]) < 0.05
    assert np.array_equal(one, noise(1))
    assert not np.array_equal(one[:, 0], noise(2)[:, 0])


# Plant.


def test_measurement_is_taken_once_per_tick() -> None:
    """Asking again gives the same; a plant that is asked never or often goes the same way."""
    encoder = "sensor={type: encoder, noise: 0.001}"
    often, once = (PlantStage(load("paper", [encoder, "seed=5"])) for _ in range(2))
    for k in range(20):
        assert often.measure() == often.measure()
        often.step(k * 1_000_000, ZERO, QUIET)
        once.step(k * 1_000_000, ZERO, QUIET)
    assert often.measure() == once.measure()
    assert often.measure().position != often.motion[0]
    other = PlantStage(load("paper", [encoder, "seed=6"]))
    assert other.measure() != PlantStage(load("paper", [encoder, "seed=5"])).measure()


def test_trace_keeps_the_true_motion() -> None:
    """Errors are those of the robot, not of its encoder; what was measured stands beside it."""
    trace = run("sensor={type: encoder, resolution: 0.01}")
    assert trace.measured_position is not None
    assert trace.measured_velocity is not None
    off = np.abs(trace.measured_position - trace.position)
    assert 0.004 < off.max() <= 0.005 + 1e-12
    assert np.allclose(trace.measured_position / 0.01, np.round(trace.measured_position / 0.01), atol=1e-9)
    assert np.array_equal(trace.error, trace.position - trace.reference_position)
    assert evaluate(trace)["whole"] is not None


def test_observer_and_controller_get_what_is_measured() -> None:
    """The first torque belongs to the encoder's rounded position, the fault to the true one."""
    rounded = run("sensor={type: encoder, resolution: 1.0}", "initial_state.position=0.4")
    at_zero = run("initial_state.position=0.0")
    assert np.array_equal(rounded.command[0], at_zero.command[0])
    assert not np.array_equal(rounded.disturbance[0], at_zero.disturbance[0])


# Delay.


def test_delay_line() -> None:
    """Zeros, then what was put in, in order; the drive reports what it applies."""
    none = FaultChain(load("paper"), ActuatorFault)
    drive = Drive(Limits(), 2, none, DT)
    state, applied = drive.init(1), []
    for n in range(1, 6):
        torque, state = drive.step(0.0, (float(n),), (0.0,), (0.0,), state)
        assert state.effort == torque
        applied.append(torque)
    assert applied == [(0.0,), (0.0,), (1.0,), (2.0,), (3.0,)]
    undelayed = Drive(Limits(), 0, none, DT)
    assert undelayed.step(0.0, (7.0,), (0.0,), (0.0,), undelayed.init(1))[0] == (7.0,)


@pytest.mark.parametrize("ticks", [0, 1, 3])
def test_effort_is_the_delayed_command(ticks: int) -> None:
    """The drive reports what it applied: over the tick before, the command of `ticks` before that."""
    trace = run(f"torque_delay={ticks}", "torque_limits=80")
    arrived = np.clip(trace.command[: -1 - ticks], -80.0, 80.0)
    assert np.array_equal(trace.effort[1 + ticks :], arrived)
    assert not trace.effort[: 1 + ticks].any()


def test_disturbances_see_the_command_actuator_faults_the_torque_that_acts() -> None:
    """The injector's u is the command; delay and limits are the drive's, its faults come after them."""
    seen: list[Vector] = []
    acted: list[float] = []

    @dataclass(frozen=True, kw_only=True)
    class Spy(Disturbance):
        def torque(self, t: float, q: Vector, v: Vector, u: Vector) -> Vector:
            seen.append(u)
            return ZERO

    @dataclass(frozen=True, kw_only=True)
    class Shorted(ActuatorFault):
        type_name: ClassVar[str] = "shorted"

        @staticmethod
        def act(p: Any, size: float, now: Moment, torque: float, q: float, v: float, s: Vector) -> Any:
            acted.append(torque)
            return 0.0, s

    scenario = load("paper", ["torque_limits=1.5", "torque_delay=1"])
    scenario = replace(scenario, disturbances=(Spy(),), faults=(Shorted(start=0.0),))
    injector, plant = InjectorStage(scenario), PlantStage(scenario)
    for k, n in enumerate((1.0, 2.0, 3.0)):
        d = injector.step(k * 1_000_000, Q, V, (n,) * 3)
        plant.step(k * 1_000_000, (n,) * 3, d)
    assert seen == [(1.0,) * 3, (2.0,) * 3, (3.0,) * 3]
    assert acted == [1.0] * 3 + [1.5] * 3, "from the first tick after its onset"
    assert plant.measure().effort == (1.5,) * 3
    assert plant.state.joint_torque == ZERO


@pytest.mark.slow
@pytest.mark.parametrize(
    ("overrides", "low", "high"),
    [
        (["torque_delay=1"], 1.8e-6, 2.5e-6),
        (["torque_delay=2"], 6e-6, 1.1e-5),
        (["sensor={type: encoder, cutoff: 0}"], 3e-4, 7e-4),
        (["sensor={type: encoder, cutoff: 50}"], 1.2e-5, 1.8e-5),
        (["sensor={type: encoder, cutoff: 20}"], 5e-4, 1e-3),
        (["sensor={type: encoder, cutoff: 100}"], 2e-5, 5e-5),
    ],
)
def test_paper_with_delay_or_encoder(overrides: list[str], low: float, high: float) -> None:
    """Mean |e| after the transient; of the cutoffs 50 Hz is best. Chattering amplifies the last bit."""
    windows = evaluate(simulate(load("paper", overrides)))
    assert windows["after_transient"] is not None
    for value in windows["after_transient"]["mean_abs_error"]:
        assert value is not None
        assert low < value < high
