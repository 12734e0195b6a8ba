# SPDX-License-Identifier: Apache-2.0
"""A Chromium without a window, for tests and pictures of the viewer. Needs the package playwright."""

from __future__ import annotations

import contextlib
import importlib.util
import os
import shutil
from collections.abc import Iterator
from typing import Any

VARIABLE = "FTCM_CHROMIUM"
"""Environment variable that names the program, where none is on the path."""
NAMES = ("chromium", "chromium-browser", "google-chrome")
FLAGS = ("--use-angle=swiftshader", "--enable-unsafe-swiftshader", "--ignore-gpu-blocklist")
"""It draws in 3-D without a graphics card."""
DESKTOP: dict[str, Any] = {"viewport": {"width": 1280, "height": 800}}
PHONE: dict[str, Any] = {
    "viewport": {"width": 390, "height": 844},
    "device_scale_factor": 2,
    "is_mobile": True,
    "has_touch": True,
}
WAIT_SECONDS = 120.0
"""Generous ceiling for what is to come."""


def missing() -> str:
    """Return what is not there; empty if everything is."""
    if importlib.util.find_spec("playwright") is None:
        return "the package playwright is not installed: pip install playwright"
    if not program():
        return f"no Chromium on the PATH, nor named by {VARIABLE}"
    return ""


def program() -> str:
    """Return the program; empty where there is none."""
    return os.environ.get(VARIABLE) or next(filter(None, map(shutil.which, NAMES)), "")


@contextlib.contextmanager
def opened(address: str, look: dict[str, Any]) -> Iterator[Any]:
    """Open a page in a browser of its own.

    Args:
        address: of the page.
        look: :data:`DESKTOP` or :data:`PHONE`.

    Yields:
        Playwright's page.
    """
    from playwright.sync_api import sync_playwright

    with sync_playwright() as driver:
        sandbox = [] if os.geteuid() else ["--no-sandbox"]
        browser = driver.chromium.launch(executable_path=program(), args=[*FLAGS, *sandbox])
        page = browser.new_page(**look)
        page.set_default_timeout(1e3 * WAIT_SECONDS)
        page.goto(address)
        yield page
        browser.close()
