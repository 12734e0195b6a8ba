# SPDX-License-Identifier: Apache-2.0
"""A run in a program or a notebook: simulated, drawn, as a table, shown."""

from __future__ import annotations

import re

import numpy as np
import pytest

import ftcm_core as ftcm
from ftcm_core.errors import FtcmError
from ftcm_core.recording.metrics import evaluate
from ftcm_core.recording.trace import Trace
from ftcm_core.scenario import load
from ftcm_core.simulation import simulate
from traces import same

pytestmark = pytest.mark.pure

SETTINGS = ["duration=1.2", "injection.faults.0.start=1.1"]


@pytest.fixture(scope="module")
def trace() -> Trace:
    return ftcm.simulate("paper", SETTINGS, controller="smc")


def test_it_is_the_run_of_the_command(trace: Trace) -> None:
    assert same(trace, simulate(load("paper", SETTINGS, "smc")))
    assert trace.scenario is not None
    assert trace.scenario.controller.type_name == "smc"


def test_it_is_drawn(trace: Trace) -> None:
    pytest.importorskip("matplotlib")
    figure = trace.plot("joint2")
    assert "joint2" in figure._suptitle.get_text()
    assert all(axes.lines or axes.collections for axes in figure.axes)
    assert "joint3" in trace.plot()._suptitle.get_text()
    with pytest.raises(FtcmError, match="joint 'joint7'; did you mean 'joint3'"):
        trace.plot("joint7")


def test_it_is_a_table_of_pandas(trace: Trace) -> None:
    pytest.importorskip("pandas", reason="pandas is not installed (pip install pandas)")
    table = trace.to_pandas()
    assert table.index.name == "time"
    assert np.array_equal(table.index, trace.time)
    assert np.array_equal(table["error.joint2"], trace.error[:, 1])
    assert np.array_equal(table["command.joint1"], trace.command[:, 0])
    assert len(table.columns) == 3 * (len(trace.columns) + 2)


def test_a_notebook_shows_how_it_went(trace: Trace) -> None:
    shown = trace._repr_html_()
    assert "<b>smc</b>, 1,201 ticks of 0.001 s, completed" in shown
    whole = evaluate(trace)["whole"]
    assert whole is not None
    cells = re.search(r"<td>whole</td>(.*?)</tr>", shown)
    assert cells is not None
    assert f"<td>{whole['mean_abs_error'][1]:.3g}</td>" in cells[1]


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ({"scenario": "papper"}, "did you mean 'paper'"),
        ({"settings": "duration=1"}, "settings: 'duration=1' is a text; expected a list of texts"),
        ({"engine": "fast"}, "engine: 'fast' is not one of plain, compiled"),
    ],
)
def test_a_mistake_is_one_line(arguments: dict[str, str], words: str) -> None:
    with pytest.raises(FtcmError, match=re.escape(words)):
        ftcm.simulate(**arguments)
