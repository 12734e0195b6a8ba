# SPDX-License-Identifier: Apache-2.0
"""What is known of a run that is to be replayed."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import numpy as np

from ftcm_core.compiled.stage import CompiledStage
from ftcm_core.recording.trace import Change
from ftcm_core.scenario import Scenario
from ftcm_core.signals import CHANNELS, Channel, Vector

Message = tuple[Vector, ...]
"""What a message says: its filled arrays, in the order position, velocity, effort."""
Said = Mapping[str, Sequence[Message | None]]
"""Per data topic, what was said at each tick; None where nothing was, or it is lost."""

ROUNDING = 1e-6
"""Relative difference up to which a value may be the same but for rounding (chosen: single operations differ
by 1e-16, which a law near its singularity makes 1e-8; other parameters make more)."""
PATIENCE = 20
"""In how many ticks a stage may give something else than what is recorded, before it is taken to be another
one (chosen). Until then all is followed up that may explain it, then only what comes nearest."""


@dataclasses.dataclass(frozen=True)
class Record:
    """A recorded run."""

    scenario: Scenario
    """With the components in force at the first tick."""
    said: Said
    """Lists of one length: the ticks from 0 on."""
    changes: tuple[Change, ...] = ()
    lockstep: bool = True
    """Whether every tick waited for its inputs; else stages may have skipped ticks, the plant held inputs."""
    status: str = "completed"
    """As of :class:`~ftcm_core.recording.trace.Trace`."""
    compiled: frozenset[str] = frozenset()
    """Stages that ran compiled."""

    @property
    def ticks(self) -> int:
        """How many ticks there are."""
        return len(self.said["joint_states"])

    def at(self, topic: str, tick: int) -> Message | None:
        """Return what was said on a topic at a tick, None if nothing is known."""
        said = self.said.get(topic)
        return said[tick] if said else None


def channels_of(scenario: Scenario) -> dict[str, Channel]:
    """Return the data topics of a run by name; ``true_state`` besides, which tells of held inputs."""
    told = next(c for c in CHANNELS if c.topic == "true_state")
    return {told.topic: told, **{c.topic: c for c in scenario.channels}}


def distance(recorded: Iterable[Message | None], computed: Iterable[Message | None]) -> float:
    """Return the largest relative difference of two sets of messages; what was not recorded does not count.

    Args:
        recorded: messages, None for one that was not recorded.
        computed: as many; None for one that does not come about, which is infinitely far.
    """
    largest = 0.0
    for theirs, ours in zip(recorded, computed):
        if theirs is None or theirs == ours:
            continue
        if ours is None:
            return float("inf")
        for a, b in zip((x for v in theirs for x in v), (x for v in ours for x in v)):
            if a != b and (a == a or b == b):  # not both nan
                apart = abs(a - b) / (1.0 + abs(a))
                largest = max(largest, apart if apart == apart else float("inf"))
    return largest


def remember(stage: Any) -> Any:
    """Return what :func:`recall` takes back: all that a stage remembers."""
    return stage.remember() if isinstance(stage, CompiledStage) else stage.state


def recall(stage: Any, memory: Any) -> None:
    """Let a stage go on from what it remembered."""
    if isinstance(stage, CompiledStage):
        stage.recall(memory)
    else:
        stage.state = memory


def alike(memory: Any, other: Any) -> bool:
    """Whether a stage with one memory is a stage with the other; not said of compiled and plain memories."""
    if isinstance(memory, np.ndarray) or isinstance(other, np.ndarray):
        return type(memory) is type(other) and np.array_equal(memory, other)
    return bool(memory == other)


def plain_state(stage: Any) -> Any:
    """Return the state of a stage as the plain stage has it."""
    if isinstance(stage, CompiledStage):
        stage.give_back()
        return stage.stage.state
    return stage.state
