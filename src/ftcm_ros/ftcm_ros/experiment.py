# SPDX-License-Identifier: Apache-2.0
"""The orchestration script: runs a scenario over the ROS graph, one run per controller.

Starts the five nodes as processes of their own, drives their lifecycle so that no tick is published
before every endpoint is matched, follows the run, stops the nodes, reads the bags back and reports.
"""

from __future__ import annotations

import argparse
import contextlib
import os
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import rclpy
from diagnostic_msgs.msg import DiagnosticArray
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions

from ftcm_core.errors import FtcmError
from ftcm_core.report.results import write_results
from ftcm_core.scenario import Scenario, load
from ftcm_ros.bag import read_bag
from ftcm_ros.domain import Domain
from ftcm_ros.latency import hop_times, percentiles, write_figure
from ftcm_ros.lifecycle_client import Managed, drive
from ftcm_ros.processes import NodeProcesses
from ftcm_ros.settings import NODES
from ftcm_ros.topics import DIAGNOSTICS

PAPER_CONTROLLERS = ("smc", "nftsmc", "ftcm")
START_SECONDS = 30.0
"""How long a node may take to come up."""
PLANT_STOP_SECONDS = 3.0
CLOSE_SECONDS = 15.0
"""How long the recorder may take to close the bag."""
SILENCE_SECONDS = 5.0
"""How long a node may say nothing on /diagnostics before the run ends."""
PROFILES = Path(__file__).with_name("fastdds.xml")
"""Settings of the middleware for the run, unless the user has some."""
MATCHING_ORDER = ("observer", "controller", "injector", "plant", "recorder")
"""Order of configuration: that of the tick, so that each message reaches first who acts on it next."""
RECORDER_WINDOW = 1000
"""Ticks the plant may run ahead of the recorder in lockstep."""


class Interrupted(Exception):
    """SIGINT or SIGTERM: stop cleanly and keep what was recorded."""


class Progress:
    """Progress on stderr: one line rewritten on a terminal, a line now and then elsewhere."""

    def __init__(self, label: str, last_tick: int, dt: float) -> None:
        """Begin a run."""
        self.label, self.last_tick, self.dt = label, last_tick, dt
        self.terminal = sys.stderr.isatty()
        self.shown = self.begin = time.monotonic()

    def show(self, tick: int, rate: float, missed: int, final: bool = False) -> None:
        """Show how far the run is."""
        now = time.monotonic()
        if not final and now - self.shown < (0.5 if self.terminal else 5.0):
            return
        self.shown = now
        left = (
            f"{(self.last_tick - tick) / rate:.0f} s left"
            if rate > 0 and not final
            else f"{now - self.begin:.1f} s"
        )
        missed_text = f", {missed} deadlines missed" if missed else ""
        where = f"t = {tick * self.dt:.2f} of {self.last_tick * self.dt:g} s"
        text = f"  {self.label}: {where}, {rate:.0f} ticks/s{missed_text}, {left}"
        end = "" if self.terminal and not final else "\n"
        print(("\r\033[K" if self.terminal else "") + text, end=end, file=sys.stderr, flush=True)


class Run:
    """One scenario with one controller over the graph."""

    def __init__(
        self, scenario: Scenario, label: str, folder: Path, options: argparse.Namespace, domain: int
    ) -> None:
        """Prepare folders and processes; nothing is started yet."""
        self.scenario, self.label, self.folder, self.options = scenario, label, folder, options
        self.bag = folder / "bags" / label
        self.logs = folder / "logs" / label
        self.processes = NodeProcesses(
            self.logs, {"ROS_DOMAIN_ID": str(domain), "ROS_LOG_DIR": str(self.logs.resolve())}
        )
        self.health: dict[str, dict[str, str]] = {}
        self.heard: dict[str, float] = {}
        self.timing: dict[str, Any] = {}

    def execute(self, node: Node) -> None:
        """Run to the end of the scenario; the nodes are stopped whatever happens.

        Raises:
            FtcmError: a node did not come up, died, or fell silent.
            Interrupted: the user stopped it.
        """
        self.node = node
        self.managed = {name: Managed(node, name) for name in NODES}
        subscription = node.create_subscription(DiagnosticArray, DIAGNOSTICS.name, self._on_diagnostics, 100)
        began = time.monotonic()
        try:
            self._start()
            self.timing["start_seconds"] = round(time.monotonic() - began, 3)
            began = time.monotonic()
            try:
                self._follow()
            finally:
                self.timing["run_seconds"] = round(time.monotonic() - began, 3)
                self._close_bag()
        finally:
            self.processes.stop()
            node.destroy_subscription(subscription)
            for managed in self.managed.values():
                managed.destroy()
            self.timing["nodes"] = self.health

    def _start(self) -> None:
        scenario_file = self.logs / "scenario.yaml"
        scenario_file.parent.mkdir(parents=True, exist_ok=True)
        scenario_file.write_text(self.scenario.to_yaml(), encoding="utf-8")
        common = {
            "scenario": str(scenario_file.resolve()),
            "autostart": False,
            "await_graph": True,
            "data_path": self.options.data_path,
            "priority": self.options.priority,
            "lock_memory": self.options.lock_memory,
            "processors": self.options.processors,
        }
        extra: dict[str, dict[str, Any]] = {
            "plant": {"mode": self.options.mode, "recorder_window": RECORDER_WINDOW},
            "recorder": {"bag": str(self.bag.resolve()), "storage": self.options.storage},
        }
        self.bag.parent.mkdir(parents=True, exist_ok=True)
        for name in NODES:
            self.processes.start(name, {**common, **extra.get(name, {})})
        for name in MATCHING_ORDER:
            self.transition("configure", (name,))
        others = tuple(n for n in NODES if n != "plant")
        self.transition("activate", others)
        self.heard = dict.fromkeys(NODES, time.monotonic())
        self.transition("activate", ("plant",))

    def transition(self, name: str, nodes: tuple[str, ...]) -> None:
        """Drive several nodes through a lifecycle transition at once.

        Raises:
            FtcmError: one of them could not.
        """
        failed = drive([self.managed[n] for n in nodes], name, self._spin, START_SECONDS)
        if failed:
            raise FtcmError(f"node {failed!r} did not {name}; {self.processes.last_words(failed)}")

    def _spin(self) -> None:
        rclpy.spin_once(self.node, timeout_sec=0.05)
        self.processes.check()
        if self.options.stop_requested:
            raise Interrupted

    def _on_diagnostics(self, message: DiagnosticArray) -> None:
        for status in message.status:
            name, _, what = status.name.partition(":")
            if name in NODES and what.strip() == "tick":
                self.health[name] = {"message": status.message, **{v.key: v.value for v in status.values}}
                self.heard[name] = time.monotonic()

    def _follow(self) -> None:
        progress = Progress(self.label, self.scenario.last_tick, self.scenario.dt)
        tick, rate = 0, 0.0
        while True:
            self._spin()
            plant = self.health.get("plant", {})
            tick = int(plant.get("tick", 0))
            rate = float(plant.get("rate_hz", 0.0)) or rate
            state = plant.get("state", "running")
            missed = int(plant.get("missed_deadlines", 0))
            if state in ("completed", "diverged"):
                elapsed = float(plant["elapsed_seconds"])
                self.timing["ticks_per_second"] = round(tick / elapsed, 1)
                progress.show(tick, tick / elapsed, missed, final=True)
                return
            progress.show(tick, rate, missed)
            for name, when in self.heard.items():
                if time.monotonic() - when > SILENCE_SECONDS:
                    raise FtcmError(
                        f"node {name!r} has said nothing for {SILENCE_SECONDS:g} s at tick {tick}; "
                        f"{self.processes.last_words(name)}"
                    )

    def _close_bag(self) -> None:
        """End the ticks, then let the recorder take in what is under way and close the bag.

        Whatever has become of the other nodes; a node that does not answer is stopped afterwards.
        """
        for name, seconds in (("plant", PLANT_STOP_SECONDS), ("recorder", CLOSE_SECONDS)):
            process = self.processes.processes.get(name)
            if process is None or process.poll() is not None:
                continue

            def spin(name: str = name, process: subprocess.Popen[bytes] = process) -> None:
                rclpy.spin_once(self.node, timeout_sec=0.05)
                if process.poll() is not None:
                    raise FtcmError(f"{name} has ended")

            with contextlib.suppress(FtcmError):
                drive([self.managed[name]], "deactivate", spin, seconds)


def build_parser() -> argparse.ArgumentParser:
    """Return the command line of ``experiment``."""
    parser = argparse.ArgumentParser(
        prog="experiment",
        description="Run a scenario over the ROS graph, one run per controller, and report.",
    )
    parser.add_argument(
        "scenario", nargs="?", default="paper", help="scenario file, or name of a shipped one"
    )
    parser.add_argument(
        "--controllers",
        nargs="+",
        metavar="NAME",
        help="default: the scenario's; for paper smc, nftsmc and ftcm",
    )
    parser.add_argument(
        "--mode", choices=("lockstep", "real_time"), default="lockstep", help="default: lockstep"
    )
    parser.add_argument(
        "--set", action="append", default=[], metavar="PATH=VALUE", help="e.g. observer.k1=10000"
    )
    parser.add_argument("--name", help="name of the run; default: scenario and time")
    parser.add_argument("--runs", type=Path, default=Path("runs"), help="folder for runs (default: runs)")
    parser.add_argument(
        "--storage", choices=("mcap", "sqlite3"), default="mcap", help="bag storage (default: mcap)"
    )
    parser.add_argument("--domain-id", type=int, help="ROS domain; default: a free one")
    parser.add_argument(
        "--data-path", choices=("waitset", "executor"), default="waitset", help="default: waitset"
    )
    parser.add_argument("--priority", type=int, default=0, help="SCHED_FIFO priority of the nodes")
    parser.add_argument("--lock-memory", action="store_true", help="lock the nodes' memory")
    parser.add_argument("--processors", default="", help="processors for the nodes, e.g. 0,1; default: all")
    parser.add_argument("--no-figures", action="store_true", help="write the table only")
    return parser


def run_experiment(options: argparse.Namespace) -> int:
    """Run everything the options say; return the exit status.

    Raises:
        FtcmError: anything that ends the whole experiment.
    """
    names = options.controllers or (PAPER_CONTROLLERS if options.scenario == "paper" else [None])
    scenarios = [load(options.scenario, options.set, controller=n) for n in names]
    labels = [s.controller.type_name for s in scenarios]
    if len(set(labels)) < len(labels):
        raise FtcmError(f"controllers {labels}: each may be named once")
    name = options.name or f"{scenarios[0].name}-{time.strftime('%Y%m%d-%H%M%S')}"
    if Path(name).name != name:
        raise FtcmError(
            f"--name {name!r}: expected a plain name without folders; choose the place with --runs"
        )
    folder: Path = options.runs / name
    try:
        folder.mkdir(parents=True)
    except FileExistsError:
        raise FtcmError(f"run {str(folder)!r} exists already; choose another --name or remove it") from None
    except (OSError, ValueError) as error:  # ValueError: a name that no file can have
        reason = getattr(error, "strerror", None) or error
        raise FtcmError(f"run {str(folder)!r} cannot be made: {reason}") from None
    domain = Domain(options.domain_id)
    os.environ.update(ROS_DOMAIN_ID=str(domain.number), ROS_AUTOMATIC_DISCOVERY_RANGE="LOCALHOST")
    os.environ["ROS_LOG_DIR"] = str((folder / "logs").resolve())
    os.environ.setdefault("FASTRTPS_DEFAULT_PROFILES_FILE", str(PROFILES))
    say(f"run {folder}: {', '.join(labels)} in {options.mode}, ROS_DOMAIN_ID={domain.number}")
    failure, finished, timing = "", [], {}

    rclpy.init(signal_handler_options=SignalHandlerOptions.NO)
    node = rclpy.create_node("experiment")
    try:
        for label, scenario in zip(labels, scenarios):
            for line in scenario.controller.warnings():
                say(f"warning: {line}")
            run = Run(scenario, label, folder, options, domain.number)
            try:
                run.execute(node)
            except FtcmError as error:
                failure = f"{label}: {error}"
            except Interrupted:
                failure = f"{label}: stopped by the user"
            timing[label] = run.timing
            if (run.bag / "metadata.yaml").exists():
                finished.append((label, run.bag))
            if failure:
                break
    finally:
        node.destroy_node()
        rclpy.try_shutdown()
        domain.release()
    report(folder, finished, timing, options)
    if failure:
        say(f"experiment: error: {failure}")
        return 130 if options.stop_requested else 1
    return 0


def report(
    folder: Path, bags: list[tuple[str, Path]], timing: dict[str, Any], options: argparse.Namespace
) -> None:
    """Read the bags back and write table, figures and summary."""
    if not bags:
        return
    say("reading the bags back ...")
    contents = [(label, read_bag(path)) for label, path in bags]
    for label, bag in contents:
        if bag.missing:
            say(f"warning: {label}: ticks missing in the bag: {bag.missing}")
    samples = [(label, hop_times(b)) for label, b in contents]
    extra = {
        "mode": options.mode,
        "timing_us": {label: percentiles(found) for label, found in samples},
        "timing": timing,
        "missing_ticks": {label: bag.missing for label, bag in contents},
        "bags": {label: str(path.relative_to(folder)) for label, path in bags},
    }
    write_results(
        folder, [(label, bag.trace) for label, bag in contents], extra, figures=not options.no_figures
    )
    if not options.no_figures:
        write_figure(samples, folder / "figures" / "timing.png")
    print((folder / "table.md").read_text(encoding="utf-8").rstrip())
    say(f"results: {folder}/summary.json, table.md, figures/, bags/")


def say(text: str) -> None:
    """Tell the user something on stderr."""
    print(text, file=sys.stderr, flush=True)


def main(argv: list[str] | None = None) -> None:
    """Entry point of ``ros2 run ftcm_ros experiment``."""
    options = build_parser().parse_args(argv)
    options.stop_requested = False

    def stop(signum: int, frame: Any) -> None:
        if options.stop_requested:
            raise KeyboardInterrupt
        options.stop_requested = True
        say("\nstopping; what was recorded is kept ...")

    signal.signal(signal.SIGINT, stop)
    signal.signal(signal.SIGTERM, stop)
    try:
        status = run_experiment(options)
    except FtcmError as error:
        say(f"experiment: error: {error}")
        status = 2
    except OSError as error:
        say(f"experiment: error: {error}")
        status = 1
    except KeyboardInterrupt:
        status = 130
    sys.exit(status)


if __name__ == "__main__":
    main()
