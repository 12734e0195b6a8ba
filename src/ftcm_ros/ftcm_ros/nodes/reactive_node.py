# SPDX-License-Identifier: Apache-2.0
"""A node that answers: the observer, the controller, the injector and the detector."""

from __future__ import annotations

import sys
import time
from abc import abstractmethod
from collections.abc import Callable
from itertools import chain
from math import isfinite
from typing import Any

from ftcm_ros.nodes.suite_node import POLL_NS, SuiteNode
from ftcm_ros.timing.durations import Durations
from ftcm_ros.timing.free_ticks import JUMP_NS, FreeTicks
from ftcm_ros.transport.aligner import Aligner
from ftcm_ros.transport.codec import JointSample
from ftcm_ros.transport.composed import Composition
from ftcm_ros.transport.topics import DEPTH, Topic

Answer = list[tuple[Callable[[Any], None], Any]]
"""What a node sends in a tick: how, and the message."""


def execution_level(times: dict[str, float]) -> str:
    """Level of a mean execution time: warn above 1 ms, error above 2 ms (as ros2_control has it)."""
    mean = times.get("execution_mean_us", 0.0)
    return "error" if mean > 2000 else "warn" if mean > 1000 else "ok"


class ReactiveNode(SuiteNode):
    """A stage that answers: when a tick's inputs are all here, it computes and publishes."""

    def __init__(self, name: str, composition: Composition | None = None) -> None:
        """Declare the common parameters; a subclass then calls :meth:`listen`."""
        super().__init__(name, composition)
        self.times = Durations()
        self.free: FreeTicks | None = None
        """What counts the ticks where stamps are not theirs."""
        self.begun_anew = 0
        """How often such stamps have jumped, so that the node began afresh."""
        self.run_ns = 0
        """Time of the tick under way in the run, ns; its stamp, where stamps are those of the run."""
        self.gaps = 0
        """Ticks skipped between two that were answered."""
        self.elapsed = 1
        """How many ticks after the last one that was answered this one is."""
        self.age_ns = 0
        """How long the oldest input of the last tick had waited, ns."""
        self._arrived = 0
        self._ahead_ns = 0
        """How long the tick under way was prepared."""
        self._incomplete = False
        """Whether the last input of a tick has come but not all others: wait for those too."""
        self._answer: Answer = []

    def count_ticks(self) -> None:
        """Take measurements of any stamps, where the parameter ``stamps`` says so, and count the ticks."""
        if self.setting("stamps") == "free":
            self._dt_ns, self._end_ns = 1, sys.maxsize  # every stamp will do
            self.free = FreeTicks(self.scenario.dt_ns)

    def listen(self, needs: dict[Topic, tuple[str, ...]]) -> None:
        """Say which topics carry a value per tick.

        Args:
            needs: per topic, which arrays must be filled; in the order in which a tick's messages come.
        """
        self._inputs = {t.name: t for t in needs}
        self._first = next(iter(self._inputs))
        self.aligner = Aligner(tuple(self._inputs), pending_limit=DEPTH)
        for topic, arrays in needs.items():
            self.subscribe(topic, arrays, self._taker(topic))

    def _taker(self, topic: Topic) -> Callable[[JointSample], None]:
        name = topic.name
        if name != self._first:
            return lambda sample: self.take(name, sample)

        def take_first(sample: JointSample) -> None:
            if all(map(isfinite, chain(*sample[1:]))):
                self.take(name, sample)
            else:
                self.refuse(topic, "not_finite", f"{sample[1:]} is not finite")

        return take_first

    def step(self) -> None:
        """Wait for the last input of a tick, and take the others with it."""
        self.plane.poll(POLL_NS, None if self._incomplete else self._inputs[self.aligner.required[-1]])

    def take(self, name: str, sample: JointSample) -> None:
        """Take one input; answer if its tick is complete."""
        time_ns, aligner = sample.time_ns, self.aligner
        begin = time.monotonic_ns()
        if name == self._first and aligner.last is not None:
            if time_ns == aligner.last:  # the plant asks again
                for send, message in self._answer:
                    send(message)
                return
            if self.free is not None:
                if abs(time_ns - aligner.last) > JUMP_NS:
                    self.begun_anew += 1
                    self.configure()
            elif time_ns == 0:  # the plant begins a run
                self.configure()
        before = aligner.last
        values = aligner.put(name, time_ns, sample)
        if values is None:
            self._arrived = begin
            if name == self._first and aligner.pending == 1:  # else others come before it
                self.prepare(time_ns, sample)
                self._ahead_ns = time.monotonic_ns() - begin
            self._incomplete = name == aligner.required[-1]
            return
        self._incomplete = False
        if self.free is None:
            self.elapsed = 1 if before is None else (time_ns - before) // self.scenario.dt_ns
            self.run_ns = time_ns
        else:
            self.elapsed = self.free.count(time_ns)
            self.run_ns = self.free.tick * self.scenario.dt_ns
        self.gaps += self.elapsed - 1
        self._answer = self.answer(time_ns, values)
        for send, message in self._answer:
            send(message)
        self.ticks += 1
        end = time.monotonic_ns()
        self.age_ns = begin - self._arrived if len(aligner.required) > 1 else 0
        self.times.add(end - begin + self._ahead_ns)
        self._ahead_ns = 0

    def prepare(self, time_ns: int, sample: JointSample) -> None:
        """Do what can be done when only the first input of a tick is here."""

    @abstractmethod
    def answer(self, time_ns: int, values: dict[str, JointSample]) -> Answer:
        """Compute one tick, whose time in the run is :attr:`run_ns`: return what to send, with this stamp."""

    def next_tick(self) -> int:
        """Number of the tick that is answered next."""
        if self.free is not None:
            return self.free.tick + 1
        return 0 if self.aligner.last is None else self.aligner.last // self.scenario.dt_ns + 1

    def run_time(self, stamp_ns: int) -> int:
        """Return the time of the run at which a stamp is, ns."""
        return stamp_ns if self.free is None else stamp_ns - self.free.first

    def configure(self) -> None:
        """Begin afresh with the next tick."""
        self.aligner.reset()
        if self.free is not None:
            self.free = FreeTicks(self.scenario.dt_ns)
        self.times = Durations()
        self._answer = []

    def health(self) -> tuple[str, str, dict[str, Any]]:
        """Execution times, gaps and age of inputs."""
        times = self.statistics("execution", self.times)
        level = execution_level(times)
        message = "active" if self.active else "inactive"
        if self.gaps:
            level, message = "warn", f"{self.gaps} ticks skipped"
        counted: dict[str, Any] = {}
        if self.free is not None:
            counted = {"early": self.free.early, "begun_anew": self.begun_anew}
            if self.free.early > 0.01 * self.ticks:
                level, message = "warn", f"{message}; measurements come more often than every dt"
        return level, message, {
            **times,
            **counted,
            "gaps": self.gaps,
            "stale": self.aligner.stale,
            "repeated": self.aligner.repeated,
            "dropped": self.aligner.dropped,
            "input_age_us": round(self.age_ns / 1000, 1),
        }  # fmt: skip
