# SPDX-License-Identifier: Apache-2.0
"""From a tick to straight-line source, by running it once on symbols instead of numbers.

The laws, models and stages are run as they are; arithmetic on a :class:`Symbol` writes a line instead of
computing a number. What is decided by types, texts and whole numbers (which components, how many joints) is
thereby decided once. Nothing here knows an equation. Two things need care in a component:

- **Decisions on numbers** (``if x > 0.0``) stand in a function of plain floats that says how many floats it
  returns (``-> float``, ``-> tuple[float, float]``). Such a *leaf* is not followed: the source calls it.
- **Conditions without which a run cannot go on** are asked through :func:`~ftcm_core.numeric.holds`. The
  source checks them, and stops before a tick in which one does not hold.
"""

from __future__ import annotations

import functools
import math
import sys
import types
from collections.abc import Callable, Iterator
from typing import Any, cast

from ftcm_core.errors import FtcmError
from ftcm_core.numeric import holds
from ftcm_core.params import Parameterised
from ftcm_core.robots import Robot

UNCHECKED = {"isfinite", "isnan", "isinf", "copysign", "atan2", "hypot", "floor", "ceil", "fmod"}
"""Functions of :mod:`math` that mean the same compiled."""

MANY_LINES = 150
"""A robot's method that writes more lines than that becomes a function of the source, if it is compiled."""
DYNAMICS = {
    "inverse_dynamics", "forward_dynamics", "gravity", "inertia_torque", "inertia_acceleration",
    "inertia_rate_torque",
}  # fmt: skip

Steps = tuple[tuple[str, Any], ...]
"""Where a value is found in a run: attributes, entries of tuples, joints of components."""


class NotCompilable(FtcmError):
    """A component does something that cannot be compiled; the message says what."""


class Symbol:
    """A number that is known only when the source runs."""

    __slots__ = ("name", "tracer")
    __hash__ = None  # type: ignore[assignment]  # no table may be keyed by a number that is not known

    def __init__(self, tracer: Tracer, name: str) -> None:
        """Stand for the variable ``name``."""
        self.tracer = tracer
        self.name = name

    def __bool__(self) -> bool:
        frame = sys._getframe(1)
        raise NotCompilable(
            f"{getattr(frame.f_code, 'co_qualname', frame.f_code.co_name)}() decides on a number "
            f"(line {frame.f_lineno} of {frame.f_code.co_filename.rpartition('/')[2]}); put the "
            "decision into a function of plain floats that is annotated with the floats it returns"
        )

    def __neg__(self) -> Any:
        return self.tracer.operate("-{}", self)

    def __pos__(self) -> Symbol:
        return self

    def __abs__(self) -> Any:
        return self.tracer.operate("abs({})", self)

    def __float__(self) -> float:
        raise NotCompilable("a function outside Python's math and the component's own wants a number")


def _operator(name: str, form: str, *, reflected: bool) -> None:
    def forward(self: Symbol, other: Any) -> Any:
        return self.tracer.operate(form, self, other)

    def backward(self: Symbol, other: Any) -> Any:
        return self.tracer.operate(form, other, self)

    setattr(Symbol, f"__{name}__", forward)
    if reflected:
        setattr(Symbol, f"__r{name}__", backward)


for _name, _sign in {"add": "+", "sub": "-", "mul": "*", "truediv": "/"}.items():
    _operator(_name, f"{{}} {_sign} {{}}", reflected=True)
_operator("pow", "checked_pow({}, {})", reflected=True)
for _name, _sign in {"lt": "<", "le": "<=", "gt": ">", "ge": ">=", "eq": "==", "ne": "!="}.items():
    _operator(_name, f"{{}} {_sign} {{}}", reflected=False)


class Tracer:
    """Runs functions on symbols and keeps the lines they write."""

    def __init__(self, many_lines: int = MANY_LINES) -> None:
        """Start with nothing written.

        Args:
            many_lines: a robot's method that writes more lines than that becomes a function of the source.
        """
        self._many_lines = many_lines
        self.lines: list[str] = []
        self.leaves: dict[types.FunctionType, str] = {}
        """Functions of plain floats that the source calls, and their names there."""
        self.slots: dict[Steps, str] = {}
        """Parameters that the source reads: where each is found, and its name there."""
        self.fixed: dict[Steps, Any] = {}
        """What was decided once: the source holds for runs that have the same."""
        self.blocks: list[tuple[str, int, list[str]]] = []
        """Functions of the source: name, number of arguments, lines; each before its use."""
        self._apart: dict[Any, tuple[str, Any] | None] = {}
        self.math: set[str] = set()
        """Functions of :mod:`math` that the source calls checked."""
        self._written: dict[str, Symbol] = {}
        self._copies: dict[types.FunctionType, types.FunctionType] = {}

    # ---- writing ----

    def operate(self, form: str, *operands: Any) -> Any:
        """Write one operation; return the symbol of its result."""
        if not all(isinstance(x, (Symbol, float, int)) for x in operands):
            return NotImplemented
        return self.write(form.format(*map(literal, operands)))

    def write(self, expression: str) -> Symbol:
        """Write ``name = expression``; one already written is not written again."""
        if expression not in self._written:
            symbol = Symbol(self, f"v{len(self._written)}")
            self.lines.append(f"{symbol.name} = {expression}")
            self._written[expression] = symbol
        return self._written[expression]

    def require(self, condition: Any) -> bool:
        """In the place of :func:`~ftcm_core.numeric.holds`: where it does not, the source stops."""
        if isinstance(condition, Symbol):
            self.lines.append(f"if not {condition.name}: break")
            return True
        return bool(condition)

    def checked(self, name: str) -> str:
        """Name in the source of a function of :mod:`math`: one that raises where Python's does."""
        if name in UNCHECKED:
            return f"math.{name}"
        self.math.add(name)
        return f"checked_{name}"

    def lines_of(self, run: Callable[[], list[str]]) -> list[str]:
        """Return the lines that a function writes, and then those that it returns.

        Raises:
            NotCompilable: the function raised something.
        """
        self.lines, self._written = [], {}
        try:
            last = run()
        except NotCompilable:
            raise
        except Exception as error:  # whatever a component raises when it is given symbols
            raise NotCompilable(f"{type(error).__name__} while it was followed: {error}") from None
        return [*self.lines, *last]

    # ---- following functions ----

    def call(self, function: types.FunctionType, *arguments: Any, **named: Any) -> Any:
        """Call a function: a leaf by the source, any other by following it."""
        numbers = all(isinstance(x, (Symbol, float)) for x in arguments)
        if numbers and not named and any(isinstance(x, Symbol) for x in arguments):
            returned = floats_returned(function)
            if returned is not None:
                name = self.leaves.setdefault(function, f"leaf{len(self.leaves)}")
                result = self.write(f"{name}({', '.join(map(literal, arguments))})")
                return result if returned == 0 else tuple(
                    [self.write(f"{result.name}[{i}]") for i in range(returned)]
                )  # fmt: skip
        return self.follow(function)(*arguments, **named)

    def call_apart(self, function: types.FunctionType, stand: Component, *arguments: Any) -> Any:
        """Call a method of a robot: one that writes many lines becomes a function of the source.

        A robot of many joints is asked for its dynamics many times in a tick. Written out each time, the
        source would take minutes to compile.
        """
        given = list(numbers(arguments))
        key = (function, stand.steps, shape(arguments))
        if key not in self._apart:
            outer = self.lines, self._written
            self.lines, self._written = [], {}
            formal = [Symbol(self, f"a{i}") for i in range(len(given))]
            result = self.follow(function)(stand, *with_numbers(arguments, iter(formal)))
            lines, (self.lines, self._written) = self.lines, outer
            self._apart[key] = None
            if len(lines) > self._many_lines and not any(line.endswith(": break") for line in lines):
                name = f"block{len(self.blocks)}"
                returned = ", ".join(map(literal, numbers(result)))
                self.blocks.append((name, len(given), [*lines, f"return ({returned},)"]))
                self._apart[key] = name, result
        block = self._apart[key]
        if block is None:
            return self.follow(function)(stand, *arguments)
        name, result = block
        values = self.write(f"{name}({', '.join(['parameters', *map(literal, given)])})")
        count = sum(1 for _ in numbers(result))
        return with_numbers(result, iter([self.write(f"{values.name}[{i}]") for i in range(count)]))

    def follow(self, function: types.FunctionType) -> types.FunctionType:
        """Return a copy of a function whose global names mean what they mean for symbols."""
        if function not in self._copies:
            known = function.__globals__
            seen = {name: self._seen(known[name]) for name in _names(function.__code__) if name in known}
            copy = types.FunctionType(
                function.__code__,
                {**known, "max": self._pick(max, ">"), "min": self._pick(min, "<"), **seen},
                function.__name__,
                function.__defaults__,
                function.__closure__,
            )
            copy.__kwdefaults__ = function.__kwdefaults__
            self._copies[function] = copy
        return self._copies[function]

    def _seen(self, value: Any) -> Any:
        if value is holds:
            return self.require
        if value is math:
            return _Math(self)
        if _of_math(value):
            return getattr(_Math(self), value.__name__)
        if isinstance(value, types.FunctionType):
            return functools.partial(self.call, value)
        if isinstance(value, type) and issubclass(value, Parameterised):
            return _Class(self, value)
        return value

    def _pick(self, plain: Callable[..., Any], sign: str) -> Callable[..., Any]:
        """The built-in max or min for symbols: as Python has it, the first of equal ones."""

        def function(*values: Any, **named: Any) -> Any:
            items = list(values[0]) if len(values) == 1 else list(values)
            if named or not any(isinstance(x, Symbol) for x in items):
                return plain(*values, **named)
            best = items[0]
            for x in items[1:]:
                best = self.operate(f"({{0}} if {{0}} {sign} {{1}} else {{1}})", x, best)
            return best

        return function

    # ---- what a run consists of ----

    def value(self, real: Any, steps: Steps) -> Any:
        """Return what a value of a run is for symbols: floats become parameters, objects stand-ins."""
        if isinstance(real, float):
            name = self.slots.setdefault(steps, f"p{len(self.slots)}")
            return Symbol(self, name)
        if isinstance(real, (tuple, list)):
            self.fixed[(*steps, ("length", None))] = len(real)
            return rebuilt(real, [self.value(x, (*steps, ("entry", i))) for i, x in enumerate(real)])
        if isinstance(real, (str, int, type(None))):
            self.fixed[steps] = real
            return real
        if not hasattr(real, "__dict__") or callable(real):
            raise NotCompilable(f"{steps[-1][1]} is a {type(real).__name__}, which cannot be compiled")
        self.fixed[(*steps, ("type", None))] = type(real)
        return Component(self, real, steps) if isinstance(real, Parameterised) else Holder(self, real, steps)


class Component:
    """Stands for a component: its numbers are parameters of the source, its methods are followed."""

    def __init__(self, tracer: Tracer, real: Parameterised, steps: Steps) -> None:
        """Stand for the component found by ``steps``."""
        self._tracer, self._real, self.steps = tracer, real, steps

    def __getattr__(self, name: str) -> Any:
        found = _attribute(type(self._real), name)
        if isinstance(found, staticmethod):
            return functools.partial(self._tracer.call, cast(types.FunctionType, found.__func__))
        if isinstance(found, types.FunctionType):
            apart = isinstance(self._real, Robot) and name in DYNAMICS
            return functools.partial(self._tracer.call_apart if apart else self._tracer.call, found, self)
        return self._tracer.value(getattr(self._real, name), (*self.steps, ("attribute", name)))

    def for_joint(self, joint: int) -> Component:
        """Return this component, reduced to one joint."""
        reduced = self._real.for_joint(joint)
        if reduced is self._real:
            return self
        return Component(self._tracer, reduced, (*self.steps, ("joint", joint)))

    def check_joints(self, joints: int) -> None:
        """Checked with the scenario."""


class Holder:
    """Stands for a stage or another object of a run; what is set on it stays here."""

    def __init__(self, tracer: Tracer, real: Any, steps: Steps) -> None:
        """Stand for the object found by ``steps``."""
        self.__dict__.update(_tracer=tracer, _real=real, _steps=steps)

    def __getattr__(self, name: str) -> Any:
        found = _attribute(type(self._real), name)
        if isinstance(found, property):
            return self._tracer.call(cast(types.FunctionType, found.fget), self)
        if isinstance(found, types.FunctionType):
            return functools.partial(self._tracer.call, found, self)
        inner = self._tracer.value(getattr(self._real, name), (*self._steps, ("attribute", name)))
        self.__dict__[name] = inner
        return inner


class _Math:
    """The module :mod:`math` for symbols."""

    def __init__(self, tracer: Tracer) -> None:
        self._tracer = tracer

    def __getattr__(self, name: str) -> Any:
        plain = getattr(math, name)
        if not callable(plain):
            return plain

        def function(*values: Any) -> Any:
            if any(isinstance(x, Symbol) for x in values):
                return self._tracer.write(f"{self._tracer.checked(name)}({', '.join(map(literal, values))})")
            return plain(*values)

        return function


class _Class:
    """A component class: its static functions for symbols."""

    def __init__(self, tracer: Tracer, real: type) -> None:
        self._tracer, self._real = tracer, real

    def __getattr__(self, name: str) -> Any:
        found = getattr(self._real, name)
        if not isinstance(found, types.FunctionType):
            return found
        return functools.partial(self._tracer.call, found)


def look_up(root: Any, steps: Steps, known: dict[Steps, Any]) -> Any:
    """Return what ``steps`` lead to.

    Args:
        root: where they start.
        steps: attributes, entries, joints.
        known: what was looked up before; added to.
    """
    if not steps:
        return root
    if steps not in known:
        kind, key = steps[-1]
        inner = look_up(root, steps[:-1], known)
        known[steps] = (
            getattr(inner, key) if kind == "attribute"
            else inner.for_joint(key) if kind == "joint"
            else len(inner) if kind == "length"
            else type(inner) if kind == "type"
            else inner[key]
        )  # fmt: skip
    return known[steps]


# ---- tuples of numbers ----


def shape(value: Any) -> Any:
    """Return the structure of nested tuples; their floats, and symbols, are all alike.

    Raises:
        NotCompilable: there is something else than floats, texts and whole numbers in them.
    """
    if isinstance(value, (float, Symbol)):
        return float
    if isinstance(value, tuple):
        return type(value), tuple([shape(x) for x in value])
    if isinstance(value, (str, int, type(None))):
        return value
    raise NotCompilable(f"a component remembers a {type(value).__name__}; expected floats in tuples")


def numbers(value: Any) -> Iterator[Any]:
    """Yield the floats, or symbols, in nested tuples."""
    if isinstance(value, (float, Symbol)):
        yield value
    elif isinstance(value, tuple):
        for x in value:
            yield from numbers(x)


def with_numbers(value: Any, found: Iterator[Any]) -> Any:
    """Return nested tuples of the same structure with other numbers, in the order of :func:`numbers`."""
    if isinstance(value, (float, Symbol)):
        return next(found)
    return rebuilt(value, [with_numbers(x, found) for x in value]) if isinstance(value, tuple) else value


def rebuilt(like: Any, items: list[Any]) -> Any:
    """Return a tuple, or named tuple, of the same kind with other items."""
    return type(like)(*items) if hasattr(like, "_fields") else tuple(items)


def literal(value: Any) -> str:
    """Return a symbol or number as source."""
    if isinstance(value, Symbol):
        return value.name
    if isinstance(value, float) and not math.isfinite(value):
        return "math.nan" if math.isnan(value) else "math.inf" if value > 0.0 else "(-math.inf)"
    text = repr(value)
    return f"({text})" if text.startswith("-") else text


_PLAIN = {"abs", "max", "min", "float", "range", "round"}


def floats_returned(function: types.FunctionType) -> int | None:
    """How many floats a leaf returns in a tuple, 0 for one float by itself; None if it is no leaf.

    A leaf works on floats alone: it, and what it calls, uses :mod:`math`, other leaves, and the few
    built-ins that mean the same on floats when compiled.
    """
    returned = function.__annotations__.get("return")
    text = returned if isinstance(returned, str) else getattr(returned, "__name__", "")
    inner = text.removeprefix("tuple[").removesuffix("]").replace(" ", "").split(",")
    count = 0 if text == "float" else len(inner) if set(inner) == {"float"} and "tuple" in text else None
    return count if count is not None and _is_plain(function, set()) else None


def globals_of(function: types.FunctionType) -> Iterator[tuple[str, Any]]:
    """Yield the global names that a function uses, with their values; built-ins are left out."""
    for name in sorted(_names(function.__code__)):
        if name in function.__globals__:
            yield name, function.__globals__[name]


WHOLE_NUMBERS: dict[types.FunctionType, str] = {}
"""Leaves whose whole numbers Python makes as long as they need to be: their source for compiling."""


def _is_plain(function: types.FunctionType, seen: set[Any]) -> bool:
    if function in seen or function in WHOLE_NUMBERS:
        return True
    seen.add(function)
    if function.__closure__ or function.__kwdefaults__ or function.__defaults__:
        return False
    used = dict(globals_of(function))
    if any(n not in used and n not in _PLAIN and not hasattr(math, n) for n in _names(function.__code__)):
        return False
    for found in used.values():
        if isinstance(found, types.FunctionType):
            if not _is_plain(found, seen):
                return False
        elif not (found is math or _of_math(found) or isinstance(found, float) or type(found) is int):
            return False
    return True


def _of_math(value: Any) -> bool:
    return isinstance(value, types.BuiltinFunctionType) and value.__module__ == "math"


def _names(code: types.CodeType) -> set[str]:
    names = set(code.co_names)
    for constant in code.co_consts:
        if isinstance(constant, types.CodeType):
            names |= _names(constant)
    return names


def _attribute(cls: type, name: str) -> Any:
    for base in cls.__mro__:
        if name in base.__dict__:
            return base.__dict__[name]
    return None
