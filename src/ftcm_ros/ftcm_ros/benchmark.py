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
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import rclpy
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions

from ftcm_core.errors import FtcmError
from ftcm_ros.bag import read_bag
from ftcm_ros.codec import JointStateCodec
from ftcm_ros.dataplane import DataPlane
from ftcm_ros.domain import Domain
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
    plane = DataPlane(Node(f"bare_{name}"), "waitset")
    source, target = CHAIN[name]
    publish = plane.publisher(target)
    plane.subscribe(source, lambda data, _: publish(data))
    plane.open()
    plane.start()
    end = time.monotonic() + STAGE_SECONDS
    while time.monotonic() < end:
        plane.poll(10**8)


def bare_chain(ticks: int) -> tuple[float, float]:
    """Rate (ticks/s) and median latency (µs) of four bare processes passing one message round."""
    context = multiprocessing.get_context("spawn")
    hops = [context.Process(target=relay, args=(name,), daemon=True) for name in CHAIN]
    for hop in hops:
        hop.start()
    rclpy.init(signal_handler_options=SignalHandlerOptions.NO)
    node = Node("bare_plant")
    try:
        plane = DataPlane(node, "waitset")
        publish = plane.publisher(JOINT_STATES)
        arrived: list[int] = []
        plane.subscribe(DISTURBANCE, lambda data, _: arrived.append(time.monotonic_ns()))
        plane.open()
        plane.start()
        data = JointStateCodec(("joint1", "joint2", "joint3")).state.encode(0, *((0.0,) * 3,) * 3)
        end = time.monotonic() + 20.0
        while not arrived:  # until the chain is matched all round
            if time.monotonic() > end:
                raise FtcmError("the bare chain did not come up within 20 s")
            publish(data)
            plane.poll(10**8)
        plane.collect(0.5)
        latencies = []
        begin = time.monotonic()
        for _ in range(ticks):
            arrived.clear()
            sent = time.monotonic_ns()
            publish(data)
            while not arrived:
                plane.poll(10**9)
            latencies.append(arrived[0] - sent)
        rate = ticks / (time.monotonic() - begin)
        plane.stop()
        return rate, statistics.median(latencies) / 1000.0
    finally:
        node.destroy_node()
        rclpy.shutdown()
        for hop in hops:
            hop.terminate()
            hop.join()


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


def measure(repetitions: int, seconds: float) -> list[tuple[str, str]]:
    """Measure all rows; return what and how much."""
    rows: list[tuple[str, str]] = []

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
            run = experiment(folder, f"waitset{i}", "--set", "duration=10")
            fast.append(run["timing"]["ftcm"]["ticks_per_second"])
            start.append(run["timing"]["ftcm"]["start_seconds"])
            latency.append(run["timing_us"]["ftcm"]["chain"]["p50"])
            slow = experiment(folder, f"executor{i}", "--set", "duration=2", "--data-path", "executor")
            plain.append(slow["timing"]["ftcm"]["ticks_per_second"])
            rate, median = bare_chain(5000)
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
        variants: dict[str, tuple[tuple[str, ...], Any]] = {
            "ordinary scheduling": ((), contextlib.nullcontext),
            "SCHED_FIFO": (("--priority", "50", "--lock-memory"), contextlib.nullcontext),
            "one core kept busy": ((), busy_core),
        }
        shares: dict[str, list[float]] = {v: [] for v in variants}
        details: dict[str, list[str]] = {v: [] for v in variants}
        for i in range(repetitions):
            for variant, (arguments, load) in variants.items():
                say(f"real time, {variant}, repetition {i + 1} of {repetitions}")
                with load():
                    run = experiment(
                        folder, f"rt{len(shares[variant])}{variant.replace(' ', '')}",
                        "--mode", "real_time", "--set", f"duration={seconds:g}", *arguments,
                    )  # fmt: skip
                nodes = run["timing"]["ftcm"]["nodes"]
                plant = nodes["plant"]
                shares[variant].append(100.0 * int(plant["missed_deadlines"]) / int(plant["ticks"]))
                cpu = sum(float(n["cpu_seconds"]) for n in nodes.values()) / seconds
                causes = ", ".join(
                    f"{c} {plant[c]}" for c in ("late_torque", "late_disturbance", "plant_overrun")
                )
                details[variant].append(f"{causes}; {cpu:.2f} cores")
        for variant in variants:
            rows.append(
                (f"real time {seconds:g} s, {variant}: deadlines missed, %", spread(shares[variant], 2))
            )
            rows.append(
                (f"real time, {variant}: causes and processors of each run", " / ".join(details[variant]))
            )
    return rows


def main(argv: list[str] | None = None) -> int:
    """Measure and print."""
    parser = argparse.ArgumentParser(prog="ftcm_ros.benchmark", description=__doc__)
    parser.add_argument("--repetitions", type=int, default=3)
    parser.add_argument("--seconds", type=float, default=20.0, help="length of the real-time runs, s")
    parser.add_argument("--output", type=Path, help="also write the table to this file")
    options = parser.parse_args(argv)
    domain = Domain()
    os.environ.update(ROS_DOMAIN_ID=str(domain.number), ROS_AUTOMATIC_DISCOVERY_RANGE="LOCALHOST")
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
    text = "\n".join(lines) + "\n"
    print(text, end="")
    if options.output:
        options.output.write_text(text, encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main())
