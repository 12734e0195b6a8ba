# SPDX-License-Identifier: Apache-2.0
"""When the plant goes on to the next tick: the one place that knows lockstep from real time.

A pacer is given the time and a way to wait, so that it is tested with a fake clock.
"""

from __future__ import annotations

import math
import time
from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass, field, fields
from typing import ClassVar

from ftcm_core.errors import FtcmError
from ftcm_core.signals import NANOSECONDS

LEAD_NS = 60_000
"""How long before a deadline the plant is awake; the waking of a thread takes about as long."""

Ready = Callable[[], bool]
Poll = Callable[[int], None]
"""Wait for messages for at most so many ns and take them in."""


@dataclass
class Misses:
    """Deadlines missed, per cause."""

    late_torque: int = 0
    """Ticks whose torque had not come at the deadline: the newest one was held."""
    late_disturbance: int = 0
    """Ticks whose torque had come but whose disturbance had not: the newest one was held."""
    plant_overrun: int = 0
    """Ticks skipped because the plant itself came more than a tick late (load, suspension)."""

    @property
    def total(self) -> int:
        """All misses."""
        return self.late_torque + self.late_disturbance + self.plant_overrun


CAUSES = tuple(f.name for f in fields(Misses))
"""Names of the causes, as in the diagnostics."""


@dataclass
class Pacer(ABC):
    """Decides when tick k ends."""

    dt_ns: int
    clock: Callable[[], int] = time.monotonic_ns
    """Steady clock, ns."""
    misses: Misses = field(default_factory=Misses)
    waits: ClassVar[bool] = False
    """Whether a tick waits for its messages, however late they are, and for the recorder."""

    @abstractmethod
    def begin(self) -> None:
        """Tick 0 begins now."""

    @abstractmethod
    def wait(self, ready: Ready, poll: Poll) -> bool:
        """Wait for the end of the tick.

        Args:
            ready: whether torque and disturbance of this tick have come.
            poll: takes messages in.

        Returns:
            Whether the tick has ended; False asks to be called again, so that the caller can
            look at other things now and then.
        """

    def late_by(self, now: int) -> int | None:
        """How late a tick begins that begins now (steady clock, ns), ns; None without a clock to keep."""
        del now
        return None


class Lockstep(Pacer):
    """A tick ends when its torque and disturbance are here, however long that takes."""

    waits: ClassVar[bool] = True
    patience_ns: int = NANOSECONDS // 50

    def begin(self) -> None:
        """Nothing to remember: only messages drive the ticks."""

    def wait(self, ready: Ready, poll: Poll) -> bool:
        """Wait for the inputs of this tick."""
        give_up = self.clock() + self.patience_ns
        while not ready():
            if self.clock() >= give_up:
                return False
            poll(self.patience_ns)
        return True


class RealTime(Pacer):
    """A tick ends at its deadline on the steady clock: t_0 + (k + 1) dt, absolute, without drift.

    A plant that comes more than a tick late (an overloaded or suspended machine) skips the ticks it
    missed instead of catching up in a burst.
    """

    deadline: int = 0
    max_late: int = 0
    """Largest lateness of a tick end since it was last cleared, ns."""

    def begin(self) -> None:
        """The first deadline is one tick from now."""
        self.deadline = self.clock() + self.dt_ns

    def late_by(self, now: int) -> int:
        """A tick begins at the deadline of the one before."""
        return now - self.deadline + self.dt_ns

    def wait(self, ready: Ready, poll: Poll) -> bool:
        """Take messages in until the deadline; with nothing to come any more, look at the clock at last."""
        while (left := self.deadline - self.clock()) > 0:
            if left > LEAD_NS:
                poll(left - LEAD_NS)
            elif not ready():
                poll(left)
        late = -left
        self.max_late = max(self.max_late, late)
        skipped = late // self.dt_ns
        self.misses.plant_overrun += skipped
        self.deadline += (1 + skipped) * self.dt_ns
        return True


def check_speed(speed: float, mode: str) -> None:
    """Check how many seconds of the run shall pass in one.

    Raises:
        FtcmError: none can, or there is no clock to keep.
    """
    if not 0.0 < speed < math.inf:
        raise FtcmError(f"speed: {speed:g} is out of range; expected a factor above 0")
    if speed != 1.0 and mode != "real_time":
        raise FtcmError(f"speed: {speed:g} is not possible with mode: {mode}, which keeps no clock")


PACERS: dict[str, type[Pacer]] = {"lockstep": Lockstep, "real_time": RealTime}
