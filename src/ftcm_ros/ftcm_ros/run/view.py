# SPDX-License-Identifier: Apache-2.0
"""What ``watch`` shows of a run that is on: from what has been heard, text. No ROS."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import yaml

from ftcm_core.detectors import VERDICTS
from ftcm_core.faults.timing import NEVER
from ftcm_core.signals import seconds
from ftcm_ros.parameters.node_parameters import ALL_NODES, NODES
from ftcm_ros.transport.topics import (
    CHANGES,
    DETECTION,
    DIAGNOSTICS,
    DISTURBANCE,
    ESTIMATE,
    FAULTS,
    JOINT_STATES,
    REFERENCE,
    SCENARIO,
    TORQUES,
    TRUE_STATE,
    Topic,
)

SILENT_SECONDS = 2.5
"""A node that has said nothing for so long is silent: it reports once a second, s."""
LEVELS = ("ok", "warn", "error", "stale")
"""Of diagnostics, by their number."""
SHOWN = (JOINT_STATES, REFERENCE, TORQUES, ESTIMATE, DISTURBANCE, DETECTION)
"""Data topics of which the newest message is shown."""
DRAWN = (TRUE_STATE,)
"""Those that are only needed to draw the arm."""
WATCHED = (DIAGNOSTICS, CHANGES, FAULTS, SCENARIO)
"""What else is listened to."""
KEPT = 20
"""Messages of a topic that are kept, to find one of the same tick in another."""


class Sample(NamedTuple):
    """A JointState: joints by name, and the arrays that it has."""

    names: tuple[str, ...]
    position: tuple[float, ...]
    velocity: tuple[float, ...]
    effort: tuple[float, ...]

    def of(self, array: str, joint: str) -> float:
        """Value of a joint; not-a-number where there is none."""
        values = getattr(self, array)
        if joint not in self.names or len(values) != len(self.names):
            return math.nan
        return float(values[self.names.index(joint)])


class Health(NamedTuple):
    """What a node has reported last."""

    level: int
    message: str
    values: Mapping[str, str]
    heard: float
    """Steady time, s."""


class Values(NamedTuple):
    """What is shown of a joint, the newest; not-a-number where nothing says it."""

    error: float
    """Measured less desired position in one and the same tick, rad."""
    command: float
    """N·m; likewise what follows."""
    drive: float
    disturbance: float
    estimate: float
    """Of the disturbance: minus what is published."""
    residual: float


class Fault(NamedTuple):
    """What has been told of a fault."""

    onset: float
    """s."""
    end: float
    joint: int | None = None
    """Its number, from 1 on; 0: all; None: it is of no joint."""


class View:
    """What has been heard of a run, and how it is shown."""

    def __init__(self) -> None:
        """Nothing yet."""
        self.health: dict[str, Health] = {}
        self.runs = 0
        """How many runs it has begun to listen to."""
        self.forget()

    def forget(self) -> None:
        """Forget the run, not the nodes: another begins, or none."""
        self.runs += 1
        self._samples: dict[str, dict[int, Sample]] = {}
        self._faults: dict[str, Fault] = {}
        self.components: dict[str, str] = {}
        """Names of the components in force, by kind."""
        self._scenario = ""
        self.scenario: dict[str, Any] = {}
        """The scenario as plain data, where it has been heard."""
        self.expected: tuple[str, ...] = ()
        """Nodes that the run has, where that is known."""

    # What is heard.

    def hear_health(self, node: str, level: int, message: str, values: Mapping[str, str], now: float) -> None:
        """Take in a report of a node; one of another process is of another run."""
        before = self.health.get(node)
        if node == "plant" and before and before.values.get("process") != values.get("process"):
            self.forget()
        if node in ALL_NODES:
            self.health[node] = Health(level, message, values, now)

    def hear_sample(self, topic: str, time_ns: int, sample: Sample) -> None:
        """Take in a message of a data topic; one of an earlier time is of another run."""
        kept = self._samples.setdefault(topic, {})
        if kept and time_ns < min(kept):
            kept.clear()
        kept[time_ns] = sample
        while len(kept) > KEPT:
            del kept[min(kept)]

    def hear_fault(self, label: str, onset: float, end: float, joint: int | None = None) -> None:
        """Take in from when to when a fault acts (s), and on which joint (from 1 on; 0: all; None: none)."""
        self._faults[label] = Fault(onset, end, joint)

    def hear_component(self, kind: str, name: str) -> None:
        """Take in which component is in force."""
        self.components[kind] = name

    def hear_scenario(self, text: str) -> None:
        """Take in the scenario, in YAML: it says which nodes the run has."""
        try:
            data = yaml.safe_load(text)
        except yaml.YAMLError:
            return
        if isinstance(data, dict):
            self.scenario, self._scenario = data, str(data.get("name", ""))
            self.expected = ALL_NODES if data.get("detector") else NODES

    # What is known.

    def silent(self, node: str, now: float) -> bool:
        """Whether a node has ceased to report."""
        return now - self.health[node].heard > SILENT_SECONDS

    def running(self, now: float) -> bool:
        """Whether a run is on, as the plant says."""
        plant = self.health.get("plant")
        return plant is not None and plant.values.get("state") == "running" and not self.silent("plant", now)

    @property
    def time(self) -> float | None:
        """Time of the run, of the newest message or report, s; None if nothing says it."""
        newest = [max(kept) for kept in self._samples.values() if kept]
        return seconds(max(newest)) if newest else None

    @property
    def joints(self) -> tuple[str, ...]:
        """Names of the joints."""
        kept = self._samples.get(JOINT_STATES.name)
        return kept[max(kept)].names if kept else ()

    @property
    def complete(self) -> bool:
        """Whether every data topic has been heard whose publisher the run has."""
        there = [topic for topic in SHOWN if topic.publishers[0] in self.expected]
        return bool(there) and all(self._samples.get(topic.name) for topic in there)

    def newest(self, topic: str, array: str, joint: str) -> float:
        """Newest value of a joint; not-a-number if there is none."""
        kept = self._samples.get(topic)
        return kept[max(kept)].of(array, joint) if kept else math.nan

    def error(self, joint: str) -> float:
        """Measured less desired position in the newest tick of which both are there, rad."""
        measured, desired = (self._samples.get(t.name, {}) for t in (JOINT_STATES, REFERENCE))
        both = measured.keys() & desired.keys()
        if not both:
            return math.nan
        tick = max(both)
        return measured[tick].of("position", joint) - desired[tick].of("position", joint)

    def values(self, joint: str) -> Values:
        """What is shown of a joint."""
        topics = (TORQUES, JOINT_STATES, DISTURBANCE, ESTIMATE, DETECTION)
        command, drive, disturbance, estimate, residual = [
            self.newest(topic.name, "effort", joint) for topic in topics
        ]
        return Values(self.error(joint), command, drive, disturbance, -estimate, residual)

    def positions(self, *topics: Topic) -> tuple[float, ...] | None:
        """Newest joint positions of the first of these topics that tells them, rad; None where none does.

        A topic that has said nothing in the newest ticks is passed over: it speaks now and then.
        """
        for topic in topics:
            kept, measured = (self._samples.get(t.name) for t in (topic, JOINT_STATES))
            if kept and measured and max(kept) >= min(measured):
                sample = kept[max(kept)]
                found = tuple([sample.of("position", joint) for joint in self.joints])
                if all(map(math.isfinite, found)):
                    return found
        return None

    def acting(self) -> list[str]:
        """Faults that act now, and since when; until then, when they will."""
        now = self.time
        said = []
        for label, (onset, end, _) in sorted(self._faults.items()):
            if onset >= NEVER:
                said.append(f"{label} waits")
            elif now is None or now <= onset:
                said.append(f"{label} from t = {onset:g} s")
            elif now < end:
                said.append(
                    f"{label} ACTS since t = {onset:g} s" + ("" if end >= NEVER else f", to {end:g} s")
                )
            else:
                said.append(f"{label} is over since t = {end:g} s")
        return said

    def faulty(self) -> set[str]:
        """Joints on which a fault acts now."""
        now = self.time
        act = [f for f in self._faults.values() if now is not None and f.onset < now <= f.end]
        broken = {fault.joint for fault in act}
        return {joint for n, joint in enumerate(self.joints, 1) if not broken.isdisjoint((0, n))}

    def alarms(self) -> dict[str, str]:
        """Joints with an alarm, and what the detector says of them."""
        found = {}
        for joint in self.joints:
            alarm, verdict = (self.newest(DETECTION.name, a, joint) for a in ("position", "velocity"))
            if alarm > 0.0:
                known = 0.0 <= verdict < len(VERDICTS)
                found[joint] = VERDICTS[int(verdict)].replace("_", " ") if known else "?"
        return found

    # How it is shown.

    def screen(self, now: float, where: str) -> str:
        """Return everything, for a screen.

        Args:
            now: steady time, s.
            where: the domain, in words.
        """
        rows = self.nodes(now)
        nodes = (
            _aligned(rows, left=(0, 1, 6)) if len(rows) > 1 else ["no node of the suite says anything yet"]
        )
        lines = [self.heading(where), "", *nodes]
        if self.joints:
            lines += ["", *self._joints()]
        if acting := self.acting():
            lines += ["", "faults: " + "; ".join(acting)]
        return "\n".join(lines)

    def heading(self, where: str) -> str:
        """Return which run it is, and how far."""
        plant = self.health.get("plant")
        values = plant.values if plant else {}
        words = ["ftcm watch", where, self._scenario, values.get("mode", "")]
        words += [f"{kind} {name}" for kind, name in sorted(self.components.items())]
        if self.time is not None:
            words.append(f"t = {self.time:.3f} s")
        if "last_tick" in values:
            words.append(f"tick {values.get('tick', '?')} of {values['last_tick']}")
        return "  ".join(filter(None, words))

    def nodes(self, now: float) -> list[tuple[str, ...]]:
        """Return a row of text for each node, below a row of headings."""
        rows: list[tuple[str, ...]] = [("node", "level", "rate Hz", "ticks", "missed", "refused", "says")]
        for node in ALL_NODES:
            if node not in self.health:
                if node in self.expected:
                    rows.append((node, "-", "", "", "", "", "not heard yet"))
                continue
            level, message, values, heard = self.health[node]
            named = LEVELS[level] if level < len(LEVELS) else str(level)
            if self.silent(node, now):
                named, message = "silent", f"for {now - heard:.0f} s; before: {message}"
            missed = values.get("missed_deadlines", values.get("gaps", ""))
            rows.append(
                (
                    node,
                    named,
                    values.get("rate_hz", ""),
                    values.get("ticks", ""),
                    missed,
                    values.get("refused", ""),
                    message,
                )
            )
        return rows

    def _joints(self) -> list[str]:
        rows: list[tuple[str, ...]] = [
            (
                "joint",
                "error rad",
                "command N·m",
                "drive N·m",
                "disturbance",
                "-estimate",
                "residual",
                "alarm",
            )
        ]
        alarms = self.alarms()
        for joint in self.joints:
            rows.append((joint, *map(number, self.values(joint)), alarms.get(joint, "")))
        return _aligned(rows, left=(0, 7))

    def line(self, now: float) -> str:
        """Return the same in one line."""
        plant = self.health.get("plant")
        if plant is None:
            return f"{', '.join(self.health)} up; no plant" if self.health else "no node says anything yet"
        said = [plant.message]
        if self.time is not None:
            said.insert(0, f"t = {self.time:.3f} s")
        said += [
            f"{plant.values.get('rate_hz', '?')} Hz",
            f"missed {plant.values.get('missed_deadlines', '?')}",
        ]
        errors = [number(self.error(joint)) for joint in self.joints]
        torques = [number(self.newest(TORQUES.name, "effort", joint)) for joint in self.joints]
        for name, numbers, unit in (("e", errors, "rad"), ("u", torques, "N·m")):
            if any(numbers):
                said.append(f"{name} {' '.join(numbers)} {unit}")
        said += [one for one in self.acting() if "ACTS" in one]
        said += [f"ALARM {joint}: {verdict}" for joint, verdict in self.alarms().items()]
        for node, report in self.health.items():
            if self.silent(node, now):
                said.append(f"{node} SILENT for {now - report.heard:.0f} s")
            elif report.level > 0 and node != "plant":
                said.append(f"{node}: {report.message}")
        return "; ".join(said)


def number(value: float) -> str:
    """Return four digits; nothing for not-a-number."""
    return "" if math.isnan(value) else f"{value:.4g}"


def _aligned(rows: Sequence[tuple[str, ...]], left: Sequence[int]) -> list[str]:
    """Lines of a table: text on the left, numbers on the right."""
    widths = [max(len(row[k]) for row in rows) for k in range(len(rows[0]))]
    return [
        "  ".join(
            cell.ljust(width) if k in left else cell.rjust(width)
            for k, (cell, width) in enumerate(zip(row, widths))
        ).rstrip()
        for row in rows
    ]
