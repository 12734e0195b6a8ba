# SPDX-License-Identifier: Apache-2.0
"""Messages that get lost at random: who reads the topic goes on with the last one received."""

from __future__ import annotations

from ftcm_core.faults import CommunicationFault, Moment
from ftcm_core.numeric import select
from ftcm_core.params import param
from ftcm_core.random_streams import uniform
from ftcm_core.registry import register
from ftcm_core.signals import Vector


@register("fault", "dropped_messages")
class DroppedMessages(CommunicationFault):
    """Dropped messages: received = the last one received with P = ψ probability, else the one sent."""

    probability: float = param(
        0.1, unit="-", at_least=0.0, at_most=1.0, doc="share of the messages that get lost",
        source="chosen: a bad network",
    )  # fmt: skip

    def receive(
        self, size: float, now: Moment, message: tuple[Vector, ...], memory: tuple[Vector, ...]
    ) -> tuple[tuple[Vector, ...], tuple[Vector, ...]]:
        """The message sent, or the one held; the first never gets lost."""
        gone = lost(size * self.probability, now.key, now.number)
        received = tuple(
            [
                tuple([select(gone, old, new) for old, new in zip(held, sent)])
                for held, sent in zip(memory or message, message)
            ]
        )
        return received, received


def lost(probability: float, key: float, number: float) -> float:
    """1 if a message gets lost, else 0.

    Args:
        probability: of each message.
        key: stream of random numbers.
        number: which number of it.
    """
    return 1.0 if uniform(key, number) < probability else 0.0
