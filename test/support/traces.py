# SPDX-License-Identifier: Apache-2.0
"""Comparing recorded runs, and reading them row by row."""

from __future__ import annotations

from typing import Any

import numpy as np

from ftcm_core.recording.trace import Trace
from ftcm_core.signals import Vector


def same(a: Trace, b: Trace, rows: slice = slice(None)) -> bool:
    """Whether two runs have the same columns and stamps, equal bit for bit.

    Args:
        a: one run.
        b: the other.
        rows: of both, which are compared; all by default.
    """
    return (
        list(a.columns) == list(b.columns)
        and a.time_ns[rows].tobytes() == b.time_ns[rows].tobytes()
        and all(
            x.shape[1:] == y.shape[1:] and x[rows].tobytes() == y[rows].tobytes()
            for x, y in zip(a.columns.values(), b.columns.values())
        )
    )


def rows_of(trace: Trace) -> list[dict[str, Vector]]:
    """Every tick of a run: its columns by name, as the plain floats that were recorded."""
    lists = {name: [tuple(row) for row in column.tolist()] for name, column in trace.columns.items()}
    return [dict(zip(lists, row)) for row in zip(*lists.values())]


def close(a: Trace, b: Trace, rtol: float = 1e-9, atol: float = 1e-9) -> None:
    """Assert that two runs ended alike and agree in every column.

    Args:
        a: one run.
        b: the other.
        rtol: largest relative difference.
        atol: largest absolute difference.
    """
    about: tuple[Any, ...] = (a.status, a.ticks, a.ended_at, list(a.columns))
    assert about == (b.status, b.ticks, b.ended_at, list(b.columns))
    for name, column in a.columns.items():
        np.testing.assert_allclose(column, b.columns[name], rtol=rtol, atol=atol, err_msg=name)
