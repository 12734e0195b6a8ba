# SPDX-License-Identifier: Apache-2.0
"""The command ``doctor``: what this machine has, and what to do about what is missing.

What concerns ROS comes from the package ``ftcm_ros``, by an entry point, where that is installed.
"""

from __future__ import annotations

import argparse
import os
import platform
import resource
import shutil
import subprocess
import sys
import threading
import time
from collections.abc import Iterable, Mapping
from importlib import metadata
from pathlib import Path
from typing import NamedTuple

import ftcm_core
from ftcm_core.cli.brought import brought
from ftcm_core.errors import FtcmError
from ftcm_core.report.results import to_json
from ftcm_core.scenario import shipped_scenarios

OK, WARNING, MISSING = "ok", "warning", "missing"
OLDEST_PYTHON = (3, 10)
NEEDED = {"numpy": "1.26", "PyYAML": "6.0.1", "tabulate": "0.9", "tqdm": "4.66"}
"""What every run needs beside Python, with the oldest version, as in ``setup.py``."""
EXTRAS = {
    "matplotlib": ("matplotlib", "figures need it", "figures"),
    "numba": ("numba", "compiled runs need it", "compiled"),
    "viser": ("viser", "ftcm watch --web needs it", "web"),
    "scipy": ("scipy", "tests of a campaign's comparisons, and even sampling, need it", "statistics"),
    "pyarrow": ("pyarrow", "a campaign's runs as Parquet need it", "parquet"),
    "optuna": ("optuna", "tuning needs it", "tune"),
    "distributed": ("distributed", "runs on more machines (--cluster) need it", "cluster"),
    "pinocchio": ("pin", "only tests need it, for an independent model", ""),
    "pandas": ("pandas", "a run as a table of pandas needs it", "notebook"),
    "mujoco": ("mujoco", "the plant mujoco needs it", "mujoco"),
    "argcomplete": ("argcomplete", "the shell completes ftcm's words with it", "completion"),
}
"""Of each module: its package in the index, what it is for, and the extra of ``ftcm_core`` that brings it."""
SLOW_CLOCKS = ("hpet", "acpi_pm", "jiffies", "refined-jiffies", "pit")
"""Clock sources of Linux that cost microseconds a reading."""
COARSE_SECONDS = 1e-6
"""A steady clock that tells no less than this is too coarse for a tick of a millisecond, s."""
DISK_BYTES = 1e9
"""So much free disk is a quarter of an hour of recording at 1 kHz: a bag grows by 0.9 MB a second."""
SHARED_MEMORY_BYTES = 32e6
"""So much free shared memory is enough: a run takes less than 10 MB of it (chosen: three at once)."""
_CAP_IPC_LOCK, _CAP_SYS_NICE = 14, 23
_IMPORT_SECONDS = 60.0


class Finding(NamedTuple):
    """One line of what the doctor says."""

    name: str
    status: str
    """``ok``, ``warning`` or ``missing``."""
    value: str
    """What there is."""
    advice: str = ""
    """What to do."""
    needed: bool = False
    """Whether no run is possible without it."""


def doctor_command(arguments: argparse.Namespace) -> int:
    """Say what this machine has; 1 if something is missing that every run needs."""
    findings = examined()
    if arguments.json:
        print(to_json([finding._asdict() for finding in findings]))
    else:
        print(told(findings))
    return int(any(finding.needed and finding.status == MISSING for finding in findings))


def examined() -> list[Finding]:
    """Examine this machine: the core's part, then that of ``ftcm_ros``."""
    findings = [
        python(),
        *packages(),
        core(),
        *extras(),
        processors(),
        real_time(),
        locked_memory(),
        clock_source(),
        clock_resolution(),
        shared_memory(),
        disk(Path()),
    ]
    try:
        function = brought("doctor")
    except FtcmError as error:
        return [*findings, Finding("ftcm_ros", MISSING, str(error), "build the workspace anew and source it")]
    if function is None:
        advice = "only runs over the ROS graph need it: make build, then source install/setup.bash"
        return [*findings, Finding("ftcm_ros", MISSING, "not installed, or not sourced", advice)]
    return [*findings, *function()]


def told(findings: Iterable[Finding]) -> str:
    """Return findings as text, one line each."""
    findings = list(findings)
    width = max(len(finding.name) for finding in findings)
    lines = [
        f"{finding.status:<7}  {finding.name:<{width}}  {finding.value}"
        + (f"; {finding.advice}" if finding.advice else "")
        for finding in findings
    ]
    return "\n".join(lines)


# What every run needs.


def python() -> Finding:
    """The interpreter."""
    value = f"{platform.python_version()} ({sys.executable})"
    if sys.version_info < OLDEST_PYTHON:
        oldest = ".".join(map(str, OLDEST_PYTHON))
        return Finding("Python", MISSING, value, f"install Python {oldest} or newer", needed=True)
    return Finding("Python", OK, value, needed=True)


def packages(needed: Mapping[str, str] = NEEDED) -> list[Finding]:
    """The packages that every run needs."""
    return [package(name, oldest, needed=True) for name, oldest in needed.items()]


def package(name: str, oldest: str, *, needed: bool) -> Finding:
    """One package of the index, of a version or newer."""
    version = version_of(name)
    advice = f"python -m pip install '{name}>={oldest}'"
    if not version:
        return Finding(name, MISSING, "not installed", advice, needed)
    if _numbers(version) < _numbers(oldest):
        return Finding(name, MISSING, f"{version} is too old", advice, needed)
    return Finding(name, OK, version, needed=needed)


def version_of(name: str) -> str:
    """Version of an installed package; empty if there is none."""
    try:
        return metadata.version(name)
    except metadata.PackageNotFoundError:
        return ""


def _numbers(version: str) -> tuple[int, ...]:
    """The leading numbers of a version."""
    found = []
    for part in version.split("."):
        if not part.isdigit():
            break
        found.append(int(part))
    return tuple(found)


def core() -> Finding:
    """The package ``ftcm_core``, with its scenarios."""
    value = f"{ftcm_core.__version__} ({Path(ftcm_core.__file__).parent})"
    if "paper" not in shipped_scenarios():
        where = "ftcm_core/config is a link to the workspace's config/: check it out as a link, install again"
        return Finding("ftcm_core", MISSING, f"{value} has no scenarios", where, needed=True)
    return suite_package("ftcm_core", value, needed=True)


def suite_package(name: str, value: str, *, needed: bool) -> Finding:
    """A package of the suite: is what runs what is installed?"""
    installed = version_of(name)
    if installed and installed != ftcm_core.__version__:
        other = f"{value}, but {installed} is installed"
        return Finding(name, WARNING, other, "build the workspace anew and source it", needed)
    return Finding(name, OK, value, needed=needed)


# What some runs need.


def extras() -> list[Finding]:
    """The packages that something needs, and not every run; imported, each in a process of its own."""
    reasons = importing(EXTRAS)
    findings = []
    for module, (name, purpose, extra) in EXTRAS.items():
        advice = f"{purpose}: python -m pip install {name}"
        if extra:
            advice += f", or the extra ftcm_core[{extra}]"
        version = version_of(name) or version_of(module)
        if module not in reasons:
            findings.append(Finding(name, OK, version or "of no known version"))
        elif version:
            findings.append(
                Finding(name, WARNING, f"{version} cannot be imported: {reasons[module]}", advice)
            )
        else:
            findings.append(Finding(name, MISSING, "not installed", advice))
    return findings


def importing(modules: Iterable[str]) -> dict[str, str]:
    """Import modules, each in a process of its own; return why those failed that did.

    An extension module made for another numpy may end its process.
    """
    started = {
        module: subprocess.Popen(
            [sys.executable, "-c", f"import {module}"],
            stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True,
        )
        for module in modules
    }  # fmt: skip
    failed = {}
    for module, process in started.items():
        try:
            _, err = process.communicate(timeout=_IMPORT_SECONDS)
        except subprocess.TimeoutExpired:
            process.kill()
            process.communicate()
            failed[module] = f"not within {_IMPORT_SECONDS:g} s"
            continue
        if process.returncode:
            lines = err.strip().splitlines()
            failed[module] = lines[-1] if lines else f"its process ended with status {process.returncode}"
    return failed


# The machine.


def processors() -> Finding:
    """How many processors this process may use."""
    count = len(os.sched_getaffinity(0))
    value = f"{count} of {os.cpu_count()}"
    if count < 2:
        advice = "runs in real time over the graph miss their ticks here; lockstep is not affected"
        return Finding("processors", WARNING, value, advice)
    return Finding("processors", OK, value)


def real_time() -> Finding:
    """Whether this process may use SCHED_FIFO: it is tried, in a thread of its own."""
    refused: list[str] = []

    def attempt() -> None:
        try:
            os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(1))
        except OSError as error:
            refused.append(error.strerror or str(error))

    thread = threading.Thread(target=attempt)
    thread.start()
    thread.join()
    soft, _ = resource.getrlimit(resource.RLIMIT_RTPRIO)
    highest = 99 if _capable(_CAP_SYS_NICE) or soft == resource.RLIM_INFINITY else soft
    if refused:
        advice = (
            "real time misses more ticks without: a line `USER - rtprio 99` in /etc/security/limits.conf and "
            "a new login, or, in a container, --cap-add SYS_NICE"
        )
        return Finding("real-time priority", WARNING, f"SCHED_FIFO: {refused[0]}", advice)
    return Finding("real-time priority", OK, f"SCHED_FIFO, 1 to {highest}")


def locked_memory() -> Finding:
    """Whether this process may lock all of its memory."""
    soft, _ = resource.getrlimit(resource.RLIMIT_MEMLOCK)
    if soft == resource.RLIM_INFINITY or _capable(_CAP_IPC_LOCK):
        return Finding("locked memory", OK, "no limit")
    advice = (
        "lock_memory needs more: a line `USER - memlock unlimited` in /etc/security/limits.conf and a new "
        "login, or, in a container, --cap-add IPC_LOCK"
    )
    return Finding("locked memory", WARNING, f"at most {_size(soft)}", advice)


def _capable(number: int) -> bool:
    """Whether this process has a capability of Linux."""
    try:
        lines = Path("/proc/self/status").read_text(encoding="ascii", errors="replace").splitlines()
        effective = next(line.split()[1] for line in lines if line.startswith("CapEff:"))
    except (OSError, StopIteration, IndexError):
        return False
    return bool(int(effective, 16) >> number & 1)


def clock_source(folder: Path = Path("/sys/devices/system/clocksource/clocksource0")) -> Finding:
    """What Linux takes the time from."""
    try:
        source = (folder / "current_clocksource").read_text(encoding="ascii").strip()
    except OSError:
        return Finding("clock source", WARNING, "Linux does not tell", "nothing, if runs keep their ticks")
    if source in SLOW_CLOCKS:
        advice = f"it is slow to read: choose another with the kernel's option clocksource=, of {folder}"
        return Finding("clock source", WARNING, source, advice)
    return Finding("clock source", OK, source)


def clock_resolution() -> Finding:
    """What the steady clock can tell apart."""
    resolution = time.clock_getres(time.CLOCK_MONOTONIC)
    value = f"{resolution * 1e9:g} ns"
    if resolution > COARSE_SECONDS:
        return Finding("clock resolution", WARNING, value, "too coarse for real time: high-resolution timers")
    return Finding("clock resolution", OK, value)


def shared_memory(folder: Path = Path("/dev/shm")) -> Finding:
    """Where processes on this machine exchange messages."""
    try:
        usage = shutil.disk_usage(folder)
    except OSError:
        advice = "mount a tmpfs there; until then messages go over UDP"
        return Finding(str(folder), WARNING, "not there", advice)
    value = f"{_size(usage.free)} free of {_size(usage.total)}"
    if usage.free < SHARED_MEMORY_BYTES:
        advice = "remove what ended processes left there, or, in a container, give it --shm-size 256m"
        return Finding(str(folder), WARNING, value, advice)
    return Finding(str(folder), OK, value)


def disk(folder: Path) -> Finding:
    """Where results would be written."""
    usage = shutil.disk_usage(folder)
    value = f"{_size(usage.free)} free in {folder.resolve()}"
    if usage.free < DISK_BYTES:
        return Finding("disk", WARNING, value, "free some, or write results elsewhere: --output, --runs")
    if not os.access(folder, os.W_OK):
        return Finding("disk", WARNING, f"{folder.resolve()} is not writable", "go to another folder")
    return Finding("disk", OK, value)


def _size(size: float) -> str:
    """A number of bytes for people."""
    return f"{size / 1e9:.1f} GB" if size >= 1e9 else f"{size / 1e6:.1f} MB"
