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
from ftcm_ros.nodes.parent import PARENT_VARIABLE
from ftcm_ros.run.external_nodes import write_parameters
from ftcm_ros.transport.network import enclave

STOP_SECONDS = 5.0
"""How long the nodes may take to end after each signal."""


class LocalNodes:
    """One process per node, each with its own log file."""

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

    def start(self, node: str, parameters: Mapping[str, Any]) -> None:
        """Start a node with parameters.

        Raises:
            OSError: its files cannot be written, or no process can be made.
        """
        self.folder.mkdir(parents=True, exist_ok=True)
        file = self.folder / f"{node}.yaml"
        write_parameters(file, node, parameters)
        command = [sys.executable, "-m", f"ftcm_ros.nodes.{node}", "--ros-args", "--params-file", str(file)]
        command += enclave(node)
        with (self.folder / f"{node}.log").open("wb") as log:
            self.processes[node] = subprocess.Popen(
                command, env=self.environment, stdin=subprocess.DEVNULL, stdout=log, stderr=subprocess.STDOUT,
                start_new_session=True, pass_fds=self.files,
            )  # fmt: skip

    def check(self) -> None:
        """Raise if a node has ended.

        Raises:
            FtcmError: names the node, how it ended, and the last lines it wrote.
        """
        for node, process in self.processes.items():
            code = process.poll()
            if code is not None:
                raise FtcmError(f"node {node!r} {describe_exit(code)}; {self.last_words(node)}")

    def pids(self) -> dict[str, int]:
        """Process numbers of the nodes that run."""
        return {node: process.pid for node, process in self.processes.items() if process.poll() is None}

    def running(self, node: str) -> bool:
        """Whether a node has been started and has not ended."""
        process = self.processes.get(node)
        return process is not None and process.poll() is None

    def last_words(self, node: str) -> str:
        """Return the end of a node's output, in one line."""
        log = self.folder / f"{node}.log"
        lines = [line.strip() for line in log.read_text(errors="replace").splitlines() if line.strip()]
        if not lines:
            return f"it wrote nothing (log: {log})"
        said_why = lines[-1].startswith(f"{node}: ")
        return f"its last words: {' | '.join(lines[-1:] if said_why else lines[-3:])} (log: {log})"

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
        return self.processes[node].pid

    def stop(self) -> dict[str, int]:
        """Stop all nodes: SIGINT, then SIGTERM, then SIGKILL; return their exit codes."""
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
        return {node: process.returncode for node, process in self.processes.items()}


def describe_exit(code: int) -> str:
    """Say how a process ended."""
    if code < 0:
        return f"was ended by {signal.Signals(-code).name}"
    return f"ended with status {code}"
