# SPDX-License-Identifier: Apache-2.0
"""The file SHA256SUMS of a bag: the files it had when it was closed, their lengths, and what was in them.

It is a file beside metadata.yaml, not a part of it, as it names that one too; readers of bags open only what
metadata.yaml names. ``sha256sum --check SHA256SUMS`` reads it.
"""

from __future__ import annotations

import hashlib
import re
from pathlib import Path
from typing import NamedTuple

NAME = "SHA256SUMS"
STORAGE_OF = {".mcap": "mcap", ".db3": "sqlite3"}
"""Endings of the files that hold messages, and their storage."""
_HEAD = "# Files of this bag when it was closed: length, then SHA-256.\n"
_ENTRY = re.compile(r"# (\d+) bytes\n([0-9a-f]{64})  ([^\n/]+)\n")


class Seal(NamedTuple):
    """What a file was: its length and SHA-256."""

    size: int
    sha256: str


class Comparison(NamedTuple):
    """A bag's files beside what they were when it was closed."""

    sealed: bool
    """Whether the bag says what they were."""
    changed: tuple[str, ...] = ()
    """Files that are not what they were, or not there."""
    note: str = ""
    """What does not fit, in one line; empty if all does."""


def seal_of(file: Path) -> Seal:
    """Read a file.

    Raises:
        OSError: it cannot be read.
    """
    digest, size = hashlib.sha256(), 0
    with file.open("rb") as stream:
        while part := stream.read(1 << 20):
            digest.update(part)
            size += len(part)
    return Seal(size, digest.hexdigest())


def write(folder: Path) -> None:
    """Read the files of a bag that has been closed, and write what they are.

    Raises:
        OSError: that is not possible.
    """
    seals = {f.name: seal_of(f) for f in sorted(folder.iterdir()) if f.is_file()}
    entries = (f"# {seal.size} bytes\n{seal.sha256}  {name}\n" for name, seal in seals.items())
    unfinished = folder / f"{NAME}.tmp"
    unfinished.write_text(_HEAD + "".join(entries), encoding="utf-8")
    unfinished.replace(folder / NAME)


def compare(folder: Path) -> Comparison:
    """Compare the files of a bag with what they were.

    Raises:
        OSError: a file cannot be read.
    """
    file = folder / NAME
    if not file.is_file():
        return Comparison(sealed=False)
    text = file.read_bytes().decode(errors="replace")
    seals = {name: Seal(int(size), digest) for size, digest, name in _ENTRY.findall(text)}
    if _HEAD + "".join(match[0] for match in _ENTRY.finditer(text)) != text:
        return Comparison(True, (NAME,), f"{NAME} is not what was recorded")
    others = [f for f in sorted(folder.iterdir()) if f.suffix in STORAGE_OF and f.name not in seals]
    changed, notes = [], []
    for name, seal in seals.items():
        here = folder / name
        if here.is_file():
            found = seal_of(here)
            if found != seal:
                changed.append(name)
                sizes = "" if found.size == seal.size else f": {found.size} bytes, {seal.size} were recorded"
                notes.append(f"{name} is not what was recorded{sizes}")
        elif renamed := next((f for f in others if seal_of(f) == seal), None):
            others.remove(renamed)
            notes.append(f"{name} is called {renamed.name} now")
        else:
            changed.append(name)
            notes.append(f"{name} is not there any more")
    notes += [f"{f.name} was not recorded with it" for f in others]
    return Comparison(True, tuple(changed), "; ".join(notes))
