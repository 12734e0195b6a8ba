# SPDX-License-Identifier: Apache-2.0
"""What the user is told on stderr while an experiment goes on: messages, and how far a run is."""

from __future__ import annotations

import os
import sys
import threading
from typing import Any

from tqdm import tqdm

TERMINAL_SECONDS, LINE_SECONDS = 0.5, 5.0
"""How often progress is shown, s: on a terminal in one line, which is rewritten; elsewhere in new lines."""
_DONE = "  {desc}: t = {now:.2f} of {end:g} s"

tqdm.set_lock(threading.RLock())  # its own is also for other processes, which do not write here


def say(text: str) -> None:
    """Tell the user something on stderr, above a line of progress if there is one."""
    tqdm.write(text, file=sys.stderr)


def _on_terminal() -> bool:
    """Whether stderr is a terminal of a known width."""
    try:
        return os.get_terminal_size(sys.stderr.fileno()).columns > 0
    except (OSError, ValueError):
        return False


class _Lines:
    """Stands in for a terminal: what would be written over the line before becomes a line of its own."""

    def write(self, text: str) -> None:
        if text.strip():
            say(text.strip("\r\n").rstrip())

    def flush(self) -> None:
        sys.stderr.flush()


class Progress(tqdm):  # type: ignore[type-arg]
    """Shows how far a run is, until it is closed."""

    monitor_interval = 0  # no thread: the run looks at it often enough

    def __init__(self, label: str, last_tick: int, dt: float) -> None:
        """Begin a run; nothing is shown yet."""
        self.dt = dt
        terminal = _on_terminal()
        every = TERMINAL_SECONDS if terminal else LINE_SECONDS
        super().__init__(
            desc=label, total=last_tick, unit=" ticks", file=None if terminal else _Lines(),
            mininterval=every, delay=every, miniters=0, dynamic_ncols=terminal, leave=False,
            bar_format=_DONE + " |{bar}| {rate_noinv_fmt}{postfix}, {remaining} left" if terminal
            else _DONE + ", {rate_noinv_fmt}{postfix}, {remaining} left",
        )  # fmt: skip

    @property
    def format_dict(self) -> Any:
        """What the line can show: also the time in the scenario, and its end."""
        found = super().format_dict
        return {**found, "now": found["n"] * self.dt, "end": found["total"] * self.dt}

    def show(self, tick: int, missed: int) -> None:
        """Say how far the run is; shown now and then."""
        if missed:
            self.set_postfix_str(f"{missed} deadlines missed", refresh=False)
        self.update(tick - self.n)

    def finish(self, tick: int, missed: int) -> None:
        """Show the end of the run, and leave that line where it is."""
        self.mininterval = float("inf")
        self.show(tick, missed)
        self.bar_format = _DONE + ", {rate_noinv_fmt}{postfix}, {elapsed_s:.1f} s"
        self.leave, self.delay = True, 0
        self.close()
