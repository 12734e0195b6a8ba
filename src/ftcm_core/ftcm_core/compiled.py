# SPDX-License-Identifier: Apache-2.0
"""Compiled runs: the tick of :mod:`ftcm_core.simulation`, its own functions, at the speed of machine code.

:mod:`ftcm_core.tracing` writes one tick of a run as straight-line source, by running the stages on symbols;
numba compiles it. The first tick, the last, and whatever the source does not cover (a run that diverges, a
component that cannot be compiled) are run by the plain stages, on the same state, so the result is that of
:func:`ftcm_core.simulation.simulate` but for the rounding of single operations.

Needs numba, which is imported when the first run is asked for.
"""

from __future__ import annotations

import contextlib
import hashlib
import importlib.util
import os
import stat
import sys
import tempfile
import types
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from ftcm_core.errors import FtcmError
from ftcm_core.params import Parameterised
from ftcm_core.scenario import Scenario
from ftcm_core.simulation import Loop, to_trace
from ftcm_core.simulation import simulate as simulate_plainly
from ftcm_core.trace import Array, Trace
from ftcm_core.tracing import (
    Mutable,
    NotTraceable,
    Part,
    Steps,
    Symbol,
    Tracer,
    called_by,
    literal,
    look_up,
    rebuilt,
    source,
    ways,
)

PATIENCE = 100
"""Ticks that a run may hand back to plain Python before it stays there."""
CACHE = "FTCM_CACHE_DIR"
"""Environment variable: folder of the compiled code; the user's cache folder by default."""


@dataclass(frozen=True)
class Program:
    """A compiled tick, for every run of the same structure."""

    layout: Any
    """What is fixed in the state of the run: types, lengths, texts."""
    slots: dict[Steps, str]
    fixed: dict[Steps, Any]
    ticks: Callable[..., int]
    """``ticks(parameters, state, k, last, dt_ns, rows) -> k``: runs ticks until ``last`` or one it cannot."""
    accelerations: Callable[..., int]
    """``accelerations(parameters, positions, torques, out) -> n``: M(q)^-1 tau by row."""

    def parameters(self, loop: Loop) -> Array | None:
        """Return the parameters of a run; None if this program is not for it."""
        known: dict[Steps, Any] = {}
        try:
            if any(look_up(loop, steps, known) != value for steps, value in self.fixed.items()):
                return None
            found = [look_up(loop, steps, known) for steps in self.slots]
        except (AttributeError, LookupError, TypeError):
            return None
        return np.array(found, dtype=np.float64) if all(isinstance(x, float) for x in found) else None


class CompiledTrace(Trace):
    """A trace of a compiled run, which also computes the lumped uncertainty compiled."""

    engine: str
    """How it ran: ``compiled``, or ``plain`` and why."""
    _acceleration: Callable[..., int]
    _parameters: Array

    def _as_acceleration(self, position: Array, torque: Array) -> Array:
        if not hasattr(self, "_acceleration"):
            return super()._as_acceleration(position, torque)
        out = np.empty_like(torque)
        count = self._acceleration(self._parameters, position, np.ascontiguousarray(torque), out)
        return out if count == len(out) else super()._as_acceleration(position, torque)


_programs: list[Program] = []
_refused: dict[Any, str] = {}


def require_numba() -> None:
    """Raise an FtcmError if numba is not installed."""
    if importlib.util.find_spec("numba") is None:
        raise FtcmError('compiled runs need numba; pip install "ftcm_core[compiled]", or run plainly')


def simulate(scenario: Scenario) -> CompiledTrace:
    """Run a scenario compiled.

    Args:
        scenario: what to run.

    Returns:
        The trace, as of :func:`ftcm_core.simulation.simulate`; ``engine`` says how it ran.

    Raises:
        FtcmError: numba is not installed.
    """
    require_numba()
    loop, last, dt_ns = Loop(scenario), scenario.last_tick, scenario.dt_ns
    columns = 8 if loop.exact else 10
    rows = np.empty((last + 1, columns * scenario.robot.joints))
    program, parameters, reason = None, None, ""
    compiled = handed_back = k = 0
    detail = ""
    while True:
        if 0 < k < last and not reason:
            try:
                if program is None or parameters is None:
                    program, parameters = _program(loop)
                if layout(loop) == program.layout:
                    state = np.array(list(flat(loop)), dtype=np.float64)
                    reached = program.ticks(parameters, state, k, last, dt_ns, rows)
                    put(loop, state.tolist())
                    compiled += reached - k
                    k = reached
            except NotTraceable as error:
                reason = str(error)
            except ArithmeticError:  # the tick in which a law leaves its domain is found by the plain run
                return _plain(scenario, "a law left its domain")
            handed_back += 1
            if handed_back > PATIENCE and not reason:
                reason = "too many ticks that only plain Python can run"

        def record(row: Any, k: int = k) -> None:
            rows[k] = row

        detail = loop.tick(k * dt_ns, k == last, record)
        if detail or k == last:
            break
        k += 1
    trace = to_trace(scenario, rows[: k + 1].ravel(), loop.status(detail), detail, kind=CompiledTrace)
    assert isinstance(trace, CompiledTrace)
    if program is not None and parameters is not None:
        trace.__dict__.update(_acceleration=program.accelerations, _parameters=parameters)
    trace.__dict__["engine"] = "compiled" if not reason else f"{'partly ' if compiled else ''}plain: {reason}"
    return trace


def prepare(scenario: Scenario) -> None:
    """Compile what a scenario needs, or find it compiled; :func:`simulate` says why if that is impossible."""
    require_numba()
    loop = Loop(scenario)
    if not loop.tick(0, False, lambda row: None):
        with contextlib.suppress(NotTraceable):
            _program(loop)


def _plain(scenario: Scenario, reason: str) -> CompiledTrace:
    plain = simulate_plainly(scenario)
    trace = CompiledTrace(**{name: getattr(plain, name) for name in plain.__dataclass_fields__})
    trace.__dict__["engine"] = f"plain: {reason}"
    return trace


# ---- the state of a run as a row of floats ----


def layout(part: Any) -> Any:
    """Return what is fixed in the state of a run; floats and symbols are just ``float``."""
    if isinstance(part, (float, Symbol)):
        return float
    if isinstance(part, tuple):
        return type(part), tuple([layout(x) for x in part])
    if isinstance(part, (Parameterised, Part)):
        return type(getattr(part, "_real", part))
    if isinstance(part, (str, int, type(None))):
        return part
    real = getattr(part, "_real", part)
    if not hasattr(real, "__dict__") or isinstance(real, type):
        raise NotTraceable(f"a component remembers a {type(real).__name__}, which cannot be compiled")
    return type(real), tuple([(name, layout(x)) for name, x in vars(part).items() if name not in _OWN])


def flat(part: Any) -> Iterator[Any]:
    """Yield the floats, or symbols, of the state of a run, in the order of :func:`put`."""
    if isinstance(part, (float, Symbol)):
        yield part
    elif isinstance(part, tuple):
        for x in part:
            yield from flat(x)
    elif not isinstance(part, (str, int, type(None), Parameterised, Part)):
        for name, x in vars(part).items():
            if name not in _OWN:
                yield from flat(x)


def put(part: Any, numbers: list[float]) -> None:
    """Put floats into the state of a run, in place."""
    remaining = iter(numbers)

    def filled(old: Any) -> Any:
        if isinstance(old, float):
            return next(remaining)
        if isinstance(old, tuple):
            return rebuilt(old, [filled(x) for x in old])
        if not isinstance(old, (str, int, type(None), Parameterised)):
            for name, x in list(vars(old).items()):
                setattr(old, name, filled(x))
        return old

    filled(part)


_OWN = ("_real", "_tracer")


def _stand_in(tracer: Tracer, part: Any, steps: Steps, names: Iterator[str]) -> Any:
    """Return the state of a run with symbols for its floats."""
    if isinstance(part, float):
        return Symbol(tracer, next(names))
    if isinstance(part, tuple):
        items = [_stand_in(tracer, x, (*steps, ("entry", i)), names) for i, x in enumerate(part)]
        return rebuilt(part, items)
    if isinstance(part, Parameterised):
        return Part(tracer, part, steps)
    if isinstance(part, (str, int, type(None))):
        return part
    attributes = {
        name: _stand_in(tracer, x, (*steps, ("attribute", name)), names) for name, x in vars(part).items()
    }
    return Mutable(tracer, part, attributes)


# ---- writing and compiling ----


def _program(loop: Loop) -> tuple[Program, Array]:
    """Return the program for a run, written and compiled unless there is one, and the run's parameters."""
    for program in _programs:
        parameters = program.parameters(loop)
        if parameters is not None and program.layout == layout(loop):
            return program, parameters
    tracer, text = write(loop)
    ticks, accelerations = _compile(tracer, text)
    program = Program(layout(loop), tracer.slots, tracer.fixed, ticks, accelerations)
    parameters = program.parameters(loop)
    if parameters is None:
        raise NotTraceable("a component's parameters change by themselves")
    _programs.append(program)
    return program, parameters


def write(loop: Loop) -> tuple[Tracer, str]:
    """Write the source of a run's tick.

    Args:
        loop: the run, after a tick.

    Returns:
        The tracer that wrote it, and the source.

    Raises:
        NotTraceable: it cannot be written, with the reason.
    """
    tracer, fixed = Tracer(), layout(loop)
    count = sum(1 for _ in flat(loop))

    def tick() -> Any:
        run = _stand_in(tracer, loop, (), (f"s{i}" for i in range(count)))
        row, u, d = run.act(Symbol(tracer, "time_ns"))
        run.plant.step(u, d)
        if layout(run) != fixed:
            raise NotTraceable("what the run remembers changes its structure")
        return row, tuple(flat(run))

    def acceleration() -> Any:
        q, tau = (tuple([Symbol(tracer, f"{x}{j}") for j in joints]) for x in ("q", "tau"))
        return Part(tracer, robot, (("attribute", "plant"), ("attribute", "robot"))).inertia_acceleration(
            q, tau
        )

    robot = loop.plant.robot
    joints = range(robot.joints)
    tick_tree, acceleration_tree = tracer.explore(tick), tracer.explore(acceleration)
    for tree in (tick_tree, acceleration_tree):
        if all(way[0] == "bail" for way in ways(tree)):
            raise NotTraceable(next(ways(tree))[2])

    def end_tick(result: Any) -> list[str]:
        row, state = result
        new = {f"s{i}": literal(x) for i, x in enumerate(state)}
        new = {name: text for name, text in new.items() if text != name}
        return [
            *(f"rows[k, {i}] = {literal(x)}" for i, x in enumerate(row)),
            *(f"next_{name} = {text}" for name, text in new.items()),
            *(f"{name} = next_{name}" for name in new),
            "k += 1",
        ]

    def end_acceleration(result: Any) -> list[str]:
        return [*(f"out[k, {j}] = {literal(x)}" for j, x in enumerate(result)), "k += 1"]

    parameters = [f"    {name} = parameters[{i}]" for i, name in enumerate(tracer.slots.values())]
    lines = [
        "def ticks(parameters, state, k, last, dt_ns, rows):",
        *parameters,
        *(f"    s{i} = state[{i}]" for i in range(count)),
        "    while k < last:",
        "        time_ns = k * dt_ns",
        *source(tick_tree, end_tick, "break", " " * 8),
        *(f"    state[{i}] = s{i}" for i in range(count)),
        "    return k",
        "",
        "",
        "def accelerations(parameters, positions, torques, out):",
        *parameters,
        "    k = 0",
        "    while k < len(out):",
        *(f"        q{j}, tau{j} = positions[k, {j}], torques[k, {j}]" for j in joints),
        *source(acceleration_tree, end_acceleration, "break", " " * 8),
        "    return k",
    ]
    return tracer, "\n".join(lines) + "\n"


_HEAD = '''"""Written and compiled by ftcm_core.compiled; may be deleted."""
import math
import numba
'''
_TICKS = "int64(float64[::1], float64[::1], int64, int64, int64, float64[:, ::1])"
_ACCELERATIONS = "int64(float64[::1], float64[:, ::1], float64[:, ::1], float64[:, ::1])"


def _compile(tracer: Tracer, text: str) -> tuple[Callable[..., int], Callable[..., int]]:
    import numba
    from numba.extending import register_jitable

    reached: dict[types.FunctionType, None] = {}

    def reach(function: types.FunctionType) -> None:
        if function not in reached:
            reached[function] = None
            register_jitable(function)
            for inner in called_by(function):
                reach(inner)

    for function in tracer.leaves:
        reach(function)
    imports = "".join(
        f"from {f.__module__} import {f.__qualname__} as {name}\n" for f, name in tracer.leaves.items()
    )
    # numba's cache does not see a change in a function that was compiled into another.
    digest = hashlib.sha256("\n".join([imports, text, *map(_code, reached)]).encode()).hexdigest()[:24]
    own = all(f.__module__.split(".")[0] == "ftcm_core" for f in reached)
    folder = _cache_folder() if own else None
    decorated = text
    for name, signature in (("ticks", _TICKS), ("accelerations", _ACCELERATIONS)):
        decorator = f'@numba.njit("{signature}", cache={folder is not None})\ndef {name}('
        decorated = decorated.replace(f"def {name}(", decorator)
    try:
        if folder is None:
            names: dict[str, Any] = {name: f for f, name in tracer.leaves.items()}
            exec(compile(_HEAD + decorated, f"<compiled {digest}>", "exec"), names)
            return names["ticks"], names["accelerations"]
        module = _import(folder / f"tick_{digest}.py", _HEAD + imports + decorated)
        return module.ticks, module.accelerations
    except numba.core.errors.NumbaError as error:
        raise NotTraceable(f"numba: {str(error).splitlines()[0]}") from None


def _import(path: Path, text: str) -> types.ModuleType:
    if not path.exists() or path.read_text(encoding="utf-8") != text:
        with tempfile.NamedTemporaryFile(
            "w", dir=path.parent, suffix=".tmp", delete=False, encoding="utf-8"
        ) as file:
            file.write(text)
        os.replace(file.name, path)
    name = f"ftcm_core_{path.stem}"
    spec = importlib.util.spec_from_file_location(name, path)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules[name] = module
    spec.loader.exec_module(module)
    return module


def _code(function: types.FunctionType) -> str:
    def described(code: types.CodeType) -> str:
        inner = [described(x) if isinstance(x, types.CodeType) else repr(x) for x in code.co_consts]
        return f"{code.co_code.hex()} {code.co_names} {inner}"

    numbers = [f"{n}={v!r}" for n in function.__code__.co_names
               if isinstance(v := function.__globals__.get(n), (int, float))]  # fmt: skip
    return f"{function.__module__}.{function.__qualname__} {described(function.__code__)} {numbers}"


def _cache_folder() -> Path | None:
    """Folder of the compiled code, private to the user; None if there cannot be one."""
    base = os.environ.get("XDG_CACHE_HOME") or os.path.join(os.path.expanduser("~"), ".cache")
    folder = Path(os.environ.get(CACHE) or os.path.join(base, "ftcm_core", "compiled"))
    try:
        folder.mkdir(parents=True, exist_ok=True, mode=0o700)
        about = folder.stat()
        # What is in there gets executed.
        if hasattr(os, "getuid") and (
            about.st_uid != os.getuid() or about.st_mode & (stat.S_IWGRP | stat.S_IWOTH)
        ):
            return None
        return folder if os.access(folder, os.W_OK) else None
    except OSError:
        return None
