# SPDX-License-Identifier: Apache-2.0
"""What each fault of a sensor does: from runs, and from steps with a measurement made up."""

from __future__ import annotations

import math
import struct
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from ftcm_core import compiled
from ftcm_core.errors import ParameterError, ScenarioError
from ftcm_core.faults import Moment, SensorFault
from ftcm_core.faults.sensor_delay import SensorDelay
from ftcm_core.faults.sensor_outliers import SensorOutliers
from ftcm_core.random_streams import gaussian, gaussian_pair, happens, stream_key, uniform
from ftcm_core.recording.trace import Trace
from ftcm_core.registry import components
from ftcm_core.scenario import Scenario, load
from ftcm_core.simulation import Loop, simulate
from ftcm_core.simulation.fault_chain import FaultChain
from traces import close
from written_tick import WrittenTick, state_numbers

pytestmark = pytest.mark.pure

DT, START = 1e-3, 0.05
FIRST = 51
"""First tick after the onset."""
SENSOR_FAULTS = [name for name, cls in components("fault").items() if issubclass(cls, SensorFault)]


def scenario(*faults: str, more: tuple[str, ...] = ()) -> Scenario:
    """The paper's experiment, 0.2 s of it, with faults that start at START."""
    listed = [f.replace("}", f", start: {START}}}") for f in faults]
    return load("paper", ["duration=0.2", f"injection.faults=[{', '.join(listed)}]", *more])


def run(*faults: str, more: tuple[str, ...] = ()) -> Trace:
    """Simulate it; nothing is off up to the onset."""
    trace = simulate(scenario(*faults, more=more))
    assert trace.status == "completed"
    assert not np.concatenate(off(trace), axis=1)[:FIRST].any()
    return trace


def off(trace: Trace) -> tuple[np.ndarray, np.ndarray]:
    """Reported minus true positions (rad) and velocities (rad/s)."""
    assert trace.measured_position is not None
    assert trace.measured_velocity is not None
    return trace.measured_position - trace.position, trace.measured_velocity - trace.velocity


def numbers(trace: Trace, fault: str, number: Any) -> np.ndarray:
    """A stream's numbers, by tick and joint; 0 up to the onset."""
    key, found = stream_key(0, f"fault.{fault}.0"), np.zeros((trace.ticks, 3))
    for k in range(FIRST, trace.ticks):
        found[k] = [number(key, float(3 * k + j)) for j in range(3)]
    return found


def samples(name: str, count: int, joints: int = 1, dt: float = DT, **given: Any) -> np.ndarray:
    """What a fault of that name makes of zeros, from its onset on: ticks, joints, position and velocity."""
    fault: Any = components("fault")[name](start=0.0, **given)
    state, zeros, found = fault.init(joints, stream_key(7, name)), (0.0,) * joints, []
    for k in range(count + 1):
        *reported, state = fault.step(k * dt, dt, zeros, zeros, state)
        found.append(np.transpose(reported))
    return np.array(found[1:])


def bits(*values: float) -> bytes:
    """Bits of floats: -0.0 is not 0.0."""
    return struct.pack(f"{len(values)}d", *values)


@pytest.mark.parametrize("name", SENSOR_FAULTS)
@settings(deadline=None, max_examples=30)
@given(data=st.data())
def test_of_size_zero_it_reports_what_is_measured(name: str, data: st.DataObject) -> None:
    """Bit for bit, also where the short way of the base class is not taken, as in compiled code.

    What it remembers stays as it is, unless it has to follow the measurement.
    """
    fault: Any = components("fault")[name]()
    (remembered,), number = fault.init(1, 5.0).memory, st.floats(-1e3, 1e3)
    size, measured = 0.0, (0.0, -0.0)
    for k in range(8):
        now = Moment(k * DT, DT, 1.0, 5.0, float(k))
        *reported, following = fault.sense(fault, size, now, *measured, remembered)
        if size == 0.0:
            assert bits(*reported) == bits(*measured)
            assert following == remembered or fault.remembers
        remembered = following
        size = data.draw(st.sampled_from([0.0, 1.0]))
        measured = data.draw(st.tuples(number, number))


# One after the other.


def test_gain_errors() -> None:
    """Reported = (1 + ψ gain) true, joint by joint; ψ of a ramp."""
    trace = run("{type: sensor_gain, gain: [0.1, -0.2, 0], velocity_gain: 0.5, profile: ramp, rise: 0.1}")
    psi = np.clip((trace.time - START) / 0.1, 0.0, 1.0)[:, None]
    position, velocity = off(trace)
    assert position == pytest.approx(psi * np.array([0.1, -0.2, 0.0]) * trace.position, abs=1e-15)
    assert velocity == pytest.approx(psi * 0.5 * trace.velocity, abs=1e-14)
    assert np.abs(position[-1, :2]).min() > 1e-2


def test_only_the_joint_that_is_named_breaks() -> None:
    """Of the others nothing is off; the one gets the random numbers that it gets anyway."""
    trace = run("{type: sensor_noise, joint: 2}")
    position, velocity = off(trace)
    assert not position[:, [0, 2]].any()
    assert not velocity[:, [0, 2]].any()
    expected = 1e-3 * numbers(trace, "sensor_noise", gaussian)[:, 1]
    assert position[:, 1] == pytest.approx(expected, abs=1e-15)


def test_white_noise_is_that_of_its_stream() -> None:
    """Position and velocity by the two numbers of each joint and tick, times their deviations."""
    trace = run("{type: sensor_noise, noise: [0.001, 0.002, 0], velocity_noise: 0.01, severity: 2}")
    position, velocity = off(trace)
    first = numbers(trace, "sensor_noise", gaussian)
    second = numbers(trace, "sensor_noise", lambda key, n: gaussian_pair(key, n)[1])
    assert position == pytest.approx(np.array([0.002, 0.004, 0.0]) * first, abs=1e-15)
    assert velocity == pytest.approx(0.02 * second, abs=1e-14)


def test_white_noise_is_white_and_gaussian() -> None:
    """Of 2 · 10000 pairs: means, deviations, tails, and no correlation; limits are 4 standard errors."""
    x = samples("sensor_noise", 10_000, 2, noise=1.0, velocity_noise=1.0).reshape(10_000, 4)
    n = len(x)
    assert np.abs(x.mean(axis=0)).max() < 4.0 / math.sqrt(n)
    assert np.abs(x.std(axis=0) - 1.0).max() < 4.0 / math.sqrt(2.0 * n)
    assert np.abs((x**4).mean(axis=0) - 3.0).max() < 4.0 * math.sqrt(96.0 / n)
    lagged = np.hstack([x[1:], x[:-1]])
    assert np.abs(np.corrcoef(lagged.T)[np.triu_indices(8, 1)]).max() < 4.0 / math.sqrt(n)


@given(key=st.integers(0, 2**53 - 1).map(float), counter=st.integers(0, 2**51).map(float))
def test_a_pair_has_the_number_of_its_counter_first(key: float, counter: float) -> None:
    """So whoever needs one more number of a tick takes no number of another."""
    first, second = gaussian_pair(key, counter)
    assert first == gaussian(key, counter)
    assert first**2 + second**2 == pytest.approx(-2.0 * math.log(uniform(key, 2.0 * counter)), rel=1e-12)


def test_coloured_noise_is_an_exact_gauss_markov_process() -> None:
    """x_k = φ x_(k-1) + √(1 - φ²) n_k, from the stream's numbers, starting from n itself."""
    fault = "{type: coloured_noise, correlation_time: [0.01, 0.1, 1], noise: 0.01, velocity_noise: 0.1}"
    trace = run(fault)
    phi = np.exp(-DT / np.array([0.01, 0.1, 1.0]))
    for found, deviation, which in zip(off(trace), (0.01, 0.1), (0, 1)):
        drawn = numbers(trace, "coloured_noise", lambda key, n, w=which: gaussian_pair(key, n)[w])
        x = np.zeros_like(drawn)
        x[FIRST] = drawn[FIRST]
        for k in range(FIRST + 1, trace.ticks):
            x[k] = phi * x[k - 1] + np.sqrt(1.0 - phi**2) * drawn[k]
        assert found == pytest.approx(deviation * x, abs=1e-12)


@pytest.mark.parametrize(("time", "dt"), [(0.02, 1e-3), (0.02, 5e-3), (1e-6, 1e-3)])
def test_coloured_noise_does_not_depend_on_the_tick(time: float, dt: float) -> None:
    """Deviation 1 and autocorrelation E^(-lag/time), whatever dt is; limits are 4 standard errors."""
    x = samples("coloured_noise", 20_000, dt=dt, noise=1.0, velocity_noise=1.0, correlation_time=time)[:, 0]
    phi = math.exp(-dt / time)
    independent = len(x) * (1.0 - phi) / (1.0 + phi)  # as many samples say as much of the mean
    assert np.abs(x.mean(axis=0)).max() < 4.0 / math.sqrt(independent)
    assert (x**2).mean(axis=0) == pytest.approx([1.0, 1.0], abs=4.0 * math.sqrt(2.0 / independent))
    for lag in (1, 5, 20):
        found = (x[lag:] * x[:-lag]).mean(axis=0)
        assert found == pytest.approx([phi**lag] * 2, abs=4.0 * math.sqrt(2.0 / independent))


def test_coloured_noise_has_its_deviation_from_the_onset_on() -> None:
    """Over 4000 joints, in the first tick and in the fifth."""
    x = samples("coloured_noise", 5, 4000, noise=1.0, correlation_time=1.0)[..., 0]
    for k in (0, 4):
        assert x[k].std() == pytest.approx(1.0, abs=4.0 / math.sqrt(2.0 * 4000))
    assert np.corrcoef(x[0], x[4])[0, 1] > 0.98


def test_quantisation() -> None:
    """Whole steps, no more than half a step off; half the severity, half the step."""
    for severity in (1.0, 0.5):
        trace = run(f"{{type: sensor_quantisation, severity: {severity}, velocity_resolution: 0.05}}")
        assert trace.measured_position is not None
        for found, reported, step in zip(
            off(trace), (trace.measured_position, trace.measured_velocity), (0.01, 0.05)
        ):
            steps = np.asarray(reported)[FIRST:] / (severity * step)
            assert steps == pytest.approx(np.round(steps), abs=1e-9)
            assert np.abs(found[FIRST:]).max() <= severity * step / 2.0 * (1.0 + 1e-12)
            assert np.abs(found[FIRST:]).max() > 0.4 * severity * step


def test_outliers() -> None:
    """Where the stream says so, by ± the spike; every other sample is the true one, bit for bit."""
    trace = run("{type: sensor_outliers, probability: [0.2, 0.1, 0], spike: 0.01, velocity_spike: 0.1}")
    position, velocity = off(trace)
    share, u = np.array([0.2, 0.1, 0.0]), numbers(trace, "sensor_outliers", uniform)
    sign = np.where(u < share / 2.0, -1.0, np.where(u > 1.0 - share / 2.0, 1.0, 0.0))
    sign[:FIRST] = 0.0
    assert position == pytest.approx(0.01 * sign, abs=1e-15)
    assert velocity == pytest.approx(0.1 * sign, abs=1e-14)
    assert not position[sign == 0.0].any()
    assert {-1.0, 1.0} <= set(sign[:, 0])


def test_outliers_are_as_many_as_it_says() -> None:
    """Of 20000 samples, of either sign; limits are 4 standard errors."""
    x = samples("sensor_outliers", 10_000, 2, probability=0.1, spike=1.0)[..., 0].ravel()
    for sign in (-1.0, 1.0):
        error = math.sqrt(0.05 * 0.95 / len(x))
        assert (x == sign).mean() == pytest.approx(0.05, abs=4.0 * error)
    always = [
        SensorOutliers.sense(SensorOutliers(probability=1.0), 1.0, moment(k), 0.0, 0.0, ()) for k in range(99)
    ]
    assert {abs(x) for x, _, _ in always} == {0.1}


def moment(k: int) -> Moment:
    """Tick k, with a stream."""
    return Moment(k * DT, DT, k * DT, 5.0, float(k))


@pytest.mark.parametrize("quantity", ["both", "position", "velocity"])
def test_a_frozen_sensor_reports_what_it_did_at_the_onset(quantity: str) -> None:
    """The last value before, for as long as it lasts; then the true one again."""
    trace = run(
        f"{{type: frozen_sensor, quantity: {quantity}, lifetime: timed, duration: 0.1, severity: 0.3}}"
    )
    last = FIRST + 100
    for name, true, reported in (
        ("position", trace.position, trace.measured_position),
        ("velocity", trace.velocity, trace.measured_velocity),
    ):
        expected = true.copy()
        if quantity in (name, "both"):
            expected[FIRST:last] = true[FIRST - 1]
            assert np.abs(expected - true)[last - 1].min() > 1e-6
        assert np.array_equal(expected, np.asarray(reported))


def test_a_sensor_that_freezes_time_and_again() -> None:
    """Each time at the last value before; no switch is on a tick."""
    trace = run("{type: frozen_sensor, profile: periodic, period: 0.0403, duty: 0.5}")
    held = []
    for k in range(trace.ticks):
        acts = k >= FIRST and math.fmod(k * DT - START, 0.0403) < 0.5 * 0.0403
        held.append(held[-1] if acts else k)
    assert np.array_equal(np.asarray(trace.measured_position), trace.position[held])
    assert len(set(held)) < trace.ticks - 60


@pytest.mark.parametrize("instead", ["last", "zero"])
def test_dropouts(instead: str) -> None:
    """Where the stream says so, joint by joint: the last sample reported, or zero."""
    trace = run(f"{{type: sensor_dropout, probability: [0.3, 0.6, 0], instead: {instead}}}")
    lost = numbers(trace, "sensor_dropout", lambda key, n: happens([0.3, 0.6, 0.0][int(n) % 3], key, n)) > 0.0
    for true, reported in (
        (trace.position, trace.measured_position),
        (trace.velocity, trace.measured_velocity),
    ):
        expected = true.copy()
        for k, j in np.argwhere(lost):
            expected[k, j] = 0.0 if instead == "zero" else expected[k - 1, j]
        assert np.array_equal(expected, np.asarray(reported))
    assert lost[FIRST:].mean(axis=0) == pytest.approx([0.3, 0.6, 0.0], abs=0.15)


def test_a_delay() -> None:
    """Reported = true, some whole ticks ago: as many as ψ makes of them."""
    ramp = "{type: sensor_delay, delay: 30, profile: ramp, rise: 0.07}"
    for fault, lag in (
        ("{type: sensor_delay, delay: 7}", lambda k: 7),
        ("{type: sensor_delay, delay: 7, severity: 0.5}", lambda k: 4),
        ("{type: sensor_delay, delay: 100}", lambda k: 100),
        (ramp, lambda k: min(30, math.floor((k * DT - START) / 0.07 * 30 + 0.5))),
    ):
        trace = run(fault)
        sent = [max(0, k - lag(k)) if k >= FIRST else k for k in range(trace.ticks)]
        assert np.array_equal(np.asarray(trace.measured_position), trace.position[sent])
        assert np.array_equal(np.asarray(trace.measured_velocity), trace.velocity[sent])


@settings(deadline=None, max_examples=50)
@given(delay=st.integers(0, 100), ticks=st.integers(1, 150), severity=st.floats(0.0, 1.0))
def test_a_delayed_sample_is_an_earlier_one(delay: int, ticks: int, severity: float) -> None:
    """Position and velocity of one tick, none from before the first."""
    fault = SensorDelay(delay=delay, severity=severity, start=0.0)
    state = fault.init(1, 0.0)
    for k in range(ticks):
        q, v, state = fault.step(k * DT, DT, (float(k),), (-float(k),), state)
        late = 0 if k == 0 else math.floor(severity * delay + 0.5)
        assert (q, v) == ((float(max(0, k - late)),), (-float(max(0, k - late)),))
        assert len(state.memory[0]) == delay


def test_a_delay_beyond_what_is_remembered_is_refused() -> None:
    """In one line."""
    with pytest.raises(ParameterError, match=r"^severity: 2 is more than .*; expected at most 1$"):
        SensorDelay(severity=2.0)
    with pytest.raises(ScenarioError, match=r"--set: injection.faults.0.delay: 101 is out of range; .*100"):
        scenario("{type: sensor_delay, delay: 101}")


# Together.

ALL = (
    "{type: sensor_delay, delay: 4}",
    "{type: sensor_dropout, probability: 0.2}",
    "{type: frozen_sensor, joint: 2, profile: intermittent, period: 0.02, duty: 0.3}",
    "{type: sensor_outliers, probability: 0.05, spike: 0.001, velocity_spike: 0.1}",
    "{type: sensor_quantisation, resolution: 1e-3, profile: ramp, rise: 0.1}",
    "{type: coloured_noise, profile: one_shot, period: 0.1, velocity_noise: 1e-3}",
    "{type: sensor_noise, profile: incipient, rate: 20, velocity_noise: 1e-3}",
    "{type: sensor_drift, walk: 1e-3}",
    "{type: sensor_bias, profile: periodic, period: 0.02}",
    "{type: sensor_gain, gain: 0.01, trigger: condition, trigger_signal: speed, trigger_above: 0.01}",
)


def test_all_of_them_are_tried_together() -> None:
    """None is left out below."""
    assert sorted(f.type_name for f in scenario(*ALL).faults) == SENSOR_FAULTS


def test_they_act_by_rank_whatever_their_order_in_the_scenario() -> None:
    """First the gain, then bias and drift, rounding, then what loses or delays samples."""
    order = [fault.type_name for fault in FaultChain(scenario(*ALL), SensorFault).faults]
    assert order == [
        "sensor_gain", "sensor_bias", "sensor_drift", "coloured_noise", "sensor_noise", "sensor_quantisation",
        "sensor_outliers", "frozen_sensor", "sensor_dropout", "sensor_delay",
    ]  # fmt: skip
    one = run(*ALL)
    other = run(*reversed(ALL))
    assert np.array_equal(np.asarray(one.measured_position), np.asarray(other.measured_position))
    few = run(
        "{type: sensor_quantisation}", "{type: sensor_bias, bias: 0.2}", "{type: sensor_gain, gain: 0.5}"
    )
    expected = 0.01 * np.round((1.5 * few.position + 0.2)[FIRST:] / 0.01)
    assert few.measured_position is not None
    assert few.measured_position[FIRST:] == pytest.approx(expected, abs=1e-14)


def test_the_source_of_the_compiled_run_gives_the_plain_run_bit_for_bit() -> None:
    """Rows and what is remembered, before, at and after the onset."""
    loop, other, plain = Loop(scenario(*ALL)), Loop(scenario(*ALL)), []
    for k in range(3):
        assert not loop.tick(k * loop.plant.dt_ns, False, lambda row: None)
        assert not other.tick(k * loop.plant.dt_ns, False, lambda row: None)
    written = WrittenTick(loop)
    assert written.run(3, 150) == 150
    for k in range(3, 150):
        assert not other.tick(k * other.plant.dt_ns, False, plain.append)
    assert written.rows == [list(row) for row in plain]
    assert written.state == state_numbers(other)


@pytest.mark.slow
def test_compiled_they_do_what_they_do_plainly(monkeypatch: pytest.MonkeyPatch, tmp_path: Any) -> None:
    """Closely: compiled code rounds some operations otherwise."""
    pytest.importorskip("numba")
    monkeypatch.setenv(compiled.CACHE, str(tmp_path))
    trace = compiled.simulate(scenario(*ALL))
    assert trace.engine == "compiled"
    close(trace, run(*ALL), rtol=1e-9, atol=1e-9)
