# SPDX-License-Identifier: Apache-2.0
"""The watchdog of a run: finds the node that has stopped working from what the nodes report. No ROS."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence

from ftcm_ros.parameters.node_parameters import NODES

CHAIN = ("observer", "controller", "injector", "detector")
"""The nodes that answer, in the order of the tick."""
REPORT_SECONDS = 1.5
"""How much longer to wait before a node is blamed for ticks that have ceased, s.

Each node reports once a second. So after this time every node that has stalled has reported that it has.
"""
HELD_UP_SECONDS = 1.0
"""When :meth:`Watchdog.culprit` has not been called for so long, this process itself was held up, s.

Such a time does not count as silence of a node.
"""


class Watchdog:
    """Names the node to blame when one falls silent or the ticks cease."""

    def __init__(
        self,
        lockstep: bool,
        patience: float,
        clock: Callable[[], float] = time.monotonic,
        nodes: Sequence[str] = NODES,
    ) -> None:
        """Begin now.

        Args:
            lockstep: whether the plant waits for the others, or they work on its thread.
            patience: how long a node may be silent, or make no tick, s.
            clock: steady time, s.
            nodes: the nodes of the run.
        """
        self._nodes = tuple(nodes)
        self.lockstep = lockstep
        self.patience = patience
        self._clock = clock
        now = self._looked = clock()
        self._heard = dict.fromkeys(self._nodes, now)
        self._moved = dict.fromkeys(self._nodes, now)
        """When each node's count of ticks last changed."""
        self._ticks = dict.fromkeys(self._nodes, -1)

    def hear(self, node: str, ticks: int, paused: bool = False) -> None:
        """Take in that a node has done so many ticks; of a run that is paused, none are expected."""
        self._heard[node] = self._clock()
        if paused:
            self._moved = dict.fromkeys(self._moved, self._heard[node])
        if ticks != self._ticks[node]:
            self._ticks[node], self._moved[node] = ticks, self._heard[node]

    def culprit(self, is_stopped: Callable[[str], bool] = lambda node: False) -> tuple[str, str]:
        """Return the node to blame and what it has failed to do; both empty while all is well.

        Args:
            is_stopped: whether a node's process is stopped. It is blamed before one that waits for it.
        """
        now = self._clock()
        away, self._looked = now - self._looked, now
        if away > HELD_UP_SECONDS:
            for times in (self._heard, self._moved):
                for node in times:
                    times[node] += away
        silent = min(self._heard, key=self._heard.__getitem__)
        if now - self._heard[silent] > self.patience:
            silent = next((n for n in self._nodes if is_stopped(n)), silent)
            return silent, f"has said nothing for {self.patience:g} s"
        stalled = [n for n in self._nodes if now - self._moved[n] > self.patience]
        if stalled and now - min(self._moved.values()) > self.patience + REPORT_SECONDS:
            return self._blame(stalled), f"has made no tick for {self.patience:g} s"
        return "", ""

    def _blame(self, stalled: list[str]) -> str:
        """Return the stalled node that the other stalled nodes wait for."""
        if "plant" not in stalled:
            answering = [n for n in CHAIN if n in stalled] or ["recorder"]
            # In lockstep the plant has stalled too, but its last report is younger.
            return min(answering, key=self._ticks.__getitem__) if self.lockstep else answering[0]
        if not self.lockstep:  # the plant waits for nobody
            return "plant"
        done = self._ticks["plant"]
        waited_for = [n for n in CHAIN if n in self._ticks and self._ticks[n] <= done]
        if not waited_for and self._ticks["recorder"] < done:
            return "recorder"
        # The one furthest behind: another may wait for it, or its last report is a tick old.
        return min(waited_for, key=self._ticks.__getitem__) if waited_for else "plant"
