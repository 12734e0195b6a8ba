# SPDX-License-Identifier: Apache-2.0
"""Soak test: the whole graph in real time for long; no tick lost, no process growing.

``python tools/soak.py --minutes 60`` runs the paper's scenario with the recorder, samples the memory of
each process, counts every message of the bag, and prints a table. Exit status: 0 if all held, 1 if not.
"""

from __future__ import annotations

import argparse
import contextlib
import csv
import math
import os
import platform
import shutil
import signal
import statistics
import sys
import threading
import time
from pathlib import Path
from typing import Any

from rosbags.rosbag2 import Reader

from ftcm_core.errors import FtcmError
from ftcm_core.report.results import new_folder
from ftcm_core.scenario import Scenario, load
from ftcm_ros.analysis.timing import by_process
from ftcm_ros.bags.writer import TopicCount
from ftcm_ros.run.experiment import build_parser
from ftcm_ros.run.graph_run import Interrupted, Run, use_domain
from ftcm_ros.timing.pacing import CAUSES
from ftcm_ros.transport.codec import stamp_of
from ftcm_ros.transport.domain import Domain
from ftcm_ros.transport.topics import data_topics

GROWTH_LIMIT_KB = 1024
"""How much a process may grow after the warm-up."""
BYTES_PER_TICK = 2000
"""Space a tick takes in the bag, generously."""
HELD_SECONDS = 1.0
"""So long the recorder is stopped once, in the middle of the warm-up. A sender keeps what has not been
acknowledged, and keeps the room for it afterwards: what counts is the memory after queues have been full."""
SETTLED = 3
"""The median of so many samples is the memory at the beginning and at the end."""


def memory_kb(pid: int) -> int:
    """Return the resident memory of a process without pages of files (libraries, which others share), kB.

    psutil offers it only with the pages of shared memory left out.

    Raises:
        OSError: there is no such process.
    """
    text = Path(f"/proc/{pid}/status").read_text(encoding="ascii")
    wanted = ("RssAnon:", "RssShmem:")
    return sum(int(line.split()[1]) for line in text.splitlines() if line.startswith(wanted))


class Sampler(threading.Thread):
    """Writes the memory of processes to a CSV file now and then, in a background thread."""

    def __init__(self, file: Path, run: Run, every: float, warm_up: float) -> None:
        """Sample the nodes of a run, once they are there, and this process."""
        super().__init__(name="sampler", daemon=True)
        self._file, self._run, self._every = file, run, every
        self._hold_at = warm_up / 2
        self._end = threading.Event()

    def run(self) -> None:
        """Sample until stopped."""
        with self._file.open("w", newline="", encoding="ascii") as file:
            rows = csv.writer(file)
            rows.writerow(("seconds", "process", "kb"))
            began = time.monotonic()
            while not self._end.wait(self._every):
                if self._run.watchdog is None:  # the ticks have not begun
                    began = time.monotonic()
                    continue
                pids = self._run.processes.pids()
                if time.monotonic() - began >= self._hold_at and "recorder" in pids:
                    self._hold_at = math.inf
                    with contextlib.suppress(OSError):  # it has just ended
                        os.kill(pids["recorder"], signal.SIGSTOP)
                        time.sleep(HELD_SECONDS)
                        os.kill(pids["recorder"], signal.SIGCONT)
                for name, pid in {**pids, "experiment": os.getpid()}.items():
                    try:
                        rows.writerow((round(time.monotonic() - began, 1), name, memory_kb(pid)))
                    except OSError:  # it has just ended
                        continue
                file.flush()

    def stop(self) -> None:
        """End, with what has been sampled in the file."""
        self._end.set()
        self.join()


def growth(file: Path, warm_up: float) -> dict[str, tuple[int, int, int]]:
    """Return per process its memory after the warm-up, at the end, and the largest in between, kB.

    Raises:
        FtcmError: too few samples.
    """
    series: dict[str, list[int]] = {}
    with file.open(newline="", encoding="ascii") as lines:
        for row in csv.DictReader(lines):
            if float(row["seconds"]) >= warm_up:
                series.setdefault(row["process"], []).append(int(row["kb"]))
    if not series or min(map(len, series.values())) < 2 * SETTLED:
        raise FtcmError("too few samples of the memory after the warm-up; make the run longer")
    return {
        name: (
            round(statistics.median(values[:SETTLED])),
            round(statistics.median(values[-SETTLED:])),
            max(values),
        )
        for name, values in series.items()
    }


def count_ticks(bag: Path, scenario: Scenario) -> dict[str, TopicCount]:
    """Count the ticks of each data topic, message by message from the file."""
    counts = {topic.name: TopicCount() for topic in data_topics(scenario)}
    with Reader(bag) as reader:
        wanted = [c for c in reader.connections if c.topic.lstrip("/") in counts]
        for connection, _, data in reader.messages(wanted):
            counts[connection.topic.lstrip("/")].add(stamp_of(data), scenario.dt_ns)
    return counts


def run_for(scenario: Scenario, options: argparse.Namespace) -> Run:
    """Run a scenario in real time with the recorder, memory sampled; return the run.

    Raises:
        FtcmError: the run could not be made, or did not come to its end.
    """
    folder = new_folder(options.folder)
    free, needed = shutil.disk_usage(folder).free, scenario.last_tick * BYTES_PER_TICK
    if free < needed:
        raise FtcmError(
            f"{str(folder)!r} has {free / 1e9:.1f} GB free; expected {needed / 1e9:.1f} GB for "
            f"{scenario.duration:g} s; choose another --folder"
        )
    arguments = ["--mode", "real_time", "--priority", str(options.priority)]
    arguments.append("--no-composed" if options.processes else "--composed")
    run_options = build_parser().parse_args(arguments)
    run_options.stop_requested = False

    def stop(signum: int, frame: Any) -> None:
        run_options.stop_requested = True

    signal.signal(signal.SIGINT, stop)
    signal.signal(signal.SIGTERM, stop)
    domain = Domain()
    use_domain(domain, folder)
    run = Run(scenario, "soak", folder, run_options, domain)
    sampler = Sampler(folder / "memory.csv", run, options.every, options.warm_up)
    sampler.start()
    try:
        run.execute()
    except Interrupted:
        raise FtcmError("stopped by the user") from None
    finally:
        sampler.stop()
        domain.release()
    return run


def check(
    counts: dict[str, TopicCount], memory: dict[str, tuple[int, int, int]], ticks: int, warm_up: float
) -> list[str]:
    """Return what did not hold, one line each."""
    lost = [
        f"{name}: {count.messages} messages, {count.missing} ticks missing, {count.repeated} repeated; "
        f"expected each of {ticks} ticks once"
        for name, count in counts.items()
        if count.missing or count.repeated or count.messages != ticks
    ]
    grown = [
        f"{name}: {end - begin} kB more after {warm_up:g} s; expected less than {GROWTH_LIMIT_KB} kB"
        for name, (begin, end, _) in memory.items()
        if end - begin >= GROWTH_LIMIT_KB
    ]
    return lost + grown


def figures(
    run: Run,
    counts: dict[str, TopicCount],
    memory: dict[str, tuple[int, int, int]],
    warm_up: float,
) -> list[str]:
    """Return what was measured, in Markdown."""
    scenario, plant = run.scenario, run.health["plant"]
    ticks = scenario.last_tick + 1
    missed = int(plant["missed_deadlines"])
    causes = ", ".join(f"{c} {plant[c]}" for c in CAUSES)
    jitter = ", ".join(f"{p} {plant[f'jitter_{p}_us']}" for p in ("p50", "p99", "p999", "max"))
    size = sum(f.stat().st_size for f in run.bag.iterdir()) / 1e6
    messages = sum(c.messages for c in counts.values())
    missing = sum(c.missing for c in counts.values())
    busy = {
        name: f"{seconds / run.timing['run_seconds']:.2f}"
        for name, seconds in by_process(run.health, "cpu_seconds").items()
    }
    share = 100 * missed / (ticks + int(plant["plant_overrun"]))
    return [
        f"{scenario.duration:g} s of real time at {1 / scenario.dt:g} Hz, controller "
        f"{scenario.controller.type_name}: {ticks:,} ticks, {messages:,} messages on {len(counts)} data "
        f"topics in a bag of {size:,.0f} MB, {missing} ticks missing.",
        "",
        f"Deadlines missed: {missed:,} ({share:.2f} %): {causes}. Tick jitter, µs: {jitter}.",
        "",
        f"| process | memory after {warm_up:g} s, kB | at the end | growth | largest | processors |",
        "|---|---|---|---|---|---|",
        *(
            f"| {name} | {begin:,} | {end:,} | {end - begin:+,} | {largest:,} | {busy.get(name, '–')} |"
            for name, (begin, end, largest) in memory.items()
        ),
    ]


def soak(options: argparse.Namespace) -> tuple[list[str], list[str]]:
    """Run; return the figures, and what did not hold.

    Raises:
        FtcmError: the run could not be made, did not come to its end, or was too short.
    """
    scenario = load("paper", [f"duration={60 * options.minutes:g}", *options.set])
    load_before = os.getloadavg()[0]
    run = run_for(scenario, options)
    memory = growth(options.folder / "memory.csv", options.warm_up)
    counts = count_ticks(run.bag, scenario)
    machine = (
        f"Machine: {os.cpu_count()} processors, {platform.platform()}, Python {platform.python_version()}. "
        f"Load before the run: {load_before:.1f}."
    )
    failures = check(counts, memory, scenario.last_tick + 1, options.warm_up)
    return [machine, "", *figures(run, counts, memory, options.warm_up)], failures


def main(argv: list[str] | None = None) -> int:
    """Run the soak test and print its figures."""
    parser = argparse.ArgumentParser(prog="tools/soak.py", description=__doc__)
    parser.add_argument("--minutes", type=float, default=60.0, help="length of the run (default: 60)")
    parser.add_argument("--warm-up", type=float, default=60.0, help="memory counts from then on, s")
    parser.add_argument("--every", type=float, default=5.0, help="time between two samples of the memory, s")
    parser.add_argument("--set", action="append", default=[], metavar="PATH=VALUE", help="e.g. seed=3")
    parser.add_argument("--priority", type=int, default=0, help="SCHED_FIFO priority of the nodes")
    parser.add_argument("--processes", action="store_true", help="a process for each node; default: composed")
    parser.add_argument(
        "--folder", type=Path, help="new folder for bag, logs and memory.csv (default: in runs)"
    )
    parser.add_argument("--output", type=Path, help="also write the figures to this file")
    options = parser.parse_args(argv)
    if options.folder is None:
        options.folder = Path("runs") / f"soak-{time.strftime('%Y%m%d-%H%M%S')}"
    try:
        lines, failures = soak(options)
    except FtcmError as error:
        print(f"soak: error: {error}", file=sys.stderr)
        return 1
    text = "\n".join(lines) + "\n"
    print(text, end="")
    if options.output:
        options.output.write_text(text, encoding="utf-8")
    for failure in failures:
        print(f"soak: failed: {failure}", file=sys.stderr)
    return 1 if failures else 0


if __name__ == "__main__":
    sys.exit(main())
