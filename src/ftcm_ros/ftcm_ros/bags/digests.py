# SPDX-License-Identifier: Apache-2.0
"""The digests of a sqlite3 file: CRC-32 of each batch of messages, in a table of its own.

A batch is what the recorder brings to the file at once, with its digest in the same transaction. Readers of
bags ask for the tables they know, and do not see this one.
"""

from __future__ import annotations

import sqlite3
import struct
import zlib
from collections.abc import Iterable, Iterator
from contextlib import closing
from pathlib import Path
from typing import Any

TABLE = "ftcm_digests"
Row = tuple[int, int, int, bytes]
"""A message: its number from 1, that of its topic, its time (ns) and what was serialized."""

_head = struct.Struct("<qqqI").pack


def add(crc: int, row: Row) -> int:
    """Return the CRC-32 of a batch so far with one more message.

    Raises:
        TypeError: the row has something else in it; so does struct.error say.
    """
    number, topic, when, data = row
    return zlib.crc32(data, zlib.crc32(_head(number, topic, when, len(data)), crc))


class DigestedStorage:
    """Stands between rosbags' writer and its sqlite3 storage, and digests the messages that pass."""

    def __init__(self, storage: Any) -> None:
        """Begin with a storage to which no message has been written."""
        self._storage = storage
        self._written = self._digested = self._crc = 0
        storage.conn.execute(f"CREATE TABLE {TABLE}(last_id INTEGER PRIMARY KEY, crc32 INTEGER NOT NULL)")

    def __getattr__(self, name: str) -> Any:
        return getattr(self._storage, name)

    def write(self, connection: Any, timestamp: int, data: bytes) -> None:
        """Write one message."""
        self._storage.write(connection, timestamp, data)
        self._written += 1
        self._crc = add(self._crc, (self._written, connection.id, timestamp, data))

    def end_batch(self) -> None:
        """Write the digest of what has been written since the last one."""
        if self._written > self._digested:
            self._storage.conn.execute(f"INSERT INTO {TABLE} VALUES(?, ?)", (self._written, self._crc))
            self._digested, self._crc = self._written, 0

    def close(self, version: int, metadata: str) -> None:
        """Write the last digest and close the file."""
        self.end_batch()
        self._storage.close(version, metadata)


def verify(file: Path) -> str:
    """Compare a closed sqlite3 file with its digests.

    Returns:
        ``whole``; ``unchecked``: it has none; or ``damaged``.

    Raises:
        OSError: it cannot be read.
    """
    with file.open("rb"):  # sqlite3 does not say why it cannot
        pass
    found = "unchecked"
    try:
        with closing(unchanging(file)) as database:
            if has_digests(database):
                found = "damaged"
                found = "damaged" if None in batches(database) else "whole"
    except sqlite3.Error:
        pass
    return found


def unchanging(file: Path) -> sqlite3.Connection:
    """Open a file that nobody writes, to read it.

    Raises:
        sqlite3.Error: that is not possible.
    """
    return sqlite3.connect(f"{file.resolve().as_uri()}?immutable=1", uri=True)


def has_digests(database: sqlite3.Connection) -> bool:
    """Whether a database has the table.

    Raises:
        sqlite3.Error: it cannot be read.
    """
    return bool(database.execute("SELECT 1 FROM sqlite_master WHERE name = ?", (TABLE,)).fetchone())


def batches(database: sqlite3.Connection) -> Iterator[list[Row] | None]:
    """Yield the messages of each batch, in their order; None for a batch that is not what was written.

    Raises:
        sqlite3.Error: the digests cannot be read.
    """
    begin = 0
    for end, expected in database.execute(f"SELECT last_id, crc32 FROM {TABLE} ORDER BY last_id").fetchall():
        rows = _rows(database, "id > ? AND id <= ?", begin, end)
        yield rows if rows and _crc(rows) == expected else None
        begin = end
    if _rows(database, "id > ?", begin) != []:  # messages of which no digest tells
        yield None


def _rows(database: sqlite3.Connection, which: str, *arguments: int) -> list[Row] | None:
    """Read messages; None where the file is not whole."""
    query = f"SELECT id, topic_id, timestamp, data FROM messages WHERE {which} ORDER BY id"
    try:
        return database.execute(query, arguments).fetchall()
    except sqlite3.Error:
        return None


def _crc(rows: Iterable[Row]) -> int | None:
    crc = 0
    try:
        for row in rows:
            crc = add(crc, row)
    except (TypeError, struct.error):
        return None
    return crc
