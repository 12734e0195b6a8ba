# SPDX-License-Identifier: Apache-2.0
"""The command ``suite``: many runs that belong together, and one table."""

from __future__ import annotations

import argparse

from ftcm_core.campaign import fault_suite
from ftcm_core.cli.calibration import detector_overrides
from ftcm_core.cli.machines import chosen_machines, machine_options
from ftcm_core.cli.output import note, progress
from ftcm_core.recording.provenance import provenance
from ftcm_core.registry import components, find
from ftcm_core.report.page.of_runs import write_page
from ftcm_core.report.page.of_suite import suite_page
from ftcm_core.report.results import new_folder, to_json, writing


def suite_command(arguments: argparse.Namespace) -> int:
    """Run the suite of faults."""
    controllers = tuple(arguments.controllers or fault_suite.Suite().controllers)
    if controllers == ("all",):
        controllers = tuple(components("controller"))
    for name in controllers:
        find("controller", name)
    suite = fault_suite.Suite(
        scenario=arguments.scenario,
        controllers=tuple(dict.fromkeys(controllers)),
        faults=tuple(dict.fromkeys(arguments.faults)),
        joints=tuple(dict.fromkeys(arguments.joints)),
        conditions=tuple(dict.fromkeys(arguments.conditions)),
        onset=arguments.onset,
        duration=arguments.duration,
        overrides=(*detector_overrides(arguments.detector_file), *arguments.overrides),
    )
    with chosen_machines(arguments) as jobs, progress("run") as show:
        folder = new_folder(arguments.output) if arguments.output is not None else None
        rows = fault_suite.run_suite(suite, jobs=jobs, progress=show)
    tables = (fault_suite.summary(rows), fault_suite.tables(rows))
    text = "\n".join(tables)
    origin = provenance()
    about = {"suite": vars(suite), "rows": rows, "provenance": origin}
    print(to_json(about) if arguments.json else text, flush=True)
    if folder:
        with writing(folder):
            (folder / "summary.json").write_text(to_json(about, indent=1) + "\n", encoding="utf-8")
            (folder / "table.md").write_text(text, encoding="utf-8")
            write_page(folder, suite_page(vars(suite), rows, tables, origin, arguments.command))
        note(f"report: {folder / 'report.html'}")
    return 0


def add_arguments(sub: argparse.ArgumentParser) -> None:
    """Declare the command's arguments."""
    default = fault_suite.Suite()
    sub.add_argument("suite", choices=("faults",), help="faults: every fault against every law")
    sub.add_argument(
        "scenario", nargs="?", default=default.scenario, metavar="SCENARIO",
        help="scenario file, or name of a shipped one (default: paper); its own faults are left out",
    )  # fmt: skip
    sub.add_argument(
        "--controllers", nargs="+", metavar="NAME",
        help=f"laws, or all (default: {' '.join(default.controllers)})",
    )  # fmt: skip
    sub.add_argument(
        "--faults", nargs="+", default=[], metavar="NAME", help="default: all that suit the robot"
    )
    sub.add_argument(
        "--joints", nargs="+", type=int, default=list(default.joints), metavar="N",
        help="joints that break, one in each run (default: 2)",
    )  # fmt: skip
    sub.add_argument(
        "--conditions", nargs="+", default=list(default.conditions), metavar="NAME",
        help=f"any of {', '.join(fault_suite.conditions())} (default: ideal)",
    )  # fmt: skip
    sub.add_argument("--onset", type=float, default=default.onset, metavar="S", help="default: 3")
    sub.add_argument("--duration", type=float, default=default.duration, metavar="S", help="default: 6")
    sub.add_argument(
        "--set", nargs="+", action="extend", default=[], metavar="PATH=VALUE", dest="overrides",
        help="change values in every run",
    )  # fmt: skip
    sub.add_argument("--detector-file", metavar="FILE", help="use the detector that calibrate wrote")
    machine_options(sub)
    sub.add_argument("--json", action="store_true", help="print one JSON object")
    sub.add_argument("--output", metavar="DIR", help="write rows, tables and report.html to a new folder")
