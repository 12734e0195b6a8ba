# SPDX-License-Identifier: Apache-2.0
"""From the plain functions to straight-line source, by running them once on symbols instead of floats.

The laws, models and stages are run as they are; arithmetic on a :class:`Symbol` writes a line instead of
computing a number. What is decided by types, texts and whole numbers (which components, how many joints) is
thereby decided once; what depends on floats stays. Nothing here knows an equation.

- A function of plain floats that says how many floats it returns is not run but called by the written
  code, as it is: a *leaf*.
- ``if`` on a symbol: the function it stands in is run again, once per outcome, and both ways are written.
- A way that cannot be written (an error, a run that diverges) *bails out*: the written code stops before
  that tick, and the plain functions run it.
"""

from __future__ import annotations

import builtins
import functools
import math
import types
from collections.abc import Callable, Iterator, Mapping
from typing import Any

from ftcm_core.errors import FtcmError
from ftcm_core.params import Parameterised

Steps = tuple[tuple[str, Any], ...]
"""How to find a value in a run's :class:`~ftcm_core.simulation.Loop`: attributes, entries, joints."""


class NotTraceable(FtcmError):
    """A function does something that symbols cannot follow; the message says what."""


class _Fork(BaseException):
    """An ``if`` on a symbol, not decided yet."""


class Symbol:
    """A float, or a truth value, that is known only when the written code runs."""

    __slots__ = ("name", "tracer")

    def __init__(self, tracer: Tracer, name: str) -> None:
        """Stand for the variable ``name``."""
        self.tracer = tracer
        self.name = name

    def __repr__(self) -> str:
        return self.name

    __hash__ = None  # type: ignore[assignment]  # no table may be keyed by a number that is not known

    def __bool__(self) -> bool:
        return self.tracer.decide(self)

    def __neg__(self) -> Any:
        return self.tracer.operate("-{}", self)

    def __pos__(self) -> Symbol:
        return self

    def __abs__(self) -> Any:
        return self.tracer.operate("abs({})", self)

    def __float__(self) -> float:
        raise NotTraceable("a function that cannot be followed wants a number")


def _operator(name: str, symbol: str) -> None:
    def forward(self: Symbol, other: Any) -> Any:
        return self.tracer.operate("{} " + symbol + " {}", self, other)

    def backward(self: Symbol, other: Any) -> Any:
        return self.tracer.operate("{} " + symbol + " {}", other, self)

    setattr(Symbol, f"__{name}__", forward)
    if symbol not in ("<", "<=", ">", ">=", "==", "!="):
        setattr(Symbol, f"__r{name}__", backward)


for _name, _symbol in {
    "add": "+", "sub": "-", "mul": "*", "truediv": "/", "pow": "**",
    "lt": "<", "le": "<=", "gt": ">", "ge": ">=", "eq": "==", "ne": "!=",
}.items():  # fmt: skip
    _operator(_name, _symbol)


class _Scope:
    """One pass through a function: what it wrote, and the earlier pass it repeats up to a decision."""

    def __init__(self, repeat: list[Any]) -> None:
        self.repeat = repeat
        self.at = 0
        self.written: list[Any] = []
        self.known: dict[str, Symbol] = {}


class Tracer:
    """Runs functions on symbols and keeps what they wrote."""

    def __init__(self) -> None:
        """Start with nothing written."""
        self.scopes: list[_Scope] = []
        self.count = 0
        self.leaves: dict[types.FunctionType, str] = {}
        self.slots: dict[Steps, str] = {}
        """Parameters the written code reads: where each is found, and its name there."""
        self.fixed: dict[Steps, Any] = {}
        """What was decided once: the written code holds for runs that have the same."""
        self._twins: dict[types.FunctionType, Callable[..., Any]] = {}
        self._copies: dict[types.FunctionType, types.FunctionType] = {}

    # ---- writing ----

    def fresh(self) -> str:
        """Return a new variable's name."""
        self.count += 1
        return f"v{self.count}"

    def operate(self, form: str, *operands: Any) -> Any:
        """Write one operation; return the symbol of its result."""
        if not all(isinstance(x, (Symbol, float, int)) for x in operands):
            return NotImplemented
        return self.write(form.format(*map(literal, operands)))

    def write(self, expression: str) -> Symbol:
        """Write ``name = expression``; one already written is not written again."""
        scope = self.scopes[-1]
        for outer in reversed(self.scopes):
            if expression in outer.known:
                return outer.known[expression]
        if scope.at < len(scope.repeat):
            name = scope.repeat[scope.at][1]
            line = scope.repeat[scope.at]
        else:
            name = self.fresh()
            line = ("line", name, expression)
        scope.at += 1
        scope.written.append(line)
        symbol = Symbol(self, name)
        scope.known[expression] = symbol
        return symbol

    def decide(self, condition: Symbol) -> bool:
        """Outcome of ``if condition`` in this pass."""
        scope = self.scopes[-1]
        if scope.at >= len(scope.repeat):
            raise _Fork(condition.name)
        _, _, taken = scope.repeat[scope.at]
        scope.written.append(scope.repeat[scope.at])
        scope.at += 1
        return bool(taken)

    def explore(self, run: Callable[[], Any]) -> Any:
        """Run a function once per outcome of its decisions.

        Returns:
            A tree: ``("end", lines, result)``, ``("bail", lines, reason)``, or
            ``("if", lines, condition, tree if true, tree if false)``.
        """

        def grow(repeat: list[Any]) -> Any:
            scope = _Scope(repeat)
            self.scopes.append(scope)
            try:
                result = run()
                return ("end", scope.written[len(repeat) :], result)
            except _Fork as fork:
                written, condition = scope.written, fork.args[0]
            except NotTraceable as error:
                return ("bail", scope.written[len(repeat) :], str(error))
            except Exception as error:
                return ("bail", scope.written[len(repeat) :], f"{type(error).__name__}: {error}")
            finally:
                self.scopes.pop()
            return (
                "if",
                written[len(repeat) :],
                condition,
                *(grow([*written, ("decision", condition, taken)]) for taken in (True, False)),
            )

        return grow([])

    def call(self, function: Callable[..., Any], arguments: tuple[Any, ...], named: Mapping[str, Any]) -> Any:
        """Run a function without side effects; where it has decisions, what it returns is merged."""
        outer = self.scopes[-1]
        if outer.at < len(outer.repeat):
            line = outer.repeat[outer.at]
        else:
            tree = self.explore(lambda: function(*arguments, **named))
            ends = [x for x in ways(tree) if x[0] == "end"]
            if not ends:
                raise NotTraceable(next(ways(tree))[2])
            outputs: list[str] = []
            result = ends[0][2] if tree[0] == "end" else self._merge([x[2] for x in ends], outputs)
            line = ("call", tree, result, outputs)
        outer.at += 1
        outer.written.append(line)
        if line[1][0] == "end":  # without decisions, what it wrote is known from here on
            outer.known.update((x[2], Symbol(self, x[1])) for x in line[1][1] if x[0] == "line")
        return line[2]

    def _merge(self, results: list[Any], outputs: list[str]) -> Any:
        first = results[0]
        if isinstance(first, tuple):
            if any(type(x) is not type(first) or len(x) != len(first) for x in results):
                raise NotTraceable("a function returns now this many values, now that many")
            return rebuilt(first, [self._merge(list(column), outputs) for column in zip(*results)])
        if all(isinstance(x, (Symbol, float, int)) for x in results):
            outputs.append(self.fresh())
            return Symbol(self, outputs[-1])
        if any(type(x) is not type(first) or x != first for x in results):
            raise NotTraceable("a function's result is a number or something else, depending on a number")
        return first

    # ---- running the plain functions ----

    def twin(self, function: Any) -> Callable[..., Any]:
        """Return the same function, its names looked up so that symbols pass through it."""
        function = getattr(function, "__wrapped__", function)  # what functools.lru_cache keeps
        if function not in self._twins:
            self._twins[function] = functools.partial(self._run, function, self.copy(function))
        return self._twins[function]

    def copy(self, function: types.FunctionType) -> types.FunctionType:
        """Return the same function with its global names replaced by what symbols pass through."""
        if function in self._copies:
            return self._copies[function]
        names = {
            name: self._seen_by_twin(function.__globals__[name])
            for name in _names(function.__code__)
            if name in function.__globals__
        }
        builtin = {name: replacement for name, replacement in self._builtins.items() if name not in names}
        copy = types.FunctionType(
            function.__code__,
            {**function.__globals__, **builtin, **names},
            function.__name__,
            function.__defaults__,
            function.__closure__,
        )
        copy.__kwdefaults__ = function.__kwdefaults__
        self._copies[function] = copy
        return copy

    def _run(self, function: types.FunctionType, copy: Callable[..., Any], *args: Any, **named: Any) -> Any:
        plain = [*args, *named.values()]
        if any(isinstance(x, Symbol) for x in plain) and all(isinstance(x, (Symbol, float)) for x in plain):
            returned = leaf_returns(function)
            if returned is not None and not named:
                name = self.leaves.setdefault(function, f"leaf{len(self.leaves)}")
                result = self.write(f"{name}({', '.join(map(literal, args))})")
                return result if returned == 0 else tuple(
                    [self.write(f"{result.name}[{i}]") for i in range(returned)]
                )  # fmt: skip
        return self.call(copy, args, named)

    def _seen_by_twin(self, value: Any) -> Any:
        if value is math:
            return _Math(self)
        if _of_math(value):
            return getattr(_Math(self), value.__name__)
        if isinstance(value, types.FunctionType) or hasattr(value, "__wrapped__"):
            # Looked up when it is called, as functions may call each other.
            return lambda *args, **named: self.twin(value)(*args, **named)
        if isinstance(value, type) and issubclass(value, Parameterised):
            return _Class(self, value)
        return value

    @functools.cached_property
    def _builtins(self) -> dict[str, Any]:
        def pick(sign: str, plain: Callable[..., Any]) -> Callable[..., Any]:
            def function(*values: Any, **named: Any) -> Any:
                items = list(values[0]) if len(values) == 1 else list(values)
                if named or not any(isinstance(x, Symbol) for x in items):
                    return plain(*values, **named)
                best = items[0]
                for x in items[1:]:
                    best = self.operate(f"({{0}} if {{0}} {sign} {{1}} else {{1}})", x, best)
                return best

            return function

        def is_instance(value: Any, kinds: Any) -> bool:
            real = 0.0 if isinstance(value, Symbol) else getattr(value, "_real", value)
            return isinstance(real, getattr(kinds, "_real", kinds))

        def refuse(name: str) -> Callable[..., Any]:
            def function(*values: Any) -> Any:
                if any(isinstance(x, Symbol) for x in values):
                    raise NotTraceable(f"{name}() of a number cannot be compiled")
                return getattr(builtins, name)(*values)

            return function

        return {
            "max": pick(">", max),
            "min": pick("<", min),
            "isinstance": is_instance,
            "float": lambda x=0.0: x if isinstance(x, Symbol) else float(x),
            **{name: refuse(name) for name in ("int", "round", "type", "hash", "divmod", "id")},
        }


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
                return self._tracer.write(f"math.{name}({', '.join(map(literal, values))})")
            return plain(*values)

        return function


class _Class:
    """A component class: its static functions for symbols."""

    def __init__(self, tracer: Tracer, real: type) -> None:
        self._tracer, self._real = tracer, real

    def __getattr__(self, name: str) -> Any:
        value = getattr(self._real, name)
        return self._tracer.twin(value) if isinstance(value, types.FunctionType) else value


class Part:
    """A component whose numbers are parameters of the written code."""

    def __init__(self, tracer: Tracer, real: Parameterised, steps: Steps) -> None:
        """Stand for the component found by ``steps``."""
        tracer.fixed[(*steps, ("type", None))] = type(real)
        self._tracer, self._real, self._steps = tracer, real, steps

    def __getattr__(self, name: str) -> Any:
        found = _attribute(type(self._real), name)
        if isinstance(found, staticmethod):
            return self._tracer.twin(found.__func__)
        if isinstance(found, types.FunctionType) or hasattr(found, "__wrapped__"):
            return functools.partial(self._tracer.twin(found), self)
        return value(self._tracer, getattr(self._real, name), (*self._steps, ("attribute", name)))

    def __repr__(self) -> str:
        return repr(self._real)

    def for_joint(self, joint: int) -> Part:
        """Return this component, reduced to one joint."""
        reduced = self._real.for_joint(joint)
        if reduced is self._real:
            return self
        return Part(self._tracer, reduced, (*self._steps, ("joint", joint)))

    def check_joints(self, joints: int) -> None:
        """Checked with the scenario."""


class Mutable:
    """A stage: its numbers are state, its methods work on this stand-in as on the stage itself."""

    def __init__(self, tracer: Tracer, real: Any, attributes: Mapping[str, Any]) -> None:
        """Stand for a stage with these attributes."""
        self.__dict__.update(attributes)
        self.__dict__["_real"] = real
        self.__dict__["_tracer"] = tracer

    def __getattr__(self, name: str) -> Any:
        found = _attribute(type(self._real), name)
        if isinstance(found, types.FunctionType):
            return functools.partial(self._tracer.copy(found), self)
        if isinstance(found, staticmethod):
            return self._tracer.twin(found.__func__)
        raise AttributeError(name)


def value(tracer: Tracer, real: Any, steps: Steps) -> Any:
    """Return what a value of a component is for symbols: floats become parameters, the rest stays."""
    if isinstance(real, float):
        if steps not in tracer.slots:
            tracer.slots[steps] = f"p{len(tracer.slots)}"
        return Symbol(tracer, tracer.slots[steps])
    if isinstance(real, tuple):
        tracer.fixed[(*steps, ("length", None))] = len(real)
        return rebuilt(real, [value(tracer, x, (*steps, ("entry", i))) for i, x in enumerate(real)])
    if isinstance(real, Parameterised):
        return Part(tracer, real, steps)
    if not isinstance(real, (str, int, type(None))):
        raise NotTraceable(f"{steps[-1][1]} is a {type(real).__name__}, which cannot be compiled")
    tracer.fixed[steps] = real
    return real


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


def rebuilt(like: tuple[Any, ...], items: list[Any]) -> Any:
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


def leaf_returns(function: types.FunctionType) -> int | None:
    """How many floats a leaf returns in a tuple, 0 for one float by itself; None if it is no leaf.

    A leaf works on floats alone: it, and what it calls, uses :mod:`math`, other leaves, and the few
    built-ins that mean the same on floats when compiled.
    """
    returned = function.__annotations__.get("return")
    text = returned if isinstance(returned, str) else getattr(returned, "__name__", "")
    inner = text.removeprefix("tuple[").removesuffix("]").replace(" ", "").split(",")
    count = 0 if text == "float" else len(inner) if set(inner) == {"float"} and "tuple" in text else None
    return count if count is not None and _is_plain(function, set()) else None


_PLAIN = {"abs", "max", "min", "float", "range"}


def called_by(function: types.FunctionType) -> Iterator[types.FunctionType]:
    """Yield the functions of this package or of a user that a leaf calls."""
    for name in _names(function.__code__):
        found = function.__globals__.get(name)
        if isinstance(found, types.FunctionType):
            yield found


def _is_plain(function: types.FunctionType, seen: set[Any]) -> bool:
    if function in seen:
        return True
    seen.add(function)
    if function.__closure__ or function.__kwdefaults__ or function.__defaults__:
        return False
    for name in _names(function.__code__):
        if name not in function.__globals__:
            if name not in _PLAIN and not hasattr(math, name):
                return False
            continue
        found = function.__globals__[name]
        if isinstance(found, types.FunctionType):
            if not _is_plain(found, seen):
                return False
        elif not (found is math or _of_math(found) or isinstance(found, float) or _small(found)):
            return False
    return True


def _small(value: Any) -> bool:
    return type(value) is int and abs(value) < 2**31


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


def ways(tree: Any) -> Iterator[Any]:
    """Yield the ends and bail-outs of a tree."""
    if tree[0] == "if":
        yield from ways(tree[3])
        yield from ways(tree[4])
    else:
        yield tree


def source(tree: Any, finish: Callable[[Any], list[str]], bail: str, indent: str) -> list[str]:
    """Write a tree as source.

    Args:
        tree: what :meth:`Tracer.explore` returned.
        finish: gives the lines at an end, for its result.
        bail: the line of a way that bails out.
        indent: white space before every line.
    """
    lines: list[str] = []
    for written in tree[1]:
        if written[0] == "line":
            lines.append(f"{indent}{written[1]} = {written[2]}")
        elif written[0] == "call":
            _, inner, result, outputs = written
            lines += source(inner, functools.partial(_assign, result, outputs), bail, indent)
    if tree[0] == "bail":
        return [*lines, indent + bail]
    if tree[0] == "end":
        return lines + [indent + line for line in finish(tree[2])]
    inner_indent = indent + "    "
    return [
        *lines,
        f"{indent}if {tree[2]}:",
        *(source(tree[3], finish, bail, inner_indent) or [inner_indent + "pass"]),
        f"{indent}else:",
        *(source(tree[4], finish, bail, inner_indent) or [inner_indent + "pass"]),
    ]


def _assign(merged: Any, outputs: list[str], result: Any) -> list[str]:
    """Lines that give the outputs of a merged call their values at one of its ends."""
    pairs: list[str] = []

    def walk(target: Any, given: Any) -> None:
        if isinstance(target, tuple):
            for x, y in zip(target, given):
                walk(x, y)
        elif isinstance(target, Symbol) and target.name in outputs:
            number = float(given) if isinstance(given, int) and not isinstance(given, bool) else given
            pairs.append(f"{target.name} = {literal(number)}")

    walk(merged, result)
    return pairs
