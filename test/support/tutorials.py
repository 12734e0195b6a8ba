# SPDX-License-Identifier: Apache-2.0
"""A reader of a page: writes its files, types its commands, runs its Python, and compares with what is shown.

A block of a page is one of these:

- a file, if its first line is a comment with nothing but a name: ``# my_law.py``, ``<!-- my_arm.urdf -->``;
  or what is added to its end: ``# my_law.py, continued``;
- commands for a shell, if it names no language;
- Python of a notebook, ``python``: the value of the last line is shown, if it has one;
- ``text``: all that the block above has printed; a line ``...`` stands for any lines that are left out.
"""

from __future__ import annotations

import ast
import contextlib
import io
import json
import os
import re
import shlex
import subprocess
import sys
import traceback
from collections.abc import Iterator
from decimal import Decimal
from pathlib import Path
from typing import Any, NamedTuple

from programs import program

SOURCES = [str(Path(__file__).resolve().parents[2] / "src" / name) for name in ("ftcm_core", "ftcm_ros")]
LEFT_OUT = "..."
REPEATS = Decimal("1e-3")
"""Relative difference to which numbers repeat across machines."""
HANG_SECONDS = 240.0
"""Generous ceiling that catches hangs."""

_BLOCK = re.compile(r"^```(\w*)\n(.*?)^```$", re.MULTILINE | re.DOTALL)
_FILE = re.compile(r"(?:#|<!--) (\w[\w./-]*\.\w+)(, continued)?(?: -->)?\n")
_NUMBER = re.compile(r"(?<![\w.])-?\d[\d,]*(?:\.\d+)?(?:e[-+]?\d+)?")


class Block(NamedTuple):
    """A block of a page."""

    kind: str
    """``file``, ``more`` (of a file), ``commands``, ``python`` or ``text``."""
    text: str
    line: int
    """In the page, from 1."""
    name: str = ""
    """Of a file."""


def blocks_of(page: str) -> list[Block]:
    """Return the blocks of a page's text in their order.

    Raises:
        ValueError: there is one that nothing is to be done with.
    """
    found = []
    for match in _BLOCK.finditer(page):
        language, text = match.groups()
        line = page.count("\n", 0, match.start()) + 1
        named = _FILE.match(text)
        if named:
            found.append(Block("more" if named[2] else "file", text, line, named[1]))
        elif language in ("", "python", "text"):
            found.append(Block(language or "commands", text, line))
        else:
            raise ValueError(f"line {line}: a block of {language!r} without the name of its file")
    return found


def difference(shown: str, printed: str) -> str:
    """Return what of a shown output was not printed; empty if all of it was, and nothing else.

    Numbers agree if they differ by no more than one in the last place shown, or :data:`REPEATS`. Whole
    numbers must be equal, but for those of three digits, to which tables round: they may differ by one. How
    many spaces there are does not matter, nor how long the line below a table's head is.
    """
    lines = _trimmed(printed)
    runs: list[list[str]] = [[]]
    for line in _trimmed(shown):
        runs.append([]) if line == LEFT_OUT else runs[-1].append(line)
    position = 0
    for k, run in enumerate(runs):
        first = position if k == 0 else None
        last = len(lines) - len(run) if k == len(runs) - 1 and (run or k == 0) else None
        for start in range(position, len(lines) - len(run) + 1):
            fits = first in (None, start) and last in (None, start)
            if fits and all(map(_agrees, run, lines[start:])):
                position = start + len(run)
                break
        else:
            return "\n".join(run) or "nothing"
    return ""


def _trimmed(text: str) -> list[str]:
    return [line.rstrip() for line in text.replace("\r", "\n").strip("\n").split("\n")]


def _agrees(shown: str, printed: str) -> bool:
    texts = [re.sub("-{3,}", "---", " ".join(line.split())) for line in (shown, printed)]
    if len({_NUMBER.sub("#", text) for text in texts}) > 1:
        return False
    return all(map(_same, *map(_NUMBER.findall, texts)))


def _same(shown: str, printed: str) -> bool:
    a, b = (Decimal(text.replace(",", "")) for text in (shown, printed))
    if not {*shown} & {*".e"}:
        rounded = {len(shown), len(printed)} == {3} and "." not in printed
        return abs(a - b) <= (1 if rounded else 0)
    place = a.as_tuple().exponent
    assert isinstance(place, int)
    return abs(a - b) <= max(Decimal(1).scaleb(place), REPEATS * abs(a))


class Reader:
    """Somebody who follows a page in an empty folder, with `ftcm` and `ros2` at hand.

    Args:
        folder: where to make the reader's folder and, beside it, that of the commands.
        domain: ROS domain of the experiments; None: there is no ROS.
    """

    def __init__(self, folder: Path, domain: int | None) -> None:
        self.folder = folder / "reader"
        self.folder.mkdir()
        commands = folder / "commands"
        commands.mkdir()
        python = shlex.quote(sys.executable)
        _script(commands / "ftcm", f'exec {python} -m ftcm_core.cli "$@"')
        if domain is not None:
            _script(commands / "ros2", "\n".join(_ros2(domain)))
        path = [str(commands), str(Path(sys.executable).parent), os.environ["PATH"]]
        modules = [os.environ.get("PYTHONPATH", ""), *SOURCES]  # behind the workspace, where that is sourced
        self.environment = {
            **os.environ,
            "PATH": os.pathsep.join(path),
            "PYTHONPATH": os.pathsep.join(filter(None, modules)),
            "MPLBACKEND": "Agg",
        }
        self._notebook: subprocess.Popen[str] | None = None

    def follow(self, page: Path) -> None:
        """Do what a page says.

        Raises:
            AssertionError: a command or a line of Python fails, or prints something else than is shown.
        """
        printed = None
        for block in blocks_of(page.read_text("utf-8")):
            where = f"{page.name}:{block.line}"
            if block.kind in ("file", "more"):
                path = self.folder / block.name
                assert path.exists() == (block.kind == "more"), f"{where}: {block.name} is there, or is not"
                with path.open("a", encoding="utf-8") as file:
                    file.write(block.text)
                printed = None
            elif block.kind == "text":
                assert printed is not None, f"{where}: there is nothing above that prints"
                missing = difference(block.text, printed)
                assert not missing, f"{where}: not printed as it is shown:\n{missing}\nbut:\n{printed}"
            else:
                printed, failed = (self.type if block.kind == "commands" else self._run)(block.text)
                assert not failed, f"{where}: {failed}\n{block.text}\n{printed}"

    def type(self, commands: str) -> tuple[str, str]:
        """Type commands; return what they print, and how they fail, empty if they do not."""
        done = subprocess.run(
            ["bash", "-eu", "-o", "pipefail", "-c", commands],
            cwd=self.folder, env=self.environment, stdin=subprocess.DEVNULL, text=True, timeout=HANG_SECONDS,
            stdout=subprocess.PIPE, stderr=subprocess.STDOUT, check=False,
        )  # fmt: skip
        return done.stdout, f"exit status {done.returncode}" if done.returncode else ""

    def _run(self, code: str) -> tuple[str, str]:
        if self._notebook is None:
            self._notebook = subprocess.Popen(
                [sys.executable, __file__],
                cwd=self.folder, env=self.environment, text=True,
                stdin=subprocess.PIPE, stdout=subprocess.PIPE,
            )  # fmt: skip
        told, answers = self._notebook.stdin, self._notebook.stdout
        assert told
        assert answers
        print(json.dumps(code), file=told, flush=True)
        printed, failed = json.loads(answers.readline())
        return printed, failed

    def close(self) -> None:
        """End the notebook."""
        if self._notebook is not None:
            self._notebook.communicate(timeout=HANG_SECONDS)


def _script(path: Path, text: str) -> None:
    path.write_text(f"#!/bin/bash\n{text}\n", "utf-8")
    path.chmod(0o755)


def _ros2(domain: int) -> Iterator[str]:
    """The lines of a script that does what `ros2 run ftcm_ros PROGRAM` does."""
    yield 'case "$1 $2 $3" in'
    for name, more in (("experiment", f"--domain-id {domain}"), ("analyse", ""), ("replay", "")):
        yield f'"run ftcm_ros {name}") exec {shlex.join(program(name))} "${{@:4}}" {more} ;;'
    yield '*) echo "ros2 $*: not known here" >&2; exit 2 ;;'
    yield "esac"


# ---- the notebook: a process of its own, which reads blocks and answers with what they print ----


def _execute(code: str, names: dict[str, Any]) -> None:
    body = ast.parse(code).body
    shown = ast.Expression(body.pop().value) if isinstance(body[-1], ast.Expr) else None
    exec(compile(ast.Module(body, []), "notebook", "exec"), names)
    value = eval(compile(shown, "notebook", "eval"), names) if shown else None
    if value is not None:
        print(repr(value))


def _notebook() -> None:
    sys.path[0] = ""
    names: dict[str, Any] = {"__name__": "__main__"}
    for line in sys.stdin:
        printed, failed = io.StringIO(), ""
        with contextlib.redirect_stdout(printed), contextlib.redirect_stderr(printed):
            try:
                _execute(json.loads(line), names)
            except Exception:
                failed = traceback.format_exc()
        print(json.dumps([printed.getvalue(), failed]), flush=True)


if __name__ == "__main__":
    _notebook()
