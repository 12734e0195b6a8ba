# SPDX-License-Identifier: Apache-2.0
"""Pacing with a fake clock: deadlines without drift, misses counted, no burst after a pause."""

from __future__ import annotations

from collections.abc import Callable

import pytest

from ftcm_ros.timing.pacing import LEAD_NS, Lockstep, RealTime

DT = 1_000_000


class FakeClock:
    """Time that passes only when something waits, works, or looks at it."""

    def __init__(self, look_ns: int = 0) -> None:
        self.now = 10**12
        self.look_ns = look_ns

    def __call__(self) -> int:
        self.now += self.look_ns
        return self.now

    def poll(self, timeout_ns: int) -> None:
        self.now += timeout_ns


def real_time(clock: FakeClock) -> RealTime:
    pacer = RealTime(DT, clock)
    pacer.begin()
    return pacer


def test_real_time_ends_ticks_at_absolute_deadlines_without_drift() -> None:
    clock = FakeClock()
    pacer = real_time(clock)
    begin = clock.now
    for k in range(1000):
        clock.now += 137_003  # the tick's own work, never a whole part of dt
        assert pacer.wait(lambda: False, clock.poll)
        assert clock.now == begin + (k + 1) * DT
    assert pacer.misses.total == 0


@pytest.mark.parametrize(
    ("pause", "skipped"), [(DT // 2, 0), (DT + DT // 2, 1), (7 * DT, 7), (3600 * 10**9, 3_600_000)]
)
def test_real_time_skips_what_a_pause_has_missed(pause: int, skipped: int) -> None:
    clock = FakeClock()
    pacer = real_time(clock)
    begin = clock.now
    pacer.wait(lambda: False, clock.poll)
    clock.now = pacer.deadline + pause
    pacer.wait(lambda: False, clock.poll)
    assert pacer.misses.plant_overrun == skipped
    before = clock.now
    pacer.wait(lambda: False, clock.poll)
    assert (clock.now - begin) % DT == 0
    assert 0 < clock.now - before <= DT, "the tick after the pause is an ordinary one, not a burst"


@pytest.mark.parametrize(
    ("ready", "last"), [(True, []), (False, [LEAD_NS])], ids=["looks at the clock", "takes messages in"]
)
def test_real_time_is_awake_before_the_deadline_and_does_not_wait_past_it(
    ready: bool, last: list[int]
) -> None:
    clock = FakeClock(look_ns=1)
    pacer = real_time(clock)
    waits: list[int] = []

    def poll(timeout_ns: int) -> None:
        waits.append(timeout_ns)
        clock.now += min(timeout_ns, 300_000)

    pacer.wait(lambda: ready, poll)
    expected = [*(w - LEAD_NS for w in (1_000_000, 700_000, 400_000, 100_000)), *last]
    assert waits == pytest.approx(expected, abs=10)
    assert 0 <= clock.now - (pacer.deadline - DT) <= 2


@pytest.mark.parametrize("polls", [0, 1, 5])
def test_lockstep_ends_the_tick_when_the_inputs_are_here(polls: int) -> None:
    clock = FakeClock()
    pacer = Lockstep(DT, clock)
    pacer.begin()
    count = 0

    def poll(timeout_ns: int) -> None:
        nonlocal count
        count += 1
        clock.now += 1000

    ready: Callable[[], bool] = lambda: count >= polls  # noqa: E731
    assert pacer.wait(ready, poll)
    assert count == polls


def test_lockstep_comes_back_now_and_then_while_it_waits() -> None:
    clock = FakeClock()
    pacer = Lockstep(DT, clock)
    begin = clock.now
    assert not pacer.wait(lambda: False, clock.poll)
    assert clock.now - begin <= 10**9
