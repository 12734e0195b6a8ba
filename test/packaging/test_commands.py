# SPDX-License-Identifier: Apache-2.0
"""Every `ftcm` command of the pages is one that the program takes, with names that there are, and runs."""

import contextlib
import io
import re
import shlex
from pathlib import Path

import pytest

from ftcm_core.cli.main import _parser
from ftcm_core.registry import components
from ftcm_core.scenario import load
from tutorials import Reader, blocks_of

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


# ---- they run ----

SHORT = {
    "simulate": ("--set", "duration=3", "injection.faults.0.start=2"),
    "compare": ("--set", "duration=3", "injection.faults.0.start=2"),
    "calibrate": ("--runs", "2", "--set", "duration=3"),
    "detectable": ("--precision", "0.5", "--set", "duration=3", "injection.faults.0.start=2"),
    "campaign": ("--runs", "2"),
    "suite": ("--faults", "loss_of_effectiveness", "--onset", "1", "--duration", "2"),
}
"""What the test adds to a command, so that it takes seconds."""
NOT_RUN = {
    "watch": "needs a graph that is on: test/ros/test_watch.py, test/ros/test_viewer.py",
    "reproduce": "its tutorial is followed by test_tutorials.py",
    "tune config/": "has 128 runs held out, however few the trials; a smaller one is in test_tutorials.py",
    "campaign config/suites/": "many laws to compile; test/core/test_contenders.py runs some draws of each",
    "--cluster": "needs the machines: test/core/test_cluster.py",
    "--params results/": "of a tuning that is not run here",
    "simulate --engine": "names an option only",
    "campaign --engine": "names an option only",
    "simulate scenario.yaml": "of the template, once installed: test_docs.py",
    "my_robot.py": "the reader's own",
}
"""Commands that have one of these texts, and why they are left out."""
FILES = {
    "my_law.py": lambda: blocks_of((DOCS / "tutorials/law.md").read_text("utf-8"))[0].text,
    "faults.yaml": lambda: next(
        text for _, text in BLOCK.findall((DOCS / "campaigns.md").read_text("utf-8")) if "runs:" in text
    ),
}
"""Files of the reader's, as other places of the pages show them."""


def runs_of(page):
    """Return what is typed for the commands of a page, in their order."""
    typed = []
    for words in dict.fromkeys(commands_of(page.read_text("utf-8"))):
        command = shlex.join(["ftcm", *words, *SHORT.get(words[0], ())])
        if not any(text in command for text in NOT_RUN):
            if "--resume" in words:  # there must be something to go on with
                typed.append(command.replace(" --resume", ""))
            typed.append(command)
    return typed


RUNS = {page.name: runs_of(page) for page in PAGES if page.parent.name != "tutorials"}
"""Those of the tutorials are run by test_tutorials.py."""


@pytest.mark.nightly
@pytest.mark.parametrize("page", [page for page, typed in RUNS.items() if typed])
def test_the_commands_of_a_page_run(page, tmp_path):
    for module in ("matplotlib", "scipy"):
        pytest.importorskip(module, reason=f"{module} is not installed")
    reader = Reader(tmp_path, None)
    (reader.folder / "config").symlink_to(ROOT / "config")
    (reader.folder / "my_lab").symlink_to(DOCS / "template" / "my_lab")
    for name, text in FILES.items():
        (reader.folder / name).write_text(text(), "utf-8")
    for command in RUNS[page]:
        if "config/arms/" in command:
            pytest.importorskip("example_robot_data", reason="example-robot-data is not installed")
        printed, failed = reader.type(command)
        assert not failed, f"{command}\n{printed}"


def test_what_is_left_out_is_there():
    typed = [shlex.join(["ftcm", *words]) for _, *words in COMMANDS]  # so that no reason outlives its command
    assert [text for text in NOT_RUN if not any(text in command for command in typed)] == []


def test_commands_are_found():
    block = "$ ftcm simulate paper \\\n   --set 'a=b c' | jq .x  # so\nftcm run FILE\n"
    text = f"See `ftcm tune`, `ftcm list --json`.\n\n```\n{block}```\n"
    assert commands_of(text) == [("simulate", "paper", "--set", "a=b c"), ("list", "--json")]
    assert len(COMMANDS) > 60
