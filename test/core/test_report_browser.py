# SPDX-License-Identifier: Apache-2.0
"""The report in a real browser: no error, plots are drawn, controls work, no sideways scrolling.

Needs the Python package playwright and a Chromium: that of playwright, one on the PATH, or the one that
``FTCM_CHROMIUM`` names. Skipped without.
"""

from __future__ import annotations

import json
import os
import shutil
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

from ftcm_core.cli import main

playwright = pytest.importorskip("playwright.sync_api", reason="the package playwright is not installed")
pytestmark = pytest.mark.slow

DESKTOP, PHONE = {"width": 1280, "height": 900}, {"width": 390, "height": 844}
INK = """canvas => {
  const pixels = canvas.getContext("2d").getImageData(0, 0, canvas.width, canvas.height).data;
  let found = 0;
  for (let i = 3; i < pixels.length; i += 4) found += pixels[i] > 0;
  return found;
}"""
"""How many pixels of a canvas are painted."""

Open = Callable[..., Any]


@pytest.fixture(scope="module")
def browser() -> Iterator[Any]:
    """A Chromium without a window."""
    with playwright.sync_playwright() as driver:
        own = driver.chromium.executable_path
        names = ("chromium", "chromium-browser", "google-chrome")
        found = [
            os.environ.get("FTCM_CHROMIUM"),
            own if Path(own).exists() else None,
            *map(shutil.which, names),
        ]
        path = next((p for p in found if p), None)
        if path is None:
            pytest.skip("no Chromium: neither playwright's, nor on the PATH, nor named by FTCM_CHROMIUM")
        sandbox = [] if os.geteuid() else ["--no-sandbox"]
        running = driver.chromium.launch(executable_path=path, args=sandbox)
        yield running
        running.close()


@pytest.fixture
def open_page(browser: Any) -> Iterator[Open]:
    """Open a report; at the end of the test nothing may have been fetched or complained about."""
    trouble: list[str] = []
    contexts = []

    def show(folder: Path, **settings: Any) -> Any:
        contexts.append(browser.new_context(**{"viewport": DESKTOP, **settings}))
        page = contexts[-1].new_page()
        page.on("console", lambda m: trouble.append(m.text) if m.type == "error" else None)
        page.on("pageerror", lambda error: trouble.append(str(error)))
        page.on("request", lambda r: None if r.url.startswith("file:") else trouble.append(r.url))
        page.goto((folder / "report.html").as_uri())
        page.wait_for_selector("html[data-drawn]")
        return page

    yield show
    for context in contexts:
        context.close()
    assert trouble == []


@pytest.fixture(scope="module")
def runs(tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("runs") / "out"
    values = ["--set", "duration=4", "injection.faults.0.start=2", "detector=cusum"]
    laws = ["--controllers", "smc", "nftsmc", "ftcm"]
    assert main(["compare", "paper", *laws, *values, "--no-figures", "--output", str(out)]) == 0
    return out


@pytest.fixture(scope="module")
def campaign(tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("campaign") / "out"
    values = ["--set", "duration=0.3", "transient=0.1", "injection.faults.0.start=0.2"]
    varied = ["--vary", "injection.faults.0.severity=uniform(0.5, 1.5)"]
    command = ["campaign", "paper", "--runs", "4", "--engine", "plain", "--controllers", "smc", "ftcm"]
    assert main([*command, *values, *varied, "--output", str(out)]) == 0
    return out


@pytest.fixture(scope="module")
def suite(tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("suite") / "out"
    command = ["suite", "faults", "--onset", "0.1", "--duration", "0.2", "--controllers", "smc", "ftcm"]
    faults = ["--faults", "vo_kang_fault", "sensor_bias"]
    assert main([*command, *faults, "--output", str(out)]) == 0
    return out


def inks(page: Any, which: str = "canvas") -> list[int]:
    """Painted pixels of each canvas that is shown."""
    return [
        canvas.evaluate(INK) for canvas in page.query_selector_all(which) if canvas.bounding_box() is not None
    ]


def settled(page: Any) -> None:
    """Wait until what was asked for is drawn."""
    page.evaluate("new Promise(done => requestAnimationFrame(() => requestAnimationFrame(done)))")


@pytest.mark.parametrize("kind", ["runs", "campaign", "suite"])
@pytest.mark.parametrize(("size", "scheme"), [(DESKTOP, "light"), (PHONE, "dark")], ids=["desktop", "phone"])
def test_everything_is_drawn_and_fits(
    kind: str, size: dict[str, int], scheme: str, open_page: Open, request: pytest.FixtureRequest
) -> None:
    page = open_page(request.getfixturevalue(kind), viewport=size, color_scheme=scheme)
    assert page.evaluate("document.documentElement.scrollWidth") <= size["width"]
    found = inks(page)
    assert len(found) >= {"runs": 7, "campaign": 6, "suite": 1}[kind]
    assert all(ink > 1000 for ink in found)
    background = page.evaluate("getComputedStyle(document.body).backgroundColor")
    assert (background == "rgb(255, 255, 255)") == (scheme == "light")


def test_a_law_can_be_hidden_and_shown(runs: Path, open_page: Open) -> None:
    page = open_page(runs)
    before = inks(page)
    page.click("button.run:has-text('smc') >> nth=0")
    settled(page)
    assert page.get_attribute("button.run >> nth=0", "aria-pressed") == "false"
    timeline_error_torque = slice(0, 1 + 3 + 3)
    assert all(a != b for a, b in zip(inks(page)[timeline_error_torque], before))
    page.click("button.run >> nth=0")
    settled(page)
    assert inks(page) == before


def test_one_joint_can_be_chosen(runs: Path, open_page: Open) -> None:
    page = open_page(runs)
    every = len(inks(page, "figure canvas"))
    page.click("button:has-text('joint2')")
    settled(page)
    assert len(inks(page, "figure canvas")) == every / 3
    page.click("button:has-text('all joints')")
    settled(page)
    assert len(inks(page, "figure canvas")) == every


def test_dragging_zooms_in_all_plots_and_a_double_click_shows_the_whole_run(
    runs: Path, open_page: Open
) -> None:
    page = open_page(runs)
    ends = "[...document.querySelectorAll('.bar input[type=number]')].map(x => Number(x.value))"
    assert page.evaluate(ends) == [0, 4]
    before = inks(page)
    chart = page.locator("figure .chart").first
    chart.scroll_into_view_if_needed()
    box = chart.bounding_box()
    left, width = 58, box["width"] - 58 - 8
    middle = box["y"] + box["height"] / 2
    page.mouse.move(box["x"] + left + 0.25 * width, middle)
    page.mouse.down()
    page.mouse.move(box["x"] + left + 0.75 * width, middle)
    page.mouse.up()
    settled(page)
    assert page.evaluate(ends) == pytest.approx([1, 3], abs=0.02)
    assert all(a != b for a, b in zip(inks(page), before))
    chart.dblclick()
    settled(page)
    assert page.evaluate(ends) == [0, 4]
    page.click("button:has-text('vo_kang_fault_0')")
    assert page.evaluate(ends) == pytest.approx([1.92, 2.16])


def test_what_is_told_under_the_pointer_was_recorded(runs: Path, open_page: Open) -> None:
    """The value of the torque at the first tick is the one that the summary has."""
    page = open_page(runs)
    chart = page.locator("figure:has-text('Torque') .chart").first
    chart.scroll_into_view_if_needed()
    box = chart.bounding_box()
    page.mouse.move(box["x"] + 58, box["y"] + 50)
    told = page.locator("figure:has-text('Torque') .said").first.inner_text().split()
    first = [r["first_torque"][0] for r in json.loads((runs / "summary.json").read_text())["results"]]
    assert told[:3] == ["t", "=", "0"]
    assert [float(x) for x in told[3:]] == [pytest.approx(x, rel=5e-3) for x in first]
    assert page.locator("figure .at >> visible=true").count() == page.locator("figure .chart").count()


def test_the_errors_can_be_drawn_linearly(runs: Path, open_page: Open) -> None:
    page = open_page(runs)
    before = inks(page, "figure canvas")
    page.click("input[type=checkbox]")
    settled(page)
    assert [a != b for a, b in zip(inks(page, "figure canvas"), before)][:6] == [True] * 3 + [False] * 3


def test_another_metric_of_a_campaign_can_be_chosen(campaign: Path, open_page: Open) -> None:
    page = open_page(campaign)
    before = inks(page)
    page.select_option("select", label="after fault: torque peak, N·m")
    settled(page)
    assert inks(page) != before
    assert len(inks(page)) == len(before)


def test_it_prints_in_light_colours_even_in_the_dark(runs: Path, open_page: Open, tmp_path: Path) -> None:
    page = open_page(runs, color_scheme="dark")
    screen = inks(page)
    page.evaluate("window.dispatchEvent(new Event('beforeprint'))")
    assert page.evaluate("getComputedStyle(document.body).backgroundColor") == "rgb(255, 255, 255)"
    page.evaluate("window.dispatchEvent(new Event('afterprint'))")
    settled(page)
    assert inks(page) == screen
    page.pdf(path=tmp_path / "report.pdf", prefer_css_page_size=True, print_background=True)
    assert (tmp_path / "report.pdf").read_bytes().startswith(b"%PDF")
