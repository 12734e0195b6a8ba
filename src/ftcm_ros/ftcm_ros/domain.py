# SPDX-License-Identifier: Apache-2.0
"""A ROS domain of its own for every run on this machine."""

from __future__ import annotations

import fcntl
import os
import random
import re
import tempfile
from pathlib import Path
from typing import IO

from ftcm_core.errors import FtcmError

DOMAINS = range(1, 102)
"""Domain numbers that are safe with Linux's default ports."""
PORT_BASE, PORT_GAIN = 7400, 250
"""Ports of a domain (DDS-RTPS 9.6.2); Fast DDS names its shared-memory ports alike."""


class Domain:
    """Holds a domain number, by a file lock that ends with the process."""

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

    def release(self) -> None:
        """Give the domain back, without the shared memory that killed nodes have left in it."""
        remove_dead_shared_memory(self.number)
        self._file.close()


def remove_dead_shared_memory(domain: int, folder: Path = Path("/dev/shm")) -> list[str]:
    """Remove Fast DDS's shared-memory files of processes that were killed.

    Args:
        domain: a domain that nobody else uses: its port files go.
        folder: where shared memory is.

    Returns:
        Names of the files removed. A segment goes only if the lock its owner holds is free.
    """
    removed = []
    ports = range(PORT_BASE + PORT_GAIN * domain, PORT_BASE + PORT_GAIN * (domain + 1))
    for path in sorted(folder.glob("*fastrtps_*")):
        port = re.fullmatch(r"(?:sem\.)?fastrtps_port(\d+)(?:_el|_mutex)?", path.name)
        segment = re.fullmatch(r"fastrtps_([0-9a-f]{16})(?:_el)?", path.name)
        dead = (
            int(port.group(1)) in ports
            if port
            else segment and _lock_is_free(folder / f"fastrtps_{segment.group(1)}_el")
        )
        if dead:
            try:
                path.unlink()
            except OSError:  # another user's, or gone already
                continue
            removed.append(path.name)
    return removed


def _lock_is_free(path: Path) -> bool:
    try:
        with path.open("rb") as file:
            fcntl.flock(file, fcntl.LOCK_SH | fcntl.LOCK_NB)
    except FileNotFoundError:
        return True
    except OSError:
        return False
    return True
