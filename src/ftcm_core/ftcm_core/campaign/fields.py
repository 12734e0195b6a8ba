# SPDX-License-Identifier: Apache-2.0
"""The contenders of each scenario of a campaign, and the errors of their runs."""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Iterable, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from ftcm_core.campaign.comparison import AT, by_scenario
from ftcm_core.recording.trace import Array

EFFORT = ("after_transient", "torque_total_variation")
"""Window and metric of the torque effort."""

_LARGEST = 1e300
"""Stands for infinity where values are averaged; no error or torque is so large."""


class Field(NamedTuple):
    """The contenders of one scenario, and their runs."""

    scenario: str
    """Its name, where there are several."""
    laws: dict[str, list[Mapping[str, Any]]]
    """Name of the contender, without that of the scenario, to results."""
    window: str
    """Where the error is looked at: after the fault, without one after the transient."""

    def rows(self, law: str, window: str, metric: str) -> dict[int, Sequence[float]]:
        """Return a metric's values per joint, by number of the run, of the runs that completed."""
        found = {}
        for one in self.laws[law]:
            row = ((one["metrics"] or {}).get(window) or {}).get(metric)
            if row and one["status"] == "completed" and all(x is not None and math.isfinite(x) for x in row):
                found[one["run"]] = row
        return found

    def errors(self, law: str) -> dict[int, float]:
        """Return the main metric by number of the run: the mean |e|, as the mean of the joints, rad."""
        return mean_of_joints(self.rows(law, self.window, "mean_abs_error"))


def mean_of_joints(rows: Mapping[int, Sequence[float]]) -> dict[int, float]:
    """Return the means of rows."""
    return {number: sum(row) / len(row) for number, row in rows.items()}


def quantiles(values: Array, shares: Sequence[float]) -> list[float]:
    """Return quantiles, linear between values, of which some may be infinite; next to such a one, infinite.

    Args:
        values: shape (n,), at least 0; n at least 1.
        shares: in [0, 1].
    """
    found = np.quantile(np.minimum(values, _LARGEST), shares)
    return [float(x) if x < _LARGEST * 1e-9 else math.inf for x in found]


def fields_of(contenders: Iterable[str], results: Iterable[Mapping[str, Any]]) -> list[Field]:
    """Return the fields of a campaign.

    Args:
        contenders: their names.
        results: lines of ``runs.jsonl``.
    """
    own = defaultdict(list)
    for one in results:
        own[one["contender"]].append(one)
    found = []
    for scenario, names in by_scenario(contenders).items():
        faulty = any((one["metrics"] or {}).get("after_fault") for name in names for one in own[name])
        laws = {name.partition(AT)[0]: own[name] for name in names}
        found.append(Field(scenario, laws, "after_fault" if faulty else "after_transient"))
    return found
