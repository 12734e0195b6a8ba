# SPDX-License-Identifier: Apache-2.0
"""Which tick a measurement of another clock is, whose stamps are no multiples of dt. No ROS, no clock."""

from __future__ import annotations

from ftcm_core.signals import NANOSECONDS

JUMP_NS = NANOSECONDS
"""Stamps that differ by more than this from one message to the next are of another run, or of a clock set."""


class FreeTicks:
    """Counts the measurements: each is a tick, and its number keeps to its stamp.

    The first measurement is tick 0. A later one is the next tick, as long as the time since the first one
    agrees with that to one dt: so stamps may jitter. Else it is the nearest tick: after lost measurements
    some are skipped; where measurements come too often, the number stays, and that is counted.
    """

    def __init__(self, dt_ns: int) -> None:
        """Nothing measured yet."""
        self._dt_ns = dt_ns
        self.first = 0
        """Stamp of the first one, ns."""
        self.tick = -1
        """The last one that was counted."""
        self.early = 0
        """Measurements that came before the next tick was due."""

    def next(self, stamp_ns: int) -> int:
        """Return the tick that a measurement is, if it is the next to be counted.

        Args:
            stamp_ns: its stamp, later than those before.
        """
        if self.tick < 0:
            return 0
        since, tick, dt = stamp_ns - self.first, self.tick + 1, self._dt_ns
        if abs(since - tick * dt) <= dt:
            return tick
        return max(self.tick, (since + dt // 2) // dt)

    def count(self, stamp_ns: int) -> int:
        """Count a measurement.

        Args:
            stamp_ns: its stamp, later than those before.

        Returns:
            By how many ticks observers and laws go on: at least one.
        """
        tick, before = self.next(stamp_ns), self.tick
        if before < 0:
            self.first = stamp_ns
        self.tick = tick
        self.early += tick == before
        return max(1, tick - before)
