# SPDX-License-Identifier: Apache-2.0
"""Messages that come late by a time of their own; who reads them acts on what comes, even if it is older."""

from __future__ import annotations

from typing import Any, ClassVar

from ftcm_core.faults import CommunicationFault, Moment
from ftcm_core.faults.past import Message, either, on_the_way, same
from ftcm_core.params import param
from ftcm_core.registry import register


@register("fault", "reordered_messages")
class ReorderedMessages(CommunicationFault):
    """Reordering: the message of tick j arrives in tick j + d_j; received = the one that arrived last.

    d_j is drawn anew for each message from 0 to ψ longest whole ticks, all with the same probability. Of
    several that arrive in one tick the newest is the last; where none does, the reader keeps what it has.

    Source: Hespanha, Naghshtabrizi and Xu (2007), A survey of recent results in networked control systems,
    Proc. IEEE 95(1); Linux's NetEm, tc-netem(8).
    """

    rank: ClassVar[int] = 80

    longest: int = param(
        5, unit="ticks", at_least=0, at_most=20, doc="longest delay of a message", source="chosen: 5 ms"
    )

    def receive(self, size: float, now: Moment, message: Message, memory: Any) -> tuple[Message, Any]:
        """What arrives in this tick, else the message acted on last."""
        received, before = memory or (message, ())
        sent = on_the_way(size, now.key, now.number, message, before, self.longest)
        for age in reversed(range(self.longest + 1)):
            received = either(same(sent[age].delay, float(age)), sent[age].message, received)
        return received, (received, sent[:-1])

    def check(self) -> None:
        """No longer delay than what is remembered."""
        CommunicationFault.check(self)
        self.check_share()
