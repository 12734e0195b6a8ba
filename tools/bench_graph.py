# SPDX-License-Identifier: Apache-2.0
"""Benchmark of the graph: lockstep against the ordinary executor and a bare chain, real time, start, reading.

``python tools/bench_graph.py`` measures all rows side by side, the variants of a row in turn, and
prints a table with medians and spreads; ``--output FILE`` also writes it as a page.
"""

from __future__ import annotations

import argparse
import contextlib
import json
import multiprocessing
import os
import platform
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

import rclpy
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions

import bench_core as core
from ftcm_core.errors import FtcmError
from ftcm_core.scenario import load
from ftcm_core.simulation import simulate
from ftcm_ros.bags.reader import read_bag
from ftcm_ros.parameters.node_parameters import NODES
from ftcm_ros.timing import scheduling
from ftcm_ros.timing.pacing import CAUSES, RealTime
from ftcm_ros.transport.codec import JointStateCodec
from ftcm_ros.transport.domain import Domain
from ftcm_ros.transport.network import set_defaults
from ftcm_ros.transport.plane import DataPlane, make_plane
from ftcm_ros.transport.topics import DISTURBANCE, ESTIMATE, JOINT_STATES, TORQUES

CHAIN = {
    "observer": (JOINT_STATES, ESTIMATE),
    "controller": (ESTIMATE, TORQUES),
    "injector": (TORQUES, DISTURBANCE),
}
STAGE_SECONDS = 60.0


def experiment(folder: Path, name: str, *arguments: str) -> dict[str, Any]:
    """Run an experiment and return its summary, with the folder of its bag under ``bag``.

    Raises:
        FtcmError: it failed.
    """
    command = [
        sys.executable,
        "-m",
        "ftcm_ros.run.experiment",
        "paper",
        "--controllers",
        "ftcm",
        "--no-figures",
    ]
    run = subprocess.run(
        [*command, "--runs", str(folder), "--name", name, *arguments],
        capture_output=True,
        text=True,
        check=False,
    )
    if run.returncode != 0:
        raise FtcmError(f"benchmark run {name!r} failed: {run.stderr.strip().splitlines()[-1]}")
    summary: dict[str, Any] = json.loads((folder / name / "summary.json").read_text())
    return {**summary, "bag": folder / name / "bags" / "ftcm"}


def relay(name: str) -> None:
    """One hop of the bare chain: pass the same bytes on, without decoding or work."""
    rclpy.init(signal_handler_options=SignalHandlerOptions.NO)
    plane = make_plane(Node(f"bare_{name}"), "listener")
    source, target = CHAIN[name]
    publish = plane.publisher(target)
    plane.subscribe(source, lambda data, _: publish(data))
    plane.open()
    end = time.monotonic() + STAGE_SECONDS
    with plane.turn:
        while time.monotonic() < end:
            plane.poll(10**8)


@contextlib.contextmanager
def bare_chain(at_once: int = 0) -> Iterator[tuple[DataPlane, Callable[[], None], list[int]]]:
    """Four bare processes that pass one message round.

    Args:
        at_once: so many rounds follow each other by themselves.

    Yields:
        The first one's data plane, to poll; what sends the message; the latency of each round, ns.

    Raises:
        FtcmError: they did not find each other.
    """
    context = multiprocessing.get_context("spawn")
    hops = [context.Process(target=relay, args=(name,), daemon=True) for name in CHAIN]
    for hop in hops:
        hop.start()
    rclpy.init(signal_handler_options=SignalHandlerOptions.NO)
    node = Node("bare_plant")
    plane = make_plane(node, "listener")
    try:
        publish = plane.publisher(JOINT_STATES)
        data = JointStateCodec(("joint1", "joint2", "joint3")).state.encode(0, *((0.0,) * 3,) * 3)
        rounds: list[int] = []
        sent = 0

        def send() -> None:
            nonlocal sent
            sent = time.monotonic_ns()
            publish(data)

        def arrived(message: bytes, published_ns: int) -> None:
            rounds.append(time.monotonic_ns() - sent)
            if matched and len(rounds) < at_once:
                send()

        matched = False
        plane.subscribe(DISTURBANCE, arrived)
        plane.open()
        with plane.turn:
            end = time.monotonic() + 20.0
            while not rounds:  # until the chain is matched all round
                if time.monotonic() > end:
                    raise FtcmError("the bare chain did not come up within 20 s")
                send()
                plane.poll(10**8)
            plane.poll(10**9)
            rounds.clear()
            matched = True
            yield plane, send, rounds
    finally:
        plane.stop()
        node.destroy_node()
        rclpy.shutdown()
        for hop in hops:
            hop.terminate()
            hop.join()


def bare_lockstep(ticks: int) -> tuple[float, float]:
    """Rate (ticks/s) and median latency (µs) of the bare chain, one round after the other."""
    with bare_chain(ticks) as (plane, send, rounds):
        begin = time.monotonic()
        send()
        while len(rounds) < ticks:
            plane.poll(10**7)
            if time.monotonic() > begin + STAGE_SECONDS:
                raise FtcmError(f"the bare chain stopped after {len(rounds)} ticks")
        return ticks / (time.monotonic() - begin), statistics.median(rounds) / 1000.0


def bare_real_time(ticks: int) -> float:
    """Share of ticks at 1 kHz that the bare chain misses, %: rounds that end late, and ticks skipped."""
    scheduling.apply(0, False, "")
    late = 0
    with bare_chain() as (plane, send, rounds):
        pacer = RealTime(10**6)
        pacer.begin()
        for _ in range(ticks):
            before = len(rounds)
            send()
            pacer.wait(lambda: False, plane.poll)
            late += len(rounds) == before
    return 100.0 * (late + pacer.misses.total) / ticks


def holes(seconds: float) -> tuple[float, float]:
    """What a process that only looks at the clock loses: holes over 0.1 ms per second, the largest, ms."""
    found = []
    last = begin = time.monotonic_ns()
    while last - begin < seconds * 1e9:
        now = time.monotonic_ns()
        if now - last > 100_000:
            found.append(now - last)
        last = now
    return len(found) / seconds, max(found, default=0) / 1e6


@contextlib.contextmanager
def busy_core() -> Iterator[None]:
    """Keep one processor busy with another process."""
    process = subprocess.Popen([sys.executable, "-c", "while True: pass"])
    try:
        yield
    finally:
        process.kill()
        process.wait()


def spread(values: Sequence[float], digits: int = 0) -> str:
    """Median and range as text."""
    return f"{statistics.median(values):,.{digits}f} ({min(values):,.{digits}f}–{max(values):,.{digits}f})"


def error_ratio(summary: dict[str, Any], lockstep: dict[str, Any]) -> float:
    """Largest ratio over the joints of the mean tracking errors of two runs of equal length."""
    pairs = zip(*(s["results"][0]["metrics"]["whole"]["mean_abs_error"] for s in (summary, lockstep)))
    return float(max(a / b for a, b in pairs))


Row = tuple[str, str, str]
"""What, how much, and what this project aims at; nothing where it does not say."""


def say(text: str) -> None:
    """Tell what is being measured."""
    print(f"  {text} ...", file=sys.stderr, flush=True)


def measure(repetitions: int, seconds: float) -> list[Row]:
    """Measure all rows of the graph."""
    lost = [holes(3.0) for _ in range(repetitions)]
    bare = [bare_real_time(10_000) for _ in range(repetitions)]
    rows = [
        ("the machine alone: holes over 0.1 ms in a busy loop, per s", spread([n for n, _ in lost]), ""),
        ("the largest of them, ms", spread([largest for _, largest in lost], 1), ""),
        ("bare chain of four processes at 1 kHz, no work, no recorder: missed, %", spread(bare, 2), ""),
    ]
    with tempfile.TemporaryDirectory() as scratch:
        folder = Path(scratch)
        rows += lockstep_rows(folder, repetitions)
        rows += real_time_rows(folder, repetitions, seconds)
        rows += analysis_rows(folder, repetitions)
    return rows


def lockstep_rows(folder: Path, repetitions: int) -> list[Row]:
    """The graph in lockstep against the executor and the bare chain, the three in turn."""
    fast: list[float] = []
    plain: list[float] = []
    floor: list[float] = []
    floor_latency: list[float] = []
    latency: list[float] = []
    start: list[float] = []
    hops: dict[str, list[float]] = {}
    for i in range(repetitions):
        say(f"lockstep, repetition {i + 1} of {repetitions}")
        run = experiment(folder, f"listener{i}", "--set", "duration=10")
        timing = run["timing"]["ftcm"]
        fast.append(timing["ticks_per_second"])
        start.append(timing["start_seconds"])
        latency.append(float(timing["nodes"]["plant"]["latency_p50_us"]))
        for name, found in run["timing_us"]["ftcm"].items():
            hops.setdefault(name, []).append(found["p50"])
        slow = experiment(folder, f"executor{i}", "--set", "duration=2", "--data-path", "executor")
        plain.append(slow["timing"]["ftcm"]["ticks_per_second"])
        rate, median = bare_lockstep(5000)
        floor.append(rate)
        floor_latency.append(median)
    begin = time.monotonic()
    trace = simulate(load("paper", ["duration=5"]))
    work = 1e6 * (time.monotonic() - begin) / trace.ticks
    allowed = 1.5 * statistics.median(floor_latency) + work
    return [
        ("lockstep, full graph, ticks/s", spread(fast), "≥ 3,000"),
        ("the same on the ordinary executor, ticks/s", spread(plain), ""),
        ("ratio, pair by pair", spread([a / b for a, b in zip(fast, plain)], 2), "≥ 5"),
        ("bare chain of four processes, ticks/s", spread(floor), ""),
        ("latency from measurement to disturbance at the plant, full graph, µs, median", spread(latency),
         f"≤ {allowed:.0f}: 1.5 × bare + work"),
        ("the same in the bare chain, µs, median", spread(floor_latency), ""),
        ("work of all nodes in a tick, in one process, µs", f"{work:.0f}", ""),
        ("hops of the full graph, from publication to publication, µs, median",
         ", ".join(f"{name} {statistics.median(hops[name]):.0f}" for name in CHAIN), ""),
        ("start of the graph to its first tick, s", spread(start, 2), "≤ 3"),
    ]  # fmt: skip


def real_time_rows(folder: Path, repetitions: int, seconds: float) -> list[Row]:
    """The graph at 1 kHz with ordinary and real-time scheduling, and beside a busy process, in turn."""
    length = ("--set", f"duration={seconds:g}")
    lockstep = experiment(folder, "lockstep", *length)
    variants: dict[str, tuple[tuple[str, ...], Any, tuple[str, str]]] = {
        "ordinary scheduling": ((), contextlib.nullcontext, ("≤ 0.1", "")),
        "SCHED_FIFO": (("--priority", "50", "--lock-memory"), contextlib.nullcontext, ("≤ 0.01", "")),
        "one core kept busy": ((), busy_core, ("", "≤ 2")),
    }
    runs: dict[str, list[dict[str, Any]]] = {variant: [] for variant in variants}
    for i in range(repetitions):
        for variant, (arguments, load_beside, _) in variants.items():
            say(f"real time, {variant}, repetition {i + 1} of {repetitions}")
            name = f"rt{i}{variant.replace(' ', '')}"
            with load_beside():
                runs[variant].append(experiment(folder, name, "--mode", "real_time", *length, *arguments))
    rows: list[Row] = []
    for variant, (_, _, (aim, error_aim)) in variants.items():
        timings = [run["timing"]["ftcm"]["nodes"] for run in runs[variant]]
        plants = [nodes["plant"] for nodes in timings]
        if refused := plants[0].get("not_permitted"):
            rows.append((f"real time {seconds:g} s, {variant}", f"not measured: {refused}", aim))
            continue
        ticks = int(plants[0]["ticks"])
        missed = [100.0 * int(plant["missed_deadlines"]) / ticks for plant in plants]
        busy, waited = (
            {n: statistics.median(1e6 * float(nodes[n][k]) / ticks for nodes in timings) for n in NODES}
            for k in ("cpu_seconds", "waited_seconds")
        )
        cores = [sum(float(nodes[n]["cpu_seconds"]) for n in NODES) / seconds for nodes in timings]
        errors = [error_ratio(run, lockstep) for run in runs[variant]]
        causes = (", ".join(f"{c} {plant[c]}" for c in CAUSES) for plant in plants)
        rows += [
            (f"real time {seconds:g} s, {variant}: deadlines missed, %", spread(missed, 2), aim),
            (f"real time, {variant}: causes in each run", " / ".join(causes), ""),
            (f"real time, {variant}: processors, all nodes", spread(cores, 2), "≤ 1" if aim else ""),
            (f"real time, {variant}: tracking error, times that of lockstep", spread(errors, 2), error_aim),
            (f"real time, {variant}: µs per tick on a processor + ready but waiting for one",
             ", ".join(f"{n} {busy[n]:.0f} + {waited[n]:.0f}" for n in NODES), ""),
        ]  # fmt: skip
    return rows


def analysis_rows(folder: Path, repetitions: int) -> list[Row]:
    """``analyse`` on the bag of the paper's run, as its user calls it."""
    bag = experiment(folder, "paper")["bag"]
    read, tables, figures = [], [], []

    def analyse(*arguments: str) -> float:
        begin = time.monotonic()
        command = [sys.executable, "-m", "ftcm_ros.analysis.analyse", str(bag), *arguments]
        subprocess.run(command, check=True, capture_output=True)
        return time.monotonic() - begin

    for i in range(repetitions):
        say(f"analysis, repetition {i + 1} of {repetitions}")
        begin = time.monotonic()
        contents = read_bag(bag)
        read.append(time.monotonic() - begin)
        tables.append(analyse())
        figures.append(analyse("--output", str(folder / f"analysed{i}")))
    what = f"bag of {contents.trace.time_ns[-1] / 1e9:g} s, {len(contents.stamps)} topics"
    return [
        (f"reading a {what}, s", spread(read, 2), ""),
        (
            "analyse: reading it, metrics and tables, the start of Python included, s",
            spread(tables, 2),
            "≤ 3",
        ),
        ("analyse --output: the same with all figures drawn, s", spread(figures, 2), ""),
    ]


def main(argv: list[str] | None = None) -> int:
    """Measure and print."""
    parser = argparse.ArgumentParser(prog="tools/bench_graph.py", description=__doc__)
    parser.add_argument("--repetitions", type=int, default=3)
    parser.add_argument("--seconds", type=float, default=20.0, help="length of the real-time runs, s")
    parser.add_argument("--core", action="store_true", help="measure the library without ROS, too")
    parser.add_argument("--output", type=Path, help="also write the results to this file, as a page")
    options = parser.parse_args(argv)
    domain = Domain()
    os.environ["ROS_DOMAIN_ID"] = str(domain.number)
    set_defaults()
    before = os.getloadavg()[0]
    try:
        rows = measure(options.repetitions, options.seconds)
    except FtcmError as error:
        print(f"benchmark: error: {error}", file=sys.stderr)
        return 1
    finally:
        domain.release()
    machine = f"{os.cpu_count()} processors, {platform.platform()}, Python {platform.python_version()}"
    lines = [
        f"Machine: {machine}. Load before the run: {before:.1f}. Median (smallest–largest) of "
        f"{options.repetitions} repetitions, the variants in turn.",
        "",
        "| what | measured | aim |",
        "|---|---|---|",
        *(f"| {what} | {value} | {aim} |" for what, value, aim in rows),
    ]
    arguments = f"--repetitions {options.repetitions} --seconds {options.seconds:g}"
    page = [
        "# Measured",
        "",
        f"Written by `make bench ARGS='{arguments}'`. What the rows mean: [real time](real_time.md).",
        "",
    ]

    def tell(more: list[str]) -> None:
        """Print lines and, if wanted, add them to the page."""
        print("\n".join(more), flush=True)
        page.extend(more)
        if options.output:
            options.output.write_text("\n".join(page) + "\n", encoding="utf-8")

    tell(lines)
    if options.core:
        print("  the library ...", file=sys.stderr, flush=True)
        tell(["", "The library without ROS:", "", "```", core.text(core.measure()), "```"])
    return 0


if __name__ == "__main__":
    sys.exit(main())
