# SPDX-License-Identifier: Apache-2.0
"""The index of a bag's chunks is kept outside of memory and comes back as it was."""

from __future__ import annotations

from io import BytesIO
from pathlib import Path

from ftcm_ros.bags.spool import Spool


def test_records_come_back_positioned_at_their_end(tmp_path: Path) -> None:
    spool = Spool(tmp_path)
    assert list(spool) == []
    expected = [bytes([i % 256]) * (i % 300) for i in range(1000)]
    for data in expected:
        record = BytesIO()
        record.write(data)
        spool.append(record)
    found = list(spool)
    assert [r.getvalue() for r in found] == expected
    assert [r.tell() for r in found] == [len(d) for d in expected]
    assert len(spool) == 1000
    assert list(tmp_path.iterdir()) == []
