# SPDX-License-Identifier: Apache-2.0
"""The command ``experiment``: runs a scenario over the ROS graph, one run per controller, and reports.

Of a campaign, it runs the first draws, one run per contender and draw.
A run starts the nodes, as processes of their own or composed in one, follows them and stops them. A run that
fails ends with its reason, and the next controller's begins. Then the bags are read back and reported.

Exit status: 0 done (a run that diverges is a result), 1 a run failed, 2 a mistake in what was asked,
130 interrupted.
"""

from __future__ import annotations

import argparse
import signal
import sys
import time
from pathlib import Path
from typing import Any

from ftcm_core.errors import FtcmError
from ftcm_core.recording.table_file import table_formats
from ftcm_core.registry import load_plugins
from ftcm_core.report.figures import FORMATS, figure_formats
from ftcm_core.scenario import load
from ftcm_ros.parameters.node_parameters import setting
from ftcm_ros.run.campaign_runs import first_draws
from ftcm_ros.run.external_nodes import AmbientDomain
from ftcm_ros.run.graph_run import Interrupted, Run, composed, use_domain
from ftcm_ros.run.progress import say
from ftcm_ros.run.run_report import report
from ftcm_ros.timing.pacing import check_speed
from ftcm_ros.transport.domain import Domain
from ftcm_ros.transport.joining import JoinError

PAPER_CONTROLLERS = ("smc", "nftsmc", "ftcm")
PATIENCE_SECONDS = 5.0
"""How long a node may be silent, or make no tick, before the run ends, s."""


def build_parser() -> argparse.ArgumentParser:
    """Return the command line of ``experiment``."""
    parser = argparse.ArgumentParser(
        prog="experiment",
        description="Run a scenario over the ROS graph, one run per controller, and report.",
    )
    parser.add_argument(
        "scenario",
        nargs="?",
        help="scenario file, or name of a shipped one; or a campaign file, of which the first draws are run",
    )
    parser.add_argument(
        "--draws", type=int, metavar="N", help="of a campaign: so many draws, each with every contender (1)"
    )
    parser.add_argument(
        "--controllers",
        nargs="+",
        metavar="NAME",
        help="default: the scenario's; for paper smc, nftsmc and ftcm",
    )
    parser.add_argument(
        "--mode", choices=("lockstep", "real_time"), default="lockstep", help="default: lockstep"
    )
    parser.add_argument(
        "--speed",
        type=float,
        default=1.0,
        metavar="FACTOR",
        help="real time: seconds of the run in a second, e.g. 0.5: half as fast (default: 1)",
    )
    parser.add_argument(
        "--composed",
        action=argparse.BooleanOptionalAction,
        help="all nodes but the recorder in one process, or each in its own; default: composed in real time, "
        "processes in lockstep",
    )
    parser.add_argument(
        "--stages",
        choices=setting("plant", "stages").choices,
        default="plain",
        help="what does the work of a tick: plain Python, or machine code made of it at the start (numba); "
        "default: plain",
    )
    parser.add_argument(
        "--set", nargs="+", action="extend", default=[], metavar="PATH=VALUE", help="e.g. observer.k1=10000"
    )
    parser.add_argument(
        "--plugin",
        action="append",
        default=[],
        metavar="FILE",
        help="load components from a Python file or module first; this runs its code, in every node too",
    )
    parser.add_argument("--name", help="name of the run; default: scenario and time")
    parser.add_argument("--runs", type=Path, default=Path("runs"), help="folder for runs (default: runs)")
    parser.add_argument(
        "--storage", choices=("mcap", "sqlite3"), default="mcap", help="bag storage (default: mcap)"
    )
    parser.add_argument("--domain-id", type=int, help="ROS domain; default: a free one")
    parser.add_argument(
        "--external-nodes",
        action="store_true",
        help="start no nodes: lay out their parameters in RUN/nodes/NODE.yaml and drive those that somebody "
        "else starts with them, in the environment's ROS domain and discovery range; one controller",
    )
    parser.add_argument(
        "--data-path",
        choices=setting("plant", "data_path").choices,
        default="listener",
        help="default: listener",
    )
    parser.add_argument(
        "--patience",
        type=float,
        default=PATIENCE_SECONDS,
        metavar="SECONDS",
        help="how long a node may be silent, or make no tick, before the run ends; 2 or more (default: 5)",
    )
    parser.add_argument("--priority", type=int, default=0, help="SCHED_FIFO priority of the nodes")
    parser.add_argument("--lock-memory", action="store_true", help="lock the nodes' memory")
    parser.add_argument("--processors", default="", help="processors for the nodes, e.g. 0,1; default: all")
    parser.add_argument("--no-figures", action="store_true", help="leave the figures out")
    parser.add_argument(
        "--figure-format",
        default="png",
        metavar="FORMATS",
        help=f"of the figures: any of {', '.join(FORMATS)}, separated by commas; default: png",
    )
    parser.add_argument(
        "--export",
        metavar="FORMATS",
        help="write the signals of each run too: csv, parquet or both, separated by a comma",
    )
    parser.add_argument(
        "--replay",
        action="store_true",
        help="run what was recorded again, in process, and compare; a run that differs has failed",
    )
    return parser


def run_experiment(options: argparse.Namespace) -> int:
    """Run everything the options say; return the exit status.

    Raises:
        FtcmError: anything that ends the whole experiment.
    """
    if not options.patience >= 2.0:  # nodes speak once a second
        raise FtcmError(f"--patience {options.patience:g} is too short; expected 2 s or more")
    figure_formats(options.figure_format)
    table_formats(options.export)
    check_speed(options.speed, options.mode)
    load_plugins(options.plugin)
    drawn = first_draws(options.scenario, options.set, options.draws)
    if drawn:
        if options.controllers:
            raise FtcmError("--controllers: a campaign names its contenders; leave it out")
        labels = list(drawn.runs)
        scenarios = [drawn.planned.scenario(run) for run in drawn.runs.values()]
    else:
        names = options.controllers or (PAPER_CONTROLLERS if options.scenario == "paper" else [None])
        scenarios = [load(options.scenario, options.set, controller=n) for n in names]
        labels = [s.controller.type_name for s in scenarios]
    if len(set(labels)) < len(labels):
        raise FtcmError(f"controllers {labels}: each may be named once")
    if options.external_nodes and options.composed:
        raise FtcmError("--composed: with --external-nodes, whoever starts the nodes composes them")
    if options.external_nodes and len(labels) > 1:
        raise FtcmError(
            f"--external-nodes: {len(labels)} controllers ({', '.join(labels)}); expected one, "
            "choose it with --controllers"
        )
    title = Path(options.scenario).stem if drawn else scenarios[0].name
    name = options.name or f"{title}-{time.strftime('%Y%m%d-%H%M%S')}"
    if Path(name).name != name:
        what = f"--name {name!r}" if options.name else f"the scenario's name {name!r}"
        raise FtcmError(f"{what}: expected a plain name without folders; choose the place with --runs")
    folder: Path = options.runs / name
    try:
        folder.mkdir(parents=True)
    except FileExistsError:
        raise FtcmError(f"run {str(folder)!r} exists already; choose another --name or remove it") from None
    except (OSError, ValueError) as error:  # ValueError: a name that no file can have
        reason = getattr(error, "strerror", None) or error
        raise FtcmError(f"run {str(folder)!r} cannot be made: {reason}") from None
    domain = AmbientDomain(options.domain_id) if options.external_nodes else Domain(options.domain_id)
    network = use_domain(domain, folder)
    nodes = "composed nodes" if composed(options) else "a process per node"
    if options.external_nodes:
        nodes = "nodes started elsewhere"
    say(
        f"run {folder}: {', '.join(labels)} in {options.mode}, {nodes}, "
        f"ROS_DOMAIN_ID={domain.number} {network}"
    )
    failures, runs = [], []
    try:
        for label, scenario in zip(labels, scenarios):
            for line in scenario.warnings():
                say(f"warning: {line}")
            run = Run(scenario, label, folder, options, domain)
            runs.append(run)
            try:
                run.execute()
            except JoinError:
                raise
            except (FtcmError, OSError) as error:
                failures.append(f"{label}: {error}")
                say(f"{label}: failed")
            except Interrupted:
                failures.append(f"{label}: stopped by the user")
                break
            domain.clean()
    finally:
        domain.release()
    try:
        failures += report(folder, runs, options, drawn)
    except FtcmError as error:
        failures.append(str(error))
    for failure in failures:
        say(f"experiment: error: {failure}")
    if options.stop_requested:
        return 130
    return 1 if failures else 0


def main(argv: list[str] | None = None) -> None:
    """Entry point of ``ros2 run ftcm_ros experiment``."""
    options = build_parser().parse_args(argv)
    if options.scenario is None:  # `--set a=1 paper` means the scenario paper
        options.scenario = options.set.pop() if options.set and "=" not in options.set[-1] else "paper"
    options.words = sys.argv[1:] if argv is None else argv
    options.stop_requested = False

    def stop(signum: int, frame: Any) -> None:
        if options.stop_requested:
            raise KeyboardInterrupt
        options.stop_requested = True
        say("stopping; what was recorded is kept ...")

    signal.signal(signal.SIGINT, stop)
    signal.signal(signal.SIGTERM, stop)
    try:
        status = run_experiment(options)
    except FtcmError as error:
        say(f"experiment: error: {error}")
        status = 2
    except OSError as error:
        say(f"experiment: error: {error}")
        status = 1
    except KeyboardInterrupt:
        status = 130
    sys.exit(status)


if __name__ == "__main__":
    main()
