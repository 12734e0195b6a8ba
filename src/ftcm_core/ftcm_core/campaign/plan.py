# SPDX-License-Identifier: Apache-2.0
"""What a campaign runs: a scenario, what varies, how often, with which controllers."""

from __future__ import annotations

import contextlib
import copy
import os
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from ftcm_core.campaign.variation import Variation, parse_variation
from ftcm_core.errors import FtcmError, ScenarioError, shown, suggestion
from ftcm_core.registry import find
from ftcm_core.scenario import Scenario, apply_override, from_mapping, read_mapping, with_plugins

MAX_RUNS = 1_000_000


@dataclass(frozen=True)
class Run:
    """One run of a campaign, small enough to send to another process."""

    number: int
    controller: str
    drawn: dict[str, str]
    """Path to value, as YAML."""


@dataclass(frozen=True)
class Campaign:
    """A scenario, what varies, and how often."""

    source: str
    """Scenario file or name of a shipped one."""
    runs: int = 100
    seed: int = 0
    variations: tuple[Variation, ...] = ()
    overrides: tuple[str, ...] = ()
    """The same in every run, as of ``--set``."""
    controllers: tuple[str, ...] = ()
    """Each runs with every draw; the scenario's own by default."""
    _read: list[Any] = field(default_factory=list, repr=False, compare=False)

    def __post_init__(self) -> None:
        """Check what can be checked without the scenario."""
        for name, value, low, high in (("runs", self.runs, 1, MAX_RUNS), ("seed", self.seed, 0, 2**63 - 1)):
            if isinstance(value, bool) or not isinstance(value, int) or not low <= value <= high:
                raise FtcmError(f"{name}: {shown(value)} is not a whole number in [{low}, {high}]")
        paths = [v.path for v in self.variations]
        for path in paths:
            if paths.count(path) > 1:
                raise FtcmError(f"--vary {path}: is varied twice")
        for name in self.controllers:
            find("controller", name)

    def run_list(self) -> list[Run]:
        """Return all runs: of each draw, one with each controller."""
        names = self.controllers or (self.scenario(Run(0, "", {})).controller.type_name,)
        return [
            Run(number, name, {v.path: v.draw(self.seed, number) for v in self.variations})
            for number in range(self.runs)
            for name in dict.fromkeys(names)
        ]

    def settings(self, run: Run) -> list[str]:
        """Return the ``--set`` list that reproduces a run."""
        return [*self.overrides, *(f"{path}={value}" for path, value in run.drawn.items())]

    def scenario(self, run: Run) -> Scenario:
        """Return the scenario of a run.

        Raises:
            ScenarioError: a value does not fit; the message names the run.
        """
        if not self._read:
            data, _, origin = read_mapping(self.source)
            self._read.append((with_plugins(data, self.source, origin), origin))
        data, origin = self._read[0]
        data = copy.deepcopy(data)
        settings = self.settings(run)
        try:
            for text in [f"controller.type={run.controller}"] * bool(run.controller) + settings:
                apply_override(data, text)
            return from_mapping(data, origin=origin)
        except ScenarioError as error:
            if not run.drawn:
                raise
            drawn = " ".join(f"{path}={value}" for path, value in run.drawn.items())
            raise ScenarioError(f"run {run.number} (drawn {drawn}): {error}") from None

    def to_mapping(self) -> dict[str, Any]:
        """Return the campaign as plain data: what a campaign file has."""
        return {
            "scenario": self.source,
            "runs": self.runs,
            "seed": self.seed,
            "vary": {v.path: str(v).partition("=")[2] for v in self.variations},
            "set": list(self.overrides),
            "controllers": list(self.controllers),
        }


def is_campaign(data: Mapping[str, Any]) -> bool:
    """Whether the plain data of a YAML file are a campaign, not a scenario."""
    return "scenario" in data


def from_file(source: str) -> Campaign:
    """Return the campaign of a file, or of a scenario by itself.

    Raises:
        FtcmError: it is neither.
    """
    data, _, origin = read_mapping(source)
    if not is_campaign(data):
        with_plugins(data, source, origin)
        return Campaign(source)
    known = ("scenario", "runs", "seed", "vary", "set", "controllers")
    data = {k: v for k, v in data.items() if k != "name" and v is not None}
    for key in data:
        if key not in known:
            raise FtcmError(f"{origin}: {shown(key)}: unknown key; {suggestion(shown(key), known)}")
    vary = data.get("vary", {})
    if not isinstance(vary, dict) or not all(isinstance(x, str) for v in vary.items() for x in v):
        raise FtcmError(f"{origin}: vary: expected a mapping of paths to distributions, e.g. uniform(1, 2)")
    for key in ("set", "controllers"):
        if not isinstance(data.get(key, []), list) or not all(isinstance(v, str) for v in data.get(key, [])):
            raise FtcmError(f"{origin}: {key}: {shown(data[key])} is not a list of texts")
    scenario = data.get("scenario")
    if not isinstance(scenario, str):
        raise FtcmError(f"{origin}: scenario: {shown(scenario)} is not a path or name")
    beside = Path(source).parent / scenario
    path = str(beside) if os.path.isfile(beside) else scenario
    with contextlib.suppress(ScenarioError):  # it is told when the scenario is read for the first run
        read, _, place = read_mapping(path)
        with_plugins(read, path, place)
    try:
        return Campaign(
            source=path,
            runs=data.get("runs", 100),
            seed=data.get("seed", 0),
            variations=tuple(parse_variation(f"{path}={text}") for path, text in vary.items()),
            overrides=tuple(data.get("set", ())),
            controllers=tuple(data.get("controllers", ())),
        )
    except FtcmError as error:
        raise FtcmError(f"{origin}: {error}") from None
