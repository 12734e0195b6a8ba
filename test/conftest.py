# SPDX-License-Identifier: Apache-2.0
"""What all tests share."""

import os
import platform
from collections.abc import Iterator
from importlib import metadata
from pathlib import Path

import pytest
from hypothesis import settings

settings.register_profile("ftcm", deadline=None)  # how long an input takes says nothing of the code
settings.load_profile("ftcm")

ROOT = Path(__file__).resolve().parents[1]


def pytest_report_header():
    ros = f"sourced ROS 2 {os.environ['ROS_DISTRO']}" if "ROS_DISTRO" in os.environ else "ROS 2 from wheels"
    return f"Python {platform.python_version()}, numpy {metadata.version('numpy')}, {ros}"


@pytest.fixture(scope="session", autouse=True)
def _compiled_code(tmp_path_factory) -> Iterator[None]:
    """One folder of compiled code for all tests and what they start: new, and shared by all workers."""
    folder = tmp_path_factory.getbasetemp()
    if "PYTEST_XDIST_WORKER" in os.environ:
        folder = folder.parent
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("FTCM_CACHE_DIR", str(folder / "compiled"))
        yield


@pytest.fixture(scope="session")
def root():
    """Return the workspace: the folder with src/, config/ and test/."""
    return ROOT
