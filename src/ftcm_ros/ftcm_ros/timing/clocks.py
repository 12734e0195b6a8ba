# SPDX-License-Identifier: Apache-2.0
"""What happened to the machine's clocks: steps of the system time, suspension. Nothing is decided by them."""

from __future__ import annotations

import time
from collections.abc import Callable

from ftcm_core.signals import NANOSECONDS

STEP_NS = NANOSECONDS // 10
"""Smallest change of the system time against the steady one that counts as a step, ns."""

Times = tuple[int, int, int]


def read_clocks() -> Times:
    """Return system time, steady time, and steady time with suspension, ns."""
    return (
        time.time_ns(),
        time.clock_gettime_ns(time.CLOCK_MONOTONIC),
        time.clock_gettime_ns(time.CLOCK_BOOTTIME),
    )


class ClockWatch:
    """Counts what a steady clock does not show."""

    def __init__(self, read: Callable[[], Times] = read_clocks) -> None:
        """Begin to watch."""
        self._read = read
        system, steady, running = read()
        self._suspended = running - steady
        self._set = system - running
        self.steps = 0
        self.stepped_ns = 0

    def look(self) -> dict[str, float]:
        """Return how often and how far the system time was set, and how long the machine was suspended."""
        system, steady, running = self._read()
        change = system - running - self._set
        if abs(change) >= STEP_NS:
            self.steps += 1
            self.stepped_ns += change
            self._set += change
        return {
            "clock_steps": self.steps,
            "clock_stepped_seconds": round(self.stepped_ns / NANOSECONDS, 3),
            "suspended_seconds": round(max(0, running - steady - self._suspended) / NANOSECONDS, 3),
        }
