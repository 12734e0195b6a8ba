# SPDX-License-Identifier: Apache-2.0
"""Every `ftcm` command of the pages is one that the program takes, with names and values that there are."""

import contextlib
import io
import re
import shlex
from pathlib import Path

import pytest

from ftcm_core.cli.main import _parser
from ftcm_core.registry import components
from ftcm_core.scenario import load

ROOT = Path(__file__).resolve().parents[2]
DOCS = ROOT / "docs"
PAGES = sorted(
    [*DOCS.glob("*.md"), *DOCS.glob("tutorials/*.md"), ROOT / "README.md", ROOT / "CONTRIBUTING.md"]
)
BLOCK = re.compile(r"^```(\w*)\n(.*?)^```$", re.MULTILINE | re.DOTALL)
PLACEHOLDER = re.compile(r"\.\.\.|…|\b[A-Z][A-Z_]+\b")
"""What stands for something of the reader's: FILE, NAME, ..."""
REFUSED = {"observer.k1=uniform(-20000, 20000)"}
"""Shown for how it is refused."""


def commands_of(text):
    """Return the words of each `ftcm` command, in blocks and in the text, without `ftcm`."""
    lines = []
    for language, block in BLOCK.findall(text):
        if not language:
            lines += re.sub(r" *\\\n *", " ", block).splitlines()
    lines += re.findall(
        r"`(ftcm \w+ [^`]+)`", BLOCK.sub("", text).replace("\n", " ")
    )  # a name alone says less
    found = []
    for line in lines:
        command = line.removeprefix("$ ")
        if command.startswith("ftcm ") and not PLACEHOLDER.search(command):
            for part in re.split(r"; |&& ", command):
                lexer = shlex.shlex(part, posix=True, punctuation_chars="|>&")
                lexer.whitespace_split = True
                words = list(lexer)
                end = next((k for k, word in enumerate(words) if word in ("|", "||", ">", "&")), len(words))
                if words[:1] == ["ftcm"] and not REFUSED & {*words}:
                    found.append(tuple(words[1:end]))
    return found


COMMANDS = sorted({(page.name, *words) for page in PAGES for words in commands_of(page.read_text("utf-8"))})


@pytest.mark.parametrize("command", COMMANDS, ids=" ".join)
def test_the_program_takes_it(command):
    _, *words = command
    said = io.StringIO()
    try:
        with contextlib.redirect_stderr(said), contextlib.redirect_stdout(said):
            options = vars(_parser().parse_args(words))
    except SystemExit as error:
        if error.code:
            pytest.fail(said.getvalue())
        return
    for kind in () if options.get("plugin") else ("controllers", "observers", "detectors"):
        unknown = {*(options.get(kind) or ())} - {*components(kind.removesuffix("s"))} - {"all"}
        assert unknown == set()
    scenario = options.get("scenario")
    settings = [change for change in options.get("set") or () if isinstance(change, str)]
    if scenario and "." not in scenario and not options.get("plugin"):  # nothing of the reader's
        load(scenario, settings, controller=options.get("controller"))


def test_commands_are_found():
    block = "$ ftcm simulate paper \\\n   --set 'a=b c' | jq .x  # so\nftcm run FILE\n"
    text = f"See `ftcm tune`, `ftcm list --json`.\n\n```\n{block}```\n"
    assert commands_of(text) == [("simulate", "paper", "--set", "a=b c"), ("list", "--json")]
    assert len(COMMANDS) > 60
