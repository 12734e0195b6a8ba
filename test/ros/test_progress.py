# SPDX-License-Identifier: Apache-2.0
"""How far a run is: a line now and then where stderr is no terminal, and nothing else."""

from __future__ import annotations

import contextlib
import re
import time

import pytest

from ftcm_ros.run import progress


def lines_of(capsys: pytest.CaptureFixture[str]) -> list[str]:
    out, err = capsys.readouterr()
    assert out == ""
    assert "\r" not in err
    return err.splitlines()


def test_a_line_now_and_then_and_one_at_the_end(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(progress, "LINE_SECONDS", 0.05)
    with progress.Progress("ftcm", 4000, 0.001) as shown:
        shown.show(1000, 0)
        assert lines_of(capsys) == []
        time.sleep(0.06)
        shown.show(2000, 3)
        (line,) = lines_of(capsys)
        assert re.fullmatch(r"  ftcm: t = 2\.00 of 4 s, [\d.]+ ticks/s, 3 deadlines missed, 00:00 left", line)
        progress.say("warning: x")
        shown.finish(4000, 3)
    said, end = lines_of(capsys)
    assert said == "warning: x"
    assert re.fullmatch(r"  ftcm: t = 4\.00 of 4 s, [\d.]+ ticks/s, 3 deadlines missed, 0\.\d s", end)


def test_a_short_run_says_its_end(capsys: pytest.CaptureFixture[str]) -> None:
    with progress.Progress("smc", 100, 0.001) as shown:
        shown.finish(100, 0)
    (line,) = lines_of(capsys)
    assert line.startswith("  smc: t = 0.10 of 0.1 s, ")


def test_a_run_that_fails_leaves_no_line(capsys: pytest.CaptureFixture[str]) -> None:
    with contextlib.suppress(ZeroDivisionError), progress.Progress("pid", 100, 0.001) as shown:
        shown.show(50, 0)
        raise ZeroDivisionError
    assert lines_of(capsys) == []
