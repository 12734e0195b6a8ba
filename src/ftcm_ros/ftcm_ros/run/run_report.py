# SPDX-License-Identifier: Apache-2.0
"""The report of an experiment: reads the bags of its runs back, writes tables, figures and a summary."""

from __future__ import annotations

import argparse
from pathlib import Path

from ftcm_core.errors import FtcmError
from ftcm_core.recording.table_file import table_formats
from ftcm_core.report.figures import figure_formats
from ftcm_core.report.results import write_results
from ftcm_ros.analysis.background import background
from ftcm_ros.analysis.replay import Proof, prove, summarised
from ftcm_ros.analysis.timing import hop_times, percentiles, timing_table, write_figure
from ftcm_ros.bags.reader import BagContents, read_bag
from ftcm_ros.run.campaign_runs import GraphCampaign
from ftcm_ros.run.graph_run import Run
from ftcm_ros.run.progress import say


def read_bags(runs: list[Run]) -> tuple[list[tuple[str, BagContents]], list[str]]:
    """Read back what was recorded, and say what is not whole.

    Returns:
        Label and contents of each bag, and why others cannot be read.
    """
    found, unreadable = [], []
    for run in runs:
        if not run.bag.exists():
            continue
        try:
            bag = read_bag(run.bag)
        except FtcmError as error:
            unreadable.append(f"{run.label}: {error}")
            continue
        found.append((run.label, bag))
        for line in bag.warnings():
            say(f"warning: {run.label}: {line}")
        for line in bag.remarks():
            say(f"{run.label}: {line}")
        if bag.damage:
            unreadable.append(f"{run.label}: {bag.damage}")
        if bag.trace.status != "completed":
            say(f"{run.label}: {bag.trace.status}: {bag.trace.detail}")
    return found, unreadable


def replayed(contents: list[tuple[str, BagContents]]) -> tuple[list[tuple[str, Proof]], list[str]]:
    """Run what was recorded again.

    Returns:
        Label and proof of each bag, and why others are none.
    """
    proofs, unproved = [], []
    for label, bag in contents:
        try:
            proof = prove(bag)
        except FtcmError as error:
            unproved.append(f"{label}: replay: {error}")
            continue
        proofs.append((label, proof))
        if not proof.found.equal:
            unproved.append(f"{label}: replay: {'; '.join(proof.lines)}")
    return proofs, unproved


def report(
    folder: Path, runs: list[Run], options: argparse.Namespace, drawn: GraphCampaign | None = None
) -> list[str]:
    """Read the bags back and write table, figures and summary, and of a campaign its rows.

    Returns:
        Why bags cannot be read, or are not what they should be.

    Raises:
        FtcmError: the results cannot be written.
    """
    say("reading the bags back ...")
    contents, unreadable = read_bags(runs)
    if not contents:
        return unreadable
    samples = [(label, hop_times(b)) for label, b in contents]
    extra = {
        "mode": options.mode,
        "stages": options.stages,
        "timing_us": {label: percentiles(found) for label, found in samples},
        "timing": {run.label: run.timing for run in runs},
        "missing_ticks": {label: bag.missing for label, bag in contents},
        "bags": {label: str(bag.path.relative_to(folder)) for label, bag in contents},
    }
    traces = [(label, bag.trace) for label, bag in contents]
    if drawn:
        drawn.write_rows(folder, traces, f"graph, {options.mode}")
    proofs, unproved = replayed(contents) if options.replay else ([], [])
    if proofs:
        extra["replay"] = {label: proof.to_mapping() for label, proof in proofs}
    more = "\n".join(text for text in (timing_table(contents), summarised(proofs)) if text)
    formats = figure_formats(options.figure_format)
    verdicts = {run.label: run.timing["verdict"] for run in runs if "verdict" in run.timing}
    told = background(
        ("ros2", "run", "ftcm_ros", "experiment", *options.words), contents, samples, proofs, verdicts
    )
    write_results(
        folder,
        traces,
        extra,
        more,
        figures=not options.no_figures,
        formats=formats,
        tables=table_formats(options.export),
        background=told,
    )
    if not options.no_figures:
        write_figure(samples, folder / "figures", formats)
    print((folder / "table.md").read_text(encoding="utf-8").rstrip())
    for label, verdict in verdicts.items():
        say(f"{label}: {verdict}")
    figures = "" if options.no_figures else "figures/, "
    say(f"results: {folder}/summary.json, table.md, {figures}bags/")
    say(f"report: {folder}/report.html")
    return unreadable + unproved
