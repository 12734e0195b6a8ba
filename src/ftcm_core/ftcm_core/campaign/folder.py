# SPDX-License-Identifier: Apache-2.0
"""The folder of a campaign: what is written while it runs, so that one that was ended can go on.

``campaign.json`` is written before the first run and says what is run; ``runs.jsonl`` has one result a line,
in the order of the runs. So the complete lines are a beginning of those of the whole campaign.
"""

from __future__ import annotations

import contextlib
import fcntl
import hashlib
import json
import os
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path
from typing import Any, BinaryIO

from ftcm_core.errors import FtcmError, shown
from ftcm_core.report.results import to_json

IDENTITY = "campaign.json"
RUNS = "runs.jsonl"


def fingerprint(data: Mapping[str, Any]) -> str:
    """Return the SHA-256 of plain data."""
    return hashlib.sha256(to_json(data).encode()).hexdigest()


def begin(folder: Path, identity: Mapping[str, Any], file: str = IDENTITY) -> None:
    """Write what is run, at once or not at all."""
    part = folder / f"{file}.part"
    part.write_text(to_json(identity, indent=1) + "\n", encoding="utf-8")
    os.replace(part, folder / file)


def check_same(folder: Path, identity: Mapping[str, Any], file: str = IDENTITY) -> list[str]:
    """Check that a folder is of the same campaign.

    Args:
        folder: where it was begun.
        identity: what is to run: plain data, with ``provenance``.
        file: what :func:`begin` wrote.

    Returns:
        What is not the same and may be: the versions.

    Raises:
        FtcmError: it is of another one, or of none.
    """
    try:
        before = json.loads((folder / file).read_text(encoding="utf-8"))
    except (OSError, ValueError):
        raise FtcmError(
            f"{str(folder)!r} has nothing to resume: no {file} that can be read; leave --resume out to begin "
            "in a new folder"
        ) from None
    now = json.loads(to_json(identity))
    for what, there, here in _differences(before, now):
        if not what.startswith("provenance."):
            raise FtcmError(
                f"{str(folder)!r} has another one: {what} is {shown(there)} there, {shown(here)} here; "
                "resume with what it was begun with, or choose a new folder"
            )
    return [f"{what} was {there}, is {here}" for what, there, here in _differences(before, now)]


def _differences(before: Any, now: Any, path: str = "") -> Iterator[tuple[str, Any, Any]]:
    if isinstance(before, dict) and isinstance(now, dict):
        for key in {**before, **now}:
            yield from _differences(before.get(key), now.get(key), f"{path}.{key}" if path else key)
    elif before != now:
        yield path, before, now


@contextlib.contextmanager
def locked(path: Path) -> Iterator[BinaryIO]:
    """Open a file for reading and writing, and make it if it is not there, for this process alone.

    Raises:
        FtcmError: another process has it.
    """
    with open(os.open(path, os.O_RDWR | os.O_CREAT, 0o666), "r+b") as file:
        try:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError:
            raise FtcmError(f"{str(path)!r}: another process is at it; wait for its end") from None
        yield file


def kept_results(
    file: BinaryIO, expected: Iterable[Mapping[str, Any]], where: str = RUNS
) -> Iterator[dict[str, Any]]:
    """Yield the results that are there, and cut the file behind the last complete line, to be written on.

    Args:
        file: as of :func:`locked`.
        expected: what each line must say, in order.
        where: what to call the file in errors.

    Raises:
        FtcmError: a line is not what it must be.
    """
    end, wanted = 0, iter(expected)
    file.seek(0)
    for number, line in enumerate(iter(file.readline, b"")):
        if not line.endswith(b"\n"):  # torn
            break
        try:
            result = json.loads(line)
            fits = all(result.get(k) == v for k, v in next(wanted).items())
        except (ValueError, AttributeError, StopIteration):
            fits = False
        if not fits:
            raise FtcmError(
                f"{where}:{number + 1}: is not run {number + 1} of this campaign; choose a new folder"
            )
        end += len(line)
        yield result
    file.seek(end)
    file.truncate()
