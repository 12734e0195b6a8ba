# SPDX-License-Identifier: Apache-2.0
"""Which ticks of a long column are drawn: the smallest and the largest value of each short interval.

They are ticks as they were recorded, at their own times, so no peak is lost and none is made up.
"""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
import numpy.typing as npt

from ftcm_core.recording.trace import Array

Rows = npt.NDArray[np.int64]

BEFORE, AFTER = 50, 250
"""So many ticks before and after an event are kept one by one (chosen: what happens there is fast)."""


def intervals(ticks: int, count: int, events: Iterable[int] = ()) -> Rows:
    """Return the first row of each interval into which a run is divided.

    Args:
        ticks: length of the run.
        count: number of intervals of equal length; a run of at most twice as many ticks is kept whole.
        events: rows near which each tick is an interval of its own.
    """
    if ticks <= 2 * count:
        return np.arange(ticks)
    marks = [np.linspace(0, ticks, count + 1).astype(np.int64)[:-1]]
    marks += [np.arange(max(0, row - BEFORE), min(ticks, row + AFTER + 1)) for row in events]
    return np.unique(np.concatenate(marks))


def kept(values: Array, begins: Rows) -> Rows:
    """Return the rows that are drawn.

    Args:
        values: one per tick; what is not finite counts as absent.
        begins: first row of each interval, ascending from 0.

    Returns:
        In ascending order, of each interval the first row with its smallest and the first with its largest
        value; of one without values its first row.
    """
    if not len(values):
        return np.arange(0)
    finite = np.where(np.isfinite(values), values, np.nan)
    of = np.repeat(np.arange(len(begins)), np.diff(np.append(begins, len(values))))
    rows = [begins[np.isnan(np.fmin.reduceat(finite, begins))]]
    for extreme in (np.fmin, np.fmax):
        hits = np.flatnonzero(finite == extreme.reduceat(finite, begins)[of])
        rows.append(hits[np.unique(of[hits], return_index=True)[1]])
    return np.unique(np.concatenate(rows))
