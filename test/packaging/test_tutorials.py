# SPDX-License-Identifier: Apache-2.0
"""The tutorials, followed as a reader does: every file written, every command run, every output compared."""

import importlib.util
from pathlib import Path

import pytest

from domains import free_domain
from tutorials import Reader, blocks_of, difference

TUTORIALS = Path(__file__).resolve().parents[2] / "docs" / "tutorials"
LONG = {"reproduce", "tune", "compare"}
"""Those that take more than five seconds of a processor."""
NEEDS = {
    "reproduce": ("matplotlib",),
    "law": ("rclpy",),
    "fault": ("matplotlib",),
    "tune": ("optuna", "scipy"),
    "compare": ("scipy",),
    "notebook": ("rclpy", "pandas", "matplotlib"),
}


def marked(page):
    marks = [pytest.mark.slow]
    if page.stem in LONG:
        marks.append(pytest.mark.nightly)
    if "rclpy" in NEEDS.get(page.stem, ()):
        marks.append(pytest.mark.ros)
    return pytest.param(page, id=page.stem, marks=marks)


@pytest.mark.parametrize("page", [marked(p) for p in sorted(TUTORIALS.glob("*.md"))])
def test_a_reader_comes_to_its_end(page, tmp_path):
    for module in NEEDS.get(page.stem, ()):
        pytest.importorskip(module, reason=f"{module} is not installed")
    reader = Reader(tmp_path, free_domain() if importlib.util.find_spec("rclpy") else None)
    try:
        reader.follow(page)
    finally:
        reader.close()
