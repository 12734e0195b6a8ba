# SPDX-License-Identifier: Apache-2.0
"""The aligner: every order of arrival gives every tick once, in order."""

from __future__ import annotations

from hypothesis import given
from hypothesis import strategies as st

from ftcm_ros.transport.aligner import Aligner


def test_a_tick_completes_when_its_last_required_input_comes() -> None:
    aligner = Aligner(("a", "b"), pending_limit=100)
    assert aligner.put("a", 0, 1) is None
    assert aligner.put("b", 0, 2) == {"a": 1, "b": 2}
    assert aligner.last == 0


def test_inputs_of_past_ticks_are_stale_if_required() -> None:
    aligner = Aligner(("a",), pending_limit=100)
    aligner.put("a", 5, 1)
    assert aligner.put("a", 5, 1) is None
    assert aligner.put("a", 3, 1) is None
    assert aligner.put("other", 3, 1) is None
    assert aligner.stale == 2


def test_an_input_that_becomes_required_may_have_come_before() -> None:
    aligner = Aligner(("a",), pending_limit=100)
    assert aligner.put("b", 1, "early") is None
    aligner.required = ("a", "b")
    assert aligner.put("a", 1, "x") == {"a": "x", "b": "early"}


def test_an_unfinished_tick_is_dropped_when_a_later_one_completes() -> None:
    aligner = Aligner(("a", "b"), pending_limit=100)
    aligner.put("a", 0, 1)
    aligner.put("a", 1, 1)
    assert aligner.put("b", 1, 1) is not None
    assert aligner.dropped == 1
    assert aligner.put("b", 0, 1) is None


def test_pending_ticks_are_limited() -> None:
    aligner = Aligner(("a", "b"), pending_limit=4)
    for t in range(1000):
        aligner.put("a", t, t)
    assert len(aligner._pending) == 4
    assert aligner.dropped == 996


@given(st.lists(st.tuples(st.sampled_from("ab"), st.integers(0, 20)), max_size=80))
def test_ticks_come_out_at_most_once_and_in_order(arrivals: list[tuple[str, int]]) -> None:
    aligner = Aligner(("a", "b"), pending_limit=100)
    out = []
    for name, t in arrivals:
        if (values := aligner.put(name, t, (name, t))) is not None:
            assert values["a"] == ("a", t)
            assert values["b"] == ("b", t)
            out.append(t)
    assert out == sorted(set(out))
