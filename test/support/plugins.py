# SPDX-License-Identifier: Apache-2.0
"""Components that only tests have, without the rest of the tests noticing."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from ftcm_core import registry
from ftcm_core.registry import KINDS, components, load_plugin
from ftcm_core.robots import Robot
from ftcm_core.robots.puma560 import Puma560
from ftcm_core.robots.urdf import Urdf

ROBOTS_FILE = Path(__file__).with_name("robots.py")


@contextlib.contextmanager
def registry_kept() -> Iterator[None]:
    """Forget afterwards what is registered or loaded as a plug-in inside."""
    kept, plugins = {kind: components(kind) for kind in KINDS}, dict(registry._plugins)
    try:
        yield
    finally:
        registry._components.update(kept)
        registry._plugins.clear()
        registry._plugins.update(plugins)


with registry_kept():
    _path = load_plugin(str(ROBOTS_FILE))
    _name = registry._plugins[_path]
    _classes = {name: cls for name, cls in components("robot").items() if cls.__module__ == _name}
ROBOTS: dict[str, Robot] = {
    name: cls()
    for name, cls in {**_classes, "urdf": Urdf, "puma560": Puma560}.items()  # type: ignore[misc]
}
"""Robots of 1, 2, 3 and 6 joints, by name."""


GAINS = {
    "pid": {"kp": 200.0, "kd": 40.0, "ki": 20.0},
    "pd_gravity": {"kp": 200.0, "kd": 40.0},
    "tdc": {"m_bar": 0.1},
    "adrc": {"b0": 1.0},
}
"""Gains for any of these robots, of the laws whose own are for the PUMA 560."""


@contextlib.contextmanager
def robots_known() -> Iterator[None]:
    """Have the robots of the plug-in file registered, as after ``--plugin``."""
    with registry_kept():
        registry._components["robot"] = {**components("robot"), **_classes}
        registry._plugins[_path] = _name
        yield


def scenario_mapping(robot: str, **more: Any) -> dict[str, Any]:
    """A scenario's mapping for any robot of :data:`ROBOTS`: slow sines, no faults.

    Args:
        robot: its name.
        **more: further keys, or others.
    """
    data = {
        "robot": robot,
        "reference": {"type": "sine", "amplitude": 0.2, "frequency": 0.3, "offset": 0.1},
        "controller": "ftcm",
        "observer": "do",
        "initial_state": {"position": 0.12},
        "duration": 0.1,
        "transient": 0.02,
        **more,
    }
    if str(data["controller"]) in GAINS:
        data["controller"] = {"type": data["controller"], **GAINS[data["controller"]]}
    return data
