# SPDX-License-Identifier: Apache-2.0
"""The command ``tune``."""

from __future__ import annotations

import argparse
import dataclasses
from pathlib import Path

from ftcm_core import campaign
from ftcm_core.cli.machines import chosen_machines, machine_options
from ftcm_core.cli.output import note, progress
from ftcm_core.cli.runs import results_folder
from ftcm_core.extras import need
from ftcm_core.report.results import to_json
from ftcm_core.tuning import run_tuning, table, tuning_from_file


def tune_command(arguments: argparse.Namespace) -> int:
    """Find the parameters of a law by trials."""
    need("optuna", "tune", "tuning")
    tuning = tuning_from_file(arguments.file)
    changes = {key: getattr(arguments, key) for key in ("trials", "seed")}
    tuning = dataclasses.replace(tuning, **{k: v for k, v in changes.items() if v is not None})
    campaign.chosen_engine(arguments.engine)
    with chosen_machines(arguments) as jobs, progress("trial") as show:
        folder = results_folder(arguments)
        assert folder is not None
        summary = run_tuning(
            tuning,
            folder,
            name=Path(arguments.file).name,
            engine=arguments.engine,
            jobs=jobs,
            resume=arguments.resume,
            progress=show,
            note=note,
        )
    print(to_json(summary) if arguments.json else table(summary), flush=True)
    return 0


def tune_options(sub: argparse.ArgumentParser) -> None:
    """Declare the command's arguments."""
    sub.add_argument("file", metavar="FILE", help="what is tuned; see docs/tuning.md")
    sub.add_argument("--output", required=True, metavar="DIR", help="write all results to a new folder")
    sub.add_argument(
        "--resume", action="store_true", help="go on with the ended tuning in the folder of --output"
    )
    sub.add_argument("--trials", type=int, metavar="N", help="number of trials; default: the file's")
    sub.add_argument("--seed", type=int, metavar="N", help="seed of the search; default: the file's")
    machine_options(sub)
    sub.add_argument(
        "--engine", choices=campaign.ENGINES, default="auto",
        help="compiled needs numba; auto: compiled where that is installed",
    )  # fmt: skip
    sub.add_argument("--json", action="store_true", help="print the summary as one JSON object")
