# SPDX-License-Identifier: Apache-2.0
"""Work over several processes that end when they should: with the parent, and on Ctrl-C."""

from __future__ import annotations

import contextlib
import multiprocessing
import os
import signal
import threading
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Future, ProcessPoolExecutor
from queue import SimpleQueue
from typing import Protocol, TypeVar

from ftcm_core.registry import load_plugins, plugins

T = TypeVar("T")
R = TypeVar("R")


class Processes(Protocol):
    """Who does work: those of this machine, :class:`Workers`, or those of a cluster."""

    @property
    def count(self) -> int:
        """How many processes there are now."""

    def begin(self, function: Callable[[T], R], item: T) -> None:
        """Get ready for work that comes soon: let processes start, and run a function in each."""

    def each(self, function: Callable[[T], R], items: Sequence[T]) -> Iterator[tuple[int, R]]:
        """Run a function on items; yield as :func:`run_parallel`, whose arguments these are."""


@contextlib.contextmanager
def processes_of(jobs: int | Processes | None, most: int | None = None) -> Iterator[Processes]:
    """Give who does the work.

    Args:
        jobs: number of processes; the number of cores by default. Or processes that are there, and stay.
        most: more processes than that would have nothing to do.
    """
    if jobs is not None and not isinstance(jobs, int):
        yield jobs
        return
    count = jobs or os.cpu_count() or 1
    with Workers(count if most is None else min(most, count)) as workers:
        yield workers


def run_parallel(
    function: Callable[[T], R], items: Sequence[T], jobs: int | Processes | None = None
) -> Iterator[tuple[int, R]]:
    """Run a function on items over several processes; yield (index of the item, result) as they finish.

    Args:
        function: picklable.
        items: picklable.
        jobs: as of :func:`processes_of`. With one process, none is started.
    """
    with processes_of(jobs, len(items)) as processes:
        yield from processes.each(function, items)


class Workers:
    """Processes that stay while they are given work, part after part.

    Args:
        count: how many; with one, or none, the work is done in this process.
    """

    def __init__(self, count: int) -> None:
        self.count = count
        self._pool: ProcessPoolExecutor | None = None

    def __enter__(self) -> Workers:
        return self

    def __exit__(self, kind: type[BaseException] | None, *rest: object) -> None:
        if self._pool is None:
            return
        if kind is not None:
            for child in multiprocessing.active_children():
                child.terminate()
        # Waiting, as Python's own end of a pool that is still ending now and then complains about that.
        self._pool.shutdown(cancel_futures=True)

    def begin(self, function: Callable[[T], R], item: T) -> None:
        """Start the processes and let each run a function, while this process goes on."""
        if self.count > 1:
            self._submit(function, [item] * self.count)

    def each(self, function: Callable[[T], R], items: Sequence[T]) -> Iterator[tuple[int, R]]:
        """Run a function on items; yield as :func:`run_parallel`, whose arguments these are."""
        if self.count < 2:
            for index, item in enumerate(items):
                yield index, function(item)
            return
        # Unlike as_completed(), it holds no lock of an unfinished future that an interrupt would leave
        # locked, for the pool to wait for without end.
        done: SimpleQueue[Future[R]] = SimpleQueue()
        futures = {future: index for index, future in enumerate(self._submit(function, items))}
        for future in futures:
            future.add_done_callback(done.put)
        for _ in items:
            future = done.get()
            index = futures.pop(future)  # so that a finished result is not held twice
            yield index, future.result()

    def _submit(self, function: Callable[[T], R], items: Sequence[T]) -> list[Future[R]]:
        with _children_ignore_interrupts():  # it starts a process of its own, which watches its semaphores
            if self._pool is None:
                self._pool = ProcessPoolExecutor(
                    self.count,
                    mp_context=multiprocessing.get_context("spawn"),
                    initializer=_begin,
                    initargs=(plugins(),),
                )
            return [self._pool.submit(function, item) for item in items]


def _begin(sources: tuple[str, ...]) -> None:
    """Make a worker ready: components of plug-ins must be known before work that has them arrives."""
    _end_with_parent()
    load_plugins(sources)


def _end_with_parent() -> None:
    """Let a worker end when the process that started it is gone, however that happened."""

    def watch() -> None:
        parent = multiprocessing.parent_process()
        if parent is not None:
            parent.join()
            os._exit(1)

    threading.Thread(target=watch, daemon=True).start()


@contextlib.contextmanager
def _children_ignore_interrupts() -> Iterator[None]:
    """Let processes started inside ignore Ctrl-C; this process ends them itself, once all are started."""
    came: list[int] = []
    # The mask is inherited. It does not keep a signal from the other threads of this process, such as
    # those of numpy, and Python then handles it here all the same: hence a handler that only notes it.
    in_main = threading.current_thread() is threading.main_thread()
    handler = signal.signal(signal.SIGINT, lambda number, _: came.append(number)) if in_main else None
    mask = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, mask)
        if in_main:
            signal.signal(signal.SIGINT, handler)
    if came:
        signal.raise_signal(signal.SIGINT)
