# SPDX-License-Identifier: Apache-2.0
"""What is written of a tick, against the stages: for Python, and for numba but run by Python itself."""

from __future__ import annotations

import warnings
from typing import Any

from ftcm_core.compiled import program, tracing
from ftcm_core.compiled.written import write
from ftcm_core.simulation import Loop


class _Plain:
    """Stands for numba: leaves functions as they are."""

    @staticmethod
    def njit(*given: Any, **_: Any) -> Any:
        return given[0] if given and callable(given[0]) else lambda function: function


class WrittenTick:
    """The tick of a run that has done one as it is written for numba, run by Python; and its state there."""

    def __init__(self, loop: Loop) -> None:
        """Write it.

        Raises:
            NotCompilable: as of :func:`ftcm_core.compiled.program.program_for`.
        """
        program.require_foreseen(loop.plant)
        tracer, self.text = program.write(loop)
        names: dict[str, Any] = {"numba": _Plain, "CACHED": False, "__name__": "written"}
        exec(self.text.replace("\nimport numba\n", "\n", 1), names)
        known: dict[Any, Any] = {}
        self.parameters = [tracing.look_up(loop, steps, known) for steps in tracer.slots]
        self.state = list(program.numbers(program.state_of(loop)))
        self.reached = [0]
        self._ticks, self._dt_ns, self._joints = names["ticks"], loop.plant.dt_ns, loop.observer.model.joints
        self._written: dict[tuple[int, int, int], float] = {}

    def run(self, first: int, last: int) -> int:
        """Run ticks ``first`` to before ``last``; return the first one not run."""
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", RuntimeWarning)  # whole numbers modulo 2^64 are meant to overflow
            reached: int = self._ticks(
                self.parameters, self.state, first, last, self._dt_ns, self._written, self.reached
            )
        return reached

    @property
    def rows(self) -> list[list[float]]:
        """What it recorded, tick by tick."""
        found: dict[int, list[float]] = {}
        for (_, k, _), value in sorted(self._written.items()):
            found.setdefault(k, []).append(float(value))
        return [found[k] for k in sorted(found)]


def state_numbers(loop: Loop) -> list[float]:
    """The floats that a run remembers, in the order of the written tick's state."""
    return list(program.numbers(program.state_of(loop)))


def written_as_plain(loop: Loop, other: Loop, first: int, last: int) -> None:
    """Both go on from tick ``first``, one by what is written: rows and states are equal bit for bit."""
    for_numba, plain = WrittenTick(loop), []  # type: WrittenTick, list[Any]
    assert for_numba.run(first, last) == last
    for_python, rows = write(loop), []  # type: Any, list[Any]
    parameters = program.parameters_of(loop, for_python.slots, for_python.fixed)
    assert parameters is not None
    given = parameters.tolist(), state_numbers(loop), first, last, loop.plant.dt_ns
    reached, state = for_python.ticks(*given, rows.append)
    assert reached == last
    for k in range(first, last):
        assert not other.tick(k * other.plant.dt_ns, False, plain.append)
    assert for_numba.rows == [list(row) for row in plain]
    assert rows == plain
    assert for_numba.state == list(state) == state_numbers(other)
