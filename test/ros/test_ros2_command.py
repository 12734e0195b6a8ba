# SPDX-License-Identifier: Apache-2.0
"""The `ros2` commands of the pages name what there is, and the real command line does what the pages say.

The commands are read from the pages. What needs `ros2` itself takes it from the PATH.
"""

from __future__ import annotations

import contextlib
import os
import re
import shlex
import shutil
import signal
import subprocess
import time
from collections.abc import Callable, Iterator
from itertools import pairwise
from pathlib import Path

import pytest

pytest.importorskip("rclpy", reason="ROS 2 (rclpy) is not installed")

import psutil

from ftcm_core.params import specs
from ftcm_core.registry import components
from ftcm_core.scenario import load
from ftcm_core.signals import CHANNELS
from ftcm_core.simulation import simulate
from ftcm_ros.analysis import analyse, replay
from ftcm_ros.bags.reader import read_bag
from ftcm_ros.parameters.node_parameters import ALL_NODES, NODES, SETTINGS
from ftcm_ros.run import drive, experiment, fault, watch
from ftcm_ros.run.launching import EXPERIMENT_ARGUMENTS, NODE_ARGUMENTS, VIEWER_ARGUMENTS
from ftcm_ros.viewer import markers
from traces import same
from tutorials import blocks_of

pytestmark = pytest.mark.ros

ROOT = Path(__file__).resolve().parents[2]
DOCS = ROOT / "docs"
PAGES = [
    ROOT / "README.md", *sorted(DOCS.glob("*.md")), *sorted(DOCS.glob("tutorials/*.md")),
    DOCS / "template/README.md",
]  # fmt: skip
BLOCK = re.compile(r"^```(\w*)\n(.*?)^```$", re.MULTILINE | re.DOTALL)
HANG_SECONDS = 120.0
"""Generous ceiling that catches hangs."""
STOP_SECONDS = 30.0
"""Generous ceiling for what Ctrl-C ends."""

needs_ros2 = pytest.mark.skipif(
    shutil.which("ros2") is None,
    reason="there is no `ros2` on the PATH: the package index has none; see CONTRIBUTING.md",
)


# ---- what the pages say ----


def lines_of(page: Path, word: str = "") -> list[str]:
    """The shell lines in the code blocks of a page that have a word in them, without comments."""
    blocks = [text for language, text in BLOCK.findall(page.read_text("utf-8")) if not language]
    shown = [re.sub(r" *\\\n *", " ", text) for text in blocks if word in text]
    lines = [line for text in shown for line in text.splitlines()]
    return [re.sub(r"(^| +)#.*", "", line.removeprefix("$ ")) for line in lines]


def commands_of(page: Path, word: str = "") -> list[str]:
    """The lines of a page's code blocks that are one `ros2` command."""
    return [line for line in lines_of(page, word) if line.startswith("ros2 ")]


def commands_in_the_text(page: Path) -> list[str]:
    """The `ros2` commands that a page names outside its code blocks."""
    return re.findall(r"`(ros2 [^`]+)`", BLOCK.sub("", page.read_text("utf-8")))


LAUNCH_FILES = {
    "experiment.launch.py": EXPERIMENT_ARGUMENTS,
    "node.launch.py": NODE_ARGUMENTS,
    "viewer.launch.py": VIEWER_ARGUMENTS,
}
PARSERS = {
    "drive": drive.build_parser,
    "experiment": experiment.build_parser,
    "analyse": analyse.build_parser,
    "replay": replay.build_parser,
    "fault": fault.build_parser,
    "watch": watch.build_parser,
    "markers": markers.build_parser,
}
ALL_COMMANDS = [
    pytest.param(shlex.split(command), id=command)
    for page in PAGES
    for command in dict.fromkeys(commands_of(page) + commands_in_the_text(page))
]


def parameters_of(node: str) -> set[str]:
    """The ROS parameters of a node: its own, and those of the components that it can use."""
    nodes = [*SETTINGS] if node == "composed" else [node]
    own = {setting.name for name in nodes for setting in SETTINGS[name]}
    kinds = [kind for kind in ("controller", "observer", "detector") if kind in nodes]
    of_components = {
        f"{name}.{spec}" for kind in kinds for name, cls in components(kind).items() for spec in specs(cls)
    }
    return own | {*kinds} | of_components | ({"step_ticks"} if "plant" in nodes else set())


@pytest.mark.parametrize("command", ALL_COMMANDS)
def test_a_command_of_the_pages_names_what_there_is(command: list[str]) -> None:
    """Program and its arguments; node and its parameter."""
    verb, *rest = command[1:]
    if not rest:  # the verb is spoken of
        assert verb in ("run", "param", "topic", "bag", "security", "lifecycle", "launch", "service")
    elif verb == "run":
        package, program, *arguments = rest
        assert package == "ftcm_ros"
        if program in PARSERS:
            PARSERS[program]().parse_args(arguments)
            return
        assert program in {*ALL_NODES, "composed"}
        given = [b.partition(":=")[0] for a, b in pairwise(arguments) if a == "-p"]
        assert {*given} <= parameters_of(program)
    elif verb in ("param", "lifecycle") and len(rest) > 1:
        node = rest[1].removeprefix("/")
        assert node in ALL_NODES
        assert verb == "lifecycle" or rest[2] in parameters_of(node)
    elif verb == "launch":
        package, file, *arguments = rest
        assert package == "ftcm_ros"
        given = [argument.partition(":=")[0] for argument in arguments if argument != "-s"]
        assert {*given} <= {argument.name for argument in LAUNCH_FILES[file]}
    elif verb == "service":
        called, name, kind, *request = rest
        assert called == "call"
        if name == "/plant/pause":
            assert (kind, request) in [
                ("std_srvs/srv/SetBool", [f"{{data: {on}}}"]) for on in ("true", "false")
            ]
        else:
            assert (kind, request) == ("std_srvs/srv/Trigger", [])
            assert re.fullmatch(r"/plant/step|/(injector|plant)/faults/\w+_\d+/(arm|clear)", name)
    else:
        assert verb in ("topic", "param", "bag", "security")


def test_the_pages_are_read() -> None:
    found = [command for page in PAGES for command in commands_of(page) + commands_in_the_text(page)]
    assert len(found) > 20
    assert "ros2 run ftcm_ros plant" in found
    assert not [command for command in found if "#" in command]


# ---- the real command line ----


class Terminal:
    """A command with a terminal's process group of its own, which Ctrl-C reaches as a whole."""

    def __init__(self, words: list[str], folder: Path) -> None:
        self.words = words
        self.output = folder / f"{time.monotonic_ns()}.txt"
        with self.output.open("w") as file:
            self.process = subprocess.Popen(
                words, cwd=folder, stdin=subprocess.DEVNULL, stdout=file, stderr=subprocess.STDOUT,
                start_new_session=True, env={**os.environ, "PYTHONUNBUFFERED": "1"},
            )  # fmt: skip

    @property
    def text(self) -> str:
        return self.output.read_text("utf-8")

    def until(self, pattern: str) -> str:
        """Wait until the command has printed something."""
        end = time.monotonic() + HANG_SECONDS
        while not re.search(pattern, self.text, re.MULTILINE):
            assert time.monotonic() < end, f"{self.words}: no {pattern!r} in {self.text}"
            assert self.process.poll() is None, f"{self.words} has ended: {self.text}"
            time.sleep(0.05)
        return self.text

    def ctrl_c(self) -> int:
        """Press Ctrl-C; return the status. Nothing is left of the command."""
        os.killpg(self.process.pid, signal.SIGINT)
        status = self.process.wait(STOP_SECONDS)
        assert "Traceback" not in self.text
        assert not [p for p in psutil.process_iter() if self._is_of_this_session(p)]
        return status

    def _is_of_this_session(self, process: psutil.Process) -> bool:
        try:
            return os.getsid(process.pid) == self.process.pid and process.status() != psutil.STATUS_ZOMBIE
        except (ProcessLookupError, psutil.NoSuchProcess):
            return False

    def close(self) -> None:
        with contextlib.suppress(ProcessLookupError):
            os.killpg(self.process.pid, signal.SIGKILL)
        self.process.wait()


class Shell:
    """Runs commands in a folder, as a user does in several terminals."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.terminals: list[Terminal] = []

    def __call__(self, command: str) -> str:
        """Run a command to its end, with success; return what it prints."""
        done = self.attempt(command)
        assert done.returncode == 0, f"{command}: {done.stdout}{done.stderr}"
        return done.stdout

    def attempt(self, command: str) -> subprocess.CompletedProcess[str]:
        """Run a command to its end."""
        return subprocess.run(
            ["bash", "-c", command],
            cwd=self.folder, stdin=subprocess.DEVNULL, capture_output=True, text=True, check=False,
            timeout=HANG_SECONDS,
        )  # fmt: skip

    def terminal(self, command: str) -> Terminal:
        """Start a command in a terminal of its own."""
        self.terminals.append(Terminal(shlex.split(command), self.folder))
        return self.terminals[-1]

    def until(self, command: str, condition: Callable[[str], bool]) -> None:
        """Ask again and again, as a user does, until what a command prints is as wanted."""
        end = time.monotonic() + HANG_SECONDS
        while not condition(found := self.attempt(command).stdout):
            assert time.monotonic() < end, f"{command}: {found}"

    def until_active(self, *nodes: str) -> None:
        """Wait until these nodes are there and active."""
        wanted = {f"/{node}: active [3]" for node in nodes}
        self.until("ros2 lifecycle get", lambda text: wanted <= {*text.splitlines()})

    def ctrl_c(self, *terminals: Terminal) -> None:
        """End nodes with Ctrl-C, each with status 0."""
        for terminal in terminals:
            assert terminal.ctrl_c() == 0, terminal.text


@pytest.fixture
def shell(tmp_path: Path, domain: int) -> Iterator[Shell]:
    """A folder with `ros2`, in a domain of its own; nothing stays behind, the daemon of `ros2` included."""
    made = Shell(tmp_path)
    yield made
    for terminal in made.terminals:
        terminal.close()
    made.attempt("ros2 daemon stop")


def program_of(command: str) -> str:
    return shlex.split(command)[3]


@needs_ros2
@pytest.mark.slow
@pytest.mark.parametrize("together", [False, True], ids=["processes", "composed"])
def test_the_commands_by_hand(shell: Shell, together: bool) -> None:
    """In their order; `composed` is in the place of the nodes of a tick."""
    nodes: list[Terminal] = []
    done = []
    for command in commands_of(DOCS / "first_steps.md", "make build"):
        kind = command.split()[1:3]
        if kind == ["run", "ftcm_ros"]:
            program = program_of(command)
            if program == "analyse":
                shell.ctrl_c(*nodes)
                assert "Mean |e| over the whole run" in shell(command)
            elif program == "replay":
                told = shell.attempt(command)  # not from its first tick on: the recorder came later
                assert "mybag: " in told.stdout + told.stderr
            elif program == "detector":
                refused = shell.attempt(command)
                assert refused.returncode == 2
                assert "the scenario has no detector" in refused.stderr
            elif program == "recorder" or (program == "composed") == together:
                nodes.append(shell.terminal(command))
        elif kind == ["param", "set"]:
            *_, node, name, value = command.split()
            if "param" not in done:
                shell.until_active(*NODES)
            assert shell(command) == "Set parameter successful\n"
            assert shell(f"ros2 param get {node} {name}").split()[-1] == value
        elif kind == ["topic", "echo"]:
            echo = shell.terminal(command)
            echo.until("^---$")
            assert re.search("^- level:", echo.text, re.MULTILINE)
            echo.ctrl_c()
        else:
            pytest.fail(f"nothing is known about {command!r}")
        done.append(kind[0])
    assert {*done} == {"run", "param", "topic"}
    assert read_bag(shell.folder / "mybag").trace.ticks > 1000


@needs_ros2
@pytest.mark.slow
def test_the_experiments_of_the_first_steps(shell: Shell) -> None:
    """As they stand there, but shorter and without figures."""
    (shell.folder / "my_scenario.yaml").write_text(load("paper").to_yaml(), "utf-8")
    found = [c for c in commands_of(DOCS / "first_steps.md", "my_scenario") if program_of(c) == "experiment"]
    assert len(found) == 2
    for k, command in enumerate(found):
        shell(f"{command} --set duration=0.5 --no-figures --name {k} --domain-id $ROS_DOMAIN_ID")
    assert {bag.name for bag in shell.folder.glob("runs/0/bags/*")} == {"smc", "ftcm"}
    (real_time,) = shell.folder.glob("runs/1/bags/*")
    assert read_bag(real_time).nodes["plant"]["mode"] == "real_time"


@needs_ros2
@pytest.mark.slow
def test_ctrl_c_ends_an_experiment(shell: Shell, domain: int) -> None:
    terminal = shell.terminal(f"ros2 run ftcm_ros experiment paper --name test --domain-id {domain}")
    terminal.until("ticks/s")
    assert terminal.ctrl_c() == 130
    assert "stopped by the user" in terminal.text
    assert (shell.folder / "runs" / "test" / "summary.json").is_file()


@needs_ros2
@pytest.mark.slow
def test_another_run_is_begun_by_the_command_in_the_text(shell: Shell) -> None:
    (again,) = [c for c in commands_in_the_text(DOCS / "first_steps.md") if c.startswith("ros2 lifecycle")]
    short = load("paper", ["duration=0.5"], controller="pid")
    (shell.folder / "short.yaml").write_text(short.to_yaml(), "utf-8")
    plant = shell.terminal("ros2 run ftcm_ros plant --ros-args -p scenario:=short.yaml")
    for count in (1, 2):
        shell.until("ros2 lifecycle get /plant", lambda text: text.startswith("inactive"))
        assert plant.text.count("completed: ") == count
        if count == 1:
            assert shell(again) == "Transitioning successful\n"
    shell.ctrl_c(plant)


SLOW = [
    "dt=0.05", "duration=3600", "injection.faults=[]", "observer.k1=50", "observer.k2=5",
    "detector=residual_threshold",
]  # fmt: skip
"""An hour of twenty ticks a second, which leaves the processors to the commands."""


@needs_ros2
@pytest.mark.slow
def test_what_ros2_shows_of_a_running_graph_and_can_change_in_it(shell: Shell) -> None:
    (shell.folder / "slow.yaml").write_text(load("paper", SLOW).to_yaml(), "utf-8")
    given = "--ros-args -p scenario:=slow.yaml"
    nodes = [shell.terminal(f"ros2 run ftcm_ros {name} {given}") for name in ALL_NODES]
    shell.until_active(*ALL_NODES)

    assert {*shell("ros2 node list").split()} == {f"/{name}" for name in ALL_NODES}
    topics = {*shell("ros2 topic list").split()}
    assert {f"/{c.topic}" for c in CHANNELS} - {"/true_state"} <= topics
    rate = shell.terminal("ros2 topic hz /joint_states")
    rate.until("^average rate: ")
    rate.ctrl_c()
    state = shell("ros2 topic echo --once /joint_states")
    assert re.findall(r"^- (joint\d)$", state, re.MULTILINE) == ["joint1", "joint2", "joint3"]

    for kind in ("controller", "observer", "detector"):
        described(shell, kind)

    assert shell("ros2 param set /controller controller smc") == "Set parameter successful\n"
    in_force = shell("ros2 topic echo --once --filter \"m.status[0].message == 'smc'\" /component_changes")
    assert "message: smc" in in_force
    for name, value, reason in (
        ("controller", "scm", "no controller 'scm'; did you mean 'smc'?"),
        ("smc.c", "-1.0", "smc.c: -1 is out of range"),
        ("smc.c", "'[1.0, 2.0]'", "expected one per joint (3)"),
        ("smc.c", "high", "smc.c: 'high' is not a number"),
        ("scenario", "other.yaml", "read-only"),
    ):
        before = shell(f"ros2 param get /controller {name}")
        refused = shell.attempt(f"ros2 param set /controller {name} {value}")
        assert "Setting parameter failed: " in refused.stderr
        assert reason in refused.stderr
        assert shell(f"ros2 param get /controller {name}") == before
    shell.ctrl_c(*nodes)


def described(shell: Shell, kind: str) -> None:
    """Text, unit, source and bounds of every parameter of every component of a kind are shown."""
    declared = [(f"{n}.{s.name}", s) for n, cls in components(kind).items() for s in specs(cls).values()]
    text = shell(f"ros2 param describe /{kind} " + " ".join(name for name, _ in declared))
    shown = re.split(r"^Parameter name: ", text, flags=re.MULTILINE)[1:]
    assert [found.splitlines()[0] for found in shown] == [name for name, _ in declared]
    for found, (_, spec) in zip(shown, declared):
        assert f"{spec.doc} [{spec.unit}] ({spec.source})" in found
        assert f"Additional constraints: expected {spec.expected}" in found
        if "Min value" in found:
            low, high = (float(x) for x in re.findall(r"(?:Min|Max) value: (\S+)", found))
            assert (low, high) == (spec.lower, spec.upper)


@needs_ros2
@pytest.mark.slow
def test_two_machines_step_by_step(shell: Shell) -> None:
    """The commands of network.md, here on one machine: the run is the in-process run float for float."""
    scenario = load("paper", ["duration=0.5", "injection.faults.0.start=0.2"])
    (shell.folder / "my.yaml").write_text(scenario.to_yaml(), "utf-8")
    lines = [line for line in lines_of(DOCS / "network.md", "lifecycle") if line]
    starts = [line for line in lines if line.startswith("ros2 run")]
    transitions = [line for line in lines if line.startswith("for ")]
    assert sorted(starts + transitions) == sorted(lines)
    nodes = [shell.terminal(line) for line in starts]
    shell.until("ros2 node list", lambda text: {*text.split()} == {f"/{name}" for name in NODES})
    for line in transitions:
        assert shell(line) == "Transitioning successful\n" * len(NODES)
    shell.until("ros2 lifecycle get /plant", lambda text: text.startswith("inactive"))
    shell.ctrl_c(*nodes)
    bag = read_bag(shell.folder / "mybag")
    assert bag.missing == {}
    assert same(bag.trace, simulate(scenario))


@needs_ros2
@pytest.mark.slow
def test_a_controller_outside_the_composition(shell: Shell) -> None:
    """The commands of real_time.md."""
    found = commands_of(DOCS / "real_time.md", "composed --nodes")
    assert [program_of(command) for command in found] == ["composed", "controller"]
    nodes = [shell.terminal(command) for command in found]
    shell.until_active("plant", "observer", "injector", "controller")
    assert shell("ros2 topic echo --once /joint_torques")
    shell.ctrl_c(*nodes)


@needs_ros2
@pytest.mark.slow
def test_the_example_of_a_plug_in(shell: Shell) -> None:
    """The commands of extending.md: run, analysed without the plug-in, which is one line, and with it."""
    code = blocks_of((DOCS / "tutorials/law.md").read_text("utf-8"))[0]
    (shell.folder / code.name).write_text(code.text, "utf-8")
    run, *analyses = [c for c in commands_of(DOCS / "extending.md") if code.name in c or "spring" in c]
    shell(f"{run} --set duration=0.5 --no-figures --name p --domain-id $ROS_DOMAIN_ID")
    without, given = analyses
    refused = shell.attempt(without)
    assert refused.returncode == 2
    assert "no controller 'spring'" in refused.stderr
    assert "give them with --plugin" in refused.stderr
    assert "| spring" in shell(given)
