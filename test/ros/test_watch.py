# SPDX-License-Identifier: Apache-2.0
"""``ftcm watch``: what it shows, of a run that is on too; and that it changes nothing of that."""

from __future__ import annotations

import math
import os
import pty
import re
import signal
import subprocess
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

pytest.importorskip("rclpy", reason="ROS 2 (rclpy) is not installed")

from ftcm_core.faults.timing import NEVER
from ftcm_core.scenario import load
from ftcm_core.simulation import simulate
from ftcm_ros.bags.reader import read_bag
from ftcm_ros.parameters.node_parameters import ALL_NODES, NODES
from ftcm_ros.run.view import DRAWN, KEPT, SHOWN, WATCHED, Sample, View
from ftcm_ros.transport.topics import DETECTION, ESTIMATE, JOINT_STATES, REFERENCE, TORQUES
from programs import program
from sros_policy import VIEWER, rules
from traces import same

pytestmark = pytest.mark.ros

HANG_SECONDS = 120.0
"""Generous ceiling that catches hangs."""
JOINTS = ("joint1", "joint2")


def view(**health: dict[str, str]) -> View:
    """A view that has heard these nodes at time 0."""
    made = View()
    for node, values in health.items():
        made.hear_health(node, 0, values.pop("says", ""), {"process": "1", **values}, 0.0)
    return made


def sample(**arrays: tuple[float, ...]) -> Sample:
    """A message of two joints."""
    return Sample(JOINTS, *(arrays.get(name, ()) for name in ("position", "velocity", "effort")))


# What it knows.


def test_the_error_is_of_one_and_the_same_tick() -> None:
    made = view()
    assert math.isnan(made.error("joint1"))
    for k in range(5):
        made.hear_sample(JOINT_STATES.name, k, sample(position=(10.0 + k, 20.0 + k)))
    for k in range(3):
        made.hear_sample(REFERENCE.name, k, sample(position=(9.0, 19.5)))
    assert (made.error("joint1"), made.error("joint2")) == (12.0 - 9.0, 22.0 - 19.5)
    assert made.joints == JOINTS


def test_joints_are_taken_by_their_name() -> None:
    turned = Sample(("joint2", "joint1"), (), (), (2.0, 1.0))
    assert (turned.of("effort", "joint1"), turned.of("effort", "joint2")) == (1.0, 2.0)
    assert math.isnan(turned.of("position", "joint1"))
    assert math.isnan(turned.of("effort", "joint3"))


def test_a_few_messages_are_kept_and_those_of_another_run_are_not() -> None:
    made = view()
    for k in range(3 * KEPT):
        made.hear_sample(TORQUES.name, k, sample(effort=(float(k), 0.0)))
    assert len(made._samples[TORQUES.name]) == KEPT
    made.hear_sample(TORQUES.name, 0, sample(effort=(-1.0, 0.0)))
    assert made.newest(TORQUES.name, "effort", "joint1") == -1.0


def test_whether_a_run_is_on() -> None:
    assert not View().running(0.0)
    assert not view(plant={"state": "waiting"}).running(0.0)
    made = view(plant={"state": "running"})
    assert made.running(1.0)
    assert not made.running(5.0), "it has said nothing since"


def test_a_plant_of_another_process_is_another_run() -> None:
    made = view(plant={"state": "running"})
    made.hear_fault("bias_0", 1.0, 2.0)
    made.hear_health("plant", 0, "", {"process": "1"}, 1.0)
    assert made.acting()
    made.hear_health("plant", 0, "", {"process": "2"}, 2.0)
    assert not made.acting()


def test_which_faults_act() -> None:
    made = view()
    for label, onset, end in (
        ("by_hand_0", NEVER, NEVER),
        ("later_0", 8.0, NEVER),
        ("now_0", 2.0, NEVER),
        ("short_0", 1.0, 3.0),
        ("timed_0", 4.0, 6.0),
    ):
        made.hear_fault(label, onset, end)
    made.hear_sample(JOINT_STATES.name, 5 * 10**9, sample())
    assert made.acting() == [
        "by_hand_0 waits",
        "later_0 from t = 8 s",
        "now_0 ACTS since t = 2 s",
        "short_0 is over since t = 3 s",
        "timed_0 ACTS since t = 4 s, to 6 s",
    ]


def test_alarms_say_what_is_broken() -> None:
    made = view()
    made.hear_sample(JOINT_STATES.name, 0, sample(position=(0.0, 0.0)))
    assert made.alarms() == {}
    made.hear_sample(DETECTION.name, 0, sample(position=(0.0, 1.0), velocity=(0.0, 3.0)))
    assert made.alarms() == {"joint2": "loss of effectiveness"}


def test_the_scenario_says_which_nodes_and_topics_there_are() -> None:
    made = view(plant={"state": "running"})
    made.hear_scenario("no: [yaml")
    assert made.expected == ()
    made.hear_scenario(load("paper").to_yaml())
    assert made.expected == NODES
    assert re.search("^observer +- +not heard yet$", made.screen(0.0, ""), re.MULTILINE)
    for topic in SHOWN:
        if topic is not DETECTION:
            assert not made.complete
            made.hear_sample(topic.name, 0, sample())
    assert made.complete
    made.hear_scenario(load("paper", ["detector=residual_threshold"]).to_yaml())
    assert made.expected == ALL_NODES
    assert not made.complete


# How it shows it.


def test_the_screen_has_a_row_for_each_node_and_joint() -> None:
    made = view(
        plant={"state": "running", "mode": "lockstep", "tick": "7", "last_tick": "9", "missed_deadlines": "3",
               "rate_hz": "990.1", "says": "running, 3 deadlines missed"},
        observer={"gaps": "0"},
    )  # fmt: skip
    made.hear_component("controller", "smc")
    made.hear_sample(JOINT_STATES.name, 10**9, sample(position=(1.0, 2.0), effort=(5.0, 6.0)))
    made.hear_sample(REFERENCE.name, 10**9, sample(position=(0.5, 2.25)))
    made.hear_sample(ESTIMATE.name, 10**9, sample(effort=(-4.0, 3.0)))
    text = made.screen(1.0, "ROS_DOMAIN_ID=7")
    assert text.splitlines()[0] == (
        "ftcm watch  ROS_DOMAIN_ID=7  lockstep  controller smc  t = 1.000 s  tick 7 of 9"
    )
    assert re.search(r"^plant +ok +990\.1 +3 +running, 3 deadlines missed$", text, re.MULTILINE)
    assert re.search(r"^observer +ok", text, re.MULTILINE)
    assert re.search(r"^joint1 +0\.5 +5 +4$", text, re.MULTILINE)
    assert re.search(r"^joint2 +-0\.25 +6 +-3$", text, re.MULTILINE)
    assert "\x1b" not in text


def test_a_node_that_is_silent_is_said_to_be() -> None:
    made = view(plant={"state": "running", "says": "running"}, observer={"says": "fine"})
    made.hear_health("plant", 0, "running", {"process": "1", "state": "running"}, 9.0)
    assert re.search(r"^observer +silent .* for 10 s; before: fine$", made.screen(10.0, ""), re.MULTILINE)
    assert "observer SILENT for 10 s" in made.line(10.0)
    assert "plant SILENT" not in made.line(10.0)


def test_one_line_has_what_matters() -> None:
    made = view(plant={"state": "running", "rate_hz": "1000", "missed_deadlines": "2", "says": "running"})
    made.hear_health("controller", 1, "2 gaps", {}, 0.0)
    made.hear_sample(JOINT_STATES.name, 10**9, sample(position=(1.0, 2.0)))
    made.hear_fault("bias_0", 0.5, NEVER)
    made.hear_sample(DETECTION.name, 10**9, sample(position=(1.0, 0.0), velocity=(2.0, 0.0)))
    line = made.line(1.0)
    assert "\n" not in line
    for said in ("t = 1.000 s; running; 1000 Hz; missed 2", "bias_0 ACTS", "ALARM joint1: sensor"):
        assert said in line
    assert line.endswith("controller: 2 gaps")
    assert View().line(0.0) == "no node says anything yet"
    assert view(observer={}).line(0.0) == "observer up; no plant"


def test_with_security_it_may_listen_and_nothing_else() -> None:
    may = rules(VIEWER)
    assert may["topics", "publish"] == ["/parameter_events", "/rosout"]
    assert may["services", "request"] == []
    assert {name.removeprefix("/") for name in may["topics", "subscribe"]} == {
        topic.name.removeprefix("/") for topic in (*SHOWN, *WATCHED, *DRAWN)
    }


# Of a run that is on.


LONG = ("paper", "--controllers", "ftcm", "--set", "duration=600", "--set", "injection.faults.0.start=0.1")


@pytest.mark.slow
def test_it_shows_a_run_that_is_on(live: Callable[..., Any], start: Callable[..., Any]) -> None:
    run = live(*LONG, "--set", "detector=residual_threshold")
    run.first_tick(("controller", "ftcm"), ("observer", "do"), ("detector", "residual_threshold"))
    once = start("run.watch", "--once", "--timeout", "60")
    out, err = once.communicate(timeout=HANG_SECONDS)
    assert (once.returncode, err) == (0, "")
    for node in ALL_NODES:
        assert re.search(rf"^{node} +(ok|warn|error) +[\d.]+ ", out, re.MULTILINE), out
    for joint in (1, 2, 3):
        (row,) = [line.split() for line in out.splitlines() if line.startswith(f"joint{joint} ")]
        assert all(math.isfinite(float(number)) for number in row[1:7]), out
    assert "controller ftcm" in out.splitlines()[0]
    assert "vo_kang_fault_0 ACTS since t = 0.1 s" in out

    lines = start("run.watch")
    assert lines.stdout
    wanted = r"^t = [\d.]+ s; running; [\d.]+ Hz; missed 0; e .* rad; u .* N·m; vo_kang_fault_0 ACTS"
    told = [lines.stdout.readline()]
    while not re.search(wanted, told[-1]):
        assert len(told) < HANG_SECONDS, told  # one a second
        told.append(lines.stdout.readline())
    lines.send_signal(signal.SIGINT)
    _, err = lines.communicate(timeout=HANG_SECONDS)
    assert (lines.returncode, err) == (0, "")

    health = start("run.watch", "--once", "--health", "--timeout", "60")
    out, _ = health.communicate(timeout=HANG_SECONDS)
    assert "plant" in out
    assert "joint1" not in out
    run.interrupt()


@pytest.mark.slow
def test_on_a_terminal_the_screen_is_drawn_again_and_again(live: Callable[..., Any]) -> None:
    run = live(*LONG)
    run.first_tick(("controller", "ftcm"), ("observer", "do"))
    ours, theirs = pty.openpty()
    process = subprocess.Popen(
        program("run.watch"), stdin=subprocess.DEVNULL, stdout=theirs, stderr=theirs,
        env={**os.environ, "COLUMNS": "70", "LINES": "12"},
    )  # fmt: skip
    os.close(theirs)
    text = ""
    end = time.monotonic() + HANG_SECONDS
    while text.count("\x1b[H\x1b[J") < 12 and time.monotonic() < end:
        text += os.read(ours, 65536).decode(errors="replace")
    process.send_signal(signal.SIGINT)
    assert process.wait(HANG_SECONDS) == 0
    os.close(ours)
    screens = text.split("\x1b[H\x1b[J")[1:-1]
    for screen in screens:
        lines = screen.replace("\r", "").splitlines()
        assert len(lines) < 12
        assert all(len(line) <= 70 for line in lines)
    assert "joint1" in screens[-1]
    run.interrupt()


@pytest.mark.slow
@pytest.mark.parametrize("how", [signal.SIGSTOP, signal.SIGKILL], ids=["hangs", "dies"])
def test_a_viewer_that_hangs_or_dies_changes_nothing(
    live: Callable[..., Any], start: Callable[..., Any], tmp_path: Path, how: signal.Signals
) -> None:
    changes = ["duration=8", "injection.faults.0.start=0.1"]
    viewer = start("run.watch")  # before the run: no node may count it for one of the others
    run = live("paper", "--controllers", "smc", *(word for change in changes for word in ("--set", change)))
    assert viewer.stdout
    while "u " not in (line := viewer.stdout.readline()):
        assert line
    viewer.send_signal(how)
    run.end()
    if how is signal.SIGSTOP:
        viewer.send_signal(signal.SIGCONT)
        viewer.send_signal(signal.SIGTERM)
    bag = read_bag(tmp_path / "runs" / "test" / "bags" / "smc")
    assert (bag.missing, bag.damage) == ({}, "")
    assert same(bag.trace, simulate(load("paper", changes, controller="smc")))


@pytest.mark.slow
@pytest.mark.parametrize("name", ["run.watch", "viewer.markers"])
def test_what_only_looks_takes_nothing_from_shared_memory(
    live: Callable[..., Any], start: Callable[..., Any], name: str
) -> None:
    run = live(*LONG)
    run.first_tick(("controller", "ftcm"), ("observer", "do"))
    viewer = start(name)
    run.until(lambda: name.partition(".")[2] in run.watcher.node.get_node_names(), "the viewer")

    def ports(pid: int) -> set[str]:
        """Shared memory in which others wait for the process when it is stopped or killed."""
        files = {os.readlink(path) for path in Path(f"/proc/{pid}/fd").iterdir() if path.exists()}
        return {file for file in files if re.search(r"/dev/shm/fastrtps_port\d+_[es]l", file)}

    assert ports(run.process.pid), "that of the experiment, which is no viewer"
    assert ports(viewer.pid) == set()
    run.interrupt()


@pytest.mark.slow
def test_it_reads_a_run_only_while_that_is_on(live: Callable[..., Any], start: Callable[..., Any]) -> None:
    viewer = start("run.watch")
    run = live(*LONG)
    node = run.watcher.node

    def read_by_it() -> set[str]:
        if "watch" not in node.get_node_names():
            return set()
        return {name for name, _ in node.get_subscriber_names_and_types_by_node("watch", "/")}

    everything = {"/" + topic.name.removeprefix("/") for topic in (*WATCHED, *SHOWN)}
    run.until(lambda: read_by_it() == everything, "its readers while the run is on")
    run.until(
        lambda: "plant" in run.health, "a report of the plant"
    )  # which the viewer may have heard sooner
    assert int(run.health["plant"]["tick"]) > 0, "and no reader before"
    run.interrupt()
    run.watcher.spin_until(lambda: read_by_it() == {"/diagnostics"}, "no reader but that of the reports")
    assert viewer.poll() is None


@pytest.mark.usefixtures("domain")
def test_where_nothing_is_it_says_so(start: Callable[..., Any]) -> None:
    once = start("run.watch", "--once", "--timeout", "0.3")
    out, err = once.communicate(timeout=HANG_SECONDS)
    assert (once.returncode, out) == (2, "")
    assert "no node of the suite says anything in ROS_DOMAIN_ID=" in err
    assert len(err.splitlines()) == 1


def test_ftcm_watch_is_that_of_the_package(monkeypatch: pytest.MonkeyPatch) -> None:
    from ftcm_core.cli import main, watching

    asked = []
    monkeypatch.setattr(watching, "brought", lambda name: lambda options: asked.append((name, options)) or 0)
    assert main(["watch", "--once", "--timeout", "3"]) == 0
    ((name, options),) = asked
    assert (name, options.once, options.timeout, options.health) == ("watch", True, 3.0, False)
    monkeypatch.setattr(watching, "brought", lambda name: None)
    assert main(["watch"]) == 2
