# SPDX-License-Identifier: Apache-2.0
"""The command ``ftcm``: simulate, compare, campaign, tune, suite, calibrate, replay, list and others.

Results go to stdout, warnings, progress and errors to stderr. Exit status: 0 done (a run that diverges is a
result), 1 the machine failed (disk, memory) or a replay differs, 2 a mistake in what was asked, 130
interrupted; ``doctor`` says 1 where no run is possible.
"""

from __future__ import annotations

import argparse
import io
import sys
from collections.abc import Sequence
from concurrent.futures.process import BrokenProcessPool
from typing import Any

import ftcm_core
from ftcm_core import campaign
from ftcm_core.cli.calibration import calibrate_command
from ftcm_core.cli.completion import complete
from ftcm_core.cli.detectable import detectable_command, detectable_options
from ftcm_core.cli.doctor import doctor_command
from ftcm_core.cli.listing import describe_command, list_command
from ftcm_core.cli.machines import machine_options
from ftcm_core.cli.output import drop_stdout, fail
from ftcm_core.cli.replaying import replay_command, replay_options
from ftcm_core.cli.runs import campaign_command, compare_command, reproduce_command, simulate_command
from ftcm_core.cli.suites import add_arguments, suite_command
from ftcm_core.cli.tuning import tune_command, tune_options
from ftcm_core.cli.watching import watch_command, watch_options
from ftcm_core.errors import FtcmError
from ftcm_core.registry import KINDS, load_plugins
from ftcm_core.report.figures import FORMATS


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command line.

    Args:
        argv: arguments; those of the process by default.

    Returns:
        The exit status.
    """
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):  # "Δ" must not crash on an ASCII terminal
            stream.reconfigure(errors="replace")
    try:
        parser = _parser()
        complete(parser)
        arguments = parser.parse_args(argv)
        arguments.command = ("ftcm", *(sys.argv[1:] if argv is None else argv))
        if sys.stdout is None:
            return fail("standard output is closed; results go there: redirect it, e.g. > FILE", 1)
        load_plugins(arguments.plugin)
        code: int = arguments.run(arguments)
        sys.stdout.flush()
        return code
    except FtcmError as error:
        return fail(str(error), 2)
    except KeyboardInterrupt:
        return 130
    except BrokenPipeError:
        drop_stdout()
        return 141
    except BrokenProcessPool:
        return fail("a simulation process was ended from outside; out of memory?", 1)
    except MemoryError:
        return fail("out of memory; shorten duration or raise dt", 1)
    except OSError as error:
        drop_stdout()
        return fail(": ".join(str(x) for x in (error.filename, error.strerror or error) if x), 1)


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="ftcm", description="Fault-tolerant control of a robot, simulated in process."
    )
    parser.add_argument("--version", action="version", version=f"ftcm {ftcm_core.__version__}")
    commands = parser.add_subparsers(title="commands", metavar="COMMAND", required=True)

    def command(name: str, function: Any, text: str, example: str) -> argparse.ArgumentParser:
        sub = commands.add_parser(name, help=text, description=text, epilog=f"example: {example}")
        sub.set_defaults(run=function)
        sub.add_argument(
            "--plugin", action="append", default=[], metavar="FILE",
            help="load components from a Python file or module first; this runs its code",
        )  # fmt: skip
        return sub

    def parameter_file(sub: argparse.ArgumentParser) -> None:
        sub.add_argument(
            "--params", metavar="FILE", help="use the controller and observer of a file, such as one by tune"
        )

    def shared(sub: argparse.ArgumentParser, *, overrides: bool = True) -> None:
        if overrides:
            sub.add_argument(
                "--set", nargs="+", action="extend", default=[], metavar="PATH=VALUE", dest="overrides",
                help="change values of the scenario, e.g. observer.k1=10000",
            )  # fmt: skip
            sub.add_argument("--detector-file", metavar="FILE", help="use the detector that calibrate wrote")
        sub.add_argument("--json", action="store_true", help="print one JSON object instead of tables")
        sub.add_argument(
            "--output", metavar="DIR", help="write results, tables, figures and report.html to a new folder"
        )
        sub.add_argument("--no-figures", action="store_true", help="leave the figures out of --output")
        sub.add_argument(
            "--figure-format", default="png", metavar="FORMATS",
            help=f"of the figures: any of {', '.join(FORMATS)}, separated by commas; default: png",
        )  # fmt: skip
        sub.add_argument(
            "--export", metavar="FORMATS",
            help="write the signals of each run too, to --output: csv, parquet or both, separated by a comma",
        )  # fmt: skip

    sub = command(
        "simulate",
        simulate_command,
        "run one scenario",
        "ftcm simulate paper --controller smc --set duration=20",
    )
    sub.add_argument(
        "scenario", nargs="?", metavar="SCENARIO", help="scenario file, or name of a shipped one"
    )
    sub.add_argument("--controller", metavar="NAME", help="use this controller")
    sub.add_argument("--observer", metavar="NAME", help="use this observer")
    sub.add_argument("--engine", choices=("plain", "compiled"), default="plain", help="compiled needs numba")
    parameter_file(sub)
    shared(sub)

    sub = command(
        "compare",
        compare_command,
        "run several controllers on one or more scenarios, in parallel",
        "ftcm compare paper --controllers smc ftcm",
    )
    sub.add_argument(
        "scenarios", nargs="*", metavar="SCENARIO", help="scenario files or names of shipped ones"
    )
    sub.add_argument("--controllers", nargs="+", metavar="NAME", help="controllers to compare; default: all")
    shared(sub)

    sub = command(
        "reproduce",
        reproduce_command,
        "repeat the paper's experiment: its Table 2 and its figures",
        "ftcm reproduce --output results/paper",
    )
    shared(sub, overrides=False)

    sub = command(
        "campaign",
        campaign_command,
        "run one scenario many times, values drawn at random, and give statistics",
        "ftcm campaign paper --runs 1000 --vary 'injection.faults.0.start=uniform(5, 15)'",
    )
    sub.add_argument(
        "source",
        nargs="?",
        metavar="SCENARIO",
        help="scenario or campaign file, or name of a shipped scenario",
    )
    sub.add_argument("--runs", type=int, metavar="N", help="number of draws; default: 100")
    sub.add_argument("--seed", type=int, metavar="N", help="seed of the draws; default: 0")
    sub.add_argument(
        "--vary", nargs="+", action="extend", default=[], metavar="PATH=DISTRIBUTION",
        help="draw a value: " + "; ".join(form for form, _ in campaign.DISTRIBUTIONS.values()),
    )  # fmt: skip
    sub.add_argument(
        "--set", nargs="+", action="extend", default=[], metavar="PATH=VALUE", dest="overrides",
        help="change values in every run",
    )  # fmt: skip
    sub.add_argument("--detector-file", metavar="FILE", help="use the detector that calibrate wrote")
    parameter_file(sub)
    sub.add_argument("--sampling", choices=campaign.SAMPLINGS, help="how draws are spread; default: random")
    for kind in ("controller", "observer", "detector"):
        sub.add_argument(f"--{kind}s", nargs="+", metavar="NAME", help="run every draw with each of these")
    machine_options(sub)
    sub.add_argument(
        "--engine", choices=campaign.ENGINES, default="auto",
        help="compiled needs numba; auto: compiled where that is installed",
    )  # fmt: skip
    sub.add_argument("--json", action="store_true", help="print the summary as one JSON object")
    sub.add_argument(
        "--output", metavar="DIR", help="write every run, the summary and report.html to a new folder"
    )
    sub.add_argument(
        "--resume",
        action="store_true",
        help="go on with the campaign in the folder of --output that was ended",
    )

    sub = command(
        "tune",
        tune_command,
        "find the parameters of a law by trials, and compare before and after on other runs",
        "ftcm tune config/tune/ftcm.yaml --output results/ftcm",
    )
    tune_options(sub)

    sub = command(
        "suite",
        suite_command,
        "run every fault of the library against several laws, in parallel, and compare",
        "ftcm suite faults --controllers smc nftsmc ftcm --joints 1 2 3 --conditions ideal encoder",
    )
    add_arguments(sub)

    sub = command(
        "replay",
        replay_command,
        "run recorded runs again and compare, float for float: 0 equal, 1 not",
        "ftcm replay runs/a/bags/ftcm",
    )
    replay_options(sub)

    sub = command(
        "calibrate",
        calibrate_command,
        "find the thresholds of a detector for a rate of false alarms, from runs without faults",
        "ftcm calibrate paper --detector cusum --false-alarms-per-hour 10 --output cusum.yaml",
    )
    sub.add_argument("scenario", metavar="SCENARIO", help="scenario file, or name of a shipped one")
    sub.add_argument("--detector", metavar="NAME", help="detector to calibrate; default: the scenario's")
    sub.add_argument(
        "--false-alarms-per-hour", type=float, required=True, metavar="X",
        help="of the whole robot, all joints together",
    )  # fmt: skip
    sub.add_argument("--runs", type=int, default=20, metavar="N", help="number of runs; default: 20")
    sub.add_argument(
        "--seed", type=int, metavar="N", help="runs have the seeds N + 1 on; default: scenario's"
    )
    sub.add_argument(
        "--set", nargs="+", action="extend", default=[], metavar="PATH=VALUE", dest="overrides",
        help="change values of the scenario, e.g. detector.residual=momentum",
    )  # fmt: skip
    sub.add_argument("--jobs", type=int, metavar="N", help="number of processes; default: one per core")
    sub.add_argument(
        "--engine", choices=campaign.ENGINES, default="auto",
        help="compiled needs numba; auto: compiled where that is installed",
    )  # fmt: skip
    sub.add_argument("--json", action="store_true", help="print one JSON object instead of YAML")
    sub.add_argument("--output", metavar="FILE", help="write the detector and where it comes from to a file")

    sub = command(
        "detectable",
        detectable_command,
        "find the size of a fault that a detector just detects",
        "ftcm detectable paper --size injection.faults.0.severity=0.01:1 --set detector=cusum duration=15",
    )
    detectable_options(sub)

    sub = command("list", list_command, "list scenarios and components", "ftcm list controller")
    sub.add_argument("kind", nargs="?", metavar="KIND", help=f"one of scenario, {', '.join(KINDS)}")
    sub.add_argument("--json", action="store_true", help="print one JSON object")

    sub = command(
        "describe", describe_command, "describe a component and its parameters", "ftcm describe ftcm"
    )
    sub.add_argument("name", metavar="NAME", help="name of a component, or KIND/NAME")
    sub.add_argument(
        "--picture", metavar="FILE", help="of a fault: draw what it does; FILE.svg, FILE.png or FILE.pdf"
    )
    sub.add_argument(
        "--set", nargs="+", action="extend", default=[], metavar="PARAMETER=VALUE", dest="overrides",
        help="of the picture: values other than the defaults, e.g. profile=ramp",
    )  # fmt: skip
    sub.add_argument("--json", action="store_true", help="print one JSON object")

    sub = command(
        "watch",
        watch_command,
        "show a run over the ROS graph that is on, and change nothing of it",
        "ftcm watch",
    )
    watch_options(sub)

    sub = command(
        "doctor",
        doctor_command,
        "say what this machine has and what is missing; exit status 1 if no run is possible",
        "ftcm doctor",
    )
    sub.add_argument("--json", action="store_true", help="print the findings as one JSON list")
    return parser
