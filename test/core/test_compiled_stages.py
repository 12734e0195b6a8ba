# SPDX-License-Identifier: Apache-2.0
"""Stages compiled one by one give what the compiled run gives, bit for bit, and hand over to plain Python."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

pytest.importorskip("numba")

from everything import EVERYTHING
from ftcm_core import compiled
from ftcm_core.compiled.stage import compiled_stage, stage_program
from ftcm_core.compiled.tracing import NotCompilable
from ftcm_core.controllers import FeedbackLaw
from ftcm_core.recording.trace import Trace
from ftcm_core.registry import components, register
from ftcm_core.scenario import Scenario, from_mapping, load
from ftcm_core.scenario.definition import replace
from ftcm_core.signals import Measurement, TrueDisturbance
from ftcm_core.simulation import Loop
from plugins import registry_kept, robots_known, scenario_mapping

pytestmark = pytest.mark.slow

FEW_TICKS = ["duration=0.3", "transient=0.1", "injection.faults.0.start=0.2"]
"""Those of test_compiled.py, whose code for each law is found here."""
OVERLOADED = {
    "trigger": "condition", "trigger_signal": "torque", "trigger_joint": 2, "trigger_above": 50.0,
}  # fmt: skip
KINDS = ("plant", "observer", "controller", "injector", "detector")
FAULTY = {
    **EVERYTHING,
    "injection": {
        "disturbances": ["vo_kang_friction"],
        "faults": [
            {"type": "vo_kang_fault", "start": 0.1},
            {"type": "loss_of_effectiveness", "start": 0.08, "loss": [0.0, 0.3, 0.2], **OVERLOADED},
            {"type": "sensor_bias", "start": 0.06, "bias": 0.002},
            {"type": "sensor_drift", "start": 0.06, "drift": 0.0, "walk": 0.001},
            {"type": "payload_pickup", "start": 0.15, "mass": 1.0},
            {"type": "dropped_messages", "topic": "joint_torques", "probability": 0.05},
        ],
    },
    "duration": 0.3,
}


def staged(scenario: Scenario, kinds: tuple[str, ...] = KINDS) -> Loop:
    """A run with these stages compiled."""
    loop = Loop(scenario)
    for kind in kinds:
        if getattr(loop, kind) is not None:
            setattr(loop, kind, compiled_stage(getattr(loop, kind), stage_program(kind, scenario)))
    return loop


def rows_of(loop: Loop, scenario: Scenario) -> tuple[np.ndarray[Any, Any], str]:
    """All rows of a run, and how it ended."""
    rows: list[Any] = []
    reason, k = "", 0
    for k in range(scenario.last_tick + 1):
        reason = loop.tick(k * scenario.dt_ns, k == scenario.last_tick, rows.append)
        if reason:
            break
    status, detail, _ = loop.ended(k * scenario.dt_ns, reason)
    return np.array(rows), f"{status} {detail}"


def row_table(trace: Trace) -> np.ndarray[Any, Any]:
    """The rows that a trace was made of."""
    return np.hstack(list(trace.columns.values()))


def equals_the_compiled_run(scenario: Scenario) -> str:
    """Compare bit for bit; return how the run ended."""
    rows, ending = rows_of(staged(scenario), scenario)
    trace = compiled.simulate(scenario)
    assert ending == f"{trace.status} {trace.detail}"
    assert np.array_equal(rows, row_table(trace))
    return ending


@pytest.mark.parametrize("law", [*components("controller")])
def test_every_law(law: str) -> None:
    """Of one joint, as in test_compiled.py."""
    with robots_known():
        scenario = from_mapping(scenario_mapping("pendulum", controller=law))
    assert equals_the_compiled_run(scenario).startswith("completed")


@pytest.mark.nightly
@pytest.mark.parametrize("law", [*components("controller")])
def test_every_law_of_the_paper_s_robot(law: str) -> None:
    assert equals_the_compiled_run(load("paper", FEW_TICKS, law)).startswith("completed")


def test_the_paper_s_run_is_the_plain_one() -> None:
    """Where no single operation is rounded otherwise."""
    scenario = load("paper", ["duration=0.5", "injection.faults.0.start=0.2"])
    assert np.array_equal(rows_of(staged(scenario), scenario)[0], rows_of(Loop(scenario), scenario)[0])


@pytest.mark.parametrize("kind", ["all", *KINDS])
def test_everything_at_once(kind: str) -> None:
    scenario = from_mapping(FAULTY)
    if kind == "all":
        equals_the_compiled_run(scenario)
    kinds = KINDS if kind == "all" else (kind,)
    rows, plain = (rows_of(loop, scenario)[0] for loop in (staged(scenario, kinds), Loop(scenario)))
    np.testing.assert_allclose(rows, plain, rtol=1e-6, atol=1e-6)


@pytest.mark.parametrize(
    "overrides",
    [
        ["position_upper_limits=[9, 0.05, 9]", "duration=2"],  # a condition does not hold
        ["controller.type=ctc", "controller.kd=2010", "duration=3"],  # it diverges
    ],
)
def test_a_run_that_ends_early_ends_as_the_plain_one(overrides: list[str]) -> None:
    scenario = load("paper", overrides)
    ending = rows_of(Loop(scenario), scenario)[1]
    assert not ending.startswith("completed")
    assert rows_of(staged(scenario), scenario)[1] == ending


def test_a_swapped_law_goes_on_as_the_plain_one() -> None:
    """Another gain keeps the state, another law begins afresh."""
    scenario = load("paper", ["duration=0.4"], "pid")
    gains = replace(scenario.controller, kp=200.0)
    smc = components("controller")["smc"]()
    found = []
    for loop in (staged(scenario), Loop(scenario)):
        rows: list[Any] = []
        for k in range(400):
            for when, law in ((100, gains), (250, smc)):
                if k != when:
                    continue
                if isinstance(loop.controller, compiled.stage.CompiledStage):
                    loop.controller.swap(law, stage_program("controller", scenario, law))
                else:
                    loop.controller.swap(law)
            assert not loop.tick(k * scenario.dt_ns, False, rows.append)
        found.append(np.array(rows))
    np.testing.assert_allclose(*found, rtol=1e-9, atol=1e-9)


def test_another_law_than_the_compiled_one_is_refused() -> None:
    scenario = load("paper", ["duration=0.4"], "ctc")
    program = stage_program("controller", scenario)
    other = Loop(load("paper", ["duration=0.4"], "smc"))
    stage = compiled_stage(other.controller, program)
    with pytest.raises(NotCompilable, match="the controller is not the one that was compiled"):
        stage.step(0, Measurement(*[(0.0,) * 3] * 3), (0.0,) * 3)


def test_skipped_ticks_and_a_safe_stop_are_done_by_the_stage_itself() -> None:
    scenario = from_mapping(FAULTY)
    rows = []
    for loop in (staged(scenario), Loop(scenario)):
        d = TrueDisturbance((1.0, 2.0, 3.0))
        found: list[Any] = []
        for k in range(20):
            y = loop.plant.measure()
            tau = loop.observer.step(y, 3 if k == 10 else 1)
            u, _ = loop.controller.step(k * scenario.dt_ns, y, tau)
            q, v = loop.plant.motion
            added = loop.injector.step(k * scenario.dt_ns, q, v, u, 3 if k == 10 else 1).torque
            assert loop.detector is not None
            residual, alarm, _ = loop.detector.step(y, u, tau, 3 if k == 10 else 1)
            if k in (12, 13):
                loop.plant.safe_stop(k * scenario.dt_ns, d)
            else:
                loop.plant.step(k * scenario.dt_ns, u, d)
            found.append([*tau, *u, *added, *residual, *alarm, *q, *v, *loop.plant.joint_torque])
        rows.append(np.array(found))
    np.testing.assert_allclose(*rows, rtol=1e-9, atol=1e-9)


def test_what_cannot_be_compiled_is_said_in_one_line() -> None:
    with registry_kept():

        @register("controller", "deciding")
        class Deciding(FeedbackLaw):
            def feedback(self, model: Any, dt: float, y: Any, reference: Any, state: Any) -> Any:
                return tuple(1.0 if e > 0.0 else -1.0 for e in y.position), state

        scenario = load("paper", ["duration=0.1"], controller="deciding")
        with pytest.raises(NotCompilable, match=r"decides on a number \(line \d+ of test_compiled_stages.py"):
            stage_program("controller", scenario)
        stage_program("observer", scenario)
