# SPDX-License-Identifier: Apache-2.0
"""Messages that get lost at random: who reads the topic goes on with the last one received."""

from __future__ import annotations

from ftcm_core.faults import CommunicationFault, Moment
from ftcm_core.faults.past import Message, either
from ftcm_core.params import param
from ftcm_core.random_streams import happens
from ftcm_core.registry import register


@register("fault", "dropped_messages")
class DroppedMessages(CommunicationFault):
    """Dropped messages: received = the last one received with P = ψ probability, else the one sent.

    Source: Sinopoli et al. (2004), Kalman filtering with intermittent observations, IEEE TAC 49(9).
    """

    probability: float = param(
        0.1, unit="-", at_least=0.0, at_most=1.0, doc="share of the messages that get lost",
        source="chosen: a bad network",
    )  # fmt: skip

    def receive(self, size: float, now: Moment, message: Message, memory: Message) -> tuple[Message, Message]:
        """The message sent, or the one held; the first never gets lost."""
        gone = happens(size * self.probability, now.key, now.number)
        received = either(gone, memory or message, message)
        return received, received
