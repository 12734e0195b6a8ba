# SPDX-License-Identifier: Apache-2.0
"""Who is to blame when a node falls silent or the ticks cease, with a clock of the test's own."""

from __future__ import annotations

import pytest

from ftcm_ros.parameters.node_parameters import ALL_NODES, NODES
from ftcm_ros.run.watchdog import Watchdog

PATIENCE = 3.0


def culprit_after(
    lockstep: bool, last: dict[str, int | None], held_up: bool = False, nodes: tuple[str, ...] = NODES
) -> tuple[str, str]:
    """Whom a watchdog blames first when each node reports once a second, its ticks ending at ``last``.

    A node without an entry goes on for ever; with None it is silent from t = 2 s on.
    """
    now = 0.0
    watchdog = Watchdog(lockstep, PATIENCE, lambda: now, nodes)
    for step in range(100):
        now = 0.1 * step + (60.0 if held_up and step > 30 else 0.0)
        for phase, node in enumerate(reversed(nodes)):
            if step % 10 == phase:
                end = last.get(node, 10**9)
                if end is not None or step < 20:
                    watchdog.hear(node, min(100 * step, 10**9 if end is None else end))
        found = watchdog.culprit()
        if found[0]:
            return found
    return "", ""


@pytest.mark.parametrize("lockstep", [True, False])
@pytest.mark.parametrize("held_up", [True, False])
def test_nobody_is_blamed_while_all_go_on(lockstep: bool, held_up: bool) -> None:
    assert culprit_after(lockstep, {}, held_up) == ("", "")


@pytest.mark.parametrize("node", NODES)
def test_a_silent_node_is_named_though_the_others_wait_for_it(node: str) -> None:
    last: dict[str, int | None] = {n: 1500 for n in NODES}
    assert culprit_after(True, {**last, node: None}) == (node, "has said nothing for 3 s")


@pytest.mark.parametrize(
    ("last", "expected"),
    [
        ({"plant": 700, "observer": 700, "controller": 700, "injector": 700, "recorder": 700}, "observer"),
        ({"plant": 700, "observer": 701, "controller": 700, "injector": 700, "recorder": 700}, "controller"),
        ({"plant": 700, "observer": 701, "controller": 701, "injector": 700, "recorder": 700}, "injector"),
        ({"plant": 700, "observer": 701, "controller": 701, "injector": 701, "recorder": 0}, "recorder"),
        ({"plant": 700, "observer": 701, "controller": 701, "injector": 701, "recorder": 701}, "plant"),
        ({"observer": 700}, "observer"),
    ],
)
def test_in_lockstep_it_is_the_one_the_plant_waits_for(last: dict[str, int | None], expected: str) -> None:
    assert culprit_after(True, last) == (expected, "has made no tick for 3 s")


@pytest.mark.parametrize(
    ("last", "expected"),
    [
        ({"controller": 700, "injector": 699, "recorder": 699}, "controller"),
        ({"injector": 700, "recorder": 700}, "injector"),
        ({"recorder": 700}, "recorder"),
        ({n: 700 for n in NODES}, "plant"),
    ],
)
def test_in_real_time_it_is_the_first_in_the_tick(last: dict[str, int | None], expected: str) -> None:
    assert culprit_after(False, last) == (expected, "has made no tick for 3 s")


@pytest.mark.parametrize("lockstep", [True, False])
def test_a_detector_is_watched_where_there_is_one(lockstep: bool) -> None:
    """In lockstep its missing ticks keep the recorder waiting, and that the plant: it is first to blame."""
    last: dict[str, int | None] = {"detector": 700, "recorder": 700}
    if lockstep:
        last |= {"plant": 1700, "observer": 1701, "controller": 1701, "injector": 1701}
    assert culprit_after(lockstep, last, nodes=ALL_NODES) == ("detector", "has made no tick for 3 s")
    if lockstep:  # those that wait for the detector's word, or whose last report is a tick old
        last |= {"observer": 1700, "controller": 1700}
        assert culprit_after(lockstep, last, nodes=ALL_NODES) == ("detector", "has made no tick for 3 s")
        del last["plant"]  # whose report that it has stalled is under way
        assert culprit_after(lockstep, last, nodes=ALL_NODES) == ("detector", "has made no tick for 3 s")
    silent: dict[str, int | None] = {"detector": None}
    assert culprit_after(lockstep, silent, nodes=ALL_NODES) == ("detector", "has said nothing for 3 s")


def test_of_two_silent_nodes_the_one_whose_process_is_stopped_is_named() -> None:
    now = 0.0
    watchdog = Watchdog(False, PATIENCE, lambda: now)
    found = ("", "")
    while not found[0]:
        now += 0.1
        for node in ("plant", "observer", "controller"):
            watchdog.hear(node, round(1000 * now))
        found = watchdog.culprit(lambda node: node == "recorder")
    assert found == ("recorder", "has said nothing for 3 s")
