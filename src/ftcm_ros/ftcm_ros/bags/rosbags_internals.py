# SPDX-License-Identifier: Apache-2.0
"""What the suite uses of rosbags beyond its documented interface, all in this file.

rosbags promises none of this. Tests notice when a new version changes it; until then its version is held in
``setup.py``. Relied on are:

* ``Writer.storage``: the storage that an open writer writes to.
* of mcap's storage, ``chunk.bio`` (the chunk being filled, in memory), ``close_chunk()`` (writes it to the
  file), ``bio`` (the file, to which a record is written as opcode, length and content), and ``chunks``: the
  list of index records, one per chunk. rosbags only appends to it, asks for its length and goes through it.
* of sqlite3's storage, ``conn``: the connection to the database, with a transaction under way; that ``write``
  gives the messages numbers from 1, and ``close`` commits. The writer asks of it what ``StorageWriter`` says.
* ``parse_qos``: qualities of service from the text in a bag.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any, cast

from rosbags.rosbag2 import Writer
from rosbags.rosbag2.metadata import parse_qos

from ftcm_ros.bags.checksums import ChecksummedFile
from ftcm_ros.bags.digests import DigestedStorage
from ftcm_ros.bags.spool import Spool

__all__ = [
    "add_checksums",
    "do_not_wait_for_the_disk",
    "flush",
    "keep_index_on_disk",
    "parse_qos",
]


def flush(writer: Writer) -> None:
    """Bring to the file what has been written to a bag.

    Raises:
        OSError: it cannot be written.
        sqlite3.Error: it cannot be written.
    """
    storage: Any = writer.storage
    if hasattr(storage, "close_chunk"):
        if storage.chunk.bio.tell():
            storage.close_chunk()
        storage.bio.flush()
    elif isinstance(storage, DigestedStorage):
        storage.end_batch()
        storage.conn.commit()


def add_checksums(writer: Writer) -> None:
    """Have a file tell whether it is whole: mcap its chunks, data and summary, sqlite3 its batches.

    Args:
        writer: of any storage, with nothing written to it yet.
    """
    storage: Any = writer.storage
    if hasattr(storage, "close_chunk"):
        storage.bio.flush()
        storage.bio = ChecksummedFile(storage.bio, Path(storage.path).read_bytes())
    elif hasattr(storage, "conn"):
        writer.storage = cast(Any, DigestedStorage(storage))


def keep_index_on_disk(writer: Writer, folder: Path) -> None:
    """Keep the index records of an mcap file on disk until the bag is closed, instead of in memory.

    Args:
        writer: of any storage.
        folder: where there is room for them.

    Raises:
        OSError: there is none.
    """
    storage: Any = writer.storage
    if hasattr(storage, "chunks"):
        storage.chunks = Spool(folder)


def do_not_wait_for_the_disk(writer: Writer) -> None:
    """Let a sqlite3 commit end when its data is in the file, for whoever reads it, if not on the disk.

    To wait for the disk can take longer than a recorder may be behind.
    """
    storage: Any = writer.storage
    if hasattr(storage, "conn"):
        storage.conn.execute("PRAGMA synchronous=OFF")
