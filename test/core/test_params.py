# SPDX-License-Identifier: Apache-2.0
"""Declared parameters: what one is, in words; canonical values; refusals in one line."""

from __future__ import annotations

import dataclasses
import math
from typing import Any

import pytest

from ftcm_core.errors import FtcmError, ParameterError, ScenarioError, suggestion
from ftcm_core.params import Parameterised, ParamSpec, param, per_joint, specs


@dataclasses.dataclass(frozen=True, kw_only=True)
class Sample(Parameterised):
    """One field of every sort."""

    gain: float = param(2.0, unit="1/s", above=0.0, per_joint=True, doc="gain", source="chosen")
    share: float = param(0.5, unit="-", at_least=0.0, below=1.0, doc="share", source="chosen")
    count: int = param(3, unit="-", at_least=1, at_most=2**63 - 1, doc="count", source="chosen")
    offset: float = param(0.0, unit="rad", doc="offset", source="chosen")
    flag: bool = param(True, unit="-", doc="flag", source="chosen")
    mode: str = param("abrupt", unit="-", choices=("abrupt", "incipient"), doc="mode", source="chosen")
    title: str = param("x", unit="-", doc="title", source="chosen")
    limit: float | None = param(None, unit="N·m", kind="float", optional=True, doc="limit", source="chosen")
    note: str = "not declared"


SPECS = specs(Sample)


@pytest.mark.parametrize(
    ("name", "words"),
    [
        ("gain", "a number or a list with one number per joint in (0, inf) (1/s)"),
        ("share", "a number in [0, 1)"),
        ("count", "a whole number in [1, 9223372036854775807]"),
        ("offset", "a number (rad)"),
        ("flag", "true or false"),
        ("mode", "one of abrupt, incipient"),
        ("title", "a text"),
        ("limit", "a number (N·m) or null"),
    ],
)
def test_expected_in_words(name: str, words: str) -> None:
    """What a user reads when a value is refused."""
    assert SPECS[name].expected == words


def test_specs_are_the_declared_fields_in_order() -> None:
    """A field without param(...) is no parameter; the kind follows from the default."""
    assert list(SPECS) == ["gain", "share", "count", "offset", "flag", "mode", "title", "limit"]
    assert [s.kind for s in SPECS.values()] == [
        "float",
        "float",
        "int",
        "float",
        "bool",
        "str",
        "str",
        "float",
    ]
    assert list(Sample().values) == list(SPECS)


@pytest.mark.parametrize(
    ("name", "value", "canonical"),
    [
        ("gain", 3, 3.0),
        ("gain", [1, 2.5], (1.0, 2.5)),
        ("share", 0, 0.0),
        ("count", 5.0, 5),
        ("count", 2**63 - 1, 2**63 - 1),
        ("count", 2**53 + 1, 2**53 + 1),
        ("flag", False, False),
        ("limit", None, None),
        ("limit", 7, 7.0),
    ],
)
def test_canonical_values(name: str, value: Any, canonical: Any) -> None:
    """Numbers become floats, lists tuples, whole floats ints; nothing is rounded."""
    found = getattr(Sample(**{name: value}), name)
    assert found == canonical
    assert type(found) is type(canonical)


@pytest.mark.parametrize(
    ("name", "value", "message"),
    [
        (
            "gain",
            0,
            "gain: 0 is out of range; expected a number or a list with one number per joint in (0, inf)",
        ),
        (
            "gain",
            [1, -2],
            "gain: -2 is out of range; expected a number or a list with one number per joint in (0, inf)",
        ),
        (
            "gain",
            "fast",
            "gain: 'fast' is not a number or a list with one number per joint in (0, inf)",
        ),
        ("gain", [[1]], "gain: [1] is not a number"),
        ("share", 1, "share: 1 is out of range; expected a number in [0, 1)"),
        ("share", [0.5], "share: [0.5] is not a number in [0, 1)"),
        ("share", math.nan, "share: nan is not finite; expected a number in [0, 1)"),
        ("offset", 10**400, "is not finite; expected a number (rad)"),
        ("count", 0, "count: 0 is out of range; expected a whole number in [1, "),
        ("count", 2.5, "count: 2.5 is not a whole number"),
        ("count", 2**63, "count: "),
        ("flag", 1, "flag: 1 is not true or false"),
        ("mode", "incipent", "mode: 'incipent' is not one of abrupt, incipient; did you mean 'incipient'?"),
        ("mode", 3, "mode: 3 is not one of abrupt, incipient"),
        ("title", None, "title: None is not a text"),
        ("limit", "none", "limit: 'none' is not a number (N·m) or null"),
    ],
)
def test_refusals_name_the_parameter_the_value_and_what_was_expected(
    name: str, value: Any, message: str
) -> None:
    """In one line."""
    with pytest.raises(ParameterError) as error:
        Sample(**{name: value})
    assert message in str(error.value)
    assert str(error.value).startswith(f"{name}: ")
    assert len(str(error.value).splitlines()) == 1


@pytest.mark.parametrize("name", ["gain", "count", "title", "limit", "flag"])
@pytest.mark.parametrize(
    "value", [16**5000, [[1] * 100_000], {"k" * 100_000: 1}], ids=["digits", "list", "mapping"]
)
def test_refusal_of_a_huge_value_is_short(name: str, value: Any) -> None:
    """Neither an error in writing the error, nor a page of it."""
    with pytest.raises(ParameterError) as error:
        Sample(**{name: value})
    length = len(str(error.value))
    assert length < 400


def test_joints() -> None:
    """A list must fit the joints; one joint's record has numbers only."""
    record = Sample(gain=[1, 2, 3])
    record.check_joints(3)
    with pytest.raises(
        ParameterError, match=r"^gain: \[1.0, 2.0, 3.0\] has 3 entries; expected one .*\(2\)$"
    ):
        record.check_joints(2)
    assert [record.for_joint(j).gain for j in range(3)] == [1.0, 2.0, 3.0]
    assert Sample().for_joint(2) == Sample()
    assert per_joint(2.0, 3) == (2.0, 2.0, 2.0)
    assert per_joint((1.0, 2.0), 2) == (1.0, 2.0)


def test_condition_between_parameters() -> None:
    """``check`` runs on construction, after every value is canonical."""

    @dataclasses.dataclass(frozen=True, kw_only=True)
    class Ordered(Parameterised):
        low: float = param(0, kind="float", unit="-", doc="low", source="chosen")
        high: float = param(1, kind="float", unit="-", doc="high", source="chosen")

        def check(self) -> None:
            assert type(self.low) is type(self.high) is float
            if self.low > self.high:
                raise ParameterError("low: above high")

    assert Ordered(low=1) == Ordered(low=1.0, high=1.0)
    with pytest.raises(ParameterError, match=r"^low: above high$"):
        Ordered(low=2)


@pytest.mark.parametrize(
    ("name", "known", "text"),
    [
        ("scm", ["smc", "pid"], "did you mean 'smc'?"),
        ("zzz", ["smc", "pid"], "known: pid, smc"),
        ("smc", [], "none are known here"),
    ],
)
def test_suggestion(name: str, known: list[str], text: str) -> None:
    """The nearest name, or else all of them."""
    assert suggestion(name, known) == text


def test_user_errors_share_a_base() -> None:
    """Command lines catch one class."""
    assert issubclass(ParameterError, FtcmError)
    assert issubclass(ScenarioError, FtcmError)
    assert ParamSpec("x", "float", 0.0, "-", "x", "x").interval == ""
