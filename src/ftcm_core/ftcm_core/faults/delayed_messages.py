# SPDX-License-Identifier: Apache-2.0
"""Messages that all come late by the same time."""

from __future__ import annotations

from typing import Any, ClassVar

from ftcm_core.faults import CommunicationFault, Moment
from ftcm_core.faults.past import Message, past, remembered, whole_ticks
from ftcm_core.params import param
from ftcm_core.registry import register


@register("fault", "delayed_messages")
class DelayedMessages(CommunicationFault):
    """Delayed messages: received = the one sent d ticks ago, d = ψ delay, rounded to whole ticks.

    Before the first message there was what the first is.

    Source: Nilsson (1998), Real-time control systems with delays, Lund.
    """

    rank: ClassVar[int] = 60

    delay: int = param(
        5, unit="ticks", at_least=0, at_most=100, doc="how late messages are", source="chosen: 5 ms"
    )

    def receive(self, size: float, now: Moment, message: Message, memory: Any) -> tuple[Message, Any]:
        """The message of some ticks ago."""
        messages = remembered(message, memory, self.delay)
        return past(messages, whole_ticks(size, float(self.delay))), messages[:-1]

    def check(self) -> None:
        """No longer delay than what is remembered."""
        CommunicationFault.check(self)
        self.check_share()
