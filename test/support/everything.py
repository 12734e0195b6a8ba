# SPDX-License-Identifier: Apache-2.0
"""A scenario that has something of everything, but for its faults."""

from __future__ import annotations

from typing import Any

EVERYTHING: dict[str, Any] = {
    "name": "everything",
    "robot": {"type": "puma560", "payload_mass": 0.5},
    "model": {"mass": "-10 %"},
    "reference": "vo_kang_cosine",
    "controller": "ftcm",
    "observer": "do",
    "detector": {"type": "residual_threshold", "threshold": 15.0},
    "sensor": {"type": "encoder", "noise": 1e-5},
    "torque_delay": 1,
    "torque_limits": [97.6, 186.4, 89.4],
    "duration": 0.8,
    "transient": 0.1,
    "seed": 3,
}
"""A mapping, to which a test adds the disturbances and faults it is about."""
