# SPDX-License-Identifier: Apache-2.0
"""The faults that act at one place of the tick, in the order in which they act."""

from __future__ import annotations

from typing import Generic, NamedTuple, TypeVar

from ftcm_core.faults import Fault, FaultState
from ftcm_core.faults.timing import NEVER
from ftcm_core.random_streams import stream_key
from ftcm_core.scenario import Scenario

F = TypeVar("F", bound=Fault)
States = tuple[FaultState, ...]


class Phase(NamedTuple):
    """From when to when a fault acts: at onset < t <= end, s."""

    onset: float
    """:data:`~ftcm_core.faults.timing.NEVER` while it waits for its trigger."""
    end: float


class FaultChain(Generic[F]):
    """The scenario's faults of one kind, sorted by rank: their order in the scenario does not matter.

    A fault has a stream of random numbers: that of the n-th of its type in this order, so a fault of another
    type shifts none.
    """

    def __init__(self, scenario: Scenario, kind: type[F], topic: str = "") -> None:
        """Take a scenario's faults.

        Args:
            scenario: the run.
            kind: base class of the faults wanted.
            topic: of communication faults, the topic wanted.
        """
        every = sorted(enumerate(scenario.faults), key=lambda x: (x[1].rank, str(x[1].to_mapping()), x[0]))
        count: dict[str, int] = {}
        found: list[tuple[int, F, float]] = []
        for number, fault in every:
            n = count[fault.type_name] = count.get(fault.type_name, -1) + 1
            if isinstance(fault, kind) and topic in ("", getattr(fault, "topic", "")):
                found.append((number, fault, stream_key(scenario.seed, f"fault.{fault.type_name}.{n}")))
        self.numbers = tuple([number for number, _, _ in found])
        """Where each stands in the scenario's list."""
        self.faults: tuple[F, ...] = tuple([fault for _, fault, _ in found])
        self._keys = tuple([key for _, _, key in found])

    def init(self, joints: int) -> States:
        """Return the states before the first tick."""
        return tuple([fault.init(joints, key) for fault, key in zip(self.faults, self._keys)])

    def phases(self, states: States) -> dict[int, Phase]:
        """Return from when to when each fault acts, as known so far, by its place in the scenario's list."""
        found = {}
        for number, fault, state in zip(self.numbers, self.faults, states):
            lasts = fault.duration if fault.lifetime == "timed" else NEVER
            found[number] = Phase(state.onset, min(NEVER, state.end, state.onset + lasts))
        return found

    def ordered(self, states: States, number: int, action: str, t: float) -> States:
        """Return the states after an order by hand; the same if the fault is none of these.

        Args:
            states: of all faults.
            number: the fault's place in the scenario's list.
            action: ``arm``: it acts after t; ``clear``: it ends at t.
            t: time, s.
        """
        changed = list(states)
        for i, (mine, state) in enumerate(zip(self.numbers, states)):
            if mine == number and action == "arm":
                changed[i] = state._replace(onset=t, end=NEVER)
            elif mine == number:
                changed[i] = state._replace(end=min(state.end, t))
        return tuple(changed)
