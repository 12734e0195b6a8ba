# SPDX-License-Identifier: Apache-2.0
"""Where a result comes from: versions, revision, plug-ins, platform, processor."""

from __future__ import annotations

import hashlib
import os
import platform
import subprocess
from importlib import metadata
from pathlib import Path

import numpy as np

from ftcm_core import __version__
from ftcm_core.registry import plugins
from ftcm_core.robots.urdf_file import files_read


def provenance() -> dict[str, str]:
    """Return versions of the suite and what it runs on, and the git revision where there is one.

    The version of a plug-in, or of a robot's file, is the begin of the SHA-256 of its file.
    """
    found = {
        "ftcm_core": __version__,
        "python": platform.python_version(),
        "numpy": np.__version__,
        "numba": _version("numba"),
        "platform": platform.platform(),
        "machine": platform.machine(),
        "processor": _processor(),
        "revision": git_revision() or "",
        **{f"plug-in {name}": _digest(Path(name)) for name in plugins()},
        **{f"robot {file}": digest for file, digest in files_read.items()},
    }
    return {name: value for name, value in found.items() if value}


def _version(package: str) -> str:
    try:
        return metadata.version(package)
    except metadata.PackageNotFoundError:
        return ""


def _processor() -> str:
    try:
        with open("/proc/cpuinfo", encoding="utf-8") as lines:
            return next(x.split(":", 1)[1].strip() for x in lines if x.startswith("model name"))
    except (OSError, StopIteration):
        return ""


def _digest(file: Path) -> str:
    try:
        return hashlib.sha256(file.read_bytes()).hexdigest()[:12]
    except OSError:  # a module, or one that is not there any more
        return ""


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
