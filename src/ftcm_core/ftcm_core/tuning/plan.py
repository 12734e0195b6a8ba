# SPDX-License-Identifier: Apache-2.0
"""What is tuned: parameters and their ranges, objectives, limits, runs to train on and runs held out."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

from ftcm_core.campaign.plan import Campaign, Run, beside, from_file
from ftcm_core.campaign.variation import Variation, parse_variation
from ftcm_core.errors import FtcmError, ParameterError, shown, suggestion
from ftcm_core.params import specs
from ftcm_core.recording.metrics import METRICS, WINDOWS
from ftcm_core.registry import find
from ftcm_core.scenario import Scenario, parse_yaml, read_mapping

Metric = tuple[str, str]
"""Window and metric."""

KEYS = (
    "campaign", "controller", "observer", "set", "parameters", "objectives", "limits", "trials", "batch",
    "seed", "training", "held_out",
)  # fmt: skip
TUNED = ("controller", "observer")
"""Components whose parameters can be tuned: those that a parameter file can have."""
MAX_TRIALS = 100_000


@dataclass(frozen=True)
class Tuning:
    """What is tuned, and how."""

    training: Campaign
    """Its draws are what every candidate runs."""
    held_out: Campaign
    """Its draws are what start and result are compared on."""
    parameters: tuple[Variation, ...]
    """Paths and their ranges."""
    objectives: tuple[Metric, ...]
    """To be small: the mean over the joints, then over the training runs."""
    limits: tuple[tuple[Metric, tuple[float, ...]], ...] = ()
    """Largest value of a metric in any training run: one number, or one per joint."""
    trials: int = 300
    batch: int = 8
    """Candidates that are chosen together; whatever the number of processes, the same ones are."""
    seed: int = 0
    settings: tuple[str, ...] = ()
    """What is tuned: controller, observer and what is set, as of ``--set``."""

    def __post_init__(self) -> None:
        """Check numbers, and the ranges against the bounds that the components declare."""
        for name, value, low, high in (
            ("trials", self.trials, 1, MAX_TRIALS),
            ("batch", self.batch, 1, 1000),
            ("seed", self.seed, 0, 2**31 - 1),
        ):
            if isinstance(value, bool) or not isinstance(value, int) or not low <= value <= high:
                raise FtcmError(f"{name}: {shown(value)} is not a whole number in [{low}, {high}]")
        if not self.parameters:
            raise FtcmError("parameters: none; expected e.g. {controller.gamma1: loguniform(0.5, 10)}")
        if not self.objectives:
            raise FtcmError("objectives: none; expected e.g. [after_fault.mean_abs_error]")
        start = self.start
        for metric, values in self.limits:
            if len(values) not in (1, start.robot.joints):
                raise FtcmError(
                    f"limits: {'.'.join(metric)}: {shown(list(values))} has {len(values)} entries; "
                    f"expected one number, or one per joint ({start.robot.joints})"
                )
        for parameter in self.parameters:
            _check_range(parameter, start)

    @property
    def start(self) -> Scenario:
        """The scenario of the first training run with the parameters that it starts from."""
        return self.training.scenario(self.runs(())[0])

    @cached_property
    def _drawn(self) -> list[Run]:
        return self.training.run_list()

    def runs(self, settings: tuple[str, ...]) -> list[Run]:
        """Return the training runs of a candidate, given by its settings as of ``--set``."""
        return [
            dataclasses.replace(run, controller="", settings=(*self.settings, *settings))
            for run in self._drawn
        ]

    @property
    def wanted(self) -> tuple[Metric, ...]:
        """Metrics that a trial needs."""
        return tuple(dict.fromkeys((*self.objectives, *(metric for metric, _ in self.limits))))

    def to_mapping(self) -> dict[str, Any]:
        """Return it as plain data."""
        return {
            "training": self.training.to_mapping(),
            "held_out": self.held_out.to_mapping(),
            "settings": list(self.settings),
            "parameters": {p.path: str(p).partition("=")[2] for p in self.parameters},
            "objectives": [".".join(metric) for metric in self.objectives],
            "limits": {".".join(metric): list(values) for metric, values in self.limits},
            "trials": self.trials,
            "batch": self.batch,
            "seed": self.seed,
        }


def _check_range(parameter: Variation, start: Scenario) -> None:
    """Check a parameter's range against its declaration."""
    kind, _, rest = parameter.path.partition(".")
    name = rest.partition(".")[0]
    if kind not in TUNED or not name:
        raise FtcmError(
            f"parameters: {parameter.path}: expected a parameter of the law or the observer, "
            "e.g. controller.gamma1"
        )
    component = getattr(start, kind)
    declared = specs(type(component))
    if name not in declared:
        raise FtcmError(f"parameters: {parameter.path}: unknown parameter; {suggestion(name, declared)}")
    value_at(start, parameter.path)
    if parameter.kind == "normal":
        raise FtcmError(
            f"parameters: {parameter.path}: {parameter.kind} has no ends; expected uniform, loguniform, "
            "integer or choice"
        )
    for text in parameter.arguments:
        try:
            declared[name].check(parse_yaml(text, parameter.path)[0])
        except ParameterError as error:
            raise FtcmError(f"parameters: {parameter.path}: {error}") from None


def value_at(scenario: Scenario, path: str) -> Any:
    """Return the value of a component's parameter, or of one joint: ``controller.c``, ``controller.c.0``.

    Raises:
        FtcmError: there is no such entry.
    """
    kind, name, *index = path.split(".")
    value = getattr(getattr(scenario, kind), name)
    for place in index:
        if not isinstance(value, tuple) or not place.isdecimal() or int(place) >= len(value):
            raise FtcmError(
                f"parameters: {path}: {kind}.{name} is {shown(value)}, which has no entry {shown(place)}; "
                f"set a list first, e.g. set: ['{kind}.{name}=[1, 1, 1]']"
            )
        value = value[int(place)]
    return value


def tuning_from_file(source: str) -> Tuning:
    """Read what is to be tuned from a file.

    Raises:
        FtcmError: it cannot be read or something in it does not fit, in one line.
    """
    data, _, origin = read_mapping(source)
    data = {k: v for k, v in data.items() if k != "name" and v is not None}
    try:
        return _tuning(data, Path(source).parent)
    except FtcmError as error:
        raise FtcmError(f"{origin}: {error}") from None


def _tuning(data: Mapping[str, Any], folder: Path) -> Tuning:
    for key in data:
        if key not in KEYS:
            raise FtcmError(f"{shown(key)}: unknown key; {suggestion(shown(key), KEYS)}")
    if not isinstance(data.get("campaign"), str):
        raise FtcmError(
            f"campaign: {shown(data.get('campaign'))} is not the path of a campaign or scenario file, "
            "nor the name of a shipped scenario"
        )
    campaign = from_file(beside(folder, data["campaign"]))
    if campaign.controllers or campaign.observers or campaign.detectors or campaign.contenders:
        raise FtcmError("campaign: has contenders; expected one that leaves the law to this file")
    settings = []
    for kind in TUNED:
        if data.get(kind) is not None:
            find(kind, data[kind])
            settings.append(f"{kind}.type={data[kind]}")
    settings += _texts(data, "set")
    return Tuning(
        training=_campaign(campaign, data, "training", campaign.seed),
        held_out=_campaign(campaign, data, "held_out", campaign.seed + 1),
        parameters=_variations(data, "parameters"),
        objectives=tuple(_metric(text, "objectives") for text in _texts(data, "objectives")),
        limits=_limits(data),
        trials=data.get("trials", 300),
        batch=data.get("batch", 8),
        seed=data.get("seed", 0),
        settings=tuple(settings),
    )


def _campaign(campaign: Campaign, data: Mapping[str, Any], key: str, seed: int) -> Campaign:
    """The campaign with what the file says of the runs to train on, or held out."""
    more = data.get(key, {})
    if not isinstance(more, dict):
        raise FtcmError(f"{key}: {shown(more)} is not a mapping, e.g. {{runs: 10, seed: 1}}")
    known = ("runs", "seed", "vary", "set", "sampling")
    for name in more:
        if name not in known:
            raise FtcmError(f"{key}: {shown(name)}: unknown key; {suggestion(shown(name), known)}")
    varied = _variations(more, "vary")
    again = {v.path for v in varied}
    return dataclasses.replace(
        campaign,
        runs=more.get("runs", campaign.runs),
        seed=more.get("seed", seed),
        sampling=more.get("sampling", campaign.sampling),
        variations=(*(v for v in campaign.variations if v.path not in again), *varied),
        overrides=(*campaign.overrides, *_texts(more, "set")),
    )


def _texts(data: Mapping[str, Any], key: str) -> list[str]:
    found = data.get(key) or []
    if not isinstance(found, list) or not all(isinstance(text, str) for text in found):
        raise FtcmError(f"{key}: {shown(found)} is not a list of texts")
    return found


def _variations(data: Mapping[str, Any], key: str) -> tuple[Variation, ...]:
    found = data.get(key) or {}
    if not isinstance(found, dict) or not all(isinstance(x, str) for item in found.items() for x in item):
        raise FtcmError(f"{key}: expected a mapping of paths to ranges, e.g. uniform(1, 2)")
    try:
        return tuple(parse_variation(f"{path}={text}") for path, text in found.items())
    except FtcmError as error:
        raise FtcmError(f"{key}: {str(error).removeprefix('--vary ')}") from None


def _metric(text: Any, key: str) -> Metric:
    window, _, metric = str(text).partition(".")
    if window not in WINDOWS:
        raise FtcmError(f"{key}: {shown(text)}: no window {shown(window)}; {suggestion(window, WINDOWS)}")
    if metric not in METRICS:
        raise FtcmError(f"{key}: {shown(text)}: no metric {shown(metric)}; {suggestion(metric, METRICS)}")
    return window, metric


def _limits(data: Mapping[str, Any]) -> tuple[tuple[Metric, tuple[float, ...]], ...]:
    found = data.get("limits") or {}
    if not isinstance(found, dict):
        raise FtcmError(f"limits: {shown(found)} is not a mapping, e.g. {{whole.torque_peak: 100}}")
    limits = []
    for text, value in found.items():
        values = value if isinstance(value, list) else [value]
        if not values or not all(isinstance(x, (int, float)) and not isinstance(x, bool) for x in values):
            raise FtcmError(f"limits: {text}: {shown(value)} is not a number or one number per joint")
        if not min(values) > 0.0:
            raise FtcmError(f"limits: {text}: {shown(value)} is not above 0")
        limits.append((_metric(text, "limits"), tuple(map(float, values))))
    return tuple(limits)
