# SPDX-License-Identifier: Apache-2.0
"""Whose messages count, of a topic that has one publisher in the suite. No ROS."""

from __future__ import annotations

import time
from collections.abc import Callable

from ftcm_core.signals import NANOSECONDS

SILENCE_NS = NANOSECONDS
"""How long a publisher must have been silent before another one of the suite takes over, ns."""
_NOBODY = 1 << 62
"""A number that none follows."""


class PublisherIdentity:
    """Tells the messages of the first publisher from those of others, by the numbers that they carry.

    The middleware numbers the messages of each publisher: 1, 2, 3 and so on. So the next message of the first
    publisher has the next number. A message with another number counts in two cases:

    * The topic has one publisher. Then messages were lost, or the publisher began anew.
    * The first publisher has been silent for :data:`SILENCE_NS`, and all publishers have the name of a node
      of the suite. Then the node was killed and started again: for a while the middleware shows both.

    Any other message with another number is from another publisher, and is refused. When the numbers of
    another publisher have caught up with those of the first, the two cannot be told apart. Then nobody's
    messages count until one publisher is left.
    """

    def __init__(
        self,
        publishers: Callable[[], int],
        strangers: Callable[[], bool],
        clock: Callable[[], int] = time.monotonic_ns,
    ) -> None:
        """Heard nobody yet.

        Args:
            publishers: how many the topic has now.
            strangers: whether any of them has another name than the suite's.
            clock: steady clock, ns.
        """
        self._publishers = publishers
        self._strangers = strangers
        self._clock = clock
        self._last = -1
        self._others: set[int] = set()
        """Last number of each other publisher."""
        self._heard = 0
        self.refused = 0
        """Messages of others."""

    def admits(self, number: int | None) -> bool:
        """Whether a message counts, by the number it carries (None: the middleware gives none)."""
        now = self._clock()
        next_one = number == self._last + 1
        if not (next_one and not self._others):
            if (
                number is None
                or self._last < 0
                or self._publishers() < 2
                or (now - self._heard >= SILENCE_NS and not self._strangers())
            ):
                self._others.clear()
            elif not next_one or self._last in self._others:
                self._others.discard(number - 1)
                self._others.add(number)
                self.refused += 1
                if next_one:
                    self._last = _NOBODY
                return False
        self._last = -1 if number is None else number
        self._heard = now
        return True
