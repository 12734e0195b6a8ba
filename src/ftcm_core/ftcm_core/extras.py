# SPDX-License-Identifier: Apache-2.0
"""Packages that only some commands need: said in one line where one is missing."""

from __future__ import annotations

import importlib.util

from ftcm_core.errors import FtcmError


def has(package: str) -> bool:
    """Whether a package is installed; it is not imported."""
    return importlib.util.find_spec(package) is not None


def need(package: str, extra: str, what: str) -> None:
    """Raise an FtcmError if a package is not installed.

    Args:
        package: name as imported.
        extra: the extra of ``ftcm_core`` that brings it.
        what: what needs it.
    """
    if not has(package):
        raise FtcmError(f'{what} needs {package}; pip install "ftcm_core[{extra}]"')
