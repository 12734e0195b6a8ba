# SPDX-License-Identifier: Apache-2.0
"""The message that says which component is in force from a tick on."""

from __future__ import annotations

import json
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue

from ftcm_core.registry import Component
from ftcm_core.signals import NANOSECONDS, Vector


def change_message(kind: str, component: Component, time_ns: int, tick: int, step: Vector) -> DiagnosticArray:
    """Describe a component that takes effect at a tick.

    Args:
        kind: ``controller`` or ``observer``.
        component: the component.
        time_ns: stamp of its first tick, ns.
        tick: number of its first tick.
        step: change of its output from the tick before, N·m per joint.
    """
    mapping: dict[str, Any] = component.to_mapping()
    values = {"tick": tick, "output_step": [round(x, 12) for x in step], "component": mapping}
    array = DiagnosticArray(
        status=[
            DiagnosticStatus(
                level=DiagnosticStatus.OK,
                name=kind,
                message=component.type_name,
                values=[KeyValue(key=k, value=json.dumps(v)) for k, v in values.items()],
            )
        ]
    )
    array.header.stamp.sec, array.header.stamp.nanosec = divmod(time_ns, NANOSECONDS)
    return array
