# SPDX-License-Identifier: Apache-2.0
"""One run over the ROS graph: one scenario with one controller, from the start of the nodes to their end.

Drives the lifecycle of the nodes so that no tick is published before every endpoint is matched.
"""

from __future__ import annotations

import argparse
import contextlib
import os
import time
from pathlib import Path
from typing import Any

import rclpy
from diagnostic_msgs.msg import DiagnosticArray

from ftcm_core.errors import FtcmError
from ftcm_core.recording.trace import ENDED_EARLY
from ftcm_core.scenario import Scenario
from ftcm_ros.analysis.timing import by_process
from ftcm_ros.parameters.node_parameters import nodes_of
from ftcm_ros.run.external_nodes import AmbientDomain, ExternalNodes
from ftcm_ros.run.lifecycle import Managed, drive
from ftcm_ros.run.local_nodes import LocalNodes
from ftcm_ros.run.progress import Progress, say
from ftcm_ros.run.run_parameters import run_parameters
from ftcm_ros.run.verdict import verdict
from ftcm_ros.run.watchdog import CHAIN, Watchdog
from ftcm_ros.transport.domain import Domain
from ftcm_ros.transport.joining import join_as
from ftcm_ros.transport.network import set_defaults
from ftcm_ros.transport.topics import DIAGNOSTICS

STOP_SECONDS = 3.0
"""How long nodes may take to end their part of a run, s."""
CLOSE_SECONDS = 15.0
"""How long the recorder may take to close the bag, s; besides, to read it again:"""
BYTES_PER_SECOND = 50e6
"""How much of the bag it reads in a second at least (chosen: a slow disk)."""
REPORT_SECONDS = 1.0
"""How long the nodes' last reports may take to come, s."""
MATCHING_ORDER = ("observer", "controller", "injector", "plant", "detector", "recorder")
"""Order of configuration: that of the tick, so that each message reaches first who acts on it next."""


def composed(options: argparse.Namespace) -> bool:
    """Whether the nodes share a process: as asked, else in real time, where it misses fewer deadlines."""
    if options.composed is None:
        return options.mode == "real_time" and not options.external_nodes
    return bool(options.composed)


class Interrupted(Exception):
    """The user has asked to stop, by SIGINT or SIGTERM: end cleanly and keep what was recorded."""


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
        self.nodes = nodes_of(scenario)
        self.bag = folder / "bags" / label
        self.logs = folder / "logs" / label
        self.processes: LocalNodes | ExternalNodes
        if isinstance(domain, AmbientDomain):
            self.processes = ExternalNodes(folder / "nodes")
        else:
            self.processes = LocalNodes(
                self.logs,
                {"ROS_DOMAIN_ID": str(domain.number), "ROS_LOG_DIR": str(self.logs.resolve())},
                [domain.fileno()],
            )
        self.health: dict[str, dict[str, str]] = {}
        self._told = {""}
        """What nodes were not permitted that the user has been told."""
        self.watchdog: Watchdog | None = None
        self.timing: dict[str, Any] = {}

    def execute(self) -> None:
        """Run to the end of the scenario, and stop the nodes whatever happens.

        This process joins the ROS graph at the beginning of the run and leaves it at the end. So a later run
        does not see nodes that were killed in this one.

        Raises:
            FtcmError: a node did not come up, died, fell silent, made no tick, or did not end well.
            Interrupted: the user stopped it.
        """
        self.node = node = join_as("experiment")
        self.managed = {name: Managed(node, name) for name in self.nodes}
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
            self._deactivate(tuple(n for n in CHAIN if n in self.nodes), STOP_SECONDS)
            self._hear_last_reports()
        finally:
            codes = self.processes.stop()
            node.destroy_node()
            rclpy.try_shutdown()
            self.timing["nodes"] = self.health
            self.timing["processes"] = [*by_process(self.health, "cpu_seconds")]
            if self.options.mode == "real_time" and int(self.health.get("plant", {}).get("ticks", 0)):
                self.timing["verdict"] = verdict(
                    self.health, self.scenario.dt, self.options.priority, os.cpu_count() or 1
                )
        for name, code in codes.items():
            ending = self.processes.ending(name, code, " after the run")
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
        names = ("mode", "speed", "stages", "data_path", "priority", "lock_memory", "processors", "storage")
        values = {name: getattr(self.options, name) for name in names}
        parameters = run_parameters(self.scenario, scenario_file, self.bag, values)
        self.bag.parent.mkdir(parents=True, exist_ok=True)
        together = tuple(n for n in self.nodes if n != "recorder") if composed(self.options) else ()
        self.processes.start(parameters, together)
        for name in MATCHING_ORDER:
            if name in self.nodes:
                self.transition("configure", (name,))
        others = tuple(n for n in self.nodes if n != "plant")
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
            if name in self.nodes and what.strip() == "tick":
                health = {"message": status.message, **{v.key: v.value for v in status.values}}
                if (refused := health.get("not_permitted", "")) not in self._told:
                    self._told.add(refused)
                    say(f"warning: {self.label}: {refused}")
                self.health[name] = health
                if self.watchdog is not None:
                    self.watchdog.hear(name, int(health["ticks"]), health.get("paused") == "True")

    def _follow(self) -> None:
        with Progress(self.label, self.scenario.last_tick, self.scenario.dt) as progress:
            self._follow_ticks(progress)

    def _follow_ticks(self, progress: Progress) -> None:
        """Follow the ticks to the end of the run.

        Raises:
            FtcmError: a node has ended or stopped working.
            Interrupted: the user stopped it.
        """
        waits = self.options.mode == "lockstep" or composed(self.options)  # for what is done on its thread
        self.watchdog = Watchdog(waits, self.options.patience, nodes=self.nodes)
        while True:
            self._spin()
            plant = self.health.get("plant", {})
            tick = int(plant.get("tick", 0))
            state = plant.get("state", "running")
            missed = int(plant.get("missed_deadlines", 0))
            if state in ("completed", *ENDED_EARLY):
                elapsed = float(plant["elapsed_seconds"])
                self.timing["ticks_per_second"] = round(tick / elapsed, 1)
                progress.finish(tick, missed)
                return
            progress.show(tick, missed)
            name, reason = self.watchdog.culprit(self.processes.is_stopped)
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
        size = sum(f.stat().st_size for f in self.bag.iterdir()) if self.bag.is_dir() else 0
        self._deactivate(("recorder",), CLOSE_SECONDS + size / BYTES_PER_SECOND)

    def _hear_last_reports(self) -> None:
        """Take in what the nodes say of the whole run, which they do when it ends."""
        end = time.monotonic() + REPORT_SECONDS
        while time.monotonic() < end and not all(
            "waited_seconds" in self.health.get(name, ()) for name in self.nodes
        ):
            rclpy.spin_once(self.node, timeout_sec=0.05)

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


def use_domain(domain: Domain | AmbientDomain, folder: Path) -> str:
    """Let this process and its children take part in a domain, with logs in a folder.

    Returns:
        Who may take part besides, as ``NAME=value`` words.
    """
    os.environ["ROS_DOMAIN_ID"] = str(domain.number)
    os.environ["ROS_LOG_DIR"] = str((folder / "logs").resolve())
    return set_defaults()
