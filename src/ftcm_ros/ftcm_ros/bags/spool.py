# SPDX-License-Identifier: Apache-2.0
"""A list of records that is on disk, not in memory."""

from __future__ import annotations

import tempfile
from collections.abc import Iterator
from io import BytesIO
from pathlib import Path


class Spool:
    """Stands in for the list in which rosbags' mcap writer keeps an index record per chunk until the end.

    The recorder ends four chunks a second, whose records would make some MB an hour in memory.
    """

    def __init__(self, folder: Path) -> None:
        """Keep the records in a nameless file on a folder's file system.

        Raises:
            OSError: it cannot be made.
        """
        self._file = tempfile.TemporaryFile(dir=folder)  # noqa: SIM115 (open as long as the bag is)
        self._count = 0

    def append(self, record: BytesIO) -> None:
        """Add a record."""
        data = record.getvalue()
        self._file.write(len(data).to_bytes(4, "little") + data)
        self._count += 1

    def __len__(self) -> int:
        return self._count

    def __iter__(self) -> Iterator[BytesIO]:
        """Give the records back, positioned at their end as they were."""
        self._file.seek(0)
        for _ in range(self._count):
            record = BytesIO()
            record.write(self._file.read(int.from_bytes(self._file.read(4), "little")))
            yield record
