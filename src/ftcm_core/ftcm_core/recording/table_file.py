# SPDX-License-Identifier: Apache-2.0
"""A trace as a table for other programs: CSV or Parquet, a row per tick, a column per signal and joint."""

from __future__ import annotations

import csv
import json
from pathlib import Path

from ftcm_core.errors import chosen
from ftcm_core.extras import need
from ftcm_core.recording.trace import Trace
from ftcm_core.signals import COLUMNS

TABLE_FORMATS = ("csv", "parquet")
"""What a trace can be written as."""
_ERRORS = {"error": "rad", "velocity_error": "rad/s"}


def table_formats(text: str | None) -> tuple[str, ...]:
    """Read what ``--export`` says.

    Raises:
        FtcmError: a format is not known, or takes a package that is not installed.
    """
    found = chosen("--export", text, TABLE_FORMATS) if text is not None else ()
    if "parquet" in found:
        need("pyarrow", "parquet", "a table in Parquet")
    return found


def write_table(path: Path, trace: Trace) -> None:
    """Write the columns of a trace.

    The first column is ``time`` (s), the others are those of :meth:`Trace.table`. Every number reads back as
    it is. Parquet has each column's ``unit`` in its metadata, and the schema's ``ftcm`` the scenario as JSON.

    Args:
        path: the file; its suffix, ``.csv`` or ``.parquet``, says what it becomes.
        trace: the run.

    Raises:
        FtcmError: Parquet, and pyarrow is not installed.
    """
    columns = {"time": trace.time, **trace.table()}
    if path.suffix == ".csv":
        with path.open("w", encoding="utf-8", newline="") as file:
            rows = csv.writer(file)
            rows.writerow(columns)
            rows.writerows(zip(*[values.tolist() for values in columns.values()]))
        return
    need("pyarrow", "parquet", "a table in Parquet")
    import pyarrow as pa
    from pyarrow import parquet

    units = {**{name: column.unit for name, column in COLUMNS.items()}, **_ERRORS, "time": "s"}
    fields = [
        pa.field(name, pa.float64(), metadata={"unit": units[name.partition(".")[0]]}) for name in columns
    ]
    scenario = trace.scenario.to_mapping() if trace.scenario else None
    schema = pa.schema(fields, metadata={"ftcm": json.dumps({"scenario": scenario, "status": trace.status})})
    parquet.write_table(pa.Table.from_arrays([pa.array(v) for v in columns.values()], schema=schema), path)
