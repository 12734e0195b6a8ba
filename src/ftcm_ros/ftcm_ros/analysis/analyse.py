# SPDX-License-Identifier: Apache-2.0
"""Analyse bags: metrics, table and figures from any rosbag2 bag with the suite's topics."""

from __future__ import annotations

import argparse
import sys
from collections import Counter
from pathlib import Path

from ftcm_core.errors import FtcmError
from ftcm_core.recording.table_file import table_formats
from ftcm_core.registry import load_plugins
from ftcm_core.report.figures import FORMATS, figure_formats
from ftcm_core.report.results import labelled, new_folder, report, to_json, write_results
from ftcm_core.scenario import load
from ftcm_ros.analysis.background import background
from ftcm_ros.analysis.replay import prove, summarised
from ftcm_ros.analysis.timing import hop_times, percentiles, timing_table, write_figure
from ftcm_ros.bags.reader import BagContents, read_bag
from ftcm_ros.bags.recovery import repair


def build_parser() -> argparse.ArgumentParser:
    """Return the command line of ``analyse``."""
    parser = argparse.ArgumentParser(
        prog="analyse",
        description="Metrics, table and figures of rosbag2 bags with the suite's topics; compares several.",
    )
    parser.add_argument("bags", nargs="+", type=Path, metavar="BAG", help="folder of a bag")
    parser.add_argument(
        "--scenario", help="scenario of the runs, for bags that do not carry it: a file or a shipped name"
    )
    parser.add_argument(
        "--output",
        type=Path,
        metavar="DIR",
        help="write summary.json, table.md, report.html and figures/ there",
    )
    parser.add_argument(
        "--figure-format",
        default="png",
        metavar="FORMATS",
        help=f"of the figures: any of {', '.join(FORMATS)}, separated by commas; default: png",
    )
    parser.add_argument(
        "--repair", type=Path, metavar="NEW", help="write a bag that was not closed anew, closed, to NEW"
    )
    parser.add_argument(
        "--plugin",
        action="append",
        default=[],
        metavar="FILE",
        help="load components that the runs used from a Python file or module; this runs its code",
    )
    parser.add_argument(
        "--accept-damage",
        action="store_true",
        help="exit status 0 for a bag that is not what was recorded; what is damaged is left out in any case",
    )
    parser.add_argument(
        "--export",
        metavar="FORMATS",
        help="write the signals of each run too, to --output: csv, parquet or both, separated by a comma",
    )
    parser.add_argument(
        "--replay",
        action="store_true",
        help="run what was recorded again, in process, and compare; exit status 1 if a run differs",
    )
    parser.add_argument("--json", action="store_true", help="print the results as one JSON object")
    return parser


def labels(bags: list[BagContents]) -> list[str]:
    """Name each bag by its controller, or by its folder where that is not unique."""
    names = [b.trace.scenario.controller.type_name if b.trace.scenario else b.path.name for b in bags]
    count = Counter(names)
    names = [n if count[n] == 1 else b.path.name for n, b in zip(names, bags)]
    count = Counter(names)
    return [n if count[n] == 1 else str(b.path) for n, b in zip(names, bags)]


def analyse(options: argparse.Namespace) -> int:
    """Do what the options say; return the exit status.

    Raises:
        FtcmError: a bag or the target cannot be used.
    """
    load_plugins(options.plugin)
    scenario = load(options.scenario) if options.scenario else None
    formats = figure_formats(options.figure_format)
    tables = table_formats(options.export)
    if tables and not options.output:
        raise FtcmError("--export needs a folder; expected --output DIR too")
    folder = new_folder(options.output) if options.output else None
    bags = [read_bag(path, scenario) for path in options.bags]
    if options.repair:
        _repair(bags, options.repair)
    traces = list(zip(labels(bags), (b.trace for b in bags)))
    for label, bag in zip((n for n, _ in traces), bags):
        for line in bag.warnings():
            print(f"warning: {label}: {line}", file=sys.stderr)
        for line in bag.remarks():
            print(f"{label}: {line}", file=sys.stderr)
        if bag.trace.scenario is None:
            print(
                f"warning: {label}: the bag does not carry its scenario; no fault windows, no observer error "
                "(give it with --scenario)",
                file=sys.stderr,
            )
    results = [labelled(label, trace) for label, trace in traces]
    samples = [(label, hop_times(bag)) for (label, _), bag in zip(traces, bags)]
    extra = {
        "damage": {label: bag.damage for (label, _), bag in zip(traces, bags)},
        "files": {label: bag.files for (label, _), bag in zip(traces, bags)},
        "missing_ticks": {label: bag.missing for (label, _), bag in zip(traces, bags)},
        "timing_us": {label: percentiles(found) for label, found in samples},
        "nodes": {label: bag.nodes for (label, _), bag in zip(traces, bags)},
    }
    proofs = [(label, prove(bag)) for (label, _), bag in zip(traces, bags) if options.replay]
    if proofs:
        extra["replay"] = {label: proof.to_mapping() for label, proof in proofs}
    timing = timing_table([(label, bag) for (label, _), bag in zip(traces, bags)])
    more = "\n".join(text for text in (timing, summarised(proofs)) if text)
    if folder is not None:
        contents = [(label, bag) for (label, _), bag in zip(traces, bags)]
        told = background(("ros2", "run", "ftcm_ros", "analyse", *options.words), contents, samples, proofs)
        write_results(folder, traces, extra, more, formats=formats, tables=tables, background=told)
        write_figure(samples, folder / "figures", formats)
        print(f"results: {folder}/summary.json, table.md, figures/", file=sys.stderr)
        print(f"report: {folder}/report.html", file=sys.stderr)
    if options.json:
        print(to_json({"results": results, **extra}, indent=1))
    else:
        print(report(results, more).rstrip())
    damaged = any(bag.damage for bag in bags) and not options.accept_damage
    return int(damaged or not all(proof.found.equal for _, proof in proofs))


def _repair(bags: list[BagContents], target: Path) -> None:
    if len(bags) != 1:
        raise FtcmError(f"--repair takes one bag; {len(bags)} are given")
    (bag,) = bags
    if not bag.recovered:
        raise FtcmError(f"bag {str(bag.path)!r} is whole; there is nothing to repair")
    count = repair(bag.path, target, bag.recovered)
    print(f"repaired: {count} messages in {target}", file=sys.stderr)


def main(argv: list[str] | None = None) -> None:
    """Entry point of ``ros2 run ftcm_ros analyse``."""
    try:
        options = build_parser().parse_args(argv)
        options.words = sys.argv[1:] if argv is None else argv
        if sys.stdout is None:
            raise OSError("standard output is closed; results go there: redirect it, e.g. > FILE")
        status = analyse(options)
        sys.stdout.flush()
    except FtcmError as error:
        print(f"analyse: error: {error}", file=sys.stderr)
        status = 2
    except BrokenPipeError:
        sys.stderr.close()
        status = 0
    except OSError as error:
        print(f"analyse: error: {error}", file=sys.stderr)
        status = 1
    except KeyboardInterrupt:
        status = 130
    sys.exit(status)


if __name__ == "__main__":
    main()
