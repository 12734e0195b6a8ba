# SPDX-License-Identifier: Apache-2.0
"""Plain runs by the written tick: every bit is that of the stages, whatever happens on the way.

That what is written for each component is the tick of its stages is in test_compiled.py.
"""

from __future__ import annotations

import numpy as np
import pytest

from ftcm_core.compiled import written
from ftcm_core.controllers.ftcm import FTCM
from ftcm_core.controllers.smc import SMC
from ftcm_core.observers.none import NoObserver
from ftcm_core.recording.trace import Change, FaultOrder, Trace
from ftcm_core.scenario import Scenario, load
from ftcm_core.simulation import simulate

pytestmark = pytest.mark.pure


def paper(*overrides: str) -> Scenario:
    """The paper's experiment, shortened, its fault moved to 0.1 s."""
    return load("paper", ["duration=0.3", "injection.faults.0.start=0.1", *overrides])


@pytest.fixture
def programs(monkeypatch: pytest.MonkeyPatch) -> list[written.PythonTicks]:
    """Nothing is written yet, and a few ticks are enough for it; what a test has written."""
    found: list[written.PythonTicks] = []
    monkeypatch.setattr(written, "_written", found)
    monkeypatch.setattr(written, "WORTH", 20)
    return found


def assert_equal(trace: Trace, stages: Trace) -> None:
    """Every field, every bit."""
    for name, column in stages.columns.items():
        np.testing.assert_array_equal(trace.columns[name], column, name)
    for field in (
        "time_ns",
        "status",
        "detail",
        "ended_at",
        "changes",
        "fault_events",
        "decisions",
        "engine",
        "scenario",
    ):
        np.testing.assert_equal(getattr(trace, field), getattr(stages, field), field)


BY_HAND = "injection.faults=[{type: loss_of_effectiveness, trigger: hand}]"
WHAT_HAPPENS: dict[str, tuple[tuple[str, ...], tuple[Change, ...], int]] = {
    "nothing": ((), (), 1),
    "new gains": ((), (Change(150, "controller", FTCM(gamma1=2.0)),), 1),
    "another law, and the first again": (
        (),
        (
            Change(100, "controller", SMC()),
            Change(200, "controller", FTCM()),
            Change(201, "controller", SMC()),
        ),
        2,
    ),
    "another observer in the last ticks": ((), (Change(290, "observer", NoObserver()),), 1),
    "a payload picked up": (("injection.faults=[{type: payload_pickup, start: 0.1, mass: 2}]",), (), 1),
    "a fault by hand": (
        (BY_HAND,),
        (Change(50, "fault", FaultOrder(0, "arm")), Change(150, "fault", FaultOrder(0, "clear"))),
        1,
    ),
    "a limit reached": (("position_upper_limits=0.8",), (), 1),
    "divergence": (("controller.gamma1=1e6",), (), 1),
    "policies may change what a tick does": (
        ("policies=[{type: switch, controller: smc}]", "detector=residual_threshold"),
        (),
        0,
    ),
}


@pytest.mark.parametrize("what", WHAT_HAPPENS)
def test_a_run_is_that_of_the_stages(what: str, programs: list[written.PythonTicks]) -> None:
    """Each program serves all ticks of the same structure."""
    overrides, changes, count = WHAT_HAPPENS[what]
    scenario = paper(*overrides)
    trace = simulate(scenario, changes)
    assert_equal(trace, simulate(scenario, changes, written=False))
    assert len(programs) == count


def test_other_numbers_need_no_new_program(programs: list[written.PythonTicks]) -> None:
    """Nor does another run."""
    for gain in (1.0, 2.0):
        simulate(paper(f"controller.gamma1={gain}"))
    assert len(programs) == 1


def test_few_ticks_are_not_worth_it(programs: list[written.PythonTicks]) -> None:
    """Unless it is written already."""
    few = paper("duration=0.015", "injection.faults=[]")
    simulate(few)
    assert not programs
    simulate(paper("injection.faults=[]"))
    assert len(programs) == 1
    assert_equal(simulate(few), simulate(few, written=False))


def test_what_is_asked_for_stage_by_stage_is_run_so(programs: list[written.PythonTicks]) -> None:
    """Which is what the others are compared with."""
    simulate(paper(), written=False)
    assert not programs
