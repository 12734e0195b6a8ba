# SPDX-License-Identifier: Apache-2.0
"""A run's signals as CSV and Parquet: every number reads back as it is."""

from __future__ import annotations

import csv
import json
from pathlib import Path

import numpy as np
import pytest

from ftcm_core.cli import main
from ftcm_core.recording.table_file import write_table
from ftcm_core.recording.trace import Trace
from ftcm_core.scenario import load
from ftcm_core.simulation import simulate

HEAD = ["time", "position.joint1", "position.joint2", "position.joint3", "velocity.joint1"]
SHORT = ["simulate", "paper", "--set", "duration=0.05", "--no-figures"]


@pytest.fixture(scope="module")
def trace() -> Trace:
    return simulate(load("paper", ["duration=0.2", "injection.faults.0.start=0.1"]))


def test_csv(tmp_path: Path, trace: Trace) -> None:
    write_table(tmp_path / "a.csv", trace)
    with (tmp_path / "a.csv").open(encoding="utf-8", newline="") as file:
        head, *rows = csv.reader(file)
    assert head[:5] == HEAD
    numbers = np.array(rows, dtype=np.float64)
    assert numbers.shape == (201, 1 + 3 * (len(trace.columns) + 2))
    assert np.array_equal(numbers[:, 0], trace.time)
    for name, values in trace.table().items():
        assert np.array_equal(numbers[:, head.index(name)], values), name


def test_parquet(tmp_path: Path, trace: Trace) -> None:
    parquet = pytest.importorskip("pyarrow.parquet", reason="pyarrow is not installed")
    write_table(tmp_path / "a.parquet", trace)
    table = parquet.read_table(tmp_path / "a.parquet")
    assert table.column_names[:5] == HEAD
    for name, values in {"time": trace.time, **trace.table()}.items():
        assert np.array_equal(table[name].to_numpy(), values), name
    units = {field.name: field.metadata[b"unit"].decode() for field in table.schema}
    assert [units[x] for x in ("time", "error.joint2", "velocity_error.joint1", "command.joint3")] == [
        "s", "rad", "rad/s", "N·m"
    ]  # fmt: skip
    about = json.loads(table.schema.metadata[b"ftcm"])
    assert (about["status"], about["scenario"]["duration"]) == ("completed", 0.2)


def test_the_command_writes_what_is_asked_for(tmp_path: Path) -> None:
    pytest.importorskip("pyarrow", reason="pyarrow is not installed")
    assert main([*SHORT, "--output", str(tmp_path / "a"), "--export", "csv,parquet"]) == 0
    assert {path.name for path in (tmp_path / "a" / "tables").iterdir()} == {"ftcm.csv", "ftcm.parquet"}
    laws = ["compare", "paper", "--controllers", "smc", "ftcm", *SHORT[2:]]
    assert main([*laws, "--output", str(tmp_path / "b"), "--export", "csv"]) == 0
    assert {path.name for path in (tmp_path / "b" / "tables").iterdir()} == {"ftcm.csv", "smc.csv"}
    assert main([*SHORT, "--output", str(tmp_path / "c")]) == 0
    assert not (tmp_path / "c" / "tables").exists()


def test_mistakes_are_one_line_before_the_run(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    output = ["--output", str(tmp_path / "a")]
    for given, said in (
        ([*output, "--export", "csv,xls"], "--export 'xls': known: csv, parquet"),
        ([*output, "--export", "cvs"], "--export 'cvs': did you mean 'csv'?"),
        ([*output, "--export", ""], "--export '': known: csv, parquet"),
        (["--export", "csv"], "--export needs a folder; expected --output DIR too"),
    ):
        assert main([*SHORT, *given]) == 2
        assert capsys.readouterr().err == f"ftcm: error: {said}\n"
    assert not (tmp_path / "a").exists()


def test_without_pyarrow_one_line_says_so(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("importlib.util.find_spec", lambda name: None)
    assert main([*SHORT, "--output", str(tmp_path / "a"), "--export", "parquet"]) == 2
    assert "pyarrow" in capsys.readouterr().err
    assert not (tmp_path / "a").exists()
