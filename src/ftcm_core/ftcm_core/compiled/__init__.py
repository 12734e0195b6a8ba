# SPDX-License-Identifier: Apache-2.0
"""Compiled runs: the tick of :mod:`ftcm_core.simulation`, its own functions, at the speed of machine code.

Three steps, one file each:

1. :mod:`~ftcm_core.compiled.tracing` runs the tick once on symbols instead of numbers. Every operation on a
   symbol writes a line, so one tick becomes straight-line source.
2. :mod:`~ftcm_core.compiled.program` puts that source, and the functions of plain floats that it calls, into
   a module that needs nothing else, compiles it with numba and keeps it in a cache folder.
3. :mod:`~ftcm_core.compiled.run` runs it. The first and the last tick, the tick in which a payload is picked
   up, and the tick in which a run ends are run by the plain functions, on the same state.

Needs numba, which is imported when the first run is asked for.
"""

from ftcm_core.compiled.program import CACHE
from ftcm_core.compiled.run import prepare, require_numba, simulate
from ftcm_core.compiled.tracing import NotCompilable

__all__ = ["CACHE", "NotCompilable", "prepare", "require_numba", "simulate"]
