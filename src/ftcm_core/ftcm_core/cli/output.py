# SPDX-License-Identifier: Apache-2.0
"""What the command line says: results on stdout; warnings, progress and errors on stderr."""

from __future__ import annotations

import contextlib
import os
import sys
from collections.abc import Callable
from typing import Any

from tqdm import tqdm


def note(text: str) -> None:
    """Say one line on stderr, where there is one."""
    if sys.stderr is not None:
        print(f"ftcm: {text}", file=sys.stderr, flush=True)


def fail(message: str, code: int) -> int:
    """Say an error in one line and return the exit status."""
    note("error: " + " ".join(message.split()))
    return code


def drop_stdout() -> None:
    """Give up on stdout, so that the interpreter does not complain about it when it exits."""
    with contextlib.suppress(OSError, ValueError, AttributeError):
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())


@contextlib.contextmanager
def progress(unit: str) -> Any:
    """Show how far something is: a line that is rewritten on a terminal, in a file one now and then.

    Args:
        unit: what is counted.

    Yields:
        What is called with how much is done and how much there is; what was done before the first call does
        not count for the time that is left.
    """
    bar: Any = None

    def show(done: int, total: int) -> None:
        nonlocal bar
        if sys.stderr is None:
            return
        if bar is None:
            every = 0.1 if sys.stderr.isatty() else 5.0
            bar = tqdm(
                total=total,
                initial=done,
                unit=unit,
                desc="ftcm",
                mininterval=every,
                leave=False,
                file=sys.stderr,
            )
        bar.update(done - bar.n)

    shown: Callable[[int, int], None] = show
    try:
        yield shown
    finally:
        if bar is not None:
            bar.close()
