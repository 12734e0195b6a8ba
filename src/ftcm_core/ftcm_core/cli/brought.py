# SPDX-License-Identifier: Apache-2.0
"""Commands, and parts of commands, that other packages bring by an entry point."""

from __future__ import annotations

from collections.abc import Callable
from importlib import metadata
from typing import Any

from ftcm_core.errors import FtcmError

GROUP = "ftcm.commands"
"""Entry points of what other packages bring: functions of the parsed options."""


def brought(name: str) -> Callable[..., Any] | None:
    """Return what an installed package brings under a name; None if none does.

    Raises:
        FtcmError: it cannot be imported.
    """
    found = [point for point in metadata.entry_points(group=GROUP) if point.name == name]
    if not found:
        return None
    try:
        function: Callable[..., Any] = found[0].load()
    except (ImportError, AttributeError) as error:  # AttributeError: of another version
        raise FtcmError(f"{name}: the package ftcm_ros cannot be imported: {error}") from None
    return function
