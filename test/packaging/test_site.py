# SPDX-License-Identifier: Apache-2.0
"""The documentation as a site: it builds without a warning, and asks nobody else for anything."""

import re
import subprocess
import sys

import pytest

pytest.importorskip("mkdocs", reason="mkdocs is not installed (make site)")
pytest.importorskip("latex2mathml", reason="latex2mathml is not installed (make site)")

pytestmark = pytest.mark.pure
FETCHED = re.compile(
    r"""<(?:script|img|iframe)[^>]*\bsrc=["'](https?:)?//|<link[^>]*\bhref=["'](https?:)?//"""
)


@pytest.fixture(scope="module")
def site(root, tmp_path_factory):
    folder = tmp_path_factory.mktemp("site")
    run = subprocess.run(
        [sys.executable, "-m", "mkdocs", "build", "--strict", "--site-dir", str(folder)],
        cwd=root, capture_output=True, text=True, timeout=120,
    )  # fmt: skip
    assert run.returncode == 0, run.stderr
    assert "WARNING" not in run.stderr
    return folder


def test_every_page_is_there_and_reached(root, site):
    docs = root / "docs"
    shown = (*docs.glob("*.md"), *docs.glob("tutorials/*.md"))
    pages = {"index", *(str(p.relative_to(docs).with_suffix("")) for p in shown)}
    assert pages == {str(p.relative_to(site).with_suffix("")) for p in site.rglob("*.html")} - {"404"}
    first = (site / "index.html").read_text("utf-8")
    assert not [page for page in pages if f'href="{page}.html"' not in first and page != "index"]


def test_nothing_is_fetched_from_elsewhere(site):
    for page in site.rglob("*.html"):
        assert not FETCHED.search(page.read_text("utf-8")), page


def test_formulas_are_drawn_by_the_browser_itself(site):
    text = (site / "equations.html").read_text("utf-8")
    assert text.count("<math") >= 5
    assert "```math" not in text
    assert "\\begin" not in re.sub(r"<annotation.*?</annotation>", "", text)
