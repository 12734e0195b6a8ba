# SPDX-License-Identifier: Apache-2.0
"""Errors that are a user's mistake, each one line: what, which value, what was expected, what to do."""

from __future__ import annotations

import difflib
from collections.abc import Iterable


class FtcmError(Exception):
    """A mistake the user can mend. Command lines print it without a traceback and exit with status 2."""


class ParameterError(FtcmError):
    """A parameter value outside its declaration."""


class ScenarioError(FtcmError):
    """A scenario file or override that is not a valid scenario."""


def suggestion(name: str, known: Iterable[str]) -> str:
    """Return ``did you mean 'x'?`` for a misspelt name, else the list of known names.

    Args:
        name: the name as the user wrote it.
        known: the names that exist.
    """
    known = sorted(known)
    close = difflib.get_close_matches(name, known, n=1, cutoff=0.5)
    if close:
        return f"did you mean '{close[0]}'?"
    return f"known: {', '.join(known)}" if known else "none are known here"
