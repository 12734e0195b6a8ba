# SPDX-License-Identifier: Apache-2.0
"""Whose messages of a topic count, where one publisher is expected. No ROS."""

from __future__ import annotations

import time
from collections.abc import Callable

from ftcm_core.signals import NANOSECONDS

SILENCE_NS = NANOSECONDS
"""How long a node must have been silent before another one of its name takes over, ns."""
_NOBODY = 1 << 62
"""A number that none follows."""


class Source:
    """Keeps to the publisher that came first, told from others by its running numbers.

    A publisher numbers its messages without gaps. A message out of that order is taken where there is no
    other publisher: messages were lost, or the publisher began anew. It is taken too when the one kept to has
    fallen silent and all publishers have the name of the suite's: a killed node that was started again, which
    the middleware shows beside its predecessor for a while.

    Once another publisher has caught up with the numbers of the one kept to, nobody can tell them apart: then
    none is heard until one is left.
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
        """Whether a message counts; ``number`` is its publisher's (None: the middleware tells none)."""
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
