# SPDX-License-Identifier: Apache-2.0
"""Parameters declared once: default, unit, bounds, description and source.

A component is a frozen dataclass whose fields are made with :func:`param`. The declaration feeds
validation, scenario files, ROS parameter descriptors and the generated reference page.
"""

from __future__ import annotations

import dataclasses
import functools
import math
from collections.abc import Collection, Hashable
from typing import Any, cast

from ftcm_core.errors import ParameterError, shown, suggestion

_KEY = "ftcm_param"


@dataclasses.dataclass(frozen=True)
class ParamSpec:
    """One declared parameter.

    ``kind`` is ``float``, ``int``, ``bool`` or ``str``. A ``per_joint`` float may be one number for
    all joints or a list with one number per joint; an ``optional`` one may be null.
    """

    name: str
    kind: str
    default: Any
    unit: str
    doc: str
    source: str
    lower: float = -math.inf
    upper: float = math.inf
    lower_open: bool = False
    upper_open: bool = False
    choices: tuple[str, ...] = ()
    per_joint: bool = False
    optional: bool = False

    @property
    def expected(self) -> str:
        """What a valid value is, in words."""
        if self.kind == "bool":
            return "true or false"
        if self.choices:
            return "one of " + ", ".join(self.choices)
        if self.kind == "str":
            return "a text or null" if self.optional else "a text"
        text = "a whole number" if self.kind == "int" else "a number"
        if self.per_joint:
            text += " or a list with one number per joint"
        if self.interval:
            text += f" in {self.interval}"
        if self.unit and self.unit != "-":
            text += f" ({self.unit})"
        return text + (" or null" if self.optional else "")

    @property
    def interval(self) -> str:
        """Bounds as an interval, e.g. ``(0, inf)``; empty when unbounded."""
        if math.isinf(self.lower) and math.isinf(self.upper):
            return ""
        left = "(" if self.lower_open or math.isinf(self.lower) else "["
        right = ")" if self.upper_open or math.isinf(self.upper) else "]"
        lower, upper = (str(x) if isinstance(x, int) else f"{x:g}" for x in (self.lower, self.upper))
        return f"{left}{lower}, {upper}{right}"

    def check(self, value: Any) -> Any:
        """Return the value in canonical form.

        Raises:
            ParameterError: the value does not fit; the message says what was expected.
        """
        if value is None and self.optional:
            return None
        if self.kind == "bool" and isinstance(value, bool):
            return value
        if self.kind == "str" and isinstance(value, str) and (not self.choices or value in self.choices):
            return value
        if self.kind == "str" and isinstance(value, str):
            raise ParameterError(f"{shown(value)} is not {self.expected}; {suggestion(value, self.choices)}")
        if self.kind in ("float", "int"):
            if self.per_joint and isinstance(value, (list, tuple)) and value:
                return tuple(self._number(v) for v in value)
            return self._number(value)
        raise ParameterError(f"{shown(value)} is not {self.expected}")

    def _number(self, value: Any) -> float | int:
        if isinstance(value, bool) or not isinstance(value, (int, float)):
            raise ParameterError(f"{shown(value)} is not {self.expected}")
        whole = self.kind == "int" and isinstance(value, int)
        try:
            number = value if whole else float(value)
        except OverflowError:
            number = math.inf
        if not whole and not math.isfinite(number):
            raise ParameterError(f"{shown(value)} is not finite; expected {self.expected}")
        low = number <= self.lower if self.lower_open else number < self.lower
        high = number >= self.upper if self.upper_open else number > self.upper
        if low or high:
            text = shown(value) if whole else f"{value:g}"
            raise ParameterError(f"{text} is out of range; expected {self.expected}")
        if self.kind == "int":
            if number != int(number):
                raise ParameterError(f"{value} is not {self.expected}")
            return int(value)
        return number


def param(
    default: Any,
    *,
    unit: str,
    doc: str,
    source: str,
    above: float | None = None,
    at_least: float | None = None,
    below: float | None = None,
    at_most: float | None = None,
    choices: tuple[str, ...] = (),
    per_joint: bool = False,
    optional: bool = False,
    kind: str = "",
) -> Any:
    """Declare one parameter of a component, as a dataclass field.

    Args:
        default: default value; its type is the parameter's type unless ``kind`` is given.
        unit: SI unit, ``-`` when dimensionless.
        doc: one line that says what it is.
        source: equation or table of the paper, or ``chosen: why``.
        above: exclusive lower bound.
        at_least: inclusive lower bound.
        below: exclusive upper bound.
        at_most: inclusive upper bound.
        choices: the texts allowed.
        per_joint: the value may also be a list with one number per joint.
        optional: the value may be null.
        kind: type name, when the default does not tell it.
    """
    sample = default[0] if isinstance(default, tuple) else default
    spec = ParamSpec(
        name="",
        kind=kind or type(sample).__name__,
        default=default,
        unit=unit,
        doc=doc,
        source=source,
        lower=above if above is not None else (at_least if at_least is not None else -math.inf),
        upper=below if below is not None else (at_most if at_most is not None else math.inf),
        lower_open=above is not None,
        upper_open=below is not None,
        choices=choices,
        per_joint=per_joint,
        optional=optional,
    )
    return dataclasses.field(default=default, metadata={_KEY: spec})


def specs(cls: type) -> dict[str, ParamSpec]:
    """Return the declared parameters of a component class by name, in declaration order."""
    return _specs(cast(Hashable, cls))


@functools.cache
def _specs(cls: Any) -> dict[str, ParamSpec]:
    return {
        f.name: dataclasses.replace(f.metadata[_KEY], name=f.name)
        for f in dataclasses.fields(cls)
        if _KEY in f.metadata
    }


class Parameterised:
    """Base of every record whose fields are declared with :func:`param`: validates on construction."""

    def __post_init__(self) -> None:
        """Check every field against its declaration."""
        for name, spec in specs(type(self)).items():
            try:
                object.__setattr__(self, name, spec.check(getattr(self, name)))
            except ParameterError as error:
                raise ParameterError(f"{name}: {error}") from None
        self.check()

    def check(self) -> None:
        """Check conditions between parameters; raise ParameterError when one fails."""

    @property
    def values(self) -> dict[str, Any]:
        """Parameter values by name, in declaration order."""
        return {name: getattr(self, name) for name in specs(type(self))}

    def check_joints(self, joints: int, names: Collection[str] | None = None) -> None:
        """Check that every per-joint list has one entry per joint.

        Args:
            joints: number of joints of the robot.
            names: parameters to look at; all by default.

        Raises:
            ParameterError: a list is of another length.
        """
        for name, value in self.values.items():
            if names is not None and name not in names:
                continue
            if isinstance(value, tuple) and len(value) != joints:
                raise ParameterError(
                    f"{name}: {shown(list(value))} has {len(value)} entries; "
                    f"expected one per joint ({joints})"
                )

    def for_joint(self, joint: int) -> Any:
        """Return this record with every per-joint value reduced to that of one joint (0-based)."""
        picked = {k: v[joint] for k, v in self.values.items() if isinstance(v, tuple)}
        return dataclasses.replace(self, **picked) if picked else self  # type: ignore[type-var]


def per_joint(value: float | tuple[float, ...], joints: int) -> tuple[float, ...]:
    """Expand a per-joint parameter to one number per joint."""
    return value if isinstance(value, tuple) else (value,) * joints


def joint_parameters(component: Parameterised, joints: int) -> tuple[Any, ...]:
    """Parameters of a component, reduced to each joint in turn; kept with the component, as it is frozen."""
    kept: tuple[Any, ...] | None = component.__dict__.get("_joint_parameters")
    if kept is None or len(kept) != joints:
        component.check_joints(joints)
        kept = tuple([component.for_joint(j) for j in range(joints)])
        component.__dict__["_joint_parameters"] = kept
    return kept
