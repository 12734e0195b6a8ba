# SPDX-License-Identifier: Apache-2.0
"""The newest values of a run, for plots that move. No ROS."""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from ftcm_ros.run.view import Values

ROWS = 600
"""Rows that are kept: half a minute at 20 Hz."""
FIELDS = (*Values._fields, "alarm")
"""What is kept of each joint."""


class History:
    """Rows of values, the oldest first."""

    def __init__(self, joints: int) -> None:
        """Nothing yet.

        Args:
            joints: how many joints a row has.
        """
        self.joints = joints
        self._rows: deque[tuple[float, ...]] = deque(maxlen=ROWS)

    def add(self, time: float, values: Sequence[Values], alarms: Sequence[bool]) -> None:
        """Take in the values of a time.

        What is not newer than the newest is left out; what is older than the oldest begins anew.

        Args:
            time: of the run, s.
            values: of each joint.
            alarms: whether the detector alarms, of each joint.
        """
        if self._rows and time < self._rows[0][0]:
            self._rows.clear()
        if not self._rows or time > self._rows[-1][0]:
            row = [x for one, alarm in zip(values, alarms) for x in (*one, float(alarm))]
            self._rows.append((time, *row))

    def table(self) -> Table:
        """Return what is kept."""
        width = 1 + self.joints * len(FIELDS)
        return Table(np.array(self._rows, dtype=float).reshape(len(self._rows), width))


class Table:
    """What a history keeps, as columns."""

    def __init__(self, rows: npt.NDArray[np.float64]) -> None:
        """Take rows as of :class:`History`."""
        self._columns = np.ascontiguousarray(rows.T)

    @property
    def time(self) -> npt.NDArray[np.float64]:
        """Times, s."""
        return self._columns[0]

    def tells(self, field: str) -> bool:
        """Whether there is a value of one of :data:`FIELDS`, of any joint and time."""
        first = 1 + FIELDS.index(field)
        return bool(np.isfinite(self._columns[first :: len(FIELDS)]).any())

    def column(self, field: str, joint: int) -> npt.NDArray[np.float64]:
        """Values of one of :data:`FIELDS`.

        Args:
            field: which.
            joint: of which joint, from 0.
        """
        return self._columns[1 + joint * len(FIELDS) + FIELDS.index(field)]
