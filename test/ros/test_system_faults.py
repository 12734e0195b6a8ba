# SPDX-License-Identifier: Apache-2.0
"""Nodes that are killed, stopped or fail in the middle of a run, on real processes."""

from __future__ import annotations

import contextlib
import json
import os
import random
import signal
import subprocess
import time
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import numpy as np
import psutil
import pytest

pytest.importorskip("rclpy", reason="ROS 2 (rclpy) is not installed")

from ftcm_core.scenario import load
from ftcm_core.simulation import simulate
from ftcm_ros.bags.reader import read_bag
from ftcm_ros.transport.topics import TRUE_STATE
from node_processes import node_pids

pytestmark = pytest.mark.ros

Start = Callable[..., "subprocess.Popen[str]"]

DURATION = {"lockstep": 3.0, "real_time": 10.0}
"""Length of the runs: a real-time run without its controller goes on until that is noticed, s."""
LAST_TICK = 900
"""The faults come in a tick before this one."""
PATIENCE = 3.0
CEILING = 60.0
"""Generous: within what time a run with a fault has ended, start included, s."""

INJECT = """
import json, os, signal, sys
from pathlib import Path

words = sys.orig_argv
node = next((w.rpartition(".")[2] for w in words if w.startswith("ftcm_ros.nodes.")), "")
if node == "recorder":
    from ftcm_ros.transport import listener

    listener.GATHER_SECONDS = 0.03
if node and "--params-file" in words:
    run = Path(words[words.index("--params-file") + 1]).parent.name
    victim, fault, tick = json.loads(os.environ["FAULTS"]).get(run, ("", "", 0))
    if victim == node or (node == "composed" and victim != "recorder"):
        from ftcm_core.simulation import stages
        from ftcm_ros.bags import writer

        owner, name = {
            "plant": (stages.PlantStage, "step"),
            "observer": (stages.ObserverStage, "step"),
            "controller": (stages.ControllerStage, "step"),
            "injector": (stages.InjectorStage, "step"),
            "detector": (stages.DetectorStage, "step"),
            "recorder": (writer.TopicCount, "add"),
        }[victim]
        original, calls = getattr(owner, name), 0

        def step(self, *arguments):
            global calls
            calls += 1
            if calls == tick * (5 if victim == "recorder" else 1) + 1:
                if fault == "exception":
                    raise RuntimeError("injected")
                if fault == "hang":
                    while True:
                        pass
                os.kill(os.getpid(), signal.Signals[fault])
            return original(self, *arguments)

        setattr(owner, name, step)
"""
"""Loaded by every Python process of the experiment: in one node of each run, a fault at a tick.

The recorder is slow to take in, so that a node fails with messages under way.
"""


class Fault(NamedTuple):
    """What happens to whom, in the run of one controller."""

    controller: str
    node: str
    kind: str


def named(fault: Fault, tick: int, line: str, composed: bool, mode: str) -> bool:
    """Whether a line of the experiment names run, node and cause.

    Not the tick of a recorder, which is behind the others, nor of a plant in real time, which brakes in ticks
    before the first torque has come: those are no calls of what raises the error.
    """
    counts = fault.node != "recorder" and not (fault.node == "plant" and mode == "real_time")
    at = f"{tick}: RuntimeError: injected" if counts else ""
    cause = {
        "SIGKILL": "was ended by SIGKILL",
        "SIGSTOP": f"has said nothing for {PATIENCE:g} s",
        "hang": f"has made no tick for {PATIENCE:g} s",
        "exception": f"its last words: {fault.node}: at tick {at}",
    }[fault.kind]
    node = fault.node
    if composed and node != "recorder" and fault.kind.startswith("SIG"):
        node = "composed" if fault.kind == "SIGKILL" else "plant"  # the first of those that are stopped
    return line.startswith(f"experiment: error: {fault.controller}: node {node!r} ") and cause in line


def alive_in(folder: Path) -> list[str]:
    """Processes of nodes whose parameters are in a folder."""
    found = []
    for process in psutil.process_iter():
        with contextlib.suppress(psutil.Error):
            words = " ".join(process.cmdline())
            if str(folder) in words and "ftcm_ros.nodes" in words:
                found.append(words)
    return found


LAWS = ("ftcm", "smc", "pid", "nftsmc", "ctc", "ftsmc")
ROUNDS = {
    "quick lockstep": "plant:SIGKILL observer:SIGSTOP controller:exception",
    "quick real_time": "injector:SIGKILL recorder:SIGSTOP",
    "1 lockstep": "observer:exception controller:SIGKILL injector:SIGSTOP "
    "recorder:exception plant:SIGSTOP observer:SIGKILL",
    "2 lockstep": "recorder:SIGKILL plant:exception controller:SIGSTOP "
    "injector:exception recorder:SIGSTOP injector:SIGKILL",
    "1 real_time": "plant:SIGKILL observer:SIGSTOP controller:exception "
    "recorder:SIGKILL injector:exception plant:SIGSTOP",
    "2 real_time": "observer:exception controller:SIGKILL injector:SIGSTOP "
    "recorder:exception plant:exception observer:SIGKILL",
    "3 real_time": "controller:SIGSTOP controller:hang",
    "detector lockstep": "detector:SIGKILL detector:hang",
    "2 detector lockstep": "detector:exception detector:SIGSTOP",
    "quick composed lockstep": "observer:exception controller:SIGKILL",
    "1 composed lockstep": "plant:exception injector:hang controller:exception "
    "observer:SIGSTOP injector:exception observer:hang",
    "2 composed lockstep": "recorder:exception recorder:SIGSTOP",
    "1 composed real_time": "plant:exception observer:exception controller:hang "
    "recorder:exception injector:SIGKILL",
}
"""Experiments: a fault in the run of each controller; together each node and fault in both modes."""
MORE = (
    "1 lockstep", "2 lockstep", "2 detector lockstep", "1 real_time", "2 real_time", "3 real_time",
    "1 composed lockstep", "2 composed lockstep", "1 composed real_time",
)  # fmt: skip
MARKS = {name: pytest.mark.nightly for name in MORE} | {"quick composed lockstep": pytest.mark.versions}


@pytest.mark.parametrize(
    "name",
    [pytest.param(n, marks=MARKS.get(n, ())) for n in ROUNDS],
)
def test_a_fault_ends_its_run_only(
    start: Start,
    tmp_path: Path,
    domain: int,
    monkeypatch: pytest.MonkeyPatch,
    shared_memory: Callable[[], list[str]],
    name: str,
) -> None:
    mode, composed = name.split()[-1], "composed" in name
    faults = [Fault(law, *pair.split(":")) for law, pair in zip(LAWS, ROUNDS[name].split())]
    without = LAWS[len(faults) : len(faults) + 1] if name == "quick lockstep" else ()
    overrides = [f"duration={DURATION[mode]}"]
    if "detector" in ROUNDS[name]:
        overrides.append("detector=residual_threshold")
    seed = random.randrange(10**6)
    print(f"seed {seed}")
    draw = random.Random(seed)
    # A recorder that is killed before it has brought anything to the file leaves nothing to be read.
    first = {f.controller: 500 if (f.node, f.kind) == ("recorder", "SIGKILL") else 1 for f in faults}
    ticks = {f.controller: draw.randint(first[f.controller], LAST_TICK) for f in faults}
    (tmp_path / "hook").mkdir()
    (tmp_path / "hook" / "sitecustomize.py").write_text(INJECT)
    monkeypatch.setenv("PYTHONPATH", f"{tmp_path / 'hook'}{os.pathsep}{os.environ.get('PYTHONPATH', '')}")
    monkeypatch.setenv(
        "FAULTS", json.dumps({f.controller: (f.node, f.kind, ticks[f.controller]) for f in faults})
    )
    process = start(
        "experiment", "paper", "--mode", mode, "--patience", str(PATIENCE), "--name", "test", "--no-figures",
        "--domain-id", str(domain), *(a for o in overrides for a in ("--set", o)),
        "--composed" if composed else "--no-composed",
        "--controllers", *(f.controller for f in faults), *without,
    )  # fmt: skip
    _, err = process.communicate(timeout=CEILING * len(faults))
    assert process.returncode == 1, err
    assert "Traceback" not in err
    lines = [line for line in err.splitlines() if line.startswith("experiment: error: ")]
    assert len(lines) == len(faults), err
    folder = tmp_path / "runs" / "test"
    for fault, line in zip(faults, lines):
        tick = ticks[fault.controller]
        assert named(fault, tick, line, composed, mode), f"{fault} at tick {tick}: {line}"
        process_name = "composed" if composed and fault.node != "recorder" else fault.node
        log = (folder / "logs" / fault.controller / f"{process_name}.log").read_text()
        assert ("Traceback" in log) == (fault.kind == "exception")
        if fault.node == "recorder" and fault.kind == "SIGKILL":
            continue  # what is kept: test_recovery.py
        bag = read_bag(folder / "bags" / fault.controller)
        # true_state is there only after ticks in which a held disturbance acted.
        every_tick = {name: stamps for name, stamps in bag.stamps.items() if name != TRUE_STATE.name}
        if fault.node == "recorder" and fault.kind == "exception":  # all it had written, that message too
            assert sum(map(len, every_tick.values())) == 5 * tick + 1
            continue
        if composed and fault.kind == "SIGKILL":  # what the recorder had not received cannot be sent again
            expected = simulate(load("paper", overrides, controller=fault.controller))
            there = ~np.isnan(bag.trace.position[:, 0])
            assert there.any()
            if mode == "lockstep":
                assert np.array_equal(bag.trace.position[there], expected.position[: len(there)][there])
            continue
        if mode == "lockstep":
            assert bag.trace.ticks >= tick
            expected = simulate(load("paper", overrides, controller=fault.controller))
            assert np.array_equal(bag.trace.position, expected.position[: bag.trace.ticks])
            assert np.array_equal(bag.trace.command[:tick], expected.command[:tick])
        else:
            assert bag.trace.time_ns[:tick].tolist() == list(range(0, tick * 1_000_000, 1_000_000))
            for topic, stamps in every_tick.items():
                assert len(np.unique(stamps[stamps < tick * 1_000_000])) == tick, topic
    for law in without:
        bag = read_bag(folder / "bags" / law)
        assert bag.missing == {}
        again = simulate(load("paper", overrides, controller=law))
        assert np.array_equal(bag.trace.position, again.position)
    assert alive_in(tmp_path) == []
    assert shared_memory() == []


@pytest.mark.parametrize("mode", ["lockstep", pytest.param("real_time", marks=pytest.mark.nightly)])
def test_a_node_stopped_for_a_moment_misses_nothing(start: Start, tmp_path: Path, mode: str) -> None:
    """Each node in turn, for longer than any scheduler keeps one waiting: what it finds then, it answers."""
    duration = 16.0 if mode == "lockstep" else 12.0
    process = start(
        "experiment", "paper", "--controllers", "ftcm", "--mode", mode, "--no-composed", "--name", "test",
        "--no-figures", "--set", f"duration={duration}",
    )  # fmt: skip
    assert process.stderr is not None
    next(line for line in process.stderr if "ticks/s" in line)
    for node, pid in node_pids(process.pid).items():
        os.kill(pid, signal.SIGSTOP)
        time.sleep(0.7)
        os.kill(pid, signal.SIGCONT)
        time.sleep(0.3)
        assert process.poll() is None, node
    _, err = process.communicate(timeout=CEILING)
    assert process.returncode == 0, err
    bag = read_bag(tmp_path / "runs" / "test" / "bags" / "ftcm")
    assert bag.trace.status == "completed"
    assert bag.missing == {}
    if mode == "lockstep":
        expected = simulate(load("paper", [f"duration={duration}"]))
        assert np.array_equal(bag.trace.position, expected.position)
        assert np.array_equal(bag.trace.command, expected.command)
    else:
        assert int(bag.nodes["plant"]["missed_deadlines"]) > 3 * 600
