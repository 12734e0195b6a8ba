# SPDX-License-Identifier: Apache-2.0
"""What the shell completes, asked as the shell asks."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

pytest.importorskip("argcomplete", reason="argcomplete is not installed (pip install argcomplete)")

from ftcm_core.registry import components

pytestmark = pytest.mark.pure


def completed(folder: Path, line: str) -> list[str]:
    """The words that the shell is offered at the end of a line."""
    asked = {
        "_ARGCOMPLETE": "1", "COMP_LINE": line, "COMP_POINT": str(len(line)), "_ARGCOMPLETE_IFS": "\n",
        "_ARGCOMPLETE_STDOUT_FILENAME": str(folder / "answer"), "_ARGCOMPLETE_SUPPRESS_SPACE": "1",
        "COMP_TYPE": "9", "_ARGCOMPLETE_COMP_WORDBREAKS": " \n",
    }  # fmt: skip
    run = subprocess.run(
        [sys.executable, "-c", "from ftcm_core.cli import main; raise SystemExit(main())"],
        cwd=folder, env={**os.environ, **asked}, capture_output=True, text=True, timeout=60,
    )  # fmt: skip
    assert run.returncode == 0, run.stderr
    return (folder / "answer").read_text(encoding="utf-8").split("\n")


def test_what_is_offered(tmp_path: Path) -> None:
    (tmp_path / "mine.yaml").write_text("{}")
    (tmp_path / "notes.txt").write_text("")
    commands = completed(tmp_path, "ftcm ")
    assert {"simulate", "compare", "campaign", "describe"} <= set(commands)
    assert completed(tmp_path, "ftcm simulate paper --controller ftc") == ["ftcm"]
    assert sorted(completed(tmp_path, "ftcm compare paper --controllers ")) == sorted(
        components("controller")
    )
    assert set(completed(tmp_path, "ftcm simulate ")) >= {"paper", "mine.yaml"}
    assert "notes.txt" not in completed(tmp_path, "ftcm simulate ")
    assert completed(tmp_path, "ftcm simulate paper --set observer.k1") == ["observer.k1="]
    assert "injection.faults.0.start=" in completed(tmp_path, "ftcm simulate paper --set injection.faults.")
    assert completed(tmp_path, "ftcm simulate mine.yaml --set obs") == [""], "a scenario that is none"
    assert "sensor_bias" in completed(tmp_path, "ftcm suite faults --faults sensor_b")
    assert "ftcm" in completed(tmp_path, "ftcm describe ft")
