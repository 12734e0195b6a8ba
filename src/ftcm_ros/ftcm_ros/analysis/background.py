# SPDX-License-Identifier: Apache-2.0
"""What the report of recorded runs says beside their results: real time, damage, replay, timing. No ROS."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
import numpy.typing as npt

from ftcm_core.report.page.of_runs import Background
from ftcm_ros.analysis.replay import Proof
from ftcm_ros.analysis.timing import page_curves
from ftcm_ros.bags.reader import BagContents


def background(
    command: Sequence[str],
    contents: Sequence[tuple[str, BagContents]],
    samples: Sequence[tuple[str, Mapping[str, npt.NDArray[np.float64]]]],
    proofs: Sequence[tuple[str, Proof]],
    verdicts: Mapping[str, str] | None = None,
) -> Background:
    """Return what ``report.html`` says beside the results.

    Args:
        command: what was typed, word by word.
        contents: the bags, by label.
        samples: latencies and jitter of each.
        proofs: their replays, if any.
        verdicts: of runs in real time, by label, where whoever ran them has judged them.
    """
    told = real_time(contents, verdicts or {})
    told += [f"{label}: {line}." for label, bag in contents for line in bag.warnings()]
    told += [f"{label}, replay: {'; '.join(proof.lines)}." for label, proof in proofs]
    return Background(tuple(command), tuple(told), page_curves(samples))


def real_time(contents: Sequence[tuple[str, BagContents]], verdicts: Mapping[str, str]) -> list[str]:
    """Say which runs were in real time, and how many deadlines they missed."""
    told, lockstep = [], []
    for label, bag in contents:
        plant = bag.nodes.get("plant", {})
        if plant.get("mode") == "lockstep":
            lockstep.append(label)
        elif label in verdicts:
            told.append(f"{label}, {verdicts[label]}.")
        elif plant.get("mode") == "real_time":
            missed, ticks = int(plant["missed_deadlines"]), int(plant["ticks"])
            told.append(f"{label}, real time: {missed:,} of {ticks:,} deadlines missed.")
    if lockstep:
        whose = "The run was" if len(contents) == 1 else f"{', '.join(lockstep)} ran"
        told.append(f"{whose} in lockstep, so nothing is said about real time.")
    return told
