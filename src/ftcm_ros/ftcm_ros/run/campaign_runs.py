# SPDX-License-Identifier: Apache-2.0
"""Draws of a campaign over the graph: which runs, and their results as the campaign has them."""

from __future__ import annotations

import dataclasses
import re
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

from ftcm_core import campaign
from ftcm_core.errors import FtcmError
from ftcm_core.recording.trace import Trace
from ftcm_core.report.results import to_json
from ftcm_core.scenario import read_mapping

ROWS = "runs.jsonl"


class GraphCampaign(NamedTuple):
    """The first draws of a campaign, one run over the graph per contender and draw."""

    planned: campaign.Campaign
    runs: dict[str, campaign.Run]
    """By label, which is a file's name too."""

    def write_rows(self, folder: Path, traces: Sequence[tuple[str, Trace]], engine: str) -> None:
        """Write ``runs.jsonl``: of the runs that have a trace, in the order of the campaign."""
        results = [
            campaign.result_of(self.planned, self.runs[label], trace, engine) for label, trace in traces
        ]
        lines = [to_json(result) + "\n" for result in results]
        (folder / ROWS).write_text("".join(lines), encoding="utf-8")


def first_draws(source: str, overrides: Sequence[str], draws: int | None) -> GraphCampaign | None:
    """Return the first draws of a campaign file; None for a scenario.

    Args:
        source: what the user named.
        overrides: as of ``--set``.
        draws: how many; 1 by default.

    Raises:
        FtcmError: the file is not one, has fewer draws, or is a scenario and draws are asked for.
    """
    if not campaign.is_campaign(read_mapping(source)[0]):
        if draws is not None:
            raise FtcmError(f"--draws {draws}: {source!r} is a scenario; expected a campaign file")
        return None
    planned = campaign.from_file(source)
    planned = dataclasses.replace(planned, overrides=(*planned.overrides, *overrides))
    count = 1 if draws is None else draws
    if not 1 <= count <= planned.runs:
        raise FtcmError(f"--draws {count}: expected 1 to {planned.runs}, what the campaign has")
    found: dict[str, campaign.Run] = {}
    for run in planned.run_list():
        if run.number < count:
            label = re.sub(r"[^A-Za-z0-9._+-]+", "-", f"{run.contender}-{run.number}")
            if label in found:
                raise FtcmError(f"contenders {run.contender!r} and {found[label].contender!r}: both {label}")
            found[label] = run
    return GraphCampaign(planned, found)
