# SPDX-License-Identifier: Apache-2.0
"""The suite's node processes: started together, watched, stopped together."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import psutil

from ftcm_core.errors import FtcmError
from ftcm_ros.nodes.parent import PARENT_VARIABLE, holding_signals
from ftcm_ros.run.external_nodes import write_parameters
from ftcm_ros.transport.network import enclave

STOP_SECONDS = 5.0
"""How long the nodes may take to end after each signal."""


COMPOSED = "composed"
"""Name of the process that has several nodes."""


class LocalNodes:
    """The processes of the nodes, each with its own log file."""

    start_seconds = 60.0
    """How long a node may take to come up."""

    def __init__(self, folder: Path, environment: Mapping[str, str], files: Sequence[int] = ()) -> None:
        """Keep logs and parameter files in a folder; the nodes inherit these open files."""
        self.folder = folder
        self.files = files
        self.environment = {
            **os.environ,
            **environment,
            PARENT_VARIABLE: str(os.getpid()),
            "PYTHONUNBUFFERED": "1",
        }
        self.processes: dict[str, subprocess.Popen[bytes]] = {}
        self._nodes: dict[str, tuple[str, ...]] = {}
        """Nodes of each process."""

    def start(self, parameters: Mapping[str, Mapping[str, Any]], together: Sequence[str] = ()) -> None:
        """Start nodes.

        Args:
            parameters: of each node.
            together: those that share a process.

        Raises:
            OSError: their files cannot be written, or no process can be made.
        """
        self.folder.mkdir(parents=True, exist_ok=True)
        for node, values in parameters.items():
            write_parameters(self.folder / f"{node}.yaml", node, values)
        if together:
            self._start(COMPOSED, tuple(together), ["--nodes", *together])
        for node in parameters:
            if node not in together:
                self._start(node, (node,), [])

    def _start(self, process: str, nodes: tuple[str, ...], arguments: list[str]) -> None:
        command = [sys.executable, "-m", f"ftcm_ros.nodes.{process}", *arguments, "--ros-args"]
        for node in nodes:
            command += ["--params-file", str(self.folder / f"{node}.yaml")]
        command += enclave(process)
        self._nodes[process] = nodes
        with (self.folder / f"{process}.log").open("wb") as log, holding_signals():
            self.processes[process] = subprocess.Popen(
                command, env=self.environment, stdin=subprocess.DEVNULL, stdout=log, stderr=subprocess.STDOUT,
                start_new_session=True, pass_fds=self.files,
            )  # fmt: skip

    def _process_of(self, node: str) -> str:
        return next((process for process, nodes in self._nodes.items() if node in nodes), node)

    def check(self) -> None:
        """Raise if a node has ended.

        Raises:
            FtcmError: names the node, how it ended, and the last lines it wrote.
        """
        for name, process in self.processes.items():
            code = process.poll()
            if code is not None:
                raise FtcmError(self.ending(name, code))

    def ending(self, process: str, code: int, when: str = "") -> str:
        """Say which node has ended (of several the one that failed), how, and its last lines."""
        _, failed = self._last_lines(process)
        return f"node {failed or process!r} {describe_exit(code)}{when}; {self.last_words(process)}"

    def pids(self) -> dict[str, int]:
        """Numbers of the processes that run."""
        return {name: process.pid for name, process in self.processes.items() if process.poll() is None}

    def running(self, node: str) -> bool:
        """Whether a node has been started and has not ended."""
        process = self.processes.get(self._process_of(node))
        return process is not None and process.poll() is None

    def last_words(self, node: str) -> str:
        """Return the end of the output of a node, or of a process, in one line."""
        process = self._process_of(node)
        lines, failed = self._last_lines(process)
        log = self.folder / f"{process}.log"
        if not lines:
            return f"it wrote nothing (log: {log})"
        return f"its last words: {' | '.join(lines[-1:] if failed else lines)} (log: {log})"

    def _last_lines(self, process: str) -> tuple[list[str], str]:
        """Return the last lines of a process, and which of its nodes they say has failed."""
        text = (self.folder / f"{process}.log").read_text(errors="replace")
        lines = [line.strip() for line in text.splitlines() if line.strip()][-3:]
        said = lines[-1].partition(": ")[0] if lines else ""
        return lines, said if said in (process, *self._nodes[process]) else ""

    def is_stopped(self, node: str) -> bool:
        """Whether a node's process is stopped, as by SIGSTOP or a debugger."""
        try:
            status = psutil.Process(self.pid(node)).status()
        except (psutil.NoSuchProcess, KeyError):
            return False
        return status in (psutil.STATUS_STOPPED, psutil.STATUS_TRACING_STOP)

    def condition(self, node: str) -> str:
        """Say what is known of a node's process."""
        return "its process is stopped" if self.is_stopped(node) else "it runs"

    def resume(self) -> None:
        """Let stopped nodes go on: a stopped process can neither finish nor act on a signal."""
        for process in self.processes.values():
            process.send_signal(signal.SIGCONT)  # does nothing to a process that has ended

    def pid(self, node: str) -> int:
        """Process number of a node."""
        return self.processes[self._process_of(node)].pid

    def stop(self) -> dict[str, int]:
        """Stop all nodes: SIGINT, then SIGTERM, then SIGKILL; return the exit code of each process."""
        for number in (signal.SIGINT, signal.SIGTERM, signal.SIGKILL):
            running = [p for p in self.processes.values() if p.poll() is None]
            for process in running:
                process.send_signal(signal.SIGCONT)  # a stopped process cannot act on anything else
                process.send_signal(number)
            end = time.monotonic() + STOP_SECONDS
            for process in running:
                try:
                    process.wait(max(0.01, end - time.monotonic()))
                except subprocess.TimeoutExpired:
                    continue
        return {name: process.returncode for name, process in self.processes.items()}


def describe_exit(code: int) -> str:
    """Say how a process ended."""
    if code < 0:
        return f"was ended by {signal.Signals(-code).name}"
    return f"ended with status {code}" if code else "has ended as one that was told to (status 0)"
