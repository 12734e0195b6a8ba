# SPDX-License-Identifier: Apache-2.0
"""Messages that come a second time, later: who reads the topic acts on them again."""

from __future__ import annotations

from typing import Any, ClassVar

from ftcm_core.faults import CommunicationFault, Moment
from ftcm_core.faults.past import Message, either, remembered
from ftcm_core.params import param
from ftcm_core.random_streams import happens
from ftcm_core.registry import register


@register("fault", "duplicated_messages")
class DuplicatedMessages(CommunicationFault):
    """Duplicates: received = the message of age ticks ago again with P = ψ probability, else the one sent.

    The copy comes after the message of its tick, and who reads the topic does not see that it is old. Before
    the first message there was what the first is.

    Source: Linux's NetEm, tc-netem(8).
    """

    rank: ClassVar[int] = 90

    probability: float = param(
        0.1, unit="-", at_least=0.0, at_most=1.0,
        doc="share of the ticks in which an old message comes again", source="chosen: as of dropped_messages",
    )  # fmt: skip
    age: int = param(
        5, unit="ticks", at_least=1, at_most=20, doc="how old the message is that comes again",
        source="chosen: 5 ms",
    )  # fmt: skip

    def receive(self, size: float, now: Moment, message: Message, memory: Any) -> tuple[Message, Any]:
        """The old message, or the one sent."""
        messages = remembered(message, memory, self.age)
        again = happens(size * self.probability, now.key, now.number)
        return either(again, messages[-1], message), messages[:-1]
