# SPDX-License-Identifier: Apache-2.0
"""Messages that come late by a time of their own; who reads them acts on the newest."""

from __future__ import annotations

from typing import Any, ClassVar

from ftcm_core.faults import CommunicationFault, Moment
from ftcm_core.faults.past import Message, at_most, either, on_the_way
from ftcm_core.params import param
from ftcm_core.registry import register


@register("fault", "jittered_messages")
class JitteredMessages(CommunicationFault):
    """Jitter: the message of tick j arrives in tick j + d_j; received = the newest that has arrived.

    d_j is drawn anew for each message from 0 to ψ longest whole ticks, all with the same probability. Who
    reads the topic looks at the time of a message, and ignores one that a newer one has overtaken.

    Source: Nilsson (1998), Real-time control systems with delays, Lund; Linux's NetEm, tc-netem(8).
    """

    rank: ClassVar[int] = 70

    longest: int = param(
        5, unit="ticks", at_least=0, at_most=20, doc="longest delay of a message", source="chosen: 5 ms"
    )

    def receive(self, size: float, now: Moment, message: Message, memory: Any) -> tuple[Message, Any]:
        """The newest that has arrived; after the longest delay each one has."""
        sent = on_the_way(size, now.key, now.number, message, memory, self.longest)
        received = sent[-1].message
        for age in reversed(range(self.longest)):
            received = either(at_most(sent[age].delay, float(age)), sent[age].message, received)
        return received, sent[:-1]

    def check(self) -> None:
        """No longer delay than what is remembered."""
        CommunicationFault.check(self)
        self.check_share()
