# SPDX-License-Identifier: Apache-2.0
"""The runs of a campaign as a table: Parquet, one row per run, flat columns with their units."""

from __future__ import annotations

import itertools
import json
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

from ftcm_core.campaign.plan import Campaign, Run
from ftcm_core.recording.metrics import METRICS, WINDOWS

ROWS = 1000
"""So many are in memory at a time."""
_NUMERIC = {"uniform": "double", "loguniform": "double", "normal": "double", "integer": "int64"}
_TEXTS = ("contender", "controller", "status", "detail", "engine")


def write_parquet(
    path: Path,
    campaign: Campaign,
    runs: Sequence[Run],
    results: Iterator[dict[str, Any]],
    about: dict[str, Any],
) -> None:
    """Write ``runs.parquet``.

    Columns: ``run``, ``contender``, ``controller``, ``status``, ``detail``, ``engine``; ``vary.PATH``, what
    was drawn, a number unless it was a choice; ``WINDOW.METRIC.joint1`` and so on, null where a run has none.
    Each column's metadata has its ``unit``, and the schema's ``ftcm`` what the campaign was, as JSON.

    Args:
        path: the file.
        campaign: what was run.
        runs: its runs.
        results: their results, in the same order.
        about: what the schema's metadata say.
    """
    import pyarrow as pa
    from pyarrow import parquet

    field = [run for run in runs if run.number == runs[0].number]  # robots of several scenarios may differ
    joints = range(max(campaign.scenario(run).robot.joints for run in field))
    measured = [(w, m, j) for w in WINDOWS for m in METRICS for j in joints]
    fields = [pa.field("run", pa.int64()), *(pa.field(name, pa.string()) for name in _TEXTS)]
    kinds = {v.path: _NUMERIC.get(v.kind, "string") for v in campaign.variations}
    fields += [pa.field(f"vary.{p}", pa.type_for_alias(kind)) for p, kind in kinds.items()]
    fields += [
        pa.field(f"{w}.{m}.joint{j + 1}", pa.float64(), metadata={"unit": METRICS[m][1]})
        for w, m, j in measured
    ]
    numbers = {"double": float, "int64": int, "string": str}

    def row(run: Run, result: dict[str, Any]) -> list[Any]:
        metrics = result["metrics"]
        return [
            result["run"],
            *(result[name] for name in _TEXTS),
            *(numbers[kind](run.drawn[p]) for p, kind in kinds.items()),
            *(
                metrics[w][m][j] if metrics.get(w) and j < len(metrics[w][m]) else None
                for w, m, j in measured
            ),
        ]

    schema = pa.schema(fields, metadata={"ftcm": json.dumps(about)})
    with parquet.ParquetWriter(path, schema) as writer:
        rows = map(row, runs, results)
        while part := list(itertools.islice(rows, ROWS)):
            columns = [pa.array(c, f.type) for c, f in zip(zip(*part), fields)]
            writer.write_table(pa.Table.from_arrays(columns, schema=schema))
