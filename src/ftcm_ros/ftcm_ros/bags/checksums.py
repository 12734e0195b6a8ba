# SPDX-License-Identifier: Apache-2.0
"""The checksums of an mcap file: CRC-32 of each chunk, of the data and of the summary, as MCAP specifies."""

from __future__ import annotations

import io
import struct
import zlib
from pathlib import Path
from typing import BinaryIO

CHUNK, DATA_END, FOOTER = 0x06, 0x0F, 0x02
"""Opcodes of the records that have a checksum."""
_CHUNK_HEAD = 28
"""Bytes of a chunk before the name of its compression: start, end, size, CRC-32 of the content."""
MAGIC = b"\x89MCAP0\r\n"
"""At the beginning and the end of a file."""
_DATA_END_SIZE, _FOOTER_SIZE = 13, 37
"""Bytes of the record, and of the record with the magic after it."""


class ChecksummedFile:
    """A file to which mcap records are written, each as opcode, length and content; fills checksums in."""

    def __init__(self, file: BinaryIO, written: bytes) -> None:
        """Go on after what has been written.

        Args:
            file: where the records go.
            written: what is in it.
        """
        self._file = file
        self._crc = zlib.crc32(written)
        """Of the data; after its end, of the summary."""
        self._head: list[bytes] = []
        """Opcode and length of the record being written."""

    def write(self, data: bytes | memoryview) -> int:
        """Write the next part of a record."""
        part = bytes(data)
        if len(self._head) < 2 and len(part) == (1, 8)[len(self._head)]:
            self._head.append(part)
            if len(self._head) == 2 and self._head[0][0] != DATA_END:
                self._crc = zlib.crc32(self._head[1], zlib.crc32(self._head[0], self._crc))
            return self._file.write(part)
        opcode = self._head[0][0] if len(self._head) == 2 else 0
        self._head = []
        if opcode == CHUNK:
            part = part[:24] + zlib.crc32(_content(part)).to_bytes(4, "little") + part[_CHUNK_HEAD:]
        elif opcode == DATA_END:
            self._crc, part = 0, self._crc.to_bytes(4, "little")
            return self._file.write(part)
        elif opcode == FOOTER:
            part = part[:16] + zlib.crc32(part[:16], self._crc).to_bytes(4, "little")
        self._crc = zlib.crc32(part, self._crc)
        return self._file.write(part)

    def tell(self) -> int:
        """Where the next part goes."""
        return self._file.tell()

    def flush(self) -> None:
        """Bring what has been written to the file."""
        self._file.flush()

    def close(self) -> None:
        """Close the file."""
        self._file.close()


def verify(file: Path) -> str:
    """Compare a closed mcap file with its checksums.

    Returns:
        ``whole``; ``unchecked``: it has none; or ``damaged``.

    Raises:
        OSError: it cannot be read.
    """
    with file.open("rb") as stream:
        found = verify_summary(stream)
        if found != "whole":
            return found
        summary = _summary_start(stream)
        stream.seek(summary - _DATA_END_SIZE)
        end = stream.read(_DATA_END_SIZE)
        expected = int.from_bytes(end[9:], "little")
        if end[0] == DATA_END and not expected:
            return "unchecked"
        whole = end[0] == DATA_END and expected == _crc(stream, 0, summary - _DATA_END_SIZE)
        return "whole" if whole else "damaged"


def verify_summary(stream: BinaryIO) -> str:
    """Compare the summary at the end of an mcap file with its checksum; returns as :func:`verify` does."""
    size = stream.seek(0, io.SEEK_END)
    stream.seek(max(0, size - _FOOTER_SIZE))
    footer = stream.read()
    if len(footer) < _FOOTER_SIZE or footer[0] != FOOTER or footer[-8:] != MAGIC:
        return "damaged"
    summary, _, expected = struct.unpack("<QQI", footer[9:29])
    if not summary or not expected:
        return "unchecked"
    if not _DATA_END_SIZE <= summary <= size - _FOOTER_SIZE:
        return "damaged"
    return "whole" if expected == _crc(stream, summary, size - 12) else "damaged"


def _summary_start(stream: BinaryIO) -> int:
    stream.seek(-_FOOTER_SIZE + 9, io.SEEK_END)
    return int.from_bytes(stream.read(8), "little")


def _crc(stream: BinaryIO, start: int, end: int) -> int:
    """CRC-32 of a part of a file."""
    stream.seek(start)
    crc = 0
    while start < end:
        part = stream.read(min(1 << 20, end - start))
        crc = zlib.crc32(part, crc)
        start += len(part)
    return crc


def _content(chunk: bytes) -> bytes:
    """The records in a chunk that is not compressed."""
    start = _CHUNK_HEAD
    compression = int.from_bytes(chunk[start : start + 4], "little")
    if compression:
        raise io.UnsupportedOperation("a compressed chunk")
    return chunk[start + 12 :]
