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
                self.clean()
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
        """Remove the shared memory that killed nodes have left."""
        remove_dead_shared_memory(self.number)

    def release(self) -> None:
        """Give the domain back, clean."""
        self.clean()
        self._file.close()


def remove_dead_shared_memory(domain: int, folder: Path = Path("/dev/shm")) -> list[str]:
    """Remove Fast DDS's shared-memory files of processes that were killed.

    Args:
        domain: a domain held by the caller: its ports, and those of no domain, that nobody listens on go.
        folder: where shared memory is.

    Returns:
        Names of the files removed. What a process is using has its lock held and stays.
    """
    removed = []
    ports = range(PORT_BASE + PORT_GAIN * domain, PORT_BASE + PORT_GAIN * (domain + 1))
    for path in sorted(folder.glob("*fastrtps_*")):
        port = re.fullmatch(r"(?:sem\.)?fastrtps_port(\d+)(?:_el|_sl|_mutex)?", path.name)
        segment = re.fullmatch(r"fastrtps_([0-9a-f]{16})(?:_el)?", path.name)
        shared = port is not None and int(port.group(1)) in SHARED_PORTS
        if port and (shared or int(port.group(1)) in ports):
            locks = [folder / f"fastrtps_port{port.group(1)}{kind}" for kind in ("_el", "_sl")]
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
