# SPDX-License-Identifier: Apache-2.0
"""Benchmark of the graph: lockstep against the ordinary executor and a bare chain, real time, start, reading.

``python -m ftcm_ros.benchmark`` measures all rows side by side, the variants of a row in turn, and
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

from ftcm_core import benchmark as core
from ftcm_core.errors import FtcmError
from ftcm_ros import scheduling
from ftcm_ros.bag import read_bag
from ftcm_ros.codec import JointStateCodec
from ftcm_ros.dataplane import DataPlane
from ftcm_ros.domain import Domain
from ftcm_ros.latency import CAUSES
from ftcm_ros.network import set_defaults
from ftcm_ros.pacing import RealTime
from ftcm_ros.settings import NODES
from ftcm_ros.topics import DISTURBANCE, ESTIMATE, JOINT_STATES, TORQUES

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
    command = [sys.executable, "-m", "ftcm_ros.experiment", "paper", "--controllers", "ftcm", "--no-figures"]
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
    plane = DataPlane(Node(f"bare_{name}"), "listener")
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
    plane = DataPlane(node, "listener")
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
    return max(a / b for a, b in pairs)


def measure(repetitions: int, seconds: float) -> list[tuple[str, str]]:
    """Measure all rows of the graph; return what and how much."""
    lost = [holes(3.0) for _ in range(repetitions)]
    bare = [bare_real_time(10_000) for _ in range(repetitions)]
    rows = [
        ("the machine alone: holes over 0.1 ms in a busy loop, per s", spread([n for n, _ in lost])),
        ("the largest of them, ms", spread([largest for _, largest in lost], 1)),
        ("bare chain of four processes at 1 kHz, no work, no recorder: missed, %", spread(bare, 2)),
    ]

    def say(text: str) -> None:
        print(f"  {text} ...", file=sys.stderr, flush=True)

    with tempfile.TemporaryDirectory() as scratch:
        folder = Path(scratch)
        fast: list[float] = []
        plain: list[float] = []
        floor: list[float] = []
        floor_latency: list[float] = []
        latency: list[float] = []
        start: list[float] = []
        read: list[float] = []
        for i in range(repetitions):
            say(f"lockstep, repetition {i + 1} of {repetitions}")
            run = experiment(folder, f"listener{i}", "--set", "duration=10")
            fast.append(run["timing"]["ftcm"]["ticks_per_second"])
            start.append(run["timing"]["ftcm"]["start_seconds"])
            latency.append(run["timing_us"]["ftcm"]["chain"]["p50"])
            slow = experiment(folder, f"executor{i}", "--set", "duration=2", "--data-path", "executor")
            plain.append(slow["timing"]["ftcm"]["ticks_per_second"])
            rate, median = bare_lockstep(5000)
            floor.append(rate)
            floor_latency.append(median)
            begin = time.monotonic()
            bag = read_bag(run["bag"])
            read.append((time.monotonic() - begin) * 40.0 / (bag.trace.ticks * bag.trace.dt))
        ratios = [a / b for a, b in zip(fast, plain)]
        rows += [
            ("lockstep, full graph, ticks/s", spread(fast)),
            ("the same on the ordinary executor, ticks/s", spread(plain)),
            ("ratio, pair by pair", spread(ratios, 2)),
            ("bare chain of four processes, ticks/s", spread(floor)),
            ("latency measurement to disturbance, full graph, µs, median", spread(latency)),
            ("the same in the bare chain, µs, median", spread(floor_latency)),
            ("start of the graph to its first tick, s", spread(start, 2)),
            ("reading a 40 s bag, s (scaled from 10 s)", spread(read, 2)),
        ]
        length = ("--set", f"duration={seconds:g}")
        lockstep = experiment(folder, "lockstep", *length)
        variants: dict[str, tuple[tuple[str, ...], Any]] = {
            "ordinary scheduling": ((), contextlib.nullcontext),
            "SCHED_FIFO": (("--priority", "50", "--lock-memory"), contextlib.nullcontext),
            "one core kept busy": ((), busy_core),
        }
        shares: dict[str, list[float]] = {v: [] for v in variants}
        errors: dict[str, list[float]] = {v: [] for v in variants}
        details: dict[str, list[str]] = {v: [] for v in variants}
        times: dict[str, dict[str, list[list[float]]]] = {v: {} for v in variants}
        for i in range(repetitions):
            for variant, (arguments, load) in variants.items():
                say(f"real time, {variant}, repetition {i + 1} of {repetitions}")
                with load():
                    run = experiment(
                        folder, f"rt{len(shares[variant])}{variant.replace(' ', '')}",
                        "--mode", "real_time", *length, *arguments,
                    )  # fmt: skip
                nodes = run["timing"]["ftcm"]["nodes"]
                plant = nodes["plant"]
                shares[variant].append(100.0 * int(plant["missed_deadlines"]) / int(plant["ticks"]))
                errors[variant].append(error_ratio(run, lockstep))
                per_tick = {
                    name: [1e6 * float(n[k]) / int(plant["ticks"]) for k in ("cpu_seconds", "waited_seconds")]
                    for name, n in nodes.items()
                }
                for name in NODES:
                    times[variant].setdefault(name, []).append(per_tick[name])
                cpu = sum(busy for busy, _ in per_tick.values()) / 1000.0
                causes = ", ".join(f"{c} {plant[c]}" for c in CAUSES)
                details[variant].append(f"{causes}; {cpu:.2f} cores")
        for variant in variants:
            rows.append(
                (f"real time {seconds:g} s, {variant}: deadlines missed, %", spread(shares[variant], 2))
            )
            rows.append(
                (f"real time, {variant}: tracking error, times that of lockstep", spread(errors[variant], 2))
            )
            rows.append(
                (f"real time, {variant}: causes and processors of each run", " / ".join(details[variant]))
            )
            medians = {
                name: [statistics.median(column) for column in zip(*found)]
                for name, found in times[variant].items()
            }
            rows.append(
                (
                    f"real time, {variant}: µs per tick on a processor + ready but waiting for one",
                    ", ".join(
                        f"{name} {busy:.0f} + {waited:.0f}" for name, (busy, waited) in medians.items()
                    ),
                )
            )
    return rows


def main(argv: list[str] | None = None) -> int:
    """Measure and print."""
    parser = argparse.ArgumentParser(prog="ftcm_ros.benchmark", description=__doc__)
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
        "| what | measured |",
        "|---|---|",
        *(f"| {what} | {value} |" for what, value in rows),
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
