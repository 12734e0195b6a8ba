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
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

import rclpy
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions

import bench_core as core
from ftcm_core.errors import FtcmError
from ftcm_core.extras import has
from ftcm_core.scenario import load
from ftcm_core.simulation import simulate
from ftcm_ros.analysis.timing import by_process
from ftcm_ros.bags.reader import read_bag
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


def bare_loop(ticks: int) -> float:
    """Share of ticks at 1 kHz that a loop misses which sleeps as the plant does, and does nothing, %."""
    scheduling.apply(0, False, "")
    turn = threading.Condition()
    pacer = RealTime(10**6)

    def sleep(ns: int) -> None:
        turn.wait(ns / 1e9)

    with turn:
        pacer.begin()
        for _ in range(ticks):
            pacer.wait(lambda: True, sleep)
    return 100.0 * pacer.misses.total / ticks


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


def measure(repetitions: int, seconds: float, processes: float) -> list[Row]:
    """Measure all rows of the graph.

    Args:
        repetitions: of each.
        seconds: length of the real-time runs of composed nodes, s.
        processes: of those of nodes in a process each, s.
    """
    lost = [holes(3.0) for _ in range(repetitions)]
    rows = [
        ("the machine alone: holes over 0.1 ms in a busy loop, per s", spread([n for n, _ in lost]), ""),
        ("the largest of them, ms", spread([largest for _, largest in lost], 1), ""),
    ]
    with tempfile.TemporaryDirectory() as scratch:
        folder = Path(scratch)
        rows += lockstep_rows(folder, repetitions)
        rows += real_time_rows(folder, repetitions, seconds, processes)
        rows += analysis_rows(folder, repetitions)
    return rows


def lockstep_rows(folder: Path, repetitions: int) -> list[Row]:
    """The graph in lockstep against the executor and the bare chain, the three in turn."""
    fast: list[float] = []
    composed: list[float] = []
    composed_start: list[float] = []
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
        together = experiment(folder, f"composed{i}", "--composed", "--set", "duration=10")
        composed.append(together["timing"]["ftcm"]["ticks_per_second"])
        composed_start.append(together["timing"]["ftcm"]["start_seconds"])
        if together["missing_ticks"]["ftcm"]:
            raise FtcmError(f"composed: ticks missing in the bag: {together['missing_ticks']['ftcm']}")
        slow = experiment(folder, f"executor{i}", "--set", "duration=2", "--data-path", "executor")
        plain.append(slow["timing"]["ftcm"]["ticks_per_second"])
        rate, median = bare_lockstep(5000)
        floor.append(rate)
        floor_latency.append(median)
    begin = time.monotonic()
    trace = simulate(load("paper", ["duration=5"]), written=False)  # as the nodes do it
    work = 1e6 * (time.monotonic() - begin) / trace.ticks
    allowed = 1.5 * statistics.median(floor_latency) + work
    return [
        ("lockstep, composed, with recorder, complete bags, ticks/s", spread(composed), "≥ 5,000"),
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
        ("the same, composed, s", spread(composed_start, 2), "≤ 1.5"),
    ]  # fmt: skip


FIFO = ("--priority", "50", "--lock-memory")
MISSED, LATENCY, CORES, ERROR = "missed", "latency", "cores", "error"
VARIANTS: dict[str, tuple[tuple[str, ...], bool, dict[str, str]]] = {
    "composed": (
        ("--composed",),
        False,
        {MISSED: "≤ 0.1, and ≤ 2 × the bare loop", LATENCY: "p50 ≤ 120, p99 ≤ 300", CORES: "≤ 0.35"},
    ),
    "composed, compiled stages": (("--composed", "--stages", "compiled"), False, {CORES: "≤ 0.35"}),
    "composed, SCHED_FIFO": (("--composed", *FIFO), False, {MISSED: "≤ 0.01"}),
    "composed, one core kept busy": (("--composed",), True, {MISSED: "≤ 1"}),
    "composed, SCHED_FIFO, one core kept busy": (("--composed", *FIFO), True, {MISSED: "≤ 0.05"}),
    "processes": (("--no-composed",), False, {MISSED: "≤ 3 × the bare chain"}),
    "processes, SCHED_FIFO": (("--no-composed", *FIFO), False, {MISSED: "less than without"}),
    "processes, one core kept busy": (("--no-composed",), True, {ERROR: "≤ 2"}),
    "processes, SCHED_FIFO, one core kept busy": (("--no-composed", *FIFO), True, {}),
}
"""Ways to run in real time: arguments of the experiment, whether a core is kept busy beside it, aims."""
RATES = {"2 kHz": "dt=0.0005", "4 kHz": "dt=0.00025"}


def real_time_rows(folder: Path, repetitions: int, seconds: float, processes: float) -> list[Row]:
    """The graph at 1 kHz, composed and as processes, beside a bare loop and a bare chain, all in turn."""
    variants = {k: v for k, v in VARIANTS.items() if "compiled" not in v[0] or has("numba")}
    lengths = {variant: processes if "processes" in variant else seconds for variant in variants}
    lockstep = {
        s: experiment(folder, f"lockstep{s:g}", "--set", f"duration={s:g}") for s in {seconds, processes}
    }
    runs: dict[str, list[dict[str, Any]]] = {variant: [] for variant in variants}
    loop: list[float] = []
    chain: list[float] = []
    for i in range(repetitions):
        say(f"real time, bare loop and bare chain, repetition {i + 1} of {repetitions}")
        loop.append(bare_loop(round(1000 * seconds)))
        chain.append(bare_real_time(round(1000 * min(seconds, 10.0))))
        for variant, (arguments, beside, _) in variants.items():
            say(f"real time, {variant}, repetition {i + 1} of {repetitions}")
            name = f"rt{i}{variant.replace(' ', '')}"
            with busy_core() if beside else contextlib.nullcontext():
                length = ("--set", f"duration={lengths[variant]:g}")
                runs[variant].append(experiment(folder, name, "--mode", "real_time", *length, *arguments))
    rows: list[Row] = [
        ("bare loop at 1 kHz, the same sleep and no work: missed, %", spread(loop, 3), ""),
        ("bare chain of four processes at 1 kHz, no work, no recorder: missed, %", spread(chain, 2), ""),
    ]
    for variant, (_, _, aims) in variants.items():
        length_s = lengths[variant]
        rows += variant_rows(variant, runs[variant], lockstep[length_s], length_s, aims)
    for rate, setting in RATES.items():
        say(f"real time, composed at {rate}")
        settings = ("--set", f"duration={seconds:g}", "--set", setting)
        fast = experiment(folder, f"rt{rate}", "--mode", "real_time", "--composed", *settings)
        plant = fast["timing"]["ftcm"]["nodes"]["plant"]
        share = 100.0 * int(plant["missed_deadlines"]) / int(plant["ticks"])
        rows.append((f"real time, composed at {rate}: missed, %", f"{share:.2f}", ""))
    return rows


def variant_rows(
    variant: str, runs: list[dict[str, Any]], lockstep: dict[str, Any], seconds: float, aims: dict[str, str]
) -> list[Row]:
    """What was measured of one way to run in real time."""
    what = f"real time, {variant}"
    timings = [run["timing"]["ftcm"]["nodes"] for run in runs]
    plants = [nodes["plant"] for nodes in timings]
    if refused := plants[0].get("not_permitted"):
        return [(f"{what}: missed, %", f"not measured: {refused}", aims.get(MISSED, ""))]
    ticks = int(plants[0]["ticks"])
    missed = [100.0 * int(plant["missed_deadlines"]) / ticks for plant in plants]
    latencies = (spread([float(plant[f"latency_{p}_us"]) for plant in plants]) for p in ("p50", "p99"))
    cores = [sum(by_process(nodes, "cpu_seconds").values()) / seconds for nodes in timings]
    errors = [error_ratio(run, lockstep) for run in runs]
    causes = (", ".join(f"{c} {plant[c]}" for c in CAUSES if plant[c] != "0") or "none" for plant in plants)
    busy, waited = (by_process(timings[0], key) for key in ("cpu_seconds", "waited_seconds"))
    per_tick = [f"{n} {1e6 * busy[n] / ticks:.0f} + {1e6 * waited[n] / ticks:.0f}" for n in busy]
    return [
        (f"{what}: missed, %", spread(missed, 3), aims.get(MISSED, "")),
        (f"{what}: causes in each run", " / ".join(causes), ""),
        (f"{what}: latency p50, p99, µs", ", ".join(latencies), aims.get(LATENCY, "")),
        (f"{what}: processors, all nodes", spread(cores, 2), aims.get(CORES, "")),
        (f"{what}: tracking error, times that of lockstep", spread(errors, 2), aims.get(ERROR, "")),
        (f"{what}: µs per tick on a processor + ready but waiting for one", ", ".join(per_tick), ""),
    ]


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
    parser.add_argument(
        "--process-seconds", type=float, help="of those with a process per node, s; default: as --seconds"
    )
    parser.add_argument("--core", action="store_true", help="measure the library without ROS, too")
    parser.add_argument("--output", type=Path, help="also write the results to this file, as a page")
    options = parser.parse_args(argv)
    domain = Domain()
    os.environ["ROS_DOMAIN_ID"] = str(domain.number)
    set_defaults()
    before = os.getloadavg()[0]
    processes = options.process_seconds or options.seconds
    try:
        rows = measure(options.repetitions, options.seconds, processes)
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
    arguments += f" --process-seconds {processes:g}" if processes != options.seconds else ""
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
