# SPDX-License-Identifier: Apache-2.0
"""What each fault of a topic does: from runs, and from steps with numbered messages."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from ftcm_core import compiled
from ftcm_core.compiled.tracing import shape
from ftcm_core.errors import ParameterError
from ftcm_core.faults import CommunicationFault, Moment
from ftcm_core.faults.past import random_ticks
from ftcm_core.random_streams import happens, stream_key, uniform
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
KEY = 4711.0
FAULTS = [name for name, cls in components("fault").items() if issubclass(cls, CommunicationFault)]
LATE = ["jittered_messages", "reordered_messages"]


def scenario(*faults: str) -> Scenario:
    """The paper's experiment, 0.2 s of it, with faults that start at START."""
    listed = [f.replace("}", f", start: {START}}}") for f in faults]
    return load("paper", ["duration=0.2", f"injection.faults=[{', '.join(listed)}]"])


def run(*faults: str) -> Trace:
    """Simulate it."""
    trace = simulate(scenario(*faults))
    assert trace.status == "completed"
    return trace


def received(name: str, ticks: int, key: float = KEY, **given: Any) -> list[int]:
    """Of which tick the message is that is received, tick by tick; the fault acts from tick 1 on."""
    fault: Any = components("fault")[name](**{"start": 0.0, **given})
    state, found = fault.init(3, key), []
    for k in range(ticks):
        message = ((float(k), -float(k)), (0.5 * k,))
        (one, other), state = fault.step(k * DT, DT, message, state)
        assert (one, other) == ((one[0], -one[0]), (0.5 * one[0],)), "one message, whole"
        found.append(int(one[0]))
    return found


def delays(ticks: int, longest: int, key: float = KEY) -> list[int]:
    """Delay of each tick's message: the stream's number, spread over 0 to the longest."""
    return [0, *(math.floor(uniform(key, float(k)) * (longest + 1)) for k in range(1, ticks))]


def newest(delay: list[int]) -> list[int]:
    """The newest message that has arrived, of a list of delays."""
    return [max(j for j in range(k + 1) if j + delay[j] <= k) for k in range(len(delay))]


def latest(delay: list[int]) -> list[int]:
    """The one that arrived last, the newest of several in one tick."""
    return [
        max((j for j in range(k + 1) if j + delay[j] <= k), key=lambda j: (j + delay[j], j))
        for k in range(len(delay))
    ]


# Each by itself.


@pytest.mark.parametrize(
    ("delay", "severity", "late"), [(0, 1.0, 0), (5, 1.0, 5), (100, 1.0, 100), (9, 0.5, 5)]
)
def test_delayed_messages(delay: int, severity: float, late: int) -> None:
    """Each by as much; before the first there is the first."""
    found = received("delayed_messages", 150, delay=delay, severity=severity)
    assert found == [max(0, k - late) for k in range(150)]


def test_a_delay_that_grows() -> None:
    """With a ramp, as the share of it that is there."""
    found = received("delayed_messages", 150, delay=30, profile="ramp", rise=0.07)
    assert found == [max(0, k - min(30, math.floor(k / 70 * 30 + 0.5))) for k in range(150)]


@pytest.mark.parametrize(("name", "model"), [(LATE[0], newest), (LATE[1], latest)])
@settings(deadline=None, max_examples=40)
@given(longest=st.integers(0, 20), key=st.integers(0, 2**53 - 1).map(float), ticks=st.integers(1, 120))
def test_messages_late_by_a_time_of_their_own(
    name: str, model: Callable[[list[int]], list[int]], longest: int, key: float, ticks: int
) -> None:
    """As of a queue that knows every message's arrival."""
    assert received(name, ticks, key, longest=longest) == model(delays(ticks, longest, key))


@pytest.mark.parametrize(("size", "longest", "upto"), [(1.0, 7, 7), (0.5, 6, 3), (0.0, 7, 0)])
def test_every_delay_is_as_probable_as_any_other(size: float, longest: int, upto: int) -> None:
    """From 0 to the share of the longest, over 20000 messages; limits are 4 standard errors."""
    drawn = [random_ticks(size, float(longest), KEY, float(k)) for k in range(20_000)]
    share = 1.0 / (upto + 1)
    counts = np.bincount(np.array(drawn, dtype=int)) / len(drawn)
    assert len(counts) == upto + 1
    assert np.abs(counts - share).max() <= 4.0 * math.sqrt(share * (1.0 - share) / len(drawn))


def test_jitter_keeps_the_order_and_reordering_does_not() -> None:
    """The newest never gets older; what arrived last does. Neither is later than the longest delay allows."""
    jittered, reordered = (np.array(received(name, 400, longest=6)) for name in LATE)
    assert (np.diff(jittered) >= 0).all()
    assert (np.diff(reordered) < 0).sum() > 40
    assert 0 <= (np.arange(400) - jittered).min() < (np.arange(400) - jittered).max() <= 6
    assert (jittered >= reordered).all()
    assert (np.arange(400) - reordered).max() > 6, "the reader keeps an old one where none arrives"


@pytest.mark.parametrize("name", LATE)
def test_once_it_is_over_each_message_is_the_one_sent(name: str) -> None:
    """Also while older ones still arrive."""
    found = received(name, 100, longest=20, lifetime="timed", duration=50.5 * DT)
    assert found[51:] == list(range(51, 100))
    assert found[:51] != list(range(51))


@pytest.mark.parametrize(("probability", "severity"), [(0.0, 1.0), (0.3, 1.0), (0.6, 0.5), (1.0, 1.0)])
def test_duplicated_messages(probability: float, severity: float) -> None:
    """Where the stream says so, the message of ``age`` ticks ago; else the one sent."""
    found = received("duplicated_messages", 200, probability=probability, severity=severity, age=7)
    again = [k > 0 and happens(probability * severity, KEY, float(k)) > 0.0 for k in range(200)]
    assert found == [max(0, k - 7) if old else k for k, old in enumerate(again)]
    assert np.mean(again[1:]) == pytest.approx(probability * severity, abs=0.15)


@pytest.mark.parametrize("name", ["delayed_messages", *LATE])
def test_more_delay_than_is_remembered_is_refused(name: str) -> None:
    """In one line."""
    with pytest.raises(ParameterError, match=r"^severity: 1\.5 is more than .*; expected at most 1$"):
        components("fault")[name](severity=1.5)


# All of them.


@pytest.mark.parametrize("name", FAULTS)
@settings(deadline=None, max_examples=30)
@given(sizes=st.lists(st.sampled_from([0.0, 0.5, 1.0]), min_size=1, max_size=60), key=st.integers(0, 2**50))
def test_of_size_zero_it_lets_the_message_through(name: str, sizes: list[float], key: int) -> None:
    """Whatever was before; what it remembers has one structure from the first message on."""
    fault: Any = components("fault")[name]()
    memory, structures = fault.init(2, 0.0).memory, set()
    for k, size in enumerate(sizes):
        now = Moment(k * DT, DT, k * DT, float(key), float(k))
        message = ((float(k), -0.0), (0.0, float(-k)))
        found, memory = fault.receive(size, now, message, memory)
        structures.add(shape(memory))
        if size == 0.0:
            assert repr(found) == repr(message)
    assert len(structures) == 1


def stream(name: str) -> float:
    """Key of a scenario's first fault of a type."""
    return stream_key(0, f"fault.{name}.0")


def sent_in_run(ticks: int, delay: list[int]) -> list[int]:
    """Delays of a run's messages: none up to the onset."""
    return [0] * FIRST + delay[FIRST:ticks]


@pytest.mark.parametrize(
    ("fault", "of"),
    [
        ("delayed_messages, delay: 3", lambda n: [k - 3 if k >= FIRST else k for k in range(n)]),
        ("jittered_messages, longest: 4",
         lambda n: newest(sent_in_run(n, delays(n, 4, stream("jittered_messages"))))),
        ("reordered_messages, longest: 4",
         lambda n: latest(sent_in_run(n, delays(n, 4, stream("reordered_messages"))))),
        ("duplicated_messages, age: 4",
         lambda n: [k - 4 if k >= FIRST and happens(0.1, stream("duplicated_messages"), float(k)) else k
                    for k in range(n)]),
    ],
)  # fmt: skip
def test_in_a_run(fault: str, of: Callable[[int], list[int]]) -> None:
    """The drive applies the command that is received; measurements are received whole."""
    trace = run(f"{{type: {fault}}}")
    sent = of(trace.ticks)
    assert np.array_equal(trace.effort[1:], trace.command[sent[:-1]])
    assert sent != list(range(trace.ticks))
    trace = run(f"{{type: {fault}, topic: joint_states}}")
    assert np.array_equal(np.asarray(trace.measured_position), trace.position[sent])
    assert np.array_equal(np.asarray(trace.measured_velocity), trace.velocity[sent])
    applied = np.vstack([np.zeros((1, 3)), trace.command[:-1]])
    assert np.array_equal(trace.effort, applied[sent])


ALL = (
    "{type: delayed_messages, delay: 2, profile: ramp, rise: 0.07}",
    "{type: jittered_messages, longest: 2}",
    "{type: reordered_messages, longest: 3, profile: intermittent, period: 0.02}",
    "{type: duplicated_messages, probability: 0.2, age: 3, lifetime: timed, duration: 0.06}",
    "{type: dropped_messages, probability: 0.2, trigger: condition, trigger_above: 0.001}",
)


def test_all_of_them_act_by_rank() -> None:
    """None is left out below; first what loses messages, then what delays them."""
    order = [fault.type_name for fault in FaultChain(scenario(*ALL), CommunicationFault).faults]
    assert sorted(order) == FAULTS
    assert order == [
        "dropped_messages", "delayed_messages", "jittered_messages", "reordered_messages",
        "duplicated_messages",
    ]  # fmt: skip


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
