# SPDX-License-Identifier: Apache-2.0
"""The experiment end to end: real node processes, real bags."""

from __future__ import annotations

import html
import json
import os
import shutil
import signal
import subprocess
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import psutil
import pytest

pytest.importorskip("rclpy", reason="ROS 2 (rclpy) is not installed")

from ftcm_core import campaign
from ftcm_core.scenario import load
from ftcm_core.simulation import simulate
from ftcm_ros.bags.reader import BagContents, read_bag
from ftcm_ros.parameters.node_parameters import NODES
from ftcm_ros.transport.domain import Domain
from node_processes import node_pids
from traces import same

pytestmark = pytest.mark.ros

Start = Callable[..., "subprocess.Popen[str]"]
Experiment = Callable[..., "subprocess.CompletedProcess[str]"]


def bag_of(folder: Path, controller: str) -> BagContents:
    return read_bag(folder / "runs" / "test" / "bags" / controller)


@pytest.mark.parametrize("controller", [pytest.param("ftcm", marks=pytest.mark.versions), "smc"])
def test_lockstep_equals_the_in_process_run(experiment: Experiment, tmp_path: Path, controller: str) -> None:
    """Every other law too: see the swap in test_robots.py."""
    overrides = ["duration=1.0", "injection.faults.0.start=0.5"]
    run = experiment("paper", "--controllers", controller, *(a for o in overrides for a in ("--set", o)))
    assert run.returncode == 0, run.stderr
    logs = tmp_path / "runs" / "test" / "logs" / controller
    assert not [n for n in NODES if "WARN" in (logs / f"{n}.log").read_text()]  # as of a transition refused
    bag = bag_of(tmp_path, controller)
    assert bag.missing == {}
    assert bag.trace.status == "completed"
    assert bag.trace.ticks == 1001
    assert same(bag.trace, simulate(load("paper", overrides, controller=controller)))
    assert (
        {"plant"} <= set(bag.nodes) <= set(NODES)
    )  # others tell once a second, and then when the run has ended
    assert "detection" not in bag.stamps
    summary = json.loads((tmp_path / "runs" / "test" / "summary.json").read_text())
    assert set(summary["timing_us"][controller]) == {"observer", "controller", "injector", "chain"}


def test_draws_of_a_campaign_have_the_rows_of_the_run_in_process(
    experiment: Experiment, tmp_path: Path
) -> None:
    file = tmp_path / "campaign.yaml"
    file.write_text(
        "scenario: paper\nruns: 4\nsampling: random\ncontenders:\n  a: [controller.type=ftcm]\n"
        "  b c: [controller.type=ctc]\nset: [duration=0.3, transient=0.1, injection.faults.0.start=0.2]\n"
        "vary: {injection.faults.0.severity: 'uniform(0.5, 1.5)'}\n"
    )
    run = experiment(str(file), "--composed")
    assert run.returncode == 0, run.stderr
    assert sorted(path.name for path in (tmp_path / "runs" / "test" / "bags").iterdir()) == ["a-0", "b-c-0"]
    rows = list(campaign.read_runs(tmp_path / "runs" / "test" / "runs.jsonl"))
    planned = campaign.from_file(str(file))
    expected = [campaign.run_one(planned, run, "plain") for run in planned.run_list()[:2]]
    assert [row.pop("engine") for row in rows] == ["graph, lockstep"] * 2
    for one in expected:
        one.pop("engine")
    assert rows == json.loads(json.dumps(expected))


@pytest.mark.parametrize(
    ("path", "storage"),
    [pytest.param("executor", "sqlite3", marks=pytest.mark.versions), ("waitset", "mcap")],
)
def test_every_data_path_and_storage_gives_the_same(
    experiment: Experiment, tmp_path: Path, path: str, storage: str
) -> None:
    overrides = ["duration=0.4", "torque_limits=[97.6, 186.4, 89.4]"]
    arguments = [a for o in overrides for a in ("--set", o)]
    run = experiment("paper", "--controllers", "ftcm", "--data-path", path, "--storage", storage, *arguments)
    assert run.returncode == 0, run.stderr
    bag = bag_of(tmp_path, "ftcm")
    assert bag.missing == {}
    assert same(bag.trace, simulate(load("paper", overrides)))


def test_sensor_and_delay_over_the_graph(experiment: Experiment, tmp_path: Path) -> None:
    overrides = ["duration=0.5", "injection.faults.0.start=0.2", "sensor={type: encoder, noise: 1e-5}"]
    overrides += ["torque_delay=2", "seed=7", "controller.discretisation=implicit"]
    run = experiment("paper", "--controllers", "ftcm", *(a for o in overrides for a in ("--set", o)))
    assert run.returncode == 0, run.stderr
    bag = bag_of(tmp_path, "ftcm")
    assert bag.missing == {}
    assert "measured_position" in bag.trace.columns
    assert same(bag.trace, simulate(load("paper", overrides)))


@pytest.mark.slow
def test_the_paper_experiment_over_the_graph(experiment: Experiment, tmp_path: Path) -> None:
    run = experiment("paper", "--controllers", "ftcm", "--composed")  # as processes: make run
    assert run.returncode == 0, run.stderr
    bag = bag_of(tmp_path, "ftcm")
    assert bag.missing == {}
    assert bag.trace.ticks == 40_001
    assert same(bag.trace, simulate(load("paper")))
    summary = json.loads((tmp_path / "runs" / "test" / "summary.json").read_text())
    (result,) = summary["results"]
    assert result["status"] == "completed"
    assert result["metrics"]["whole"]["mean_abs_error"] == pytest.approx(
        [0.002608, 0.002609, 0.002604], rel=1e-3
    )
    assert {"results", "provenance", "timing", "mode"} <= set(summary)
    table = (tmp_path / "runs" / "test" / "table.md").read_text()
    assert "Table 2" in table
    assert "missed deadlines" not in table
    assert run.stderr.splitlines()[-1] == "report: runs/test/report.html"
    page = (tmp_path / "runs" / "test" / "report.html").read_text(encoding="utf-8")
    assert "The run was in lockstep, so nothing is said about real time." in page
    assert "ros2 run ftcm_ros experiment paper --controllers ftcm --composed" in page


@pytest.mark.parametrize("nodes", ["--composed", pytest.param("--no-composed", marks=pytest.mark.versions)])
def test_real_time_counts_every_miss_and_holds_the_torque(
    experiment: Experiment, tmp_path: Path, nodes: str
) -> None:
    run = experiment("paper", "--controllers", "ftcm", "--mode", "real_time", nodes, "--set", "duration=3")
    assert run.returncode == 0, run.stderr
    bag = bag_of(tmp_path, "ftcm")
    plant = bag.nodes["plant"]
    assert plant["state"] == "completed"
    trace = bag.trace
    assert trace.ticks == 3001
    summary = json.loads((tmp_path / "runs" / "test" / "summary.json").read_text())
    hops = {"observer", "controller", "injector", "chain"} if nodes == "--no-composed" else set()
    assert set(summary["timing_us"]["ftcm"]) == {"jitter", *hops}
    assert all(summary["timing_us"]["ftcm"][hop]["p50"] > 0 for hop in hops)
    processes = {"composed", "recorder"} if nodes == "--composed" else set(NODES)
    assert set(summary["timing"]["ftcm"]["processes"]) == processes
    # The effort reported at tick k+1 is the command of tick k, or one that was held.
    commands = trace.command.tolist()
    held = braked = 0
    for k, applied in enumerate(trace.effort[1:].tolist()):
        if applied != commands[k]:
            held += 1
            braked += applied != [0.0, 0.0, 0.0] and applied not in commands[:k]
    misses = {cause: int(plant[cause]) for cause in ("late_torque", "late_disturbance", "plant_overrun")}
    assert held <= misses["late_torque"], misses
    assert braked <= int(plant["safe_stop_ticks"])
    assert int(plant["missed_deadlines"]) == sum(misses.values())
    for quantity in ("jitter", "latency", "execution"):
        ordered = [float(plant[f"{quantity}_{p}_us"]) for p in ("p50", "p99", "p999", "max")]
        assert 0 <= ordered[0] <= ordered[1] <= ordered[2] <= ordered[3]
        assert ordered[3] > 0
    nodes = summary["timing"]["ftcm"]["nodes"]
    assert all(float(nodes[n]["cpu_seconds"]) > 0 for n in NODES)
    assert all(float(nodes[n]["execution_mean_us"]) > 0 for n in NODES if n != "recorder")
    table = (tmp_path / "runs" / "test" / "table.md").read_text()
    (row,) = [
        line for line in table.splitlines() if line.startswith("| ftcm") and " / " in line and "3001" in line
    ]
    assert [c.strip() for c in row.split("|")][2:6] == ["3001", *map(str, misses.values())]
    page = (tmp_path / "runs" / "test" / "report.html").read_text(encoding="utf-8")
    assert f"<li>ftcm, {html.escape(summary['timing']['ftcm']['verdict'], quote=False)}.</li>" in page
    assert '"timing":[{"title":"tick jitter' in page


def test_real_time_without_a_miss_is_the_in_process_run(experiment: Experiment, tmp_path: Path) -> None:
    """With ticks of 50 ms, which a machine that is not overloaded meets, and an observer that suits them."""
    overrides = ["duration=3", "dt=0.05", "injection.faults.0.start=1", "observer.k1=50", "observer.k2=5"]
    arguments = [a for o in overrides for a in ("--set", o)]
    for _ in range(5):
        run = experiment("paper", "--controllers", "ftcm", "--mode", "real_time", *arguments)
        assert run.returncode == 0, run.stderr
        bag = bag_of(tmp_path, "ftcm")
        if bag.nodes["plant"]["missed_deadlines"] == "0":
            break
        shutil.rmtree(tmp_path / "runs")
    else:
        pytest.fail("deadlines of 50 ms were missed in each of five runs")
    assert bag.missing == {}
    assert bag.trace.status == "completed"
    assert same(bag.trace, simulate(load("paper", overrides)))


@pytest.mark.slow
@pytest.mark.parametrize(
    ("mode", "nodes", "stages"),
    [
        ("lockstep", "--composed", "plain"),
        ("lockstep", "--no-composed", "plain"),
        ("lockstep", "--no-composed", "compiled"),
        ("real_time", "--composed", "plain"),
        ("real_time", "--no-composed", "plain"),
        ("real_time", "--composed", "compiled"),
    ],
)
def test_the_controller_is_swapped_while_running(
    live: Callable[..., Any], watcher: Any, tmp_path: Path, mode: str, nodes: str, stages: str
) -> None:
    if stages == "compiled":
        pytest.importorskip("numba")
    overrides = ["duration=600", "injection.faults.0.start=2"]
    arguments = [a for o in overrides for a in ("--set", o)]
    run = live("paper", "--mode", mode, "--controllers", "ftcm", nodes, "--stages", stages, *arguments)
    run.first_tick(("controller", "ftcm"), ("observer", "do"))
    assert watcher.set("controller", controller="scm") == [
        (False, "no controller 'scm'; did you mean 'smc'?")
    ]
    ((refused, reason),) = watcher.set("controller", smc__c=-1.0)
    assert not refused
    assert "smc.c: -1 is out of range" in reason
    assert watcher.get("controller", "smc.c") == 2.0
    run.change("controller", controller="smc", smc__c=3)
    run.change("observer", do__k1=15000.0)
    run.interrupt()
    bag = bag_of(tmp_path, "ftcm")
    kinds = [(c.kind, c.component.type_name) for c in bag.trace.changes]
    assert sorted(kinds) == [("controller", "smc"), ("controller", "smc"), ("observer", "do")]
    assert bag.trace.changes[0].tick > 0
    assert bag.trace.scenario is not None
    assert bag.trace.scenario.controller.type_name == "ftcm"
    if mode == "lockstep":
        # A plant that is stopped may have served some of its last measurement only.
        whole = bag.trace.ticks - 1
        assert bag.trace.changes[-1].tick < whole
        again = simulate(load("paper", [*overrides, f"duration={whole * 1e-3:g}"]), bag.trace.changes)
        if stages == "plain":
            assert same(bag.trace, again, slice(whole))
        else:
            for name, column in again.columns.items():
                recorded = bag.trace.columns[name][:whole]
                np.testing.assert_allclose(recorded, column[:whole], rtol=1e-6, atol=1e-6, err_msg=name)


def run_until_ticks(process: subprocess.Popen[str]) -> None:
    """Wait until an experiment reports progress."""
    assert process.stderr is not None
    for line in process.stderr:
        if "ticks/s" in line:
            return
    pytest.fail("the experiment ended before its first progress line")


@pytest.mark.parametrize("number", [pytest.param(signal.SIGINT, marks=pytest.mark.versions), signal.SIGTERM])
def test_stopping_keeps_what_was_recorded(start: Start, tmp_path: Path, number: signal.Signals) -> None:
    process = start("experiment", "paper", "--controllers", "smc", "ftcm", "--name", "test", "--no-figures")
    run_until_ticks(process)
    pids = node_pids(process.pid)
    assert set(pids) == set(NODES)
    process.send_signal(number)
    _, err = process.communicate(timeout=60)
    assert process.returncode == 130
    assert "stopped by the user" in err
    bag = bag_of(tmp_path, "smc")
    assert bag.trace.status == "incomplete"
    assert bag.trace.ticks > 1000
    assert not [p for p in pids.values() if psutil.pid_exists(p)]
    again = simulate(load("paper", controller="smc"))
    assert np.array_equal(bag.trace.position, again.position[: bag.trace.ticks])
    assert (tmp_path / "runs" / "test" / "summary.json").is_file()


def test_an_experiment_that_is_killed_leaves_a_bag_and_nothing_else(
    start: Start, tmp_path: Path, domain: int, shared_memory: Callable[[], list[str]]
) -> None:
    process = start(
        "experiment", "paper", "--controllers", "ftcm", "--name", "test", "--no-figures",
        "--domain-id", str(domain),
    )  # fmt: skip
    run_until_ticks(process)
    pids = node_pids(process.pid)
    assert len(pids) == 5
    process.kill()
    process.communicate(timeout=30)
    for pid in pids.values():
        for _ in range(300):
            if not psutil.pid_exists(pid):
                break
            signal.sigtimedwait([signal.SIGUSR2], 0.1)
        else:
            pytest.fail(f"node {pid} outlived its experiment")
    bag = bag_of(tmp_path, "ftcm")
    assert bag.trace.status == "incomplete"
    assert bag.trace.ticks > 1000
    Domain(domain).release()  # free at once
    assert shared_memory() == []


@pytest.mark.versions
def test_a_run_that_diverges_is_a_result(experiment: Experiment, tmp_path: Path) -> None:
    overrides = ["duration=2", "dt=0.02"]
    arguments = [a for o in overrides for a in ("--set", o)]
    run = experiment("paper", "--controllers", "ftcm", "ctc", *arguments)
    assert run.returncode == 0, run.stderr
    expected = simulate(load("paper", overrides))
    assert expected.status == "diverged"
    assert f"ftcm: diverged: {expected.detail}" in run.stderr
    assert "Traceback" not in run.stderr
    bag = bag_of(tmp_path, "ftcm")
    assert bag.trace.status == "diverged"
    assert bag.trace.detail == expected.detail
    assert same(bag.trace, expected)
    assert bag_of(tmp_path, "ctc").trace.status == "completed"


@pytest.mark.slow
@pytest.mark.alone
@pytest.mark.skipif(
    "FTCM_TEST_SET_CLOCK" not in os.environ, reason="needs FTCM_TEST_SET_CLOCK=1: sets the time"
)
def test_the_system_time_is_set_back_for_longer_than_a_node_may_be_silent(
    start: Start, tmp_path: Path
) -> None:
    patience = 2.0
    arguments = ["--controllers", "ftcm", "--mode", "real_time", "--set", "duration=10", "--name", "test"]
    process = start("experiment", "paper", *arguments, "--no-figures", "--patience", f"{patience:g}")
    run_until_ticks(process)
    ahead = time.time() - time.monotonic()
    try:
        time.clock_settime(time.CLOCK_REALTIME, time.time() - 100)
    except PermissionError as error:
        pytest.skip(f"the time cannot be set: {error}")
    try:
        time.sleep(2 * patience)
    finally:
        time.clock_settime(time.CLOCK_REALTIME, time.monotonic() + ahead)
    _, err = process.communicate(timeout=120)
    assert process.returncode == 0, err
    bag = bag_of(tmp_path, "ftcm")
    assert bag.missing == {}
    assert bag.trace.ticks == 10_001
    assert bag.nodes["plant"]["clock_steps"] == "2"
    assert float(bag.nodes["plant"]["clock_stepped_seconds"]) == pytest.approx(0.0, abs=0.1)


@pytest.mark.parametrize(
    "together",
    [
        pytest.param((), id="processes"),
        pytest.param(("plant", "observer", "controller", "injector"), id="composed"),
        pytest.param(("plant", "observer", "injector"), id="the controller outside"),
        pytest.param(("observer", "controller"), id="the plant outside", marks=pytest.mark.slow),
    ],
)
def test_nodes_that_somebody_else_starts(
    start: Start, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, domain: int, together: tuple[str, ...]
) -> None:
    monkeypatch.setenv("FTCM_HEARTBEAT", str(tmp_path / "heartbeat"))
    arguments = ["--controllers", "ftcm", "--set", "duration=0.5", "--name", "test", "--no-figures"]
    process = start("experiment", "paper", "--external-nodes", *arguments)
    files = {n: tmp_path / "runs" / "test" / "nodes" / f"{n}.yaml" for n in NODES}
    while not all(f.exists() for f in files.values()):
        assert process.poll() is None, process.communicate()
        time.sleep(0.1)
    alone = [n for n in NODES if n not in together]
    nodes = [start(f"nodes.{n}", "--ros-args", "--params-file", str(files[n])) for n in alone]
    if together:
        given = [word for n in together for word in ("--params-file", str(files[n]))]
        nodes.append(start("nodes.composed", "--nodes", *together, "--ros-args", *given))
    _, err = process.communicate(timeout=120)
    assert process.returncode == 0, err
    bag = bag_of(tmp_path, "ftcm")
    assert bag.missing == {}
    assert same(bag.trace, simulate(load("paper", ["duration=0.5"])))
    assert [n.poll() for n in nodes] == [None] * (len(alone) + bool(together))
    assert (tmp_path / "heartbeat").exists()


@pytest.mark.parametrize(
    ("arguments", "text"),
    [
        (["papr"], "did you mean 'paper'?"),
        (["paper", "--controllers", "scm"], "did you mean 'smc'?"),
        (["paper", "--controllers", "smc", "smc"], "each may be named once"),
        (["paper", "--draws", "2"], "--draws 2: 'paper' is a scenario; expected a campaign file"),
        (["paper", "--set", "observer.k1=-1"], "observer.k1: -1 is out of range"),
        (["--set", "duration=1", "observer.k1=-1", "paper"], "observer.k1: -1 is out of range"),
        (["paper", "--set", "observer.type=none", "--controllers", "ftcm"], "uses the disturbance estimate"),
        (["paper", "--plugin", "nowhere.py"], "plug-in 'nowhere.py': no such file"),
        (["paper", "--domain-id", "999"], "domain 999 is out of range"),
        (["paper", "--external-nodes"], "3 controllers (smc, nftsmc, ftcm); expected one"),
        (
            ["paper", "--external-nodes", "--controllers", "smc", "--domain-id", "-1"],
            "domain -1 is out of range",
        ),
    ],
)
def test_mistakes_are_one_line(
    experiment: Experiment, tmp_path: Path, arguments: list[str], text: str
) -> None:
    run = experiment(*arguments)
    assert run.returncode == 2
    assert run.stdout == ""
    assert len(run.stderr.strip().splitlines()) == 1, run.stderr
    assert text in run.stderr


@pytest.mark.parametrize(
    ("arguments", "text"),
    [(["--set", "name=../x"], "the scenario's name '../x-"), (["--name", "../x"], "--name '../x': ")],
)
def test_a_run_stays_in_its_folder(start: Start, tmp_path: Path, arguments: list[str], text: str) -> None:
    process = start("experiment", "paper", *arguments)
    out, err = process.communicate(timeout=60)
    assert (process.returncode, out) == (2, "")
    assert err.startswith(f"experiment: error: {text}")
    assert err.endswith("expected a plain name without folders; choose the place with --runs\n")
    assert list(tmp_path.iterdir()) == []


def test_an_existing_run_is_not_touched(experiment: Experiment, tmp_path: Path) -> None:
    (tmp_path / "runs" / "test").mkdir(parents=True)
    run = experiment("paper")
    assert run.returncode == 2
    assert "exists already" in run.stderr
    assert list((tmp_path / "runs" / "test").iterdir()) == []
