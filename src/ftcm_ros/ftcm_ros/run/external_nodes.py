# SPDX-License-Identifier: Apache-2.0
"""Nodes that somebody else starts and stops, in containers or on other machines."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import yaml

from ftcm_core.errors import FtcmError


def write_parameters(file: Path, node: str, parameters: Mapping[str, Any]) -> None:
    """Write a node's parameter file. Whoever waits for it sees it complete.

    Raises:
        OSError: it cannot be written.
    """
    file.parent.mkdir(parents=True, exist_ok=True)
    unfinished = file.with_suffix(".tmp")
    unfinished.write_text(
        yaml.safe_dump({f"/{node}": {"ros__parameters": dict(parameters)}}), encoding="utf-8"
    )
    unfinished.replace(file)


class ExternalNodes:
    """In the place of :class:`~ftcm_ros.run.local_nodes.LocalNodes`: lays out parameters, starts nothing."""

    start_seconds = 120.0
    """How long a node may take to come up: its container or machine starts first."""

    def __init__(self, folder: Path) -> None:
        """Lay the parameter files out in a folder that the nodes' starter reads, ``<node>.yaml``."""
        self.folder = folder

    def start(self, parameters: Mapping[str, Mapping[str, Any]], together: Sequence[str] = ()) -> None:
        """Lay out the nodes' parameters, for whoever starts them, together or not."""
        for node, values in parameters.items():
            write_parameters(self.folder / f"{node}.yaml", node, values)

    def check(self) -> None:
        """Nothing is known of a process elsewhere; a node that falls silent is noticed by its silence."""

    def pids(self) -> dict[str, int]:
        """Process numbers that are known: none."""
        return {}

    def running(self, node: str) -> bool:
        """Whether a node may still answer: nobody here knows better."""
        return True

    def is_stopped(self, node: str) -> bool:
        """Not as far as is known here."""
        return False

    def condition(self, node: str) -> str:
        """Say why no more is known."""
        return "it was started elsewhere"

    def resume(self) -> None:
        """Nothing that is stopped elsewhere can be let go on from here."""

    def ending(self, process: str, code: int, when: str = "") -> str:
        """Say how a process has ended: none is known of."""
        return ""

    def last_words(self, node: str) -> str:
        """Say where a node's output is."""
        return "it was started elsewhere: see its output there (docker/compose logs)"

    def stop(self) -> dict[str, int]:
        """Leave the nodes to whoever started them: no exit codes."""
        return {}


class AmbientDomain:
    """In the place of :class:`~ftcm_ros.transport.domain.Domain`: one that is in use already."""

    def __init__(self, wanted: int | None = None) -> None:
        """Use the wanted domain, or the environment's.

        Raises:
            FtcmError: that is no domain.
        """
        text = os.environ.get("ROS_DOMAIN_ID") or "0" if wanted is None else str(wanted)
        if not text.isdecimal() or int(text) > 232:
            raise FtcmError(f"domain {text} is out of range; expected 0 to 232")
        self.number = int(text)

    def clean(self) -> None:
        """Its nodes go on."""

    def release(self) -> None:
        """Its nodes go on."""
