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
from typing import TypeVar

from ftcm_core.registry import load_plugins, plugins

T = TypeVar("T")
R = TypeVar("R")


def run_parallel(
    function: Callable[[T], R], items: Sequence[T], jobs: int | None = None
) -> Iterator[tuple[int, R]]:
    """Run a function on items over several processes; yield (index of the item, result) as they finish.

    Args:
        function: picklable.
        items: picklable.
        jobs: number of processes; the number of cores by default. With one, no process is started.
    """
    with Workers(min(len(items), jobs or os.cpu_count() or 1)) as workers:
        yield from workers.each(function, items)


class Workers:
    """Processes that stay while they are given work, part after part.

    Args:
        count: how many; with one, or none, the work is done in this process.
    """

    def __init__(self, count: int) -> None:
        self._count = count
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

    def each(self, function: Callable[[T], R], items: Sequence[T]) -> Iterator[tuple[int, R]]:
        """Run a function on items; yield as :func:`run_parallel`, whose arguments these are."""
        if self._count < 2:
            for index, item in enumerate(items):
                yield index, function(item)
            return
        # Unlike as_completed(), it holds no lock of an unfinished future that an interrupt would leave
        # locked, for the pool to wait for without end.
        done: SimpleQueue[Future[R]] = SimpleQueue()
        with _children_ignore_interrupts():  # it starts a process of its own, which watches its semaphores
            if self._pool is None:
                self._pool = ProcessPoolExecutor(
                    self._count,
                    mp_context=multiprocessing.get_context("spawn"),
                    initializer=_begin,
                    initargs=(plugins(),),
                )
            futures: dict[Future[R], int] = {
                self._pool.submit(function, item): index for index, item in enumerate(items)
            }
            for future in futures:
                future.add_done_callback(done.put)
        for _ in items:
            future = done.get()
            index = futures.pop(future)  # so that a finished result is not held twice
            yield index, future.result()


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
