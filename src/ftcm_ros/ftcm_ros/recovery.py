# SPDX-License-Identifier: Apache-2.0
"""What can be read of a bag that was not closed: its recorder was killed, or its disk was full."""

from __future__ import annotations

import shutil
import sqlite3
import struct
from collections.abc import Iterator
from contextlib import closing
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from rosbags.rosbag2.storage_mcap import McapReader
from rosbags.rosbag2.storage_sqlite3 import Sqlite3Reader
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from ftcm_core.errors import FtcmError
from ftcm_ros.recording import new_bag, reason_of

Message = tuple[Any, int, bytes]
"""Connection of rosbags, time (ns) and serialized message."""

_STORAGE = {".mcap": "mcap", ".db3": "sqlite3"}
_MCAP_MAGIC = b"\x89MCAP0\r\n"
_MCAP_WITH_MESSAGES = (0x03, 0x04, 0x05, 0x06)  # schema, channel, message, chunk
_MCAP_END = (0x00, 0x0F)  # no record at all, end of the data


def scan(path: Path) -> Iterator[Message]:
    """Yield every whole message of a bag's files, from the first on; neither index nor metadata are needed.

    The bag's folder is not modified.

    Args:
        path: folder of the bag, or one of its files.

    Raises:
        OSError: a file cannot be opened.
    """
    for file in _files(path):
        yield from (_scan_mcap if file.suffix == ".mcap" else _scan_sqlite)(file)


def repair(path: Path, target: Path, note: str) -> int:
    """Write what can be read of a bag to a new one, closed, and return the number of messages.

    Args:
        path: the bag that was not closed.
        target: the bag to make.
        note: what was recovered; it stands in the new bag's metadata.

    Raises:
        FtcmError: the target exists or cannot be written.
    """
    typestore = get_typestore(Stores.ROS2_JAZZY)
    connections: dict[str, Any] = {}
    count = 0
    writer = new_bag(target, _STORAGE[_files(path)[0].suffix])
    try:
        for found, when, data in scan(path):
            if found.topic not in connections:
                if found.msgtype not in typestore.types:
                    typestore.register(get_types_from_msg(found.msgdef.data, found.msgtype))
                connections[found.topic] = writer.add_connection(
                    found.topic,
                    found.msgtype,
                    typestore=typestore,
                    offered_qos_profiles=found.ext.offered_qos_profiles,
                )
            writer.write(connections[found.topic], when, data)
            count += 1
        writer.set_custom_data("recovered", note)
        writer.close()
    except (OSError, sqlite3.Error) as error:
        raise FtcmError(f"bag {str(target)!r} cannot be written: {reason_of(error)}") from None
    return count


def _files(path: Path) -> list[Path]:
    if path.is_file():
        return [path]
    found = [f for f in path.iterdir() if f.suffix in _STORAGE and f.is_file()]
    return sorted(found, key=lambda f: (len(f.name), f.name))  # a bag in parts: _9 before _10


def _scan_mcap(file: Path) -> Iterator[Message]:
    """Record by record up to the first that is not whole; a chunk counts whole or not at all."""
    reader = McapReader(file)
    with file.open("rb") as stream:
        size = file.stat().st_size
        if stream.read(len(_MCAP_MAGIC)) != _MCAP_MAGIC:
            return
        reader.bio = stream
        begin = stream.tell()
        while len(head := stream.read(9)) == 9:
            opcode, length = struct.unpack("<BQ", head)
            end = begin + 9 + length
            if end > size or opcode in _MCAP_END:
                return
            if opcode in _MCAP_WITH_MESSAGES:
                reader.data_start, reader.data_end = begin, end
                try:
                    reader.meta_scan()
                    messages = list(reader.messages_scan(reader.connections))
                except Exception:  # rosbags has many error types for a record that holds something else
                    return
                yield from messages
            begin = stream.seek(end)


def _scan_sqlite(file: Path) -> Iterator[Message]:
    """In a copy, as a transaction that was under way has to be rolled back."""
    with TemporaryDirectory() as folder:
        try:
            reader = Sqlite3Reader(_consistent_copy(file, Path(folder)))
            reader.open()
        except OSError:
            raise
        except Exception:  # sqlite3, apsw and rosbags each have their own for a file that is not whole
            return
        try:
            messages = reader.messages(reader.connections)
            while (message := _next(messages)) is not None:
                yield message
        finally:
            reader.close()


def _next(messages: Iterator[Message]) -> Message | None:
    try:
        return next(messages, None)
    except Exception:
        return None


def _consistent_copy(file: Path, folder: Path) -> Path:
    copy = folder / "bag.db3"
    beside = [file.with_name(file.name + suffix) for suffix in ("", "-journal", "-wal")]
    if not beside[2].exists():
        try:
            with (
                closing(sqlite3.connect(f"{file.resolve().as_uri()}?mode=ro", uri=True)) as source,
                closing(sqlite3.connect(copy)) as target,
            ):
                source.backup(target)  # also while a recorder is writing
            return copy
        except sqlite3.OperationalError:  # a journal to roll back, which a reader may not
            copy.unlink(missing_ok=True)
    for part in beside:
        if part.exists():
            shutil.copyfile(part, folder / part.name.replace(file.name, copy.name, 1))
    with closing(sqlite3.connect(copy)) as database:
        database.execute("SELECT count(*) FROM messages")  # rolls back
    return copy
