# SPDX-License-Identifier: Apache-2.0
"""The compiled tick of a run: its source as a module of its own, compiled with numba and kept."""

from __future__ import annotations

import ast
import hashlib
import importlib.util
import inspect
import math
import os
import re
import stat
import sys
import tempfile
import textwrap
import types
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeVar, cast

import numpy as np

from ftcm_core.compiled.tracing import (
    WHOLE_NUMBERS,
    Holder,
    NotCompilable,
    Steps,
    Symbol,
    Tracer,
    globals_of,
    literal,
    look_up,
    numbers,
    shape,
    with_numbers,
)
from ftcm_core.random_streams import uniform
from ftcm_core.recording.trace import Array
from ftcm_core.simulation import Loop

CACHE = "FTCM_CACHE_DIR"
"""Environment variable: folder of the compiled code; the user's cache folder by default."""

STAGES = ("plant", "observer", "controller", "injector", "detector")
"""Attributes of a run whose ``state`` is what it remembers between ticks."""


@dataclass(frozen=True)
class Written:
    """A tick that was written, for every run of the same structure."""

    shape: Any
    """Structure of the run's state."""
    slots: dict[Steps, str]
    fixed: dict[Steps, Any]


P = TypeVar("P", bound=Written)


@dataclass(frozen=True)
class Program(Written):
    """A compiled tick."""

    ticks: Callable[..., int]
    """``ticks(parameters, state, k, last, dt_ns, columns, reached) -> k``: runs ticks until ``last`` or one
    that it cannot; ``reached[0]`` is the tick under way, also when it raises."""
    accelerations: Callable[..., int]
    """``accelerations(parameters, positions, torques, out) -> n``: M(q)^-1 tau of the model, row by row."""
    sums: Callable[..., int]
    """``sums(values, out) -> n``: of at least one row of one value per joint, the sums, row after row."""


def parameters_of(root: Any, slots: dict[Steps, str], fixed: dict[Steps, Any]) -> Array | None:
    """Return the parameters that a source reads; None if it is not for this run or stage.

    Args:
        root: the run or stage.
        slots: where the parameters are found.
        fixed: what the source has decided once.
    """
    known: dict[Steps, Any] = {}
    try:
        if any(look_up(root, steps, known) != value for steps, value in fixed.items()):
            return None
        found = [look_up(root, steps, known) for steps in slots]
    except (AttributeError, LookupError, TypeError):
        return None
    return np.array(found, dtype=np.float64) if all(isinstance(x, float) for x in found) else None


_programs: list[Program] = []


def program_for(loop: Loop) -> tuple[Program, Array]:
    """Return the program for a run that has done a tick, compiled unless there is one, and its parameters.

    Raises:
        NotCompilable: with the reason.
    """
    require_no_policies(loop)
    require_foreseen(loop.plant)
    found = matching(_programs, loop)
    if found is None:
        tracer, text = write(loop)
        functions = compiled(text, "ticks", "accelerations", "sums")
        program = Program(shape(state_of(loop)), tracer.slots, tracer.fixed, *functions)
        found = matching([program], loop)
        if found is None:
            raise NotCompilable("a component's parameters change by themselves")
        _programs.append(program)
    return found


def matching(programs: Iterable[P], loop: Loop) -> tuple[P, Array] | None:
    """Return the first program for a run that has done a tick, and its parameters; None if there is none."""
    structure = shape(state_of(loop))
    for program in programs:
        if program.shape == structure:
            parameters = parameters_of(loop, program.slots, program.fixed)
            if parameters is not None:
                return program, parameters
    return None


# ---- the state of a run ----


def state_of(loop: Loop) -> tuple[Any, ...]:
    """Return what a run remembers between ticks: an immutable value."""
    stages = (getattr(loop, name) for name in STAGES)
    return tuple([stage and stage.state for stage in stages])


def put_state(loop: Loop, state: tuple[Any, ...]) -> None:
    """Let a run go on from a state."""
    for name, inner in zip(STAGES, state):
        if getattr(loop, name) is not None:
            getattr(loop, name).state = inner


# ---- writing ----


def write(loop: Loop) -> tuple[Tracer, str]:
    """Write the module of a run's tick.

    Args:
        loop: the run, after a tick.

    Returns:
        The tracer that followed the tick, and the module's source.

    Raises:
        NotCompilable: with the reason.
    """
    tracer = Tracer()
    state = state_of(loop)
    count = sum(1 for _ in numbers(state))
    tick_lines = tracer.lines_of(lambda: _tick(tracer, loop, state))
    acceleration_lines = tracer.lines_of(lambda: _acceleration(tracer, loop))
    parameters = reading(tracer)
    joints = range(loop.observer.model.joints)
    lines = [
        f"@numba.njit({_TICKS!r}, cache=CACHED)",
        "def ticks(parameters, state, k, last, dt_ns, columns, reached):",
        *indented(1, parameters),
        *indented(1, [f"s{i} = state[{i}]" for i in range(count)]),
        "    while k < last:",
        "        reached[0] = k",
        "        time_ns = k * dt_ns",
        *indented(2, tick_lines),
        *indented(1, [f"state[{i}] = s{i}" for i in range(count)]),
        "    return k",
        "",
        "",
        f"@numba.njit({_ACCELERATIONS!r}, cache=CACHED)",
        "def accelerations(parameters, positions, torques, out):",
        *indented(1, parameters),
        "    k = 0",
        "    while k < len(out):",
        *indented(2, acceleration_lines),
        "    return k",
        "",
        "",
        f"@numba.njit({_SUMS!r}, cache=CACHED)",
        "def sums(values, out):",
        *indented(1, [f"s{j} = values[0, {j}]" for j in joints]),
        "    k = 1",
        "    while k < len(values):",
        *indented(2, [f"s{j} += values[k, {j}]" for j in joints]),
        "        k += 1",
        *indented(1, [f"out[{j}] = s{j}" for j in joints]),
        "    return k",
    ]
    return tracer, module_of(tracer, lines)


def require_foreseen(plant: Any) -> None:
    """Raise NotCompilable for a plant whose engine is no Python, or whose robot changes no one knows when."""
    if plant.plant.foreign:
        raise NotCompilable(f"the plant {plant.plant.type_name!r} is another library's")
    if not plant.foreseen:
        raise NotCompilable("a fault changes the robot at a time that is not known from the start")


def require_no_policies(loop: Loop) -> None:
    """Raise NotCompilable for a run in which policies may change what a tick does."""
    if loop.accommodation:
        raise NotCompilable("policies change the law, the observer or what is measured while it runs")


def reading(tracer: Tracer) -> list[str]:
    """Lines that read the parameters."""
    return [f"{name} = parameters[{i}]" for i, name in enumerate(tracer.slots.values())]


def module_of(tracer: Tracer, lines: list[str]) -> str:
    """Source of a module with these functions, and those that they call."""
    return "\n".join([_HEAD, *_leaves(tracer), *_blocks(tracer), *lines]) + "\n"


def _blocks(tracer: Tracer) -> Iterator[str]:
    """Source of the functions that the tracer has set apart."""
    for name, count, lines in tracer.blocks:
        yield "@numba.njit"
        yield from block(tracer, name, count, lines)
        yield "\n"


def block(tracer: Tracer, name: str, count: int, lines: list[str]) -> list[str]:
    """Source of a function that the tracer has set apart, of its lines."""
    positions = {name: i for i, name in enumerate(tracer.slots.values())}
    used = sorted(set(re.findall(r"\bp\d+\b", "\n".join(lines))), key=positions.__getitem__)
    return [
        f"def {name}({', '.join(['parameters', *(f'a{i}' for i in range(count))])}):",
        *indented(1, [f"{p} = parameters[{positions[p]}]" for p in used]),
        *indented(1, lines),
    ]


def _tick(tracer: Tracer, loop: Loop, state: tuple[Any, ...]) -> list[str]:
    joints = loop.observer.model.joints
    row, moved = follow_tick(tracer, loop, state)
    return [
        *(f"columns[{i // joints}, k, {i % joints}] = {literal(x)}" for i, x in enumerate(row)),
        *following(state, moved),
        "k += 1",
    ]


def follow_tick(tracer: Tracer, loop: Loop, state: tuple[Any, ...]) -> tuple[tuple[Any, ...], Any]:
    """Follow a tick of a run.

    Args:
        tracer: writes its lines.
        loop: the run, after a tick.
        state: its state.

    Returns:
        What the tick records and the next state, of symbols.
    """
    run: Any = Holder(tracer, loop, ())
    symbols = with_numbers(state, (Symbol(tracer, f"s{i}") for i in range(10**9)))
    put_state(run, symbols)
    run.plant.changes = ()  # the ticks in which the robot changes are not run by the source
    time_ns = Symbol(tracer, "time_ns")
    row, u, d = run.act(time_ns)
    run.plant.step(time_ns, u, d)
    return row, state_of(run)


def changed_numbers(state: Any, moved: Any) -> dict[str, str]:
    """Return what becomes of the numbers of a state, by name, as source; of those that change.

    Raises:
        NotCompilable: the next state has another structure.
    """
    if shape(moved) != shape(state):
        raise NotCompilable("what a component remembers changes its structure from tick to tick")
    found = {f"s{i}": literal(x) for i, x in enumerate(numbers(moved))}
    return {name: text for name, text in found.items() if text != name}


def following(state: Any, moved: Any) -> list[str]:
    """Lines that put the next state in the place of the present one.

    Raises:
        NotCompilable: it has another structure.
    """
    changed = changed_numbers(state, moved)
    return [
        *(f"next_{name} = {text}" for name, text in changed.items()),
        *(f"{name} = next_{name}" for name in changed),
    ]


def _acceleration(tracer: Tracer, loop: Loop) -> list[str]:
    joints = range(loop.observer.model.joints)
    q = tuple([tracer.write(f"positions[k, {j}]") for j in joints])
    tau = tuple([tracer.write(f"torques[k, {j}]") for j in joints])
    model = tracer.value(loop.observer.model, (("attribute", "observer"), ("attribute", "model")))
    found = model.inertia_acceleration(q, tau)
    return [*(f"out[k, {j}] = {literal(x)}" for j, x in enumerate(found)), "k += 1"]


def indented(depth: int, lines: list[str]) -> Iterator[str]:
    """Yield lines of a deeper level."""
    return (" " * 4 * depth + line for line in lines)


_TICKS = "int64(float64[::1], float64[::1], int64, int64, int64, float64[:, :, ::1], int64[::1])"
_ACCELERATIONS = "int64(float64[::1], float64[:, ::1], float64[:, ::1], float64[:, ::1])"
_SUMS = "int64(float64[:, ::1], float64[::1])"
_HEAD = '''"""Written and compiled by ftcm_core.compiled; may be deleted."""

import math

import numba
import numpy


@numba.njit
def checked_pow(x, y):
    """x ** y, which raises where Python does."""
    result = x**y
    if not math.isfinite(result) and math.isfinite(x) and math.isfinite(y):
        raise OverflowError
    return result

'''
_CHECKED = '''
@numba.njit
def checked_{name}(x):
    """math.{name}, which raises where Python does: beyond its domain, and where it overflows."""
    result = math.{name}(x)
    if not math.isfinite(result) and (math.isfinite(x) or (result != result and x == x)):
        raise ValueError
    return result

'''
WHOLE_NUMBERS[cast(types.FunctionType, uniform)] = '''
def uniform(key, counter):
    """Number of a stream, in 64-bit whole numbers."""
    z = (numpy.uint64(key) << numpy.uint64(11)) + (
        numpy.uint64(counter) + numpy.uint64(1)
    ) * numpy.uint64(0x9E3779B97F4A7C15)
    z = (z ^ (z >> numpy.uint64(30))) * numpy.uint64(0xBF58476D1CE4E5B9)
    z = (z ^ (z >> numpy.uint64(27))) * numpy.uint64(0x94D049BB133111EB)
    return (numpy.float64((z ^ (z >> numpy.uint64(31))) >> numpy.uint64(12)) + 0.5) * 2.0**-52
'''


class _Leaf(ast.NodeTransformer):
    """Rewrites a leaf for the module: global names as they are called there, powers and math checked."""

    def __init__(self, tracer: Tracer, names: dict[str, str]) -> None:
        self._tracer, self._names = tracer, names

    def visit_FunctionDef(self, node: ast.FunctionDef) -> ast.AST:
        node.returns, node.decorator_list = None, []
        for argument in node.args.args:
            argument.annotation = None
        if isinstance(node.body[0], ast.Expr) and isinstance(node.body[0].value, ast.Constant):
            node.body = node.body[1:] or [ast.Pass()]
        return self.generic_visit(node)

    def visit_AnnAssign(self, node: ast.AnnAssign) -> ast.AST:
        assert node.value is not None
        return self.generic_visit(ast.Assign(targets=[node.target], value=node.value, lineno=node.lineno))

    def visit_Name(self, node: ast.Name) -> ast.AST:
        return ast.Name(id=self._names.get(node.id, node.id), ctx=node.ctx)

    def visit_Attribute(self, node: ast.Attribute) -> ast.AST:
        self.generic_visit(node)
        if (
            isinstance(node.value, ast.Name)
            and node.value.id == "math"
            and callable(getattr(math, node.attr))
        ):
            return ast.Name(id=self._tracer.checked(node.attr), ctx=ast.Load())
        return node

    def visit_BinOp(self, node: ast.BinOp) -> ast.AST:
        constant = isinstance(node.left, ast.Constant) and isinstance(node.right, (ast.Constant, ast.UnaryOp))
        self.generic_visit(node)
        if not isinstance(node.op, ast.Pow) or constant:
            return node
        return ast.Call(
            func=ast.Name(id="checked_pow", ctx=ast.Load()), args=[node.left, node.right], keywords=[]
        )


def _leaves(tracer: Tracer) -> list[str]:
    """Source of the leaves that a tick calls, and of what they call, each before its use."""
    texts: list[str] = []
    names: dict[types.FunctionType, str] = {}

    def name_of(function: types.FunctionType) -> str:
        if function not in names:
            names[function] = tracer.leaves.get(function) or f"inner{len(names)}"
            if function in WHOLE_NUMBERS:
                body = WHOLE_NUMBERS[function].replace(function.__name__, names[function], 1)
                texts.append(f"# {function.__module__}.{function.__qualname__}\n@numba.njit{body}\n")
            else:
                texts.append(leaf(function))
        return names[function]

    def leaf(function: types.FunctionType) -> str:
        renamed: dict[str, str] = {}
        for name, found in globals_of(function):
            if isinstance(found, types.FunctionType):
                renamed[name] = name_of(found)
            elif isinstance(found, types.BuiltinFunctionType):
                renamed[name] = tracer.checked(found.__name__)
            elif found is math:
                renamed[name] = "math"
            else:
                renamed[name] = literal(found)
        try:
            tree = ast.parse(textwrap.dedent(inspect.getsource(function)))
        except OSError:
            raise NotCompilable(f"the source of {function.__qualname__}() cannot be found") from None
        (definition,) = tree.body
        assert isinstance(definition, ast.FunctionDef)
        rewritten = _Leaf(tracer, renamed).visit(definition)
        rewritten.name = names[function]
        text = ast.unparse(ast.fix_missing_locations(rewritten))
        return f"# {function.__module__}.{function.__qualname__}\n@numba.njit\n{text}\n"

    for function in tracer.leaves:
        name_of(function)
    return [*(_CHECKED.format(name=name) for name in sorted(tracer.math)), *texts]


# ---- compiling ----


def compiled(text: str, *functions: str) -> list[Callable[..., int]]:
    """Compile a module, or find it compiled.

    Args:
        text: its source.
        functions: what of it is wanted.

    Raises:
        NotCompilable: numba does not take it.
    """
    import numba

    folder = cache_folder()
    digest = hashlib.sha256(text.encode()).hexdigest()[:24]
    name = f"ftcm_compiled_{digest}"
    text = text.replace("cache=CACHED", f"cache={folder is not None}")
    try:
        if folder is None:
            names: dict[str, Any] = {"__name__": name}
            exec(compile(text, f"<{name}>", "exec"), names)
            return [names[function] for function in functions]
        module = _imported(folder / f"tick_{digest}.py", name, text)
        return [getattr(module, function) for function in functions]
    except numba.core.errors.NumbaError as error:
        raise NotCompilable(f"numba: {str(error).splitlines()[0]}") from None


def _imported(path: Path, name: str, text: str) -> types.ModuleType:
    if not path.exists() or path.read_text(encoding="utf-8") != text:
        with tempfile.NamedTemporaryFile(
            "w", dir=path.parent, suffix=".tmp", delete=False, encoding="utf-8"
        ) as file:
            file.write(text)
        os.replace(file.name, path)
    spec = importlib.util.spec_from_file_location(name, path)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules[name] = module
    spec.loader.exec_module(module)
    return module


def cache_folder() -> Path | None:
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
