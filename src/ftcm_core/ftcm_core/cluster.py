# SPDX-License-Identifier: Apache-2.0
"""Work on more machines: the processes of a cluster of Dask in the place of those of this machine.

Who does what, and what is done again when a process is killed, is Dask's. Here is what a process must be told
first: it loads the plug-ins and compares versions before it reads the work, as that may be made of them.

Needs distributed (extra ``cluster``), which is imported when a cluster is asked for.
"""

from __future__ import annotations

import functools
import hashlib
import logging
import pickle
import platform
import threading
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures.process import BrokenProcessPool
from importlib import metadata
from pathlib import Path
from typing import Any, TypeVar

import ftcm_core
from ftcm_core.errors import FtcmError
from ftcm_core.extras import need
from ftcm_core.registry import load_plugins, plugins

T = TypeVar("T")
R = TypeVar("R")

WAIT = 10.0
"""So long a scheduler may take to answer, s (chosen)."""
_loading = threading.Lock()
"""A process of a cluster may have several threads; a plug-in is loaded once."""


class Cluster:
    """The processes of a cluster, as an :class:`~ftcm_core.parallel.Processes`.

    Args:
        address: of its scheduler, e.g. ``tcp://host:8786``.

    Raises:
        FtcmError: distributed is missing, or nobody answers.
    """

    def __init__(self, address: str) -> None:
        need("distributed", "cluster", "a cluster")
        from distributed import Client

        for name in ("client", "utils", "core"):  # they log tracebacks of what is told here in one line
            logging.getLogger(f"distributed.{name}").setLevel(logging.CRITICAL)
        self.address = address
        try:
            self._client = Client(address, timeout=WAIT, set_as_default=False)
        except (OSError, ValueError) as error:  # TimeoutError is an OSError
            raise FtcmError(
                f"cluster {address!r} cannot be reached: {error or type(error).__name__}; expected the "
                "address of a running scheduler, e.g. tcp://host:8786"
            ) from None

    def __enter__(self) -> Cluster:
        return self

    def __exit__(self, *rest: object) -> None:
        self._client.close()

    @property
    def count(self) -> int:
        """How many threads its processes have now, together."""
        return sum(self._client.nthreads().values())

    def begin(self, function: Callable[[T], R], item: T) -> None:
        """Nothing: its processes run already."""

    def each(self, function: Callable[[T], R], items: Sequence[T]) -> Iterator[tuple[int, R]]:
        """Run a function on items, as :func:`~ftcm_core.parallel.run_parallel`.

        What a process had to do that is killed, others do. It is given up when four were killed at it.

        Raises:
            FtcmError: a process has other versions, or cannot load a plug-in; or the scheduler is gone.
            BrokenProcessPool: every process that tried an item was killed.
        """
        from distributed import CancelledError, KilledWorker, as_completed
        from distributed.comm import CommClosedError

        packed = [pickle.dumps((function, item)) for item in items]
        futures = self._client.map(_work, packed, about=_about(), sources=plugins(), pure=False)
        places = {future.key: place for place, future in enumerate(futures)}
        finished = as_completed(futures, loop=self._client.loop)
        del futures, packed  # so that a result is not held when it was yielded
        try:
            for future in finished:
                yield places.pop(future.key), future.result()
        except KilledWorker as error:
            raise BrokenProcessPool(str(error)) from None
        except ModuleNotFoundError as error:
            if not (error.name or "").startswith("ftcm_core"):
                raise
            raise FtcmError(
                f"cluster {self.address!r}: a process does not find ftcm_core; install version "
                f"{ftcm_core.__version__} there"
            ) from None
        except (CancelledError, CommClosedError) as error:
            raise FtcmError(
                f"cluster {self.address!r}: the scheduler is gone ({type(error).__name__}); start it again; "
                "a campaign or tuning with --output goes on with --resume"
            ) from None


def _work(packed: bytes, about: Mapping[str, str], sources: Sequence[str]) -> Any:
    """What a process of the cluster does."""
    with _loading:
        try:
            load_plugins(sources)
        except FtcmError as error:
            raise FtcmError(f"cluster: on {platform.node()}: {error}") from None
        here = _about()
    for what, version in about.items():
        if here.get(what) != version:
            raise FtcmError(
                f"cluster: on {platform.node()} {what} is {here.get(what) or 'not there'}, here it is "
                f"{version or 'not there'}; use the same everywhere, as another one may give other results"
            )
    function, item = pickle.loads(packed)
    return function(item)


def _about() -> dict[str, str]:
    """What must be the same on both sides for results to be the same."""
    return {**_versions(), **{f"the plug-in {name}": _digest(Path(name)) for name in plugins()}}


@functools.cache
def _versions() -> dict[str, str]:
    found = {"ftcm_core": f"{ftcm_core.__version__} (code {_code()})"}
    found["Python"] = ".".join(platform.python_version_tuple()[:2])
    for package in ("numpy", "numba"):
        try:
            found[package] = metadata.version(package)
        except metadata.PackageNotFoundError:
            found[package] = ""
    return found


def _code() -> str:
    """Begin of the SHA-256 of the package's Python files."""
    folder = Path(ftcm_core.__file__).parent
    digest = hashlib.sha256()
    for file in sorted(folder.rglob("*.py")):
        digest.update(f"{file.relative_to(folder)}\n".encode() + file.read_bytes())
    return digest.hexdigest()[:12]


def _digest(file: Path) -> str:
    return hashlib.sha256(file.read_bytes()).hexdigest()[:12] if file.is_file() else ""
