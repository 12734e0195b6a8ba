# SPDX-License-Identifier: Apache-2.0
"""docs/laws.md: it has every law, names tests that there are, and its numbers are what is measured."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import pytest

from ftcm_core.recording.metrics import evaluate
from ftcm_core.registry import components
from ftcm_core.scenario import load
from ftcm_core.simulation import simulate

ROOT = Path(__file__).resolve().parents[2]
PAGE = (ROOT / "docs" / "laws.md").read_text(encoding="utf-8")
COLUMNS = [
    ("after_fault", "rms_error"),
    ("whole", "torque_peak"),
    ("after_transient", "torque_total_variation"),
]
"""Window and metric of the columns of the last table."""


def table(heading: str) -> dict[str, list[str]]:
    """Cells of the rows of a section's table, by the law in the first."""
    section = PAGE.partition(f"\n## {heading}\n")[2].partition("\n## ")[0]
    rows = [
        re.split(r"(?<!\\)\|", line.strip().strip("|"))
        for line in section.splitlines()
        if line.startswith("| `")
    ]
    return {row[0].strip(" `"): [cell.strip() for cell in row[1:]] for row in rows}


def measured(law: str, overrides: list[str]) -> list[list[float]]:
    """The columns of a run."""
    found: Any = evaluate(simulate(load("paper", overrides, law)))
    return [found[window][metric] for window, metric in COLUMNS]


def row(law: str, overrides: list[str]) -> str:
    """A row of a table of numbers, measured now: how the page was written."""
    cells = [" ".join(f"{x:.3g}" for x in values) for values in measured(law, overrides)]
    return f"| `{law}` | " + " | ".join(cells) + " |"


@pytest.mark.parametrize(
    "heading", ["The laws", "What they claim", "One run each", "With an encoder and a delay"]
)
def test_every_law_is_in_every_table(heading: str) -> None:
    """Once, and no other."""
    assert list(table(heading)) == list(components("controller"))


def test_every_test_named_is_there() -> None:
    """In the file that is named before it."""
    missing = []
    for law, cells in table("What they claim").items():
        named = re.findall(r"`(test_\w+\.py)`|`(test_\w+)`", " ".join(cells))
        assert named, law
        assert named[0][0], f"{law}: the file comes first"
        text = ""
        for file, test in named:
            if file:
                text = (ROOT / "test" / "core" / file).read_text(encoding="utf-8")
            elif not re.search(rf"^    def {test}\(|^def {test}\(", text, re.MULTILINE):
                missing.append(test)
    assert missing == []


def test_who_needs_an_observer_is_said() -> None:
    """Those whose class says so."""
    needing = {law for law, cells in table("The laws").items() if "observer" in cells[2]}
    assert needing == {law for law, cls in components("controller").items() if cls.needs_observer}


RUNS = {"One run each": [], "With an encoder and a delay": ["torque_delay=1", "sensor=encoder"]}


@pytest.mark.nightly
@pytest.mark.slow
@pytest.mark.parametrize("heading", RUNS)
@pytest.mark.parametrize("law", components("controller"))
def test_documented_numbers(law: str, heading: str) -> None:
    """To 10 %, or above a bound: chattering amplifies the last bit, so other machines differ in some."""
    assert " ".join(RUNS[heading]) in PAGE
    for found, cell in zip(measured(law, RUNS[heading]), table(heading)[law]):
        for value, text in zip(found, cell.split()):
            if text.startswith(">"):
                assert value > float(text[1:])
            else:
                assert value == pytest.approx(float(text), rel=0.1)
