# SPDX-License-Identifier: Apache-2.0
"""A ROS domain of its own for every run on this machine."""

from __future__ import annotations

import fcntl
import os
import random
import re
import tempfile
import time
from pathlib import Path
from typing import IO

from ftcm_core.errors import FtcmError

DOMAINS = range(1, 102)
"""Domain numbers that are safe with Linux's default ports."""
PORT_BASE, PORT_GAIN = 7400, 250
"""Ports of a domain (DDS-RTPS 9.6.2); Fast DDS names its shared-memory ports alike."""
SHARED_PORTS = range(7000, PORT_BASE)
"""Shared-memory ports that Fast DDS gives to processes of any domain, under LOCALHOST."""
SETTLED_SECONDS = 2.0
"""A lock file younger than this may not be locked yet by the process that has just made it."""


class Domain:
    """Holds a domain number, by a file lock that ends with the last process that has the file open."""

    def __init__(self, wanted: int | None = None) -> None:
        """Take the wanted domain, or any free one.

        Raises:
            FtcmError: it is taken by another run, or all are.
        """
        if wanted is not None and not 0 <= wanted <= 232:
            raise FtcmError(f"domain {wanted} is out of range; expected 0 to 232")
        candidates = [wanted] if wanted is not None else random.sample(DOMAINS, len(DOMAINS))
        for number in candidates:
            lock = self._lock(number)
            if lock is not None:
                self.number = number
                self._file = lock
                remove_dead_shared_memory(number)
                return
        what = f"domain {wanted} is" if wanted is not None else "all domains are"
        raise FtcmError(
            f"{what} in use by other runs on this machine; wait, or choose another with --domain-id"
        )

    @staticmethod
    def _lock(number: int) -> IO[str] | None:
        path = Path(tempfile.gettempdir()) / f"ftcm-domain-{os.getuid()}-{number}.lock"
        file = path.open("w")
        try:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError:
            file.close()
            return None
        return file

    def fileno(self) -> int:
        """Descriptor of the lock file: a process that inherits it holds the domain until it ends."""
        return self._file.fileno()

    def clean(self) -> None:
        """Remove the shared memory that killed nodes have left, once it can be told from that in use."""
        remove_dead_shared_memory(self.number)
        end = time.monotonic() + SETTLED_SECONDS
        while has_new_ports(self.number) and time.monotonic() < end:
            time.sleep(0.1)  # only age tells them from the files of a process that is starting
            remove_dead_shared_memory(self.number)

    def release(self) -> None:
        """Give the domain back, clean."""
        self.clean()
        self._file.close()


def remove_dead_shared_memory(domain: int, folder: Path = Path("/dev/shm")) -> list[str]:
    """Remove Fast DDS's shared-memory files of processes that were killed.

    Args:
        domain: a domain held by the caller: its ports that nobody listens on go. So do those of no domain, if
            no process at all uses Fast DDS's shared memory.
        folder: where shared memory is.

    Returns:
        Names of the files removed. What a process is using has its lock held and stays.
    """
    removed = []
    # A process that opens a port holds its segment's lock, and not yet the port's.
    alone = all(_is_free(lock) for lock in folder.glob(f"fastrtps_{'[0-9a-f]' * 16}_el"))
    for path in sorted(folder.glob("*fastrtps_*")):
        port = _port(path)
        segment = re.fullmatch(r"fastrtps_([0-9a-f]{16})(?:_el)?", path.name)
        shared = port in SHARED_PORTS and alone
        if shared or port in ports_of(domain):
            locks = [folder / f"fastrtps_port{port}{kind}" for kind in ("_el", "_sl")]
        elif segment:
            locks = [folder / f"fastrtps_{segment.group(1)}_el"]
        else:
            continue
        try:
            if shared and _is_new(path.stat()):
                continue  # another domain's process, which has not locked it yet
            if all(_is_free(lock) for lock in locks):
                path.unlink()
                removed.append(path.name)
        except OSError:  # another user's, or gone already
            continue
    return removed


def has_new_ports(domain: int, folder: Path = Path("/dev/shm")) -> bool:
    """Whether a shared-memory port of this domain is so new that it may be in use, or not any more."""
    for path in folder.glob("fastrtps_port*"):
        try:
            if _port(path) in ports_of(domain) and _is_new(path.stat()):
                return True
        except OSError:  # gone already
            continue
    return False


def lost_ports(folder: Path = Path("/dev/shm")) -> list[int]:
    """Return this process's shared-memory ports in which no message arrives.

    Where processes begin while others end, it happens that one of them removes a port that another has just
    opened (Fast DDS 2.14.5): messages for it then go elsewhere, and nothing says so.

    Args:
        folder: where shared memory is.
    """
    open_files = (_link(file) for file in Path("/proc/self/fd").glob("*"))
    locks = [re.fullmatch(rf"{folder}/fastrtps_port(\d+)_el( \(deleted\))?", name) for name in open_files]
    held = {int(lock[1]): not lock[2] for lock in locks if lock}
    if not held:
        return []
    lines = Path("/proc/self/maps").read_text("utf-8").splitlines()
    mapped = {line.split(maxsplit=5)[5]: int(line.split()[4]) for line in lines if "/fastrtps_port" in line}
    lost = []
    for port, locked in sorted(held.items()):
        segment = folder / f"fastrtps_port{port}"
        try:
            there = segment.stat().st_ino == mapped.get(str(segment))
        except FileNotFoundError:
            there = False
        if not (locked and there):
            lost.append(port)
    return lost


def ports_of(domain: int) -> range:
    """Ports of a domain."""
    return range(PORT_BASE + PORT_GAIN * domain, PORT_BASE + PORT_GAIN * (domain + 1))


def _port(path: Path) -> int:
    """Number of the port that a file in shared memory belongs to; -1 if it is none's."""
    port = re.fullmatch(r"(?:sem\.)?fastrtps_port(\d+)(?:_el|_sl|_mutex)?", path.name)
    return int(port.group(1)) if port else -1


def _link(file: Path) -> str:
    """What an open file is; empty if it is closed meanwhile."""
    try:
        return os.readlink(file)
    except OSError:
        return ""


def _is_free(lock: Path) -> bool:
    """Whether nobody holds a lock file: it is not there, or settled and not locked."""
    try:
        with lock.open("rb") as file:
            if _is_new(os.fstat(file.fileno())):
                return False
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except FileNotFoundError:
        return True
    except BlockingIOError:
        return False
    return True


def _is_new(stat: os.stat_result) -> bool:
    return time.time() - stat.st_mtime < SETTLED_SECONDS
