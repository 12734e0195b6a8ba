# SPDX-License-Identifier: Apache-2.0
"""What tests do in a container: where the nodes' own Python and mathematical library are."""

from __future__ import annotations

import json
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np
import rclpy
from rcl_interfaces.srv import SetParameters
from rclpy.parameter import Parameter

from ftcm_core.simulation import simulate
from ftcm_ros.bags.reader import read_bag


def differing_ticks(found: Any, expected: Any) -> list[int]:
    """Rows in which two arrays of floats are not the same bit for bit; those that were lost are NaN."""
    bits = [np.ascontiguousarray(x).view(np.int64) for x in (found, expected)]
    there = ~np.isnan(found).all(axis=1)
    return [int(k) for k in np.flatnonzero((bits[0] != bits[1]).any(axis=1) & there)]


def compare(path: str) -> dict[str, Any]:
    """What a bag holds, what is missing, and which columns of the rest differ from the in-process run."""
    bag = read_bag(Path(path))
    trace = bag.trace
    again = simulate(trace.scenario, trace.changes)
    differing = {
        name: differing_ticks(trace.columns[name], column[: trace.ticks]) if name in trace.columns else [0]
        for name, column in again.columns.items()
    }
    return {
        "ticks": trace.ticks,
        "status": trace.status,
        "missing": bag.missing,
        "columns": list(trace.columns),
        "differing": [name for name, where in differing.items() if where],
        "differing_ticks": {n: [len(w), w[0], w[-1]] for n, w in differing.items() if w},
        "changes": [[c.kind, c.component.type_name, c.tick] for c in trace.changes],
        "plant": bag.nodes.get("plant", {}),
        "revision": json.loads(bag.metadata.get("provenance", "{}")).get("revision"),
        "held": int((trace.effort[1:] != trace.command[:-1]).any(axis=1).sum()),
        "topics": json.loads(bag.metadata.get("topics", "{}")),
    }


def change(node_name: str, name: str, value: str) -> dict[str, Any]:
    """Set a parameter of a node, as `ros2 param set` does."""
    rclpy.init()
    node = rclpy.create_node("test")
    client = node.create_client(SetParameters, f"/{node_name}/set_parameters")
    assert client.wait_for_service(timeout_sec=30)
    request = SetParameters.Request(parameters=[Parameter(name, value=value).to_parameter_msg()])
    end = time.monotonic() + 30
    future = None
    while time.monotonic() < end:  # an answer is dropped before the server has discovered the client
        future = client.call_async(request)
        rclpy.spin_until_future_complete(node, future, timeout_sec=2)
        if future.done():
            break
    (result,) = future.result().results
    return {"successful": result.successful, "reason": result.reason}


if __name__ == "__main__":
    print(json.dumps({"compare": compare, "change": change}[sys.argv[1]](*sys.argv[2:])))
