# SPDX-License-Identifier: Apache-2.0
"""Messages that get lost at random: who reads the topic goes on with the last one received."""

from __future__ import annotations

from typing import NamedTuple

from ftcm_core.faults import CommunicationFault
from ftcm_core.numeric import select
from ftcm_core.params import param
from ftcm_core.random_streams import uniform
from ftcm_core.registry import register
from ftcm_core.signals import Vector


class LinkState(NamedTuple):
    """What the fault remembers."""

    key: float
    """Its stream of random numbers."""
    sent: float
    """Messages sent."""
    held: tuple[Vector, ...]
    """Arrays of the last message received; empty before the first, which never gets lost."""


@register("fault", "dropped_messages")
class DroppedMessages(CommunicationFault):
    """Dropped messages: received = the last one received with P = probability, else the one sent."""

    probability: float = param(
        0.1, unit="-", at_least=0.0, at_most=1.0, doc="share of the messages that get lost",
        source="chosen: a bad network",
    )  # fmt: skip

    def init(self, joints: int, key: float) -> LinkState:
        """Nothing sent."""
        return LinkState(key, 0.0, ())

    def step(
        self, t: float, dt: float, message: tuple[Vector, ...], state: LinkState
    ) -> tuple[tuple[Vector, ...], LinkState]:
        """The message sent, or the one held."""
        gone = lost(t, self.start, self.probability, state.key, state.sent)
        received = tuple(
            [
                tuple([select(gone, old, new) for old, new in zip(held, sent)])
                for held, sent in zip(state.held or message, message)
            ]
        )
        return received, LinkState(state.key, state.sent + 1.0, received)


def lost(t: float, start: float, probability: float, key: float, counter: float) -> float:
    """1 if a message gets lost, else 0.

    Args:
        t: time, s.
        start: before this none does, s.
        probability: of each message.
        key: stream of random numbers.
        counter: which number of it.
    """
    return 1.0 if t > start and uniform(key, counter) < probability else 0.0
