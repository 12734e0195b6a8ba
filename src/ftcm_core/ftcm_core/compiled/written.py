# SPDX-License-Identifier: Apache-2.0
"""The tick of a run, written out as one function of Python: for plain runs, without numba.

It does the operations of the stages on the same floats, so every bit of a run is equal. It is more than twice
as fast: no vectors and records are made and taken apart on the way, and what several stages compute alike is
computed once.
"""

from __future__ import annotations

import math
import operator
import re
from array import array
from collections import Counter
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from typing import Any

from ftcm_core.compiled.program import (
    Written,
    block,
    changed_numbers,
    follow_tick,
    indented,
    matching,
    put_state,
    require_foreseen,
    require_no_policies,
    state_of,
)
from ftcm_core.compiled.tracing import NotCompilable, Tracer, literal, numbers, shape, with_numbers
from ftcm_core.simulation.loop import Loop

WORTH = 2000
"""For fewer ticks nothing is written (chosen: to write takes as long as some 1000 ticks, stage by stage)."""
MANY_LINES = 400
"""A robot's method that writes more lines than that is a function of its own (chosen: a PUMA's have less)."""
LONG = 240
"""Characters of an expression beyond which it is not put into another one (chosen)."""


@dataclass(frozen=True)
class PythonTicks(Written):
    """A written tick, as a function of Python."""

    ticks: Callable[..., tuple[int, tuple[float, ...]]]
    """``ticks(parameters, state, k, last, dt_ns, record) -> (k, state)``: runs ticks until ``last`` or one
    that has to be run stage by stage."""


_written: list[PythonTicks] = []


class Ahead:
    """Runs ticks of a loop as they are written, where they can be."""

    def __init__(self, loop: Loop, rows: array[float]) -> None:
        """Stand beside a loop.

        Args:
            loop: the run.
            rows: takes what is recorded.
        """
        self._loop, self._record = loop, rows.extend
        self._found: tuple[PythonTicks, tuple[float, ...]] | None = None
        self._known = False

    def forget(self) -> None:
        """Something of the run was exchanged."""
        self._known = False

    def run(self, k: int, stop: int, end: int) -> int:
        """Run ticks.

        Args:
            k: the first of them; the loop has run the one before.
            stop: the tick to stop before.
            end: until then nothing of the run is exchanged.

        Returns:
            The first tick that was not run: ``stop``, or one that the loop has to run itself.
        """
        if not self._known:
            self._known, self._found = True, _found_for(self._loop, end - k)
        if self._found is None:
            return k
        program, parameters = self._found
        before = state_of(self._loop)
        given = tuple(numbers(before))
        k, state = program.ticks(parameters, given, k, stop, self._loop.plant.dt_ns, self._record)
        put_state(self._loop, with_numbers(before, iter(state)))
        return k


def _found_for(loop: Loop, ticks: int) -> tuple[PythonTicks, tuple[float, ...]] | None:
    """What is written for a run, and its parameters; None if nothing is or can be, or it is not worth it."""
    try:
        require_no_policies(loop)
        require_foreseen(loop.plant)
        found = matching(_written, loop)
        if found is None and ticks >= WORTH:
            _written.append(write(loop))
            found = matching(_written[-1:], loop)
    except NotCompilable:
        return None
    return found and (found[0], tuple(found[1].tolist()))


def write(loop: Loop) -> PythonTicks:
    """Write the tick of a run.

    Args:
        loop: the run, after a tick.

    Raises:
        NotCompilable: with the reason.
    """
    tracer, state = Tracer(MANY_LINES), state_of(loop)
    row: list[str] = []
    following: dict[str, str] = {}

    def tick() -> list[str]:
        recorded, moved = follow_tick(tracer, loop, state)
        row.extend(map(literal, recorded))
        following.update(changed_numbers(state, moved))
        return []

    once, lines = _parted(tracer.lines_of(tick))
    lines, results = _tightened(lines, [*row, *following.values()])
    given = _tuple(f"s{i}" for i, _ in enumerate(numbers(state)))
    source = [
        *_blocks(tracer),
        "def ticks(parameters, state, k, last, dt_ns, record):",
        f"    {_tuple(tracer.slots.values())} = parameters",
        f"    {given} = state",
        "    try:",
        *indented(2, once),
        "        for k in range(k, last):",
        "            time_ns = k * dt_ns",
        *indented(3, lines),
        f"            row = {_tuple(results[: len(row)])}",
        f"            {_tuple(following)} = {_tuple(results[len(row) :])}",
        "            record(row)",
        "        else:",
        "            k = last",
        "    except (ArithmeticError, ValueError):",
        "        pass  # the stages say how",
        f"    return k, {given}",
    ]
    names: dict[str, Any] = {"math": math, "checked_pow": operator.pow}
    names |= {f"checked_{name}": getattr(math, name) for name in tracer.math}
    names |= {name: function for function, name in tracer.leaves.items()}
    exec(compile("\n".join(source), "<written tick>", "exec"), names)
    return PythonTicks(shape(state), tracer.slots, tracer.fixed, names["ticks"])


def _tuple(items: Iterable[str]) -> str:
    return f"({''.join(f'{item}, ' for item in items)})"


def _blocks(tracer: Tracer) -> Iterator[str]:
    """Source of the functions that the tracer has set apart."""
    for name, count, lines in tracer.blocks:
        lines, (returned,) = _tightened(lines[:-1], [lines[-1]])
        yield from block(tracer, name, count, [*lines, returned])


_VARIABLE = re.compile(r"\bv\d+\b")


def _parted(lines: list[str]) -> tuple[list[str], list[str]]:
    """The lines that say the same in every tick, and the others."""
    once: list[str] = []
    others: list[str] = []
    known: set[str] = set()
    for line in lines:
        name, _, expression = line.partition(" = ")
        moving = re.search(r"\b(s\d+|time_ns)\b", line) or not known.issuperset(_VARIABLE.findall(expression))
        if moving or not expression:
            others.append(line)
        else:
            once.append(line)
            known.add(name)
    return once, others


def _tightened(lines: list[str], results: list[str]) -> tuple[list[str], list[str]]:
    """Put what is used once where it is used, and take tuples apart where they are made.

    Args:
        lines: ``name = expression``, each name once; or ``if not name: break``.
        results: expressions that follow.
    """
    entries: dict[str, dict[int, str]] = {}
    """Tuples that functions return: the names of their entries."""
    kept: list[tuple[str, str]] = []
    for line in lines:
        name, _, expression = line.partition(" = ")
        if entry := re.fullmatch(r"(v\d+)\[(\d+)\]", expression):
            entries.setdefault(entry[1], {})[int(entry[2])] = name
        else:
            kept.append((name, expression))
    uses = Counter(_VARIABLE.findall("\n".join([*(e or name for name, e in kept), *results])))
    inside: dict[str, str] = {}

    def put_in(text: str) -> str:
        return _VARIABLE.sub(lambda found: inside.pop(found[0], found[0]), text)

    out = []
    for name, expression in kept:
        if not expression:
            out.append(put_in(name))
        elif name in entries:
            out.append(f"{_tuple(x for _, x in sorted(entries[name].items()))} = {put_in(expression)}")
        else:
            text = put_in(expression)
            if uses[name] == 1 and len(text) < LONG:
                inside[name] = f"({text})"
            else:
                out.append(f"{name} = {text}")
    return out, [put_in(text) for text in results]
