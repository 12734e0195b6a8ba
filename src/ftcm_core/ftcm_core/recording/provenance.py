# SPDX-License-Identifier: Apache-2.0
"""Where a result comes from: versions, revision, platform."""

from __future__ import annotations

import os
import platform
import subprocess
from pathlib import Path

import numpy as np

from ftcm_core import __version__


def provenance() -> dict[str, str]:
    """Return versions of the suite and what it runs on, and the git revision where there is one."""
    found = {
        "ftcm_core": __version__,
        "python": platform.python_version(),
        "numpy": np.__version__,
        "platform": platform.platform(),
        "machine": platform.machine(),
    }
    revision = git_revision()
    return {**found, "revision": revision} if revision else found


def git_revision() -> str | None:
    """Return the checkout's revision, with ``+`` if there are uncommitted changes.

    Outside a checkout: what ``FTCM_REVISION`` says, as an image does of what it was built from, or None.
    """
    here = Path(__file__).resolve()
    if (
        _git(here.parent, "ls-files", "--error-unmatch", here.name) is None
    ):  # installed inside some other checkout
        return os.environ.get("FTCM_REVISION") or None
    return _git(here.parent, "describe", "--always", "--abbrev=12", "--dirty=+", "--exclude=*")


def _git(folder: Path, *arguments: str) -> str | None:
    environment = {k: v for k, v in os.environ.items() if not k.startswith("GIT_")}
    try:
        run = subprocess.run(
            ["git", "-C", str(folder), *arguments],
            capture_output=True, text=True, timeout=5, check=False, env=environment,
        )  # fmt: skip
    except (OSError, subprocess.SubprocessError):
        return None
    return run.stdout.strip() or None if run.returncode == 0 else None
