# SPDX-License-Identifier: Apache-2.0
"""Errors that are a user's mistake, each one line: what, which value, what was expected, what to do."""

from __future__ import annotations

import difflib
import reprlib
from collections.abc import Iterable, Sequence

_repr = reprlib.Repr()
_repr.maxstring = _repr.maxother = 60
_repr.maxlist = _repr.maxtuple = _repr.maxdict = 4
_repr.maxlevel = 2


class FtcmError(Exception):
    """A mistake the user can mend. Command lines print it without a traceback and exit with status 2."""

    def __init__(self, message: str) -> None:
        """Make it one line, whatever is quoted in it."""
        super().__init__(" ".join(message.splitlines()))


def shown(value: object) -> str:
    """Return a value as an error message shows it: like ``repr``, but never long.

    Args:
        value: whatever the user gave.
    """
    try:
        text = _repr.repr(value)
    except (ValueError, RecursionError):  # an integer of thousands of digits, a list that contains itself
        text = f"a value of type {type(value).__name__}"
    return text if len(text) <= 120 else text[:117] + "..."


class ParameterError(FtcmError):
    """A parameter value outside its declaration."""


class Unsuited(ParameterError):
    """A component that is valid in itself but does not fit the rest of the scenario."""


class ScenarioError(FtcmError):
    """A scenario file or override that is not a valid scenario."""

    unsuited = False
    """Whether a component is valid in itself but does not fit the rest: see :class:`Unsuited`."""


MOST_NAMES = 20
"""So many names are told to somebody who has misspelt one beyond recognition."""


def suggestion(name: str, known: Iterable[str]) -> str:
    """Return ``did you mean 'x'?`` for a misspelt name, else the list of known names.

    Args:
        name: the name as the user wrote it.
        known: the names that exist.
    """
    known = sorted(known)
    name = name[:60]
    close = difflib.get_close_matches(name, known, n=1, cutoff=0.5)
    if close:
        return f"did you mean '{close[0]}'?"
    if len(known) > MOST_NAMES:
        return f"{len(known)} are known, such as {', '.join(known[:MOST_NAMES])}; ftcm list names them"
    return f"known: {', '.join(known)}" if known else "none are known here"


def chosen(option: str, text: str, known: Sequence[str]) -> tuple[str, ...]:
    """Read the words of an option, separated by commas; each counts once.

    Raises:
        FtcmError: one is not known.
    """
    found = tuple(dict.fromkeys(word.strip() for word in text.split(",")))
    for word in found:
        if word not in known:
            raise FtcmError(f"{option} {word!r}: {suggestion(word, known)}")
    return found
