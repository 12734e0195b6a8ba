# SPDX-License-Identifier: Apache-2.0
"""The stages that answer, replayed: observer, controller, injector and detector."""

from __future__ import annotations

import math
from collections.abc import Callable
from itertools import product
from typing import Any

from ftcm_core.compiled.stage import CompiledStage, compiled_stage, stage_program
from ftcm_core.recording.trace import Change
from ftcm_core.replay.record import ROUNDING, Message, Record, distance, plain_state, recall, remember
from ftcm_core.signals import Measurement, seconds
from ftcm_core.simulation.stages import ControllerStage, DetectorStage, InjectorStage, ObserverStage

Computed = dict[str, list[Message | None]]
"""What the replay gives, per data topic and tick."""
Answer = tuple[Message, ...]
Call = Callable[[Any, int, tuple[Message, ...], int], Answer]
"""A stage, time (ns), what it received, how many ticks after its last answer: what it sends."""


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
        self._gap = 0
        """Ticks since the last one that is known to have been answered."""
        self._before_gap: Any = None
        """The stage's memory then."""
        self._sure = True
        """Whether the stage's memory is known."""

    def change(self, component: Any) -> None:
        """Use another component from this tick on."""
        if isinstance(self._stage, CompiledStage):
            old = getattr(self._stage, self.name)
            self._stage.swap(component, stage_program(self.name, self._record.scenario, component))
        else:
            old = getattr(self._stage, self.name)
            self._stage.swap(component)
        if type(component) is not type(old):
            self._gap = 0  # it starts afresh

    def tick(self, k: int) -> None:
        """Answer one tick; the inputs of the tick have been computed."""
        record, computed = self._record, self._computed
        said = [record.at(topic, k) for topic in self.outputs]
        heard = [heard_at(record, computed, topic, k) for topic in self._inputs]
        if not all(heard):  # the run has ended before, as far as the replay knows
            self.undecided += [k] * any(message is not None for message in said)
            return
        answered = record.lockstep or any(message is not None for message in said)
        memory = remember(self._stage)
        tries = [(memory, 1)]
        if not answered:  # or its answer is lost: nobody knows
            if self._gap == 0:
                self._before_gap = plain_state(self._stage)
            self._gap += 1
            self._sure = False
        elif self._gap:
            tries.append((self._before_gap, self._gap + 1))
            self._gap = 0
        best: tuple[float, Answer, Any] | None = None
        for inputs, (begin, ticks) in product(product(*heard), tries):
            recall(self._stage, begin)
            answer = self._answer(k, inputs, ticks)
            apart = distance(said, answer)
            if best is None or apart < best[0]:
                best = apart, answer, remember(self._stage)
            if apart == 0.0:
                break
        assert best is not None
        apart, answer, memory = best
        recall(self._stage, memory)
        for topic, message in zip(self.outputs, answer):
            self._computed[topic][k] = message
        if not answered:
            return
        lost = not record.lockstep and any(record.at(topic, k) is None for topic in self._inputs)
        if apart <= ROUNDING:
            self._sure = True
        elif lost or not self._sure:
            self._sure = False
            self.undecided.append(k)

    def _answer(self, k: int, inputs: tuple[Message, ...], ticks: int) -> Answer:
        time_ns = k * self._record.scenario.dt_ns
        try:
            return self._call(self._stage, time_ns, inputs, ticks)
        except (ArithmeticError, ValueError):
            return self._failed(time_ns)


def heard_at(record: Record, computed: Computed, topic: str, k: int) -> list[Message]:
    """Return what may have been received: what is recorded, then what the replay gives where that differs."""
    theirs, ours = record.at(topic, k), computed[topic][k]
    found = [message for message in (theirs, ours) if message is not None]
    return found[:1] if len(found) == 2 and distance([theirs], [ours]) == 0.0 else found


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
            ("detection",), _detect, lambda _: ((zeros, nan),))  # fmt: skip
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
    return ((found.alarm, found.residual),)
