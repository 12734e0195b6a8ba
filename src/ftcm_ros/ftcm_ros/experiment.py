# SPDX-License-Identifier: Apache-2.0
"""The orchestration script: runs a scenario over the ROS graph, one run per controller.

Starts the five nodes as processes of their own, drives their lifecycle so that no tick is published
before every endpoint is matched, follows the run, stops the nodes, reads the bags back and reports. A run
that fails ends with its reason, and the next controller's begins.

Exit status: 0 done (a run that diverges is a result), 1 a run failed, 2 a mistake in what was asked,
130 interrupted.
"""

from __future__ import annotations

import argparse
import contextlib
import os
import signal
import sys
import time
from pathlib import Path
from typing import Any

import rclpy
from diagnostic_msgs.msg import DiagnosticArray

from ftcm_core.errors import FtcmError
from ftcm_core.report.results import write_results
from ftcm_core.scenario import Scenario, load
from ftcm_core.trace import ENDED_EARLY
from ftcm_ros.bag import BagContents, read_bag
from ftcm_ros.domain import Domain
from ftcm_ros.external import AmbientDomain, ExternalNodes
from ftcm_ros.graph import JoinError, join_as
from ftcm_ros.latency import hop_times, percentiles, timing_table, write_figure
from ftcm_ros.lifecycle_client import Managed, drive
from ftcm_ros.network import set_defaults
from ftcm_ros.processes import NodeProcesses, describe_exit
from ftcm_ros.settings import NODES
from ftcm_ros.topics import DIAGNOSTICS
from ftcm_ros.watch import CHAIN, Watch

PAPER_CONTROLLERS = ("smc", "nftsmc", "ftcm")
STOP_SECONDS = 3.0
CLOSE_SECONDS = 15.0
"""How long the recorder may take to close the bag."""
PATIENCE_SECONDS = 5.0
"""How long a node may be silent, or make no tick, before the run ends."""
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
        self,
        scenario: Scenario,
        label: str,
        folder: Path,
        options: argparse.Namespace,
        domain: Domain | AmbientDomain,
    ) -> None:
        """Prepare folders and processes; nothing is started yet."""
        self.scenario, self.label, self.folder, self.options = scenario, label, folder, options
        self.bag = folder / "bags" / label
        self.logs = folder / "logs" / label
        self.processes: NodeProcesses | ExternalNodes
        if isinstance(domain, AmbientDomain):
            self.processes = ExternalNodes(folder / "nodes")
        else:
            self.processes = NodeProcesses(
                self.logs,
                {"ROS_DOMAIN_ID": str(domain.number), "ROS_LOG_DIR": str(self.logs.resolve())},
                [domain.fileno()],
            )
        self.health: dict[str, dict[str, str]] = {}
        self._told = {""}
        """What nodes were not permitted that the user has been told."""
        self.watch: Watch | None = None
        self.timing: dict[str, Any] = {}

    def execute(self) -> None:
        """Run to the end of the scenario; the nodes are stopped whatever happens.

        Takes part in the domain only so long: what it knew of nodes that were killed ends with it.

        Raises:
            FtcmError: a node did not come up, died, fell silent, made no tick, or did not end well.
            Interrupted: the user stopped it.
        """
        self.node = node = join_as("experiment")
        self.managed = {name: Managed(node, name) for name in NODES}
        node.create_subscription(DiagnosticArray, DIAGNOSTICS.name, self._on_diagnostics, 100)
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
            self._deactivate(CHAIN, STOP_SECONDS)
        finally:
            codes = self.processes.stop()
            node.destroy_node()
            rclpy.try_shutdown()
            self.timing["nodes"] = self.health
        for name, code in codes.items():
            ending = f"node {name!r} {describe_exit(code)} after the run; {self.processes.last_words(name)}"
            if code > 0:
                raise FtcmError(ending)
            if code < 0:  # what it had to do is done
                say(f"warning: {self.label}: {ending}")
        if not (self.bag / "metadata.yaml").exists():
            raise FtcmError(f"the bag was not closed; {self.processes.last_words('recorder')}")

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
        self.transition("activate", ("plant",))

    def transition(self, name: str, nodes: tuple[str, ...]) -> None:
        """Drive several nodes through a lifecycle transition at once.

        Raises:
            FtcmError: one of them could not.
        """
        failed = drive([self.managed[n] for n in nodes], name, self._spin, self.processes.start_seconds)
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
                health = {"message": status.message, **{v.key: v.value for v in status.values}}
                if (refused := health.get("not_permitted", "")) not in self._told:
                    self._told.add(refused)
                    say(f"warning: {self.label}: {refused}")
                self.health[name] = health
                if self.watch is not None:
                    self.watch.hear(name, int(health["ticks"]))

    def _follow(self) -> None:
        progress = Progress(self.label, self.scenario.last_tick, self.scenario.dt)
        tick, rate = 0, 0.0
        self.watch = Watch(self.options.mode == "lockstep", self.options.patience)
        while True:
            self._spin()
            plant = self.health.get("plant", {})
            tick = int(plant.get("tick", 0))
            rate = float(plant.get("rate_hz", 0.0)) or rate
            state = plant.get("state", "running")
            missed = int(plant.get("missed_deadlines", 0))
            if state in ("completed", *ENDED_EARLY):
                elapsed = float(plant["elapsed_seconds"])
                self.timing["ticks_per_second"] = round(tick / elapsed, 1)
                progress.show(tick, tick / elapsed, missed, final=True)
                return
            progress.show(tick, rate, missed)
            name, reason = self.watch.culprit(self.processes.is_stopped)
            if name:
                said = self.health.get(name, {}).get("message", "")
                raise FtcmError(
                    f"node {name!r} {reason}, at tick {tick}: {self.processes.condition(name)}, "
                    f"its last diagnostics {said!r}; {self.processes.last_words(name)}"
                )

    def _close_bag(self) -> None:
        """End the ticks, then let the recorder take in what is under way and close the bag.

        Whatever has become of the other nodes; a node that does not answer is stopped afterwards.
        """
        self.processes.resume()
        self._deactivate(("plant",), STOP_SECONDS)
        self._deactivate(("recorder",), CLOSE_SECONDS)

    def _deactivate(self, names: tuple[str, ...], seconds: float) -> None:
        """Let nodes end their run and say how it was, as far as they still can."""
        running = [n for n in names if self.processes.running(n)]

        def spin() -> None:
            rclpy.spin_once(self.node, timeout_sec=0.05)
            for name in running:
                if not self.processes.running(name):
                    raise FtcmError(f"{name} has ended")

        with contextlib.suppress(FtcmError):
            drive([self.managed[n] for n in running], "deactivate", spin, seconds)


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
        "--external-nodes",
        action="store_true",
        help="start no nodes: lay out their parameters in RUN/nodes/NODE.yaml and drive those that somebody "
        "else starts with them, in the environment's ROS domain and discovery range; one controller",
    )
    parser.add_argument(
        "--data-path",
        choices=("listener", "waitset", "executor"),
        default="listener",
        help="default: listener",
    )
    parser.add_argument(
        "--patience",
        type=float,
        default=PATIENCE_SECONDS,
        metavar="SECONDS",
        help="how long a node may be silent, or make no tick, before the run ends; 2 or more (default: 5)",
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
    if not options.patience >= 2.0:  # nodes speak once a second
        raise FtcmError(f"--patience {options.patience:g} is too short; expected 2 s or more")
    names = options.controllers or (PAPER_CONTROLLERS if options.scenario == "paper" else [None])
    scenarios = [load(options.scenario, options.set, controller=n) for n in names]
    labels = [s.controller.type_name for s in scenarios]
    if len(set(labels)) < len(labels):
        raise FtcmError(f"controllers {labels}: each may be named once")
    if options.external_nodes and len(labels) > 1:
        raise FtcmError(
            f"--external-nodes: {len(labels)} controllers ({', '.join(labels)}); expected one, "
            "choose it with --controllers"
        )
    name = options.name or f"{scenarios[0].name}-{time.strftime('%Y%m%d-%H%M%S')}"
    if Path(name).name != name:
        what = f"--name {name!r}" if options.name else f"the scenario's name {name!r}"
        raise FtcmError(f"{what}: expected a plain name without folders; choose the place with --runs")
    folder: Path = options.runs / name
    try:
        folder.mkdir(parents=True)
    except FileExistsError:
        raise FtcmError(f"run {str(folder)!r} exists already; choose another --name or remove it") from None
    except (OSError, ValueError) as error:  # ValueError: a name that no file can have
        reason = getattr(error, "strerror", None) or error
        raise FtcmError(f"run {str(folder)!r} cannot be made: {reason}") from None
    domain = AmbientDomain(options.domain_id) if options.external_nodes else Domain(options.domain_id)
    network = use_domain(domain, folder)
    say(f"run {folder}: {', '.join(labels)} in {options.mode}, ROS_DOMAIN_ID={domain.number} {network}")
    failures, runs = [], []
    try:
        for label, scenario in zip(labels, scenarios):
            for line in scenario.controller.warnings():
                say(f"warning: {line}")
            run = Run(scenario, label, folder, options, domain)
            runs.append(run)
            try:
                run.execute()
            except JoinError:
                raise
            except (FtcmError, OSError) as error:
                failures.append(f"{label}: {error}")
                say(f"{label}: failed")
            except Interrupted:
                failures.append(f"{label}: stopped by the user")
                break
            domain.clean()
    finally:
        domain.release()
    try:
        failures += report(folder, runs, options)
    except FtcmError as error:
        failures.append(str(error))
    for failure in failures:
        say(f"experiment: error: {failure}")
    if options.stop_requested:
        return 130
    return 1 if failures else 0


def use_domain(domain: Domain | AmbientDomain, folder: Path) -> str:
    """Let this process and its children take part in a domain, with logs in a folder.

    Returns:
        Who may take part besides, as ``NAME=value`` words.
    """
    os.environ["ROS_DOMAIN_ID"] = str(domain.number)
    os.environ["ROS_LOG_DIR"] = str((folder / "logs").resolve())
    return set_defaults()


def read_bags(runs: list[Run]) -> tuple[list[tuple[str, BagContents]], list[str]]:
    """Read back what was recorded, and say what is not whole.

    Returns:
        Label and contents of each bag, and why others cannot be read.
    """
    found, unreadable = [], []
    for run in runs:
        if not run.bag.exists():
            continue
        try:
            bag = read_bag(run.bag)
        except FtcmError as error:
            unreadable.append(f"{run.label}: {error}")
            continue
        found.append((run.label, bag))
        if bag.recovered:
            say(f"warning: {run.label}: bag was not closed; recovered: {bag.recovered}")
        if bag.unusable:
            say(f"warning: {run.label}: messages that are no tick left out: {bag.unusable}")
        if bag.missing:
            say(f"warning: {run.label}: ticks missing in the bag: {bag.missing}")
        if bag.trace.status != "completed":
            say(f"{run.label}: {bag.trace.status}: {bag.trace.detail}")
    return found, unreadable


def report(folder: Path, runs: list[Run], options: argparse.Namespace) -> list[str]:
    """Read the bags back and write table, figures and summary.

    Returns:
        Why bags cannot be read.

    Raises:
        FtcmError: the results cannot be written.
    """
    say("reading the bags back ...")
    contents, unreadable = read_bags(runs)
    if not contents:
        return unreadable
    samples = [(label, hop_times(b)) for label, b in contents]
    extra = {
        "mode": options.mode,
        "timing_us": {label: percentiles(found) for label, found in samples},
        "timing": {run.label: run.timing for run in runs},
        "missing_ticks": {label: bag.missing for label, bag in contents},
        "bags": {label: str(bag.path.relative_to(folder)) for label, bag in contents},
    }
    traces = [(label, bag.trace) for label, bag in contents]
    write_results(folder, traces, extra, timing_table(contents), figures=not options.no_figures)
    if not options.no_figures:
        write_figure(samples, folder / "figures" / "timing.png")
    print((folder / "table.md").read_text(encoding="utf-8").rstrip())
    say(f"results: {folder}/summary.json, table.md, figures/, bags/")
    return unreadable


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
