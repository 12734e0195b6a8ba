# SPDX-License-Identifier: Apache-2.0
"""What was measured or sent some ticks ago, for effects that lose it or are late with it."""

from __future__ import annotations

import math
from typing import Any, NamedTuple

from ftcm_core.numeric import select
from ftcm_core.random_streams import uniform
from ftcm_core.signals import Vector

Message = tuple[Vector, ...]
"""Arrays of a message."""


class Sent(NamedTuple):
    """A message on its way."""

    delay: float
    """After so many ticks it arrives; in the tick in which it was sent for 0."""
    message: Message


def either(condition: float, yes: Any, no: Any) -> Any:
    """Return ``yes`` if the condition is not zero, else ``no``: floats in tuples of one structure."""
    if type(condition) is float:  # a short way that compiled code does not take
        return yes if condition != 0.0 else no
    if isinstance(yes, tuple):
        return tuple([either(condition, a, b) for a, b in zip(yes, no)])
    return select(condition, yes, no)


def remembered(latest: Any, before: tuple[Any, ...], ticks: int) -> tuple[Any, ...]:
    """Return what was there 0 to ``ticks`` ticks ago; before the first there was what the first is.

    Args:
        latest: of this tick.
        before: of the ticks before, the latest first: what this returned last, without its end; () at first.
        ticks: how far back.
    """
    return (latest, *(before or (latest,) * ticks))


def past(found: tuple[Any, ...], lag: float) -> Any:
    """Return what was there ``lag`` ticks ago, of :func:`remembered`."""
    if type(lag) is float:  # a short way that compiled code does not take
        return found[int(lag)]
    result = found[0]
    for age in range(1, len(found)):
        result = either(same(lag, float(age)), found[age], result)
    return result


def on_the_way(size: float, key: float, number: float, message: Message, memory: Any, ticks: int) -> Any:
    """Return the messages of the last ``ticks`` ticks and this one as :class:`Sent`, the latest first.

    Args:
        size: of the fault.
        key: stream of random numbers.
        number: which number of it.
        message: sent in this tick.
        memory: what this returned last, without its end; () at first.
        ticks: longest delay.
    """
    first = memory or (Sent(0.0, message),) * ticks
    return (Sent(random_ticks(size, float(ticks), key, number), message), *first)


def whole_ticks(size: float, ticks: float) -> float:
    """Share ``size`` of a number of ticks, rounded."""
    return float(math.floor(size * ticks + 0.5))


def random_ticks(size: float, ticks: float, key: float, number: float) -> float:
    """A whole number of ticks, 0 up to a share ``size`` of ``ticks``, all alike for a whole share.

    Args:
        size: the share, 0 to 1.
        ticks: longest delay.
        key: stream of random numbers.
        number: which number of it.
    """
    return float(math.floor(uniform(key, number) * (size * ticks + 1.0)))


def same(x: float, y: float) -> float:
    """1 if two numbers are equal, else 0."""
    return 1.0 if x == y else 0.0


def at_most(x: float, y: float) -> float:
    """1 for x <= y, else 0."""
    return 1.0 if x <= y else 0.0
