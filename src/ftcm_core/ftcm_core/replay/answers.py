# SPDX-License-Identifier: Apache-2.0
"""The stages that answer, replayed: observer, controller, injector and detector."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable
from itertools import product
from typing import Any, NamedTuple

from ftcm_core.compiled.stage import CompiledStage, compiled_stage, stage_program
from ftcm_core.recording.trace import Change
from ftcm_core.replay.record import (
    PATIENCE,
    Message,
    Record,
    alike,
    distance,
    plain_state,
    recall,
    remember,
)
from ftcm_core.signals import Measurement, seconds
from ftcm_core.simulation.stages import ControllerStage, DetectorStage, InjectorStage, ObserverStage

Computed = dict[str, list[list[Message]]]
"""What the replay gives, per data topic and tick: the likeliest first; several where that is not known."""
Answer = tuple[Message, ...]
Call = Callable[[Any, int, tuple[Message, ...], int], Answer]
"""A stage, time (ns), what it received, how many ticks after its last answer: what it sends."""

MOST = 8
"""How many possibilities are followed up at once (chosen)."""


class Possibility(NamedTuple):
    """What a stage may remember."""

    memory: Any
    ticks: int = 1
    """How many ticks after its last answer the next one is."""


class AnsweringStage:
    """One stage, run again from what it received."""

    def __init__(
        self, name: str, record: Record, computed: Computed, stage: Any, inputs: tuple[str, ...],
        outputs: tuple[str, ...], call: Call, failed: Callable[[int], Answer],
    ) -> None:  # fmt: skip
        """Begin before the first tick.

        Args:
            name: ``observer``, ``controller``, ``injector`` or ``detector``.
            record: the run.
            computed: what the replay gives; its outputs are added.
            stage: the stage, plain or compiled.
            inputs: topics that it reads.
            outputs: topics that it writes.
            call: runs it.
            failed: what its node sends at a time (ns) at which it leaves its domain.
        """
        self.name, self.outputs = name, outputs
        self.undecided: list[int] = []
        """Ticks of which the record does not tell enough."""
        self._record, self._computed, self._stage = record, computed, stage
        self._inputs, self._call, self._failed = inputs, call, failed
        self._possible = [Possibility(remember(stage))]
        self._patience = PATIENCE
        self._sure = True
        """Whether the stage's memory is known."""
        self._begun = False
        """Whether it has answered."""

    def change(self, component: Any) -> None:
        """Use another component from this tick on; one of another kind starts afresh."""
        stage, possible = self._stage, []
        keeps = type(component) is type(getattr(stage, self.name))
        for possibility in self._possible:  # memories of compiled stages are of one component
            recall(stage, possibility.memory)
            possible.append(possibility._replace(memory=plain_state(stage)))
        recall(stage, possible[0].memory)
        if isinstance(stage, CompiledStage):
            stage.swap(component, stage_program(self.name, self._record.scenario, component))
        else:
            stage.swap(component)
        self._possible = possible if keeps else [Possibility(remember(stage))]

    def order(self, number: int, action: str, t: float) -> None:
        """Arm or clear a fault by hand at t, s, where this stage has any."""
        if self.name in ("controller", "injector"):
            self._possible = [
                possibility._replace(memory=ordered(self._stage, possibility.memory, number, action, t))
                for possibility in self._possible
            ]

    def tick(self, k: int) -> None:
        """Answer one tick; the inputs of the tick have been computed."""
        record = self._record
        said = [record.at(topic, k) for topic in self.outputs]
        heard = [heard_at(record, self._computed, topic, k) for topic in self._inputs]
        known = any(message is not None for message in said)
        if not all(heard):  # the run has ended before, as far as the replay knows
            self.undecided += [k] * known
            return
        found: list[tuple[float, Answer, Possibility]] = []
        for (memory, ticks), inputs in product(self._possible, product(*heard)):
            recall(self._stage, memory)
            answer = self._answer(k, inputs, ticks)
            found.append((distance(said, answer), answer, Possibility(remember(self._stage))))
        found.sort(key=lambda possible: possible[0])
        best = found[0][0]
        if best == 0.0:
            found = [possible for possible in found if possible[0] == 0.0]
        elif self._patience:
            self._patience -= 1
        else:
            found = found[:1]
        for i, topic in enumerate(self.outputs):
            self._computed[topic][k] = distinct(answer[i] for _, answer, _ in found[:MOST])
        following: list[Possibility] = []
        for _, _, possibility in found[:MOST]:
            if not any(alike(possibility.memory, other.memory) for other in following):
                following.append(possibility)
        if record.lockstep or known:
            self._possible, self._begun = following, True
        else:  # it has skipped this tick, or its answer is lost: of all that may be, the first and the last
            skipped = [p._replace(ticks=p.ticks + self._begun) for p in self._possible]
            self._possible = [*following[: MOST // 2], *skipped[-(MOST // 2) :]]
        if record.lockstep:
            return
        if known and best == 0.0:
            self._sure = True
        elif not known or any(record.at(topic, k) is None for topic in self._inputs):
            self._sure = False
        if known and best > 0.0 and not self._sure:
            self.undecided.append(k)

    def _answer(self, k: int, inputs: tuple[Message, ...], ticks: int) -> Answer:
        time_ns = k * self._record.scenario.dt_ns
        try:
            return self._call(self._stage, time_ns, inputs, ticks)
        except (ArithmeticError, ValueError):
            return self._failed(time_ns)


def ordered(stage: Any, memory: Any, number: int, action: str, t: float) -> Any:
    """Return what a stage remembers after a fault has been armed or cleared by hand at t, s."""
    recall(stage, memory)
    stage.order(number, action, t)
    return remember(stage)


def heard_at(record: Record, computed: Computed, topic: str, k: int) -> list[Message]:
    """Return what may have been received: what is recorded, then what the replay gives where that differs."""
    recorded, ours = record.at(topic, k), computed[topic][k]
    if recorded is None:
        return ours
    return [recorded] if recorded in ours else [recorded, *ours]


def distinct(messages: Iterable[Message]) -> list[Message]:
    """Return messages without repetition."""
    return list(dict.fromkeys(messages))


def answering_stages(record: Record, computed: Computed) -> list[AnsweringStage]:
    """Make the stages of a run that answer, in the order of a tick."""
    scenario = record.scenario
    n = scenario.robot.joints
    nan, zeros = (math.nan,) * n, (0.0,) * n
    motion = "true_state" if scenario.hidden else "joint_states"
    found = []

    def control_failed(time_ns: int) -> Answer:
        reference = scenario.reference.at(seconds(time_ns), n)
        return (nan,), (reference.position, reference.velocity)

    def add(name: str, stage: Any, inputs: tuple[str, ...], outputs: tuple[str, ...], call: Call,
            failed: Callable[[int], Answer]) -> None:  # fmt: skip
        stage = as_it_ran(record, name, stage)
        found.append(AnsweringStage(name, record, computed, stage, inputs, outputs, call, failed))

    add("observer", ObserverStage(scenario.observer, scenario.model, scenario.dt), ("joint_states",),
        ("disturbance_estimate",), _observe, lambda _: ((nan,),))  # fmt: skip
    add("controller", ControllerStage(scenario), ("joint_states", "disturbance_estimate"),
        ("joint_torques", "reference"), _control, control_failed)  # fmt: skip
    add("injector", InjectorStage(scenario), (motion, "joint_torques"), ("disturbance",), _inject,
        lambda _: ((nan,),))  # fmt: skip
    if scenario.detector:
        add("detector", DetectorStage(scenario), ("joint_states", "disturbance_estimate", "joint_torques"),
            ("detection",), _detect, lambda _: ((zeros, zeros, nan),))  # fmt: skip
    return found


def as_it_ran(record: Record, name: str, stage: Any) -> Any:
    """Return a stage as its node had it: plain, or compiled.

    Raises:
        FtcmError: it cannot be compiled here.
    """
    if name not in record.compiled:
        return stage
    return compiled_stage(stage, stage_program(name, record.scenario))


def changes_at(changes: tuple[Change, ...]) -> dict[int, list[Change]]:
    """Return the changes of each tick that has some."""
    found: dict[int, list[Change]] = {}
    for change in changes:
        found.setdefault(change.tick, []).append(change)
    return found


def _observe(stage: Any, time_ns: int, inputs: tuple[Message, ...], ticks: int) -> Answer:
    (y,) = inputs
    return ((stage.step(Measurement(*y), ticks),),)


def _control(stage: Any, time_ns: int, inputs: tuple[Message, ...], ticks: int) -> Answer:
    y, estimate = inputs
    u, reference = stage.step(time_ns, Measurement(*y), *estimate)
    return (u,), (reference.position, reference.velocity)


def _inject(stage: Any, time_ns: int, inputs: tuple[Message, ...], ticks: int) -> Answer:
    (q, v, *_), (u,) = inputs
    return (tuple(stage.step(time_ns, q, v, u, ticks)),)


def _detect(stage: Any, time_ns: int, inputs: tuple[Message, ...], ticks: int) -> Answer:
    y, (tau_hat,), (u,) = inputs
    found = stage.step(Measurement(*y), u, tau_hat, ticks)
    return ((found.alarm, found.verdict, found.residual),)
