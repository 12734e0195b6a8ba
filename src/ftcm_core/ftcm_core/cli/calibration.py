# SPDX-License-Identifier: Apache-2.0
"""The command ``calibrate``, and reading what it wrote."""

from __future__ import annotations

import argparse
import json
import os
from pathlib import Path
from typing import Any

from ftcm_core.campaign.calibration import calibrate
from ftcm_core.cli.output import note, progress
from ftcm_core.errors import FtcmError
from ftcm_core.registry import find
from ftcm_core.report.results import to_json
from ftcm_core.scenario import load, read_mapping
from ftcm_core.scenario.yaml_text import dump_yaml

HEAD = "# Thresholds by ftcm calibrate; use them with: ftcm simulate SCENARIO --detector-file THIS_FILE\n"


def calibrate_command(arguments: argparse.Namespace) -> int:
    """Find the thresholds of a detector for a stated rate of false alarms."""
    overrides = list(arguments.overrides)
    if arguments.detector is not None:
        find("detector", arguments.detector)
        overrides.insert(0, f"detector.type={arguments.detector}")
    scenario = load(arguments.scenario, overrides)
    if arguments.output is not None and os.path.lexists(arguments.output):
        raise FtcmError(f"output {arguments.output!r} exists already; choose a new file")
    with progress("run") as show:
        found = calibrate(
            scenario,
            arguments.false_alarms_per_hour,
            arguments.runs,
            seed=scenario.seed if arguments.seed is None else arguments.seed,
            engine=arguments.engine,
            jobs=arguments.jobs,
            progress=show,
            note=note,
        )
    text = HEAD + dump_yaml(found, unicode=False)
    if arguments.output is not None:
        Path(arguments.output).write_text(text, encoding="utf-8")
    print(to_json(found) if arguments.json else text, end="\n" if arguments.json else "", flush=True)
    return 0


def detector_overrides(file: str | None) -> list[str]:
    """Return the override that sets the detector of a file.

    Args:
        file: what ``calibrate`` wrote, or any YAML file with the key ``detector``; None: no override.

    Raises:
        FtcmError: it cannot be read or has no detector.
    """
    if file is None:
        return []
    data: dict[str, Any] = read_mapping(file)[0]
    if not isinstance(data.get("detector"), (dict, str)):
        raise FtcmError(f"{file}: no detector in it; expected a file that ftcm calibrate wrote")
    return [f"detector={json.dumps(data['detector'])}"]
