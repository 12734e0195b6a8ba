# SPDX-License-Identifier: Apache-2.0
"""The launch files: what they start, and a run as `ros2 launch` does it.

What needs `ros2 launch` itself takes it from the PATH; who drives the nodes is tested without it, too.
"""

from __future__ import annotations

import importlib.util
import os
import re
import shutil
import signal
import subprocess
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
import yaml

pytest.importorskip("rclpy", reason="ROS 2 (rclpy) is not installed")

import psutil

from ftcm_core.errors import FtcmError
from ftcm_core.scenario import load
from ftcm_core.simulation import simulate
from ftcm_ros.bags.reader import read_bag
from ftcm_ros.parameters.node_parameters import ALL_NODES, NODES, SETTINGS
from ftcm_ros.run import launching
from ftcm_ros.run.launching import (
    EXPERIMENT_ARGUMENTS,
    NODE_ARGUMENTS,
    VIEWER_ARGUMENTS,
    Process,
    parsed,
    shown_default,
)
from ftcm_ros.run.run_parameters import run_parameters
from traces import same

pytestmark = pytest.mark.ros

FOLDER = Path(__file__).resolve().parents[2] / "src" / "ftcm_ros" / "launch"
HANG_SECONDS = 120.0
"""Generous ceiling that catches hangs."""
SHORT = "duration=0.5 injection.faults.0.start=0.2"

needs_launch = pytest.mark.skipif(
    importlib.util.find_spec("launch_ros") is None,
    reason="launch and launch_ros are not installed: the package index has none; see CONTRIBUTING.md",
)
needs_ros2_launch = pytest.mark.skipif(
    shutil.which("ros2") is None or importlib.util.find_spec("ros2launch") is None,
    reason="there is no `ros2 launch` on the PATH: the package index has none; see CONTRIBUTING.md",
)


def given(**values: str) -> dict[str, str]:
    """The arguments of ``experiment.launch.py``, some of them set."""
    return {**{a.name: shown_default(a) for a in EXPERIMENT_ARGUMENTS}, **values}


def read(file: str) -> dict[str, Any]:
    """The parameters in a node's parameter file."""
    ((_, of_node),) = yaml.safe_load(Path(file).read_text("utf-8")).items()
    found: dict[str, Any] = of_node["ros__parameters"]
    return found


# What is started.


def test_a_process_for_each_node_and_one_that_drives_them(tmp_path: Path) -> None:
    found = launching.experiment(given(controller="smc", set=SHORT, bag=str(tmp_path / "bag")), tmp_path)
    assert [process.executable for process in found.nodes] == [*NODES]
    assert found.scenario == load("paper", SHORT.split(), controller="smc")
    assert load(str(tmp_path / "scenario.yaml")) == found.scenario
    assert found.driver == Process("drive", (str(tmp_path / "scenario.yaml"),))
    for process in found.nodes:
        (file,) = process.parameters
        assert isinstance(file, str)
        values = read(file)
        assert {*values} <= {s.name for s in SETTINGS[process.executable]}
        assert (values["autostart"], values["await_graph"]) == (False, True)
        assert values["scenario"] == str(tmp_path / "scenario.yaml")
    assert read(str(tmp_path / "recorder.yaml"))["bag"] == str(tmp_path / "bag")
    assert read(str(tmp_path / "plant.yaml"))["mode"] == "lockstep"
    assert not (tmp_path / "bag").exists(), "the recorder makes it"


def test_a_detector_where_the_scenario_has_one(tmp_path: Path) -> None:
    found = launching.experiment(given(set="detector=residual_threshold"), tmp_path)
    assert [process.executable for process in found.nodes] == [*ALL_NODES]


@pytest.mark.parametrize(
    ("mode", "composed", "together"),
    [
        ("lockstep", "auto", False),
        ("lockstep", "true", True),
        ("real_time", "auto", True),
        ("real_time", "false", False),
    ],
)
def test_composed_as_asked_else_in_real_time(
    tmp_path: Path, mode: str, composed: str, together: bool
) -> None:
    found = launching.experiment(given(mode=mode, composed=composed), tmp_path)
    names = [process.executable for process in found.nodes]
    assert names == (["composed", "recorder"] if together else [*NODES])
    if together:
        stage_nodes = tuple(node for node in NODES if node != "recorder")
        assert found.nodes[0].arguments == ("--nodes", *stage_nodes)
        assert [Path(str(file)).stem for file in found.nodes[0].parameters] == [*stage_nodes]


def test_priority_is_for_the_nodes_of_a_tick(tmp_path: Path) -> None:
    launching.experiment(given(priority="50", lock_memory="true"), tmp_path)
    for node in NODES:
        values = read(str(tmp_path / f"{node}.yaml"))
        assert values["priority"] == (0 if node == "recorder" else 50)
        assert values["lock_memory"] is True


def test_in_lockstep_policies_wait_for_the_detector(tmp_path: Path) -> None:
    scenario = load("paper")
    for mode, waits in (("lockstep", True), ("real_time", False)):
        found = run_parameters(scenario, tmp_path / "s.yaml", tmp_path / "bag", {"mode": mode})
        assert [node for node, values in found.items() if "await_detection" in values] == [
            "observer",
            "controller",
        ]
        assert found["controller"]["await_detection"] is waits


@pytest.mark.parametrize(
    ("values", "said"),
    [
        ({"scenario": "papr"}, "papr"),
        ({"controller": "fctm"}, "no controller 'fctm'; did you mean 'ftcm'?"),
        ({"set": "duration=ten"}, "duration"),
        ({"set": "'duration=1"}, 'set: "\'duration=1": No closing quotation'),
        ({"plugins": "no_such_file.py"}, "no_such_file.py"),
        ({"priority": "high"}, "priority: 'high'; expected a whole number"),
        ({"lock_memory": "1"}, "lock_memory: '1'; expected true or false"),
        ({"mode": "fast"}, "mode: no 'fast'; known: lockstep, real_time"),
        ({"bag": "."}, "exists already"),
    ],
)
def test_a_mistake_is_one_line(tmp_path: Path, values: dict[str, str], said: str) -> None:
    with pytest.raises(FtcmError, match=re.escape(said)):
        launching.experiment(given(**values), tmp_path)


def test_a_single_node_with_its_parameters() -> None:
    nothing = {a.name: "" for a in NODE_ARGUMENTS}
    assert launching.single({**nothing, "node": "observer"}) == Process("observer")
    one = {**nothing, "node": "plant", "mode": "lockstep", "recorder_window": "7", "autostart": "false"}
    values = {"mode": "lockstep", "recorder_window": 7, "autostart": False}
    assert launching.single(one).parameters == (values,)
    for wrong, said in (
        ({"node": "plnt"}, "node: no 'plnt'; did you mean 'plant'?"),
        ({"node": "observer", "mode": "lockstep"}, "mode: node 'observer' has no such parameter"),
        ({"node": "plant", "mode": "fast"}, "mode: no 'fast'"),
        ({"node": "plant", "params_file": "none.yaml"}, "there is no file 'none.yaml'"),
    ):
        with pytest.raises(FtcmError, match=re.escape(said)):
            launching.single({**nothing, **wrong})


def test_every_argument_has_its_default_back() -> None:
    for argument in EXPERIMENT_ARGUMENTS:
        assert parsed(argument, shown_default(argument)) == argument.default
        assert argument.description


@needs_launch
@pytest.mark.parametrize(
    ("file", "declared"),
    [("experiment", EXPERIMENT_ARGUMENTS), ("node", NODE_ARGUMENTS), ("viewer", VIEWER_ARGUMENTS)],
)
def test_the_launch_files_declare_these_arguments(file: str, declared: tuple[Any, ...]) -> None:
    from launch.launch_description_sources import get_launch_description_from_python_launch_file

    found = get_launch_description_from_python_launch_file(str(FOLDER / f"{file}.launch.py"))
    assert [a.name for a in found.get_launch_arguments()] == [a.name for a in declared]


# Who drives them.


def start_nodes(
    start: Callable[..., subprocess.Popen[str]], tmp_path: Path, changes: str
) -> dict[str, subprocess.Popen[str]]:
    """Start the nodes of a run as the launch file does; its scenario is ``scenario.yaml``."""
    found = launching.experiment(given(set=changes, bag=str(tmp_path / "bag")), tmp_path)
    return {
        process.executable: start(
            f"nodes.{process.executable}", "--ros-args", "--params-file", str(*process.parameters)
        )
        for process in found.nodes
    }


@pytest.mark.slow
@pytest.mark.usefixtures("domain")
def test_driven_nodes_do_the_run_float_for_float(
    start: Callable[..., subprocess.Popen[str]], tmp_path: Path
) -> None:
    nodes = start_nodes(start, tmp_path, SHORT)
    driver = start("run.drive", "scenario.yaml")
    _, err = driver.communicate(timeout=HANG_SECONDS)
    assert driver.returncode == 0, err
    assert "completed: 0.5 s" in err
    assert all(node.poll() is None for node in nodes.values()), "they are somebody else's"
    bag = read_bag(tmp_path / "bag")
    assert (bag.missing, bag.damage) == ({}, "")
    assert same(bag.trace, simulate(load("paper", SHORT.split())))


@pytest.mark.slow
@pytest.mark.usefixtures("domain")
def test_a_node_that_stops_during_the_run_is_named(
    start: Callable[..., subprocess.Popen[str]], tmp_path: Path
) -> None:
    nodes = start_nodes(start, tmp_path, "duration=600")
    driver = start("run.drive", "scenario.yaml", "--patience", "2")
    assert driver.stderr
    assert "ticks/s" in driver.stderr.readline()
    nodes["controller"].send_signal(signal.SIGSTOP)
    _, err = driver.communicate(timeout=HANG_SECONDS)
    nodes["controller"].send_signal(signal.SIGCONT)
    assert driver.returncode == 1, err
    assert "drive: error: node 'controller' has" in err


@pytest.mark.usefixtures("domain")
def test_without_nodes_it_says_which_it_has_waited_for(start: Callable[..., subprocess.Popen[str]]) -> None:
    driver = start("run.drive", "paper", "--wait", "0.2")
    _, err = driver.communicate(timeout=HANG_SECONDS)
    assert driver.returncode == 1
    assert (
        err.strip()
        == "drive: error: node 'observer' did not configure, for which it has 0.2 s; see its output"
    )


@pytest.mark.parametrize(
    ("arguments", "said"), [(["papr"], "papr"), (["paper", "--patience", "1"], "too short; expected 2 s")]
)
def test_a_mistake_of_who_drives_is_one_line(
    start: Callable[..., subprocess.Popen[str]], arguments: list[str], said: str
) -> None:
    driver = start("run.drive", *arguments)
    _, err = driver.communicate(timeout=HANG_SECONDS)
    assert driver.returncode == 2
    (line,) = err.splitlines()
    assert line.startswith("drive: error: ")
    assert said in line


# The real `ros2 launch`.


class Launch:
    """A launch file under way, with a terminal's process group of its own."""

    def __init__(self, words: list[str], folder: Path) -> None:
        self.output = folder / f"launch-{time.monotonic_ns()}.txt"
        with self.output.open("w") as file:
            self.process = subprocess.Popen(
                ["ros2", "launch", "ftcm_ros", *words],
                cwd=folder, stdin=subprocess.DEVNULL, stdout=file, stderr=subprocess.STDOUT,
                start_new_session=True, env={**os.environ, "ROS_LOG_DIR": str(folder / "log")},
            )  # fmt: skip

    @property
    def text(self) -> str:
        return self.output.read_text("utf-8")

    def until(self, pattern: str) -> None:
        """Wait until something has been printed."""
        end = time.monotonic() + HANG_SECONDS
        while not re.search(pattern, self.text, re.MULTILINE):
            assert time.monotonic() < end, f"no {pattern!r} in {self.text}"
            assert self.process.poll() is None, self.text
            time.sleep(0.05)

    def end(self) -> int:
        """Wait for its end; return the status. Nothing is left of it."""
        status = self.process.wait(HANG_SECONDS)
        assert not [p for p in psutil.process_iter() if self._is_of_this_session(p)]
        return status

    def _is_of_this_session(self, process: psutil.Process) -> bool:
        try:
            return os.getsid(process.pid) == self.process.pid and process.status() != psutil.STATUS_ZOMBIE
        except (ProcessLookupError, psutil.NoSuchProcess):
            return False


@pytest.fixture
def ros2_launch(tmp_path: Path, domain: int) -> Iterator[Callable[..., Launch]]:
    """Starts launch files in a domain of its own; nothing stays behind."""
    started: list[Launch] = []

    def run(*words: str) -> Launch:
        started.append(Launch([*words], tmp_path))
        return started[-1]

    yield run
    for one in started:
        if one.process.poll() is None:
            os.killpg(one.process.pid, signal.SIGKILL)
            one.process.wait()


@needs_ros2_launch
@pytest.mark.slow
@pytest.mark.parametrize("composed", ["false", "true"])
def test_ros2_launch_does_the_run_float_for_float(
    ros2_launch: Callable[..., Launch], tmp_path: Path, composed: str
) -> None:
    one = ros2_launch(
        "experiment.launch.py", "scenario:=paper", "controller:=ftcm", f"set:={SHORT}", "bag:=mybag",
        f"composed:={composed}",
    )  # fmt: skip
    assert one.end() == 0, one.text
    bag = read_bag(tmp_path / "mybag")
    assert (bag.missing, bag.damage) == ({}, "")
    assert same(bag.trace, simulate(load("paper", SHORT.split(), controller="ftcm")))
    assert one.text.count("process started") == (3 if composed == "true" else 6)


@needs_ros2_launch
@pytest.mark.slow
def test_ros2_launch_in_real_time_with_a_detector(ros2_launch: Callable[..., Launch], tmp_path: Path) -> None:
    one = ros2_launch(
        "experiment.launch.py", "mode:=real_time", f"set:={SHORT} detector=residual_threshold", "bag:=mybag"
    )
    assert one.end() == 0, one.text
    bag = read_bag(tmp_path / "mybag")
    assert bag.nodes["plant"]["mode"] == "real_time"
    assert re.findall(r"\[(\w+)-\d\]: process started", one.text) == ["composed", "recorder", "drive"]
    assert "detection" in bag.stamps
    assert bag.trace.ticks == 501


@needs_ros2_launch
@pytest.mark.slow
def test_ctrl_c_ends_ros2_launch_with_a_whole_bag(ros2_launch: Callable[..., Launch], tmp_path: Path) -> None:
    one = ros2_launch("experiment.launch.py", "set:=duration=600", "bag:=mybag")
    one.until(r"^\[drive-\d\]   ftcm: t = ")
    os.killpg(one.process.pid, signal.SIGINT)
    one.end()
    assert "Traceback" not in one.text
    assert "SIGKILL" not in one.text
    bag = read_bag(tmp_path / "mybag")
    assert bag.damage == ""
    assert bag.trace.ticks > 100


@needs_ros2_launch
@pytest.mark.slow
def test_a_node_that_ends_ends_the_launch_with_its_name(
    ros2_launch: Callable[..., Launch], tmp_path: Path
) -> None:
    one = ros2_launch("experiment.launch.py", "set:=duration=600", "bag:=mybag")
    one.until(r"recording to")
    (pid,) = re.findall(r"observer-\d\]: process started with pid \[(\d+)\]", one.text)
    os.kill(int(pid), signal.SIGKILL)
    assert one.end() == 1
    assert "observer has ended with status -9 before the run has" in one.text
    assert read_bag(tmp_path / "mybag").damage == "", "the recorder has closed it"


@needs_ros2_launch
@pytest.mark.parametrize("word", ["scenario:=papr", "controller:=fctm", "priority:=high", "mode:=fast"])
def test_ros2_launch_refuses_a_mistake_before_anything_starts(
    ros2_launch: Callable[..., Launch], word: str
) -> None:
    one = ros2_launch("experiment.launch.py", word)
    assert one.end() == 1
    assert word.partition(":=")[2] in one.text
    assert "process started" not in one.text


@needs_ros2_launch
@pytest.mark.slow
def test_ros2_launch_starts_a_single_node(ros2_launch: Callable[..., Launch], tmp_path: Path) -> None:
    (tmp_path / "short.yaml").write_text(load("paper", ["duration=0.2"]).to_yaml(), encoding="utf-8")
    one = ros2_launch("node.launch.py", "node:=plant", "scenario:=short.yaml", "torque_timeout:=0")
    one.until("completed: 0.2 s")
    os.killpg(one.process.pid, signal.SIGINT)
    one.end()
    assert "Traceback" not in one.text
