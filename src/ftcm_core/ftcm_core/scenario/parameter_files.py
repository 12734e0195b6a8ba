# SPDX-License-Identifier: Apache-2.0
"""Parameter files: components with their parameters, to be used in any scenario (``--params FILE``)."""

from __future__ import annotations

import json

from ftcm_core.errors import FtcmError, shown
from ftcm_core.scenario.reading import read_mapping

TAKEN = ("controller", "observer", "detector")
"""Components that a parameter file may have; other keys tell where it comes from."""


def parameter_overrides(file: str | None) -> list[str]:
    """Return the overrides that set the components of a parameter file.

    Args:
        file: a YAML file with any of :data:`TAKEN`, as ``tune`` writes it; None: no override.

    Raises:
        FtcmError: it cannot be read or has none of them.
    """
    if file is None:
        return []
    data = read_mapping(file)[0]
    found = [(kind, data[kind]) for kind in TAKEN if data.get(kind) is not None]
    for kind, value in found:
        if not isinstance(value, (dict, str)):
            raise FtcmError(f"{file}: {kind}: {shown(value)} is not a component")
    if not found:
        raise FtcmError(f"{file}: none of {', '.join(TAKEN)} in it; expected a file that ftcm tune wrote")
    return [f"{kind}={json.dumps(value)}" for kind, value in found]
