# SPDX-License-Identifier: Apache-2.0
"""The command ``detectable``."""

from __future__ import annotations

import argparse

from ftcm_core import campaign
from ftcm_core.campaign.detectable import just_detectable
from ftcm_core.cli.calibration import detector_overrides
from ftcm_core.cli.output import note
from ftcm_core.errors import FtcmError
from ftcm_core.report.results import to_json
from ftcm_core.report.table import markdown
from ftcm_core.scenario import load


def detectable_command(arguments: argparse.Namespace) -> int:
    """Find the size of a fault that is just detectable."""
    path, equals, span = arguments.size.partition("=")
    low, colon, high = span.partition(":")
    try:
        limits = float(low), float(high)
    except ValueError:
        equals = ""
    if not (equals and colon):
        raise FtcmError(
            f"--size {arguments.size!r}: expected PATH=SMALL:LARGE, e.g. injection.faults.0.severity=0.01:1"
        )
    overrides = [*detector_overrides(arguments.detector_file), *arguments.overrides]
    found = just_detectable(
        load(arguments.scenario, overrides),
        path.strip(),
        *limits,
        runs=arguments.runs,
        share=arguments.share,
        precision=arguments.precision,
        engine=arguments.engine,
        jobs=arguments.jobs,
        progress=lambda size, hits: note(f"{size:.4g}: detected in {hits} of {arguments.runs}"),
    )
    if arguments.json:
        print(to_json(found), flush=True)
        return 0
    rows = [["size", "detected", "delay (median), s"]]
    for one in found["tried"]:
        delay = "–" if one["delay_median"] is None else f"{one['delay_median']:.4g}"
        rows.append([f"{one['size']:.4g}", f"{one['detected']} of {found['runs']}", delay])
    print(f"Just detectable: {path} between {found['missed']:.4g} and {found['detected']:.4g}.\n")
    print(markdown(rows), flush=True)
    return 0


def detectable_options(sub: argparse.ArgumentParser) -> None:
    """Declare the command's arguments."""
    sub.add_argument(
        "scenario", metavar="SCENARIO", help="scenario file, or name of a shipped one; one fault"
    )
    sub.add_argument(
        "--size", required=True, metavar="PATH=SMALL:LARGE",
        help="the fault's parameter that says how large it is; a size that is missed, one that is detected",
    )  # fmt: skip
    sub.add_argument("--detector-file", metavar="FILE", help="use the detector that calibrate wrote")
    sub.add_argument(
        "--set", nargs="+", action="extend", default=[], metavar="PATH=VALUE", dest="overrides",
        help="change values of the scenario",
    )  # fmt: skip
    sub.add_argument(
        "--runs", type=int, default=1, metavar="N", help="runs of each size, a seed each; default: 1"
    )
    sub.add_argument(
        "--share",
        type=float,
        default=0.95,
        metavar="X",
        help="of the runs that must detect it; default: 0.95",
    )
    sub.add_argument("--precision", type=float, default=0.05, metavar="X", help="relative; default: 0.05")
    sub.add_argument("--jobs", type=int, metavar="N", help="number of processes; default: one per core")
    sub.add_argument(
        "--engine", choices=campaign.ENGINES, default="auto",
        help="compiled needs numba; auto: compiled where that is installed",
    )  # fmt: skip
    sub.add_argument("--json", action="store_true", help="print one JSON object")
