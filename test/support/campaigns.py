# SPDX-License-Identifier: Apache-2.0
"""Two laws over drawn gains of the observer: a campaign whose files are compared byte for byte."""

from __future__ import annotations

from pathlib import Path

from ftcm_core.campaign import Campaign, parse_variation

FILES = ("runs.jsonl", "summary.json", "table.md")
"""What a campaign writes that must be the same however it was run."""


def planned(runs: int, fault: float, seed: int = 0) -> Campaign:
    """The paper's experiment, shortened to twice the time of the fault.

    Args:
        runs: number of draws.
        fault: when the fault comes, s.
        seed: of the draws.
    """
    return Campaign(
        "paper",
        runs=runs,
        seed=seed,
        variations=(parse_variation("observer.k1=uniform(10000, 20000)"),),
        overrides=(f"duration={2 * fault}", f"transient={fault / 2}", f"injection.faults.0.start={fault}"),
        controllers=("ftcm", "smc"),
    )


def contents(folder: Path) -> dict[str, bytes]:
    """Return the files of a campaign's folder."""
    return {name: (folder / name).read_bytes() for name in FILES}
