# SPDX-License-Identifier: Apache-2.0
"""What can be read of a bag that was not closed: its recorder was killed, or its disk was full."""

from __future__ import annotations

import shutil
import sqlite3
from collections.abc import Iterator
from contextlib import closing
from io import BufferedReader, BytesIO
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, NamedTuple

from mcap.exceptions import EndOfFile, McapError
from mcap.reader import SeekingReader, Summary
from mcap.records import Channel, Chunk, DataEnd, McapRecord, Schema
from mcap.records import Message as McapMessage
from mcap.stream_reader import StreamReader, get_chunk_data_stream
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from ftcm_core.errors import FtcmError
from ftcm_ros.bags import manifest
from ftcm_ros.bags.checksums import MAGIC, verify_summary
from ftcm_ros.bags.digests import Row, batches, has_digests, unchanging
from ftcm_ros.bags.rosbags_internals import parse_qos
from ftcm_ros.bags.writer import new_bag, reason_of


class Origin(NamedTuple):
    """The topic of a message, as the bag describes it."""

    topic: str
    msgtype: str
    definition: str
    """Text of the message definition."""
    qos: list[Any]
    """Qualities of service that its publishers offered."""


Message = tuple[Origin, int, bytes]
"""Topic, time (ns) and serialized message."""


def scan(path: Path) -> Iterator[Message]:
    """Yield every whole message of a bag's files, from the first on; neither index nor metadata are needed.

    The bag's folder is not modified.

    Args:
        path: folder of the bag, or one of its files.

    Raises:
        OSError: a file cannot be opened.
    """
    for file in files_of(path):
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
    writer = new_bag(target, manifest.STORAGE_OF[files_of(path)[0].suffix])
    try:
        for found, when, data in scan(path):
            if found.topic not in connections:
                if found.msgtype not in typestore.types:
                    typestore.register(get_types_from_msg(found.definition, found.msgtype))
                connections[found.topic] = writer.add_connection(
                    found.topic,
                    found.msgtype,
                    typestore=typestore,
                    offered_qos_profiles=found.qos,
                )
            writer.write(connections[found.topic], when, data)
            count += 1
        writer.set_custom_data("recovered", note)
        writer.close()
        manifest.write(target)
    except (OSError, sqlite3.Error) as error:
        raise FtcmError(f"bag {str(target)!r} cannot be written: {reason_of(error)}") from None
    return count


def files_of(path: Path) -> list[Path]:
    """Return the files of a bag that hold messages, in order."""
    if path.is_file():
        return [path]
    found = [f for f in path.iterdir() if f.suffix in manifest.STORAGE_OF and f.is_file()]
    return sorted(found, key=lambda f: (len(f.name), f.name))  # a bag in parts: _9 before _10


def _scan_mcap(file: Path) -> Iterator[Message]:
    """Yield the messages of every chunk that is whole, up to the first record that is cut off.

    Where a record in the middle has lost its length, the summary at the end of the file says where the next
    chunk is. It also has the topics, if the chunk that had them is damaged.
    """
    schemas: dict[int, Schema] = {}
    origins: dict[int, Origin] = {}
    later: list[int] = []
    size = file.stat().st_size
    with file.open("rb") as stream:
        if (summary := _summary(stream)) is not None:
            schemas = dict(summary.schemas)
            origins = {i: _origin(channel, schemas) for i, channel in summary.channels.items()}
            later = sorted(index.chunk_start_offset for index in summary.chunk_indexes)
        stream.seek(len(MAGIC))
        records = _records(stream, size)
        while True:
            here = stream.tell()
            try:
                record = next(records, None)
            except Exception:  # mcap has many errors for a record that is cut off or holds something else
                later = [offset for offset in later if offset > here]
                if not later:
                    return
                stream.seek(later[0])
                records = _records(stream, size)
                continue
            if record is None or isinstance(record, DataEnd):
                return
            try:
                parts = _parts(record)
            except Exception:  # a damaged chunk: its checksum, or anything in it
                continue
            for part in parts:
                if isinstance(part, Schema):
                    schemas[part.id] = part
                elif isinstance(part, Channel) and part.schema_id in schemas:
                    origins[part.id] = _origin(part, schemas)
                elif isinstance(part, McapMessage) and part.channel_id in origins:
                    yield origins[part.channel_id], part.log_time, part.data


def _summary(stream: BufferedReader) -> Summary | None:
    """Return the summary at the end of a closed file; None if there is none that is known to be whole."""
    if verify_summary(stream) != "whole":
        return None
    stream.seek(0)
    try:
        return SeekingReader(stream).get_summary()
    except McapError:  # the magic at the beginning is damaged
        return None


def _records(stream: BufferedReader | BytesIO, size: int) -> Iterator[McapRecord]:
    """Yield the records from where a stream stands to its end.

    Raises:
        Exception: a record is not whole; mcap has many errors for that.
    """
    records = StreamReader(stream, skip_magic=True, emit_chunks=True, record_size_limit=size).records
    while stream.tell() < size:
        here = stream.tell()
        if stream.read(1) == b"\0":  # no record at all: a part of the file that was never written
            raise EndOfFile
        stream.seek(here)
        yield next(records)


def _parts(record: McapRecord) -> list[McapRecord]:
    """Return the records in a chunk, or the record itself.

    Raises:
        Exception: the chunk is not whole.
    """
    if not isinstance(record, Chunk):
        return [record]
    stream, size = get_chunk_data_stream(record, validate_crc=True)
    if size != record.uncompressed_size:
        raise EndOfFile
    return list(_records(BytesIO(stream.read(size)), size))


def _origin(channel: Channel, schemas: dict[int, Schema]) -> Origin:
    schema = schemas[channel.schema_id]
    qos = parse_qos(channel.metadata.get("offered_qos_profiles", ""))
    return Origin(channel.topic, schema.name, schema.data.decode(), qos)


def _scan_sqlite(file: Path) -> Iterator[Message]:
    """Yield the messages; of a bag that was not closed from a copy, to roll back what was under way."""
    with TemporaryDirectory() as folder:
        try:
            closed = file.with_name("metadata.yaml").is_file()
            with closing(unchanging(file) if closed else _consistent_copy(file, Path(folder))) as database:
                origins = _topics(database)
                for _, topic, when, data in _rows(database):
                    if topic in origins and isinstance(when, int) and isinstance(data, bytes):
                        yield origins[topic], when, data
        except sqlite3.Error:  # no more can be read
            return


def _rows(database: sqlite3.Connection) -> Iterator[Row]:
    """Yield the messages of the batches that are as they were written; without digests, all there are.

    Raises:
        sqlite3.Error: the file is not whole.
    """
    order = "timestamp, id"
    if has_digests(database):
        try:
            for rows in batches(database):
                yield from rows or ()
        except sqlite3.Error:  # the digests cannot be read
            order = "id"
        else:
            return
    yield from database.execute(f"SELECT id, topic_id, timestamp, data FROM messages ORDER BY {order}")


def _topics(database: sqlite3.Connection) -> dict[int, Origin]:
    """Return the topics of a rosbag2 file by number; files of before Jazzy have no definitions.

    Raises:
        sqlite3.Error: they cannot be read.
    """
    definitions: dict[str, str] = {}
    if database.execute("SELECT 1 FROM sqlite_master WHERE name = 'message_definitions'").fetchone():
        definitions.update(
            database.execute("SELECT topic_type, encoded_message_definition FROM message_definitions")
        )
    rows = database.execute("SELECT * FROM topics")
    columns = [name for name, *_ in rows.description]
    found = {}
    for topic in (dict(zip(columns, row)) for row in rows):
        try:
            qos = parse_qos(topic.get("offered_qos_profiles", ""))
        except Exception:  # rosbags has many errors for a text that is damaged
            qos = []
        definition = definitions.get(topic["type"], "")
        found[topic["id"]] = Origin(topic["name"], topic["type"], definition, qos)
    return found


def _consistent_copy(file: Path, folder: Path) -> sqlite3.Connection:
    copy = folder / "bag.db3"
    beside = [file.with_name(file.name + suffix) for suffix in ("", "-journal", "-wal")]
    if not beside[2].exists():
        try:
            with (
                closing(sqlite3.connect(f"{file.resolve().as_uri()}?mode=ro", uri=True)) as source,
                closing(sqlite3.connect(copy)) as target,
            ):
                source.backup(target)  # also while a recorder is writing
            return sqlite3.connect(copy)
        except sqlite3.OperationalError:  # a journal to roll back, which a reader may not
            copy.unlink(missing_ok=True)
    for part in beside:
        if part.exists():
            shutil.copyfile(part, folder / part.name.replace(file.name, copy.name, 1))
    return sqlite3.connect(copy)  # whoever reads first rolls back
