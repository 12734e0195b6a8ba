# SPDX-License-Identifier: Apache-2.0
"""Timing of a recorded run: tick jitter and the latency of each hop, from the times of publication."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from ftcm_core.errors import FtcmError
from ftcm_core.report.results import writing
from ftcm_core.report.table import markdown
from ftcm_ros.bags.reader import BagContents
from ftcm_ros.timing.pacing import CAUSES
from ftcm_ros.transport.topics import DETECTION, DISTURBANCE, ESTIMATE, JOINT_STATES, TORQUES

TITLES = {
    "jitter": "tick jitter, absolute",
    **{name: f"hop: {name}" for name in ("observer", "controller", "injector", "detector")},
    "chain": "whole chain",
}
"""What :func:`hop_times` gives, in the order in which it is drawn."""
PERCENTILES = {"p50": 50.0, "p99": 99.0, "p999": 99.9, "max": 100.0}


def hop_times(bag: BagContents) -> dict[str, npt.NDArray[np.float64]]:
    """Return samples in µs: ``jitter`` of the tick and the latency of each hop and of the chain.

    ``jitter``: interval between two measurements less dt (not in lockstep, which has no clock).
    ``observer``, ``controller``, ``injector``, ``detector``: from the message that the node waits for to its
    own.
    ``chain``: from measurement to disturbance. A topic that is not recorded gives no samples, nor does a hop
    between nodes of one process: there messages are published after the hand-over.
    """
    stamps, published = bag.stamps, bag.published
    found: dict[str, npt.NDArray[np.float64]] = {}
    first = stamps.get(JOINT_STATES.name)
    if first is not None and len(first) > 1 and bag.nodes.get("plant", {}).get("mode") != "lockstep":
        found["jitter"] = (np.diff(published[JOINT_STATES.name]) - np.diff(first)) / 1000.0
    scenario = bag.trace.scenario
    awaited = ESTIMATE if scenario is None or scenario.controller.needs_observer else JOINT_STATES
    hops = {
        "observer": (JOINT_STATES, ESTIMATE),
        "controller": (awaited, TORQUES),
        "injector": (TORQUES, DISTURBANCE),
        "detector": (TORQUES, DETECTION),
        "chain": (JOINT_STATES, DISTURBANCE),
    }
    process = {node: values.get("process", node) for node, values in bag.nodes.items()}
    for name, (before, after) in hops.items():
        writers = [topic.publishers[0] for topic in (before, after)]
        if len({process.get(node, node) for node in writers}) < 2:
            continue
        if before.name in stamps and after.name in stamps:
            _, i, j = np.intersect1d(stamps[before.name], stamps[after.name], return_indices=True)
            found[name] = (published[after.name][j] - published[before.name][i]) / 1000.0
    return {name: values for name, values in found.items() if len(values)}


def percentiles(samples: dict[str, npt.NDArray[np.float64]]) -> dict[str, dict[str, float]]:
    """Return p50, p99, p99.9 and the largest of each, µs; of jitter, its absolute value."""
    return {
        name: {
            label: round(float(np.percentile(np.abs(v) if name == "jitter" else v, share)), 1)
            for label, share in PERCENTILES.items()
        }
        for name, v in samples.items()
    }


def by_process(nodes: Mapping[str, Mapping[str, str]], key: str) -> dict[str, float]:
    """Return what the nodes' diagnostics say of their processes.

    Args:
        nodes: diagnostics of each node.
        key: ``cpu_seconds`` or ``waited_seconds``, s.

    Returns:
        The value of each process; its name is that of its node, ``composed`` for one with several.
    """
    processes: dict[str, dict[str, float]] = {}
    for name, values in nodes.items():
        processes.setdefault(values.get("process", name), {})[name] = float(values.get(key, 0.0))
    return {
        "composed" if len(found) > 1 else next(iter(found)): max(found.values())
        for found in processes.values()
    }


def timing_table(runs: list[tuple[str, BagContents]]) -> str:
    """Return what the plants of real-time runs have counted, in Markdown; nothing if there are none."""
    causes = [cause.replace("_", " ") for cause in CAUSES]
    rows = [["controller", "ticks", *causes, "jitter, µs", "latency, µs", "processors"]]
    for label, bag in runs:
        plant = bag.nodes.get("plant", {})
        if plant.get("mode") != "real_time":
            continue
        quantities = (
            " / ".join(plant.get(f"{quantity}_{p}_us", "–") for p in PERCENTILES)
            for quantity in ("jitter", "latency")
        )
        busy = sum(by_process(bag.nodes, "cpu_seconds").values())
        processors = f"{busy / float(plant['elapsed_seconds']):.2f}"
        rows.append([label, plant["ticks"], *(plant[c] for c in CAUSES), *quantities, processors])
    if len(rows) == 1:
        return ""
    return f"""Real time: missed deadlines by cause; jitter (how late ticks began) and latency (from the
measurement to torque and disturbance at the plant), p50 / p99 / p99.9 / max; processors that all
nodes kept busy:

{markdown(rows)}
"""


def exceedance(values: npt.NDArray[np.float64]) -> tuple[npt.NDArray[np.float64], npt.NDArray[np.float64]]:
    """Return values, µs, at least 1, and the share of samples that reach each.

    At most 800, the largest among them.
    """
    ordered = np.sort(np.abs(values))
    share = 1.0 - np.arange(len(ordered)) / len(ordered)
    keep = np.unique(np.geomspace(1, len(ordered), 400).astype(int)) - 1
    keep = np.unique(np.concatenate([keep, len(ordered) - 1 - keep]))
    return np.maximum(ordered[keep], 1.0), share[keep]


def panels(samples: Iterable[Mapping[str, npt.NDArray[np.float64]]]) -> dict[str, str]:
    """Return the title of each quantity that a run has, by its name."""
    having = {name for found in samples for name in found}
    return {name: title for name, title in TITLES.items() if name in having}


def page_curves(
    runs: Sequence[tuple[str, Mapping[str, npt.NDArray[np.float64]]]],
) -> tuple[dict[str, Any], ...]:
    """Return how often latency and jitter exceed a value, as ``report.html`` draws it."""
    found = []
    for name, title in panels(samples for _, samples in runs).items():
        curves = []
        for run, (_, samples) in enumerate(runs):
            if name in samples:
                values, share = exceedance(samples[name])
                curves.append({"run": run, "x": values.tolist(), "y": share.tolist()})
        title = f"{title}: share of ticks above, over µs"
        found.append({"title": title, "unit": "µs", "logX": True, "logY": True, "curves": curves})
    return tuple(found)


def write_figure(
    runs: list[tuple[str, dict[str, npt.NDArray[np.float64]]]],
    folder: Path,
    formats: Sequence[str] = ("png",),
) -> None:
    """Draw how often latency and jitter exceed a value, one line per run, one panel per quantity.

    Raises:
        FtcmError: matplotlib is not installed, or the file cannot be written.
    """
    try:
        from matplotlib.backends.backend_agg import FigureCanvasAgg
        from matplotlib.figure import Figure
    except ImportError:
        raise FtcmError('figures need matplotlib: pip install "ftcm_core[figures]"') from None
    titles = panels(samples for _, samples in runs)
    if not titles:
        return
    figure = Figure(figsize=(2.4 * len(titles) + 1.0, 3.6), layout="constrained")
    FigureCanvasAgg(figure)
    for axes, name in zip(np.atleast_1d(figure.subplots(1, len(titles), sharey=True)), titles):
        for (label, samples), style in zip(runs, ("-", "--", ":", "-.") * len(runs)):
            if name in samples:
                axes.plot(*exceedance(samples[name]), style, label=label)
        axes.set_xscale("log")
        axes.set_yscale("log")
        axes.set_title(titles[name], fontsize=10)
        axes.set_xlabel("µs")
        axes.tick_params(which="minor", labelbottom=False)
        axes.grid(alpha=0.3)
    first = figure.axes[0]
    first.set_ylabel("share of ticks above")
    first.legend(fontsize=8)
    with writing(folder):
        folder.mkdir(parents=True, exist_ok=True)
        for suffix in formats:
            figure.savefig(folder / f"timing.{suffix}", dpi=130)
