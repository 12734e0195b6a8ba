# SPDX-License-Identifier: Apache-2.0
"""Which inputs of a tick are here: pairs messages by stamp. No ROS, no clock."""

from __future__ import annotations

from typing import Any


class Aligner:
    """Collect the inputs of a tick until all required ones have come.

    Ticks complete in order of stamp; what comes for a tick no newer than the last complete one is
    not used any more.
    """

    def __init__(self, required: tuple[str, ...], pending_limit: int) -> None:
        """Expect one value per required input and tick; keep at most so many unfinished ticks."""
        self.required = required
        self.pending_limit = pending_limit
        self.stale = 0
        """Required inputs that came for a tick already past."""
        self.repeated = 0
        """Inputs that came again for a tick not complete yet: the first counts."""
        self.dropped = 0
        """Ticks given up unfinished, because a later one completed or too many were pending."""
        self.reset()

    def reset(self) -> None:
        """Forget every tick: a new run begins."""
        self.last: int | None = None
        """Stamp of the last complete tick, ns."""
        self._pending: dict[int, dict[str, Any]] = {}

    @property
    def pending(self) -> int:
        """How many unfinished ticks are here."""
        return len(self._pending)

    def put(self, name: str, time_ns: int, value: Any) -> dict[str, Any] | None:
        """Add one input.

        Args:
            name: which input.
            time_ns: stamp of its tick, ns.
            value: the signal.

        Returns:
            The tick's inputs by name once all required ones are here, else None.
        """
        if self.last is not None and time_ns <= self.last:
            self.stale += name in self.required
            return None
        values = self._pending.setdefault(time_ns, {})
        if name in values:
            self.repeated += 1
            return None
        values[name] = value
        for needed in self.required:
            if needed not in values:
                if len(self._pending) > self.pending_limit:
                    del self._pending[next(iter(self._pending))]
                    self.dropped += 1
                return None
        if len(self._pending) > 1:
            for older in [t for t in self._pending if t < time_ns]:
                del self._pending[older]
                self.dropped += 1
        del self._pending[time_ns]
        self.last = time_ns
        return values
