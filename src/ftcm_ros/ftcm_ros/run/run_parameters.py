# SPDX-License-Identifier: Apache-2.0
"""The nodes' own parameters in a run that somebody drives from outside."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from ftcm_core.registry import plugins
from ftcm_core.scenario import Scenario
from ftcm_ros.parameters.node_parameters import SETTINGS, nodes_of

RECORDER_WINDOW = 1000
"""Ticks the plant may run ahead of the recorder in lockstep."""


def run_parameters(
    scenario: Scenario, file: Path, bag: Path, values: Mapping[str, Any]
) -> dict[str, dict[str, Any]]:
    """Return the parameters of each node of a run: nothing begins before every endpoint is matched.

    Args:
        scenario: the run.
        file: where it stands for the nodes to read.
        bag: folder of the bag to make.
        values: ``mode``, and other parameters of the nodes (``stages``, ``priority``, ...); each node takes
            those that it has.
    """
    lockstep = values["mode"] == "lockstep"
    common: dict[str, Any] = {
        "scenario": str(file.resolve()),
        "plugins": ",".join(plugins()),
        "autostart": False,
        "await_graph": True,
        "await_detection": lockstep,
        "recorder_window": RECORDER_WINDOW,
        "bag": str(bag.resolve()),
        **values,
    }
    of_node: dict[str, dict[str, Any]] = {
        node: {s.name: common[s.name] for s in SETTINGS[node] if s.name in common}
        for node in nodes_of(scenario)
    }
    of_node["recorder"]["priority"] = 0  # not in the tick: it must not take the processor from those that are
    return of_node
