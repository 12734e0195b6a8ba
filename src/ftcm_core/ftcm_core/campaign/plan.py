# SPDX-License-Identifier: Apache-2.0
"""What a campaign runs: a scenario or several, what varies, how often, with which contenders."""

from __future__ import annotations

import contextlib
import copy
import itertools
import os
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from ftcm_core.campaign.comparison import AT
from ftcm_core.campaign.sampling import SAMPLINGS, draws
from ftcm_core.campaign.variation import Variation, parse_variation
from ftcm_core.errors import FtcmError, ScenarioError, shown, suggestion
from ftcm_core.registry import find
from ftcm_core.scenario import Scenario, apply_override, from_mapping, read_mapping, with_plugins
from ftcm_core.scenario.parameter_files import parameter_overrides

MAX_RUNS = 1_000_000
CHOSEN = {"controllers": "controller", "observers": "observer", "detectors": "detector"}
"""Keys of a campaign that name components, and their kind: every combination is a contender."""
KEYS = ("scenario", "scenarios", "runs", "seed", "sampling", "vary", "set", *CHOSEN, "contenders")


@dataclass(frozen=True)
class Run:
    """One run of a campaign, small enough to send to another process."""

    number: int
    controller: str
    drawn: dict[str, str]
    """Path to value, as YAML."""
    contender: str = ""
    """What the results call it."""
    settings: tuple[str, ...] = ()
    """What makes it this contender, as of ``--set``, beside the controller."""
    scenario: str = ""
    """Name of its scenario, where the campaign has several."""


@dataclass(frozen=True)
class Campaign:
    """A scenario or several, what varies, and how often."""

    source: str
    """Scenario file or name of a shipped one; of several, the first."""
    runs: int = 100
    seed: int = 0
    variations: tuple[Variation, ...] = ()
    overrides: tuple[str, ...] = ()
    """The same in every run, as of ``--set``."""
    controllers: tuple[str, ...] = ()
    """Each runs with every draw; the scenario's own by default."""
    observers: tuple[str, ...] = ()
    """Likewise; with several of both, each combination runs."""
    detectors: tuple[str, ...] = ()
    contenders: tuple[tuple[str, tuple[str, ...]], ...] = ()
    """In the place of those: names, and what makes each of them, as of ``--set``."""
    sampling: str = "random"
    """One of :data:`~ftcm_core.campaign.sampling.SAMPLINGS`."""
    scenarios: tuple[tuple[str, str], ...] = ()
    """In the place of the one: names and sources. Each contender runs in each, with the same draws."""
    _read: dict[str, tuple[dict[str, Any], str]] = field(default_factory=dict, repr=False, compare=False)

    def __post_init__(self) -> None:
        """Check what can be checked without the scenario."""
        for name, value, low, high in (("runs", self.runs, 1, MAX_RUNS), ("seed", self.seed, 0, 2**63 - 1)):
            if isinstance(value, bool) or not isinstance(value, int) or not low <= value <= high:
                raise FtcmError(f"{name}: {shown(value)} is not a whole number in [{low}, {high}]")
        if self.sampling not in SAMPLINGS:
            raise FtcmError(
                f"sampling: {shown(self.sampling)} is none; {suggestion(str(self.sampling), SAMPLINGS)}"
            )
        paths = [v.path for v in self.variations]
        for path in paths:
            if paths.count(path) > 1:
                raise FtcmError(f"--vary {path}: is varied twice")
        scenarios = [name for name, _ in self.scenarios]
        for name in scenarios:
            if scenarios.count(name) > 1:
                raise FtcmError(f"scenarios: {name}: is given twice; a scenario is called as its file is")
        for name in (*scenarios, *(name for name, _ in self.contenders)):
            if AT in name:
                raise FtcmError(f"{shown(name)}: a name of a contender or scenario has no {AT!r}; rename it")
        set_as_a_whole = {text.partition("=")[0].strip() for text in self.overrides} | set(paths)
        for key, kind in CHOSEN.items():
            names = getattr(self, key)
            for name in names:
                find(kind, name)
            if names and self.contenders:
                raise FtcmError(f"{key}: contenders are given too; give one of them")
            given = key if names else "contenders"
            for path in sorted(set_as_a_whole & {kind, f"{kind}.type"}) if getattr(self, given) else ():
                raise FtcmError(f"{path}: is set, and {given} are given too; give one of them")

    def run_list(self) -> list[Run]:
        """Return all runs: of each draw, one with each contender."""
        field = [
            (name + AT * bool(scenario) + scenario, controller, more, scenario)
            for scenario, _ in self.scenarios or (("", ""),)
            for name, controller, more in self._field(scenario)
        ]
        drawn = draws(self.variations, self.sampling, self.seed, self.runs)
        return [
            Run(n, controller, d, name, more, scenario)
            for n, d in enumerate(drawn)
            for name, controller, more, scenario in field
        ]

    def _field(self, scenario: str) -> list[tuple[str, str, tuple[str, ...]]]:
        """Name, controller and settings of each contender in a scenario."""
        if self.contenders:
            return [
                (name, self.scenario(Run(0, "", {}, name, more, scenario)).controller.type_name, more)
                for name, more in self.contenders
            ]
        own = self._plain(scenario)[0]
        controllers = self.controllers or (
            self.scenario(Run(0, "", {}, scenario=scenario)).controller.type_name,
        )
        chosen = (controllers, self.observers or ("",), self.detectors or ("",))
        found = []
        for controller, observer, detector in itertools.product(*map(dict.fromkeys, chosen)):
            more = [f"observer.type={observer}"] * bool(observer)
            if detector:  # a scenario may have none, or null
                more.append(f"detector{'.type' if own.get('detector') else ''}={detector}")
            found.append(("+".join(filter(None, (controller, observer, detector))), controller, tuple(more)))
        return found

    def settings(self, run: Run) -> list[str]:
        """Return the ``--set`` list that reproduces a run."""
        return [*run.settings, *self.overrides, *(f"{path}={value}" for path, value in run.drawn.items())]

    def mapping(self) -> dict[str, Any]:
        """Return the plain data of the scenario, or of several by name."""
        if self.scenarios:
            return {name: self._plain(name)[0] for name, _ in self.scenarios}
        return self._plain("")[0]

    def _plain(self, scenario: str) -> tuple[dict[str, Any], str]:
        """Plain data of a scenario, and what to call its file in errors; read once."""
        if scenario not in self._read:
            source = dict(self.scenarios).get(scenario, self.source)
            data, _, origin = read_mapping(source)
            self._read[scenario] = with_plugins(data, source, origin), origin
        return self._read[scenario]

    def scenario(self, run: Run) -> Scenario:
        """Return the scenario of a run.

        Raises:
            ScenarioError: a value does not fit; the message names the run.
        """
        read, origin = self._plain(run.scenario)
        data = copy.deepcopy(read)
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
            **({"scenarios": dict(self.scenarios)} if self.scenarios else {}),
            "runs": self.runs,
            "seed": self.seed,
            "sampling": self.sampling,
            "vary": {v.path: str(v).partition("=")[2] for v in self.variations},
            "set": list(self.overrides),
            **{key: list(getattr(self, key)) for key in CHOSEN},
            "contenders": {name: list(more) for name, more in self.contenders},
        }


def is_campaign(data: Mapping[str, Any]) -> bool:
    """Whether the plain data of a YAML file are a campaign, not a scenario."""
    return "scenario" in data or "scenarios" in data


def from_file(source: str) -> Campaign:
    """Return the campaign of a file, or of a scenario by itself.

    Raises:
        FtcmError: it is neither.
    """
    data, _, origin = read_mapping(source)
    if not is_campaign(data):
        with_plugins(data, source, origin)
        return Campaign(source)
    data = {k: v for k, v in data.items() if k != "name" and v is not None}
    for key in data:
        if key not in KEYS:
            raise FtcmError(f"{origin}: {shown(key)}: unknown key; {suggestion(shown(key), KEYS)}")
    vary = data.get("vary", {})
    if not isinstance(vary, dict) or not all(isinstance(x, str) for v in vary.items() for x in v):
        raise FtcmError(f"{origin}: vary: expected a mapping of paths to distributions, e.g. uniform(1, 2)")
    for key in ("set", "scenarios", *CHOSEN):
        if not isinstance(data.get(key, []), list) or not all(isinstance(v, str) for v in data.get(key, [])):
            raise FtcmError(f"{origin}: {key}: {shown(data[key])} is not a list of texts")
    several = data.get("scenarios", [])
    if several and "scenario" in data:
        raise FtcmError(f"{origin}: scenario: scenarios are given too; give one of them")
    for scenario in several or [data.get("scenario")]:
        if not isinstance(scenario, str):
            raise FtcmError(f"{origin}: scenario: {shown(scenario)} is not a path or name")
    folder = Path(source).parent
    paths = [beside(folder, scenario) for scenario in several or [data["scenario"]]]
    for path in paths:
        with contextlib.suppress(ScenarioError):  # it is told when the scenario is read for the first run
            read, _, place = read_mapping(path)
            with_plugins(read, path, place)
    try:
        return Campaign(
            source=paths[0],
            scenarios=tuple((Path(path).stem, path) for path in paths) if several else (),
            runs=data.get("runs", 100),
            seed=data.get("seed", 0),
            variations=tuple(parse_variation(f"{path}={text}") for path, text in vary.items()),
            overrides=tuple(data.get("set", ())),
            controllers=tuple(data.get("controllers", ())),
            observers=tuple(data.get("observers", ())),
            detectors=tuple(data.get("detectors", ())),
            contenders=_contenders(data.get("contenders", {}), folder),
            sampling=data.get("sampling", "random"),
        )
    except FtcmError as error:
        raise FtcmError(f"{origin}: {error}") from None


def beside(folder: Path, name: str) -> str:
    """Return the path of a file in a folder if there is one of that name, else the name."""
    return str(folder / name) if os.path.isfile(folder / name) else name


def _contenders(given: Any, folder: Path) -> tuple[tuple[str, tuple[str, ...]], ...]:
    """Read named contenders: each a list of settings, or a parameter file in the folder."""
    if not isinstance(given, dict) or not all(isinstance(name, str) for name in given):
        raise FtcmError(
            f"contenders: {shown(given)} is not a mapping of names to lists of settings or parameter files"
        )
    found = []
    for name, value in given.items():
        if isinstance(value, str):
            value = parameter_overrides(beside(folder, value))
        if not isinstance(value, list) or not all(isinstance(text, str) for text in value):
            raise FtcmError(
                f"contenders: {name}: {shown(value)} is not a list of settings, e.g. [controller.type=smc], "
                "nor a parameter file"
            )
        found.append((name, tuple(value)))
    return tuple(found)
