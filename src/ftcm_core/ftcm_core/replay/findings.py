# SPDX-License-Identifier: Apache-2.0
"""Replaying a whole run: what equals, what differs first, and the likely cause."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from ftcm_core.recording.trace import ENDED_EARLY, Array
from ftcm_core.replay.answers import AnsweringStage, Computed, answering_stages, changes_at
from ftcm_core.replay.plant import Held, ReplayedPlant
from ftcm_core.replay.record import ROUNDING, Message, Record, channels_of
from ftcm_core.signals import COLUMNS, seconds

FEW = 10
"""Up to so many ticks that differ, and all else equal, are a record that was changed (chosen)."""


class Difference(NamedTuple):
    """A recorded number that the replay does not give."""

    tick: int
    signal: str
    """Its column, as of :data:`~ftcm_core.signals.COLUMNS`."""
    joint: int
    """From 0."""
    recorded: float
    computed: float
    """nan where the replay gives none: the run had ended."""

    @property
    def apart(self) -> float:
        """How far they are apart, in the unit of the signal."""
        return abs(self.recorded - self.computed)


@dataclass(frozen=True)
class StageFinding:
    """What the replay says of one stage."""

    name: str
    ticks: int
    """Ticks compared."""
    differing: tuple[int, ...]
    """Those in which a number differs."""
    undecided: tuple[int, ...]
    """Those of which the record does not tell enough."""
    first: Difference | None
    largest: float
    """Largest difference, relative to 1 + the number."""


@dataclass(frozen=True)
class Replay:
    """What the replay of a run says."""

    record: Record
    stages: tuple[StageFinding, ...]
    held: Held
    """Ticks in which the plant moved with inputs that were not those of the tick."""
    end: tuple[str, str]
    """How the replay ends, where the record ends early: status and reason; else completed."""

    @property
    def first(self) -> Difference | None:
        """The first difference, in the order of the tick."""
        found = [stage.first for stage in self.stages if stage.first]
        return min(found, key=lambda difference: difference.tick, default=None)

    @property
    def ends_alike(self) -> bool:
        """Whether a run that could not go on ends so here too."""
        return self.record.status not in ENDED_EARLY or self.end[0] == self.record.status

    @property
    def equal(self) -> bool:
        """Whether all that can be decided is equal, float for float."""
        return self.first is None and self.ends_alike

    @property
    def undecided(self) -> int:
        """Ticks of all stages that cannot be decided."""
        return sum(len(stage.undecided) for stage in self.stages)

    @property
    def whole(self) -> bool:
        """Whether the run is that of the simulation in process: each tick acted with its own inputs."""
        return self.equal and not self.undecided and not self.held.ticks


def replay(record: Record, progress: Callable[[int, int], None] | None = None) -> Replay:
    """Run a recorded run again, stage by stage, and compare.

    Args:
        record: the run.
        progress: called about every 1000 ticks with the ticks done and the last tick.

    Raises:
        FtcmError: stages that ran compiled cannot be compiled here.
    """
    channels, last = channels_of(record.scenario), record.ticks - 1
    computed: Computed = {topic: [[] for _ in range(record.ticks)] for topic in channels}
    plant = ReplayedPlant(record, computed)
    answering = answering_stages(record, computed)
    changes = changes_at(record.changes)
    stages: list[ReplayedPlant | AnsweringStage] = [plant, *answering]
    for k in range(record.ticks):
        for order in (change.component for change in changes.get(k, ()) if change.kind == "fault"):
            for place in stages:
                place.order(order.number, order.action, seconds(k * record.scenario.dt_ns))
        for stage in answering:
            for change in changes.get(k, ()):
                if change.kind == stage.name:
                    stage.change(change.component)
            stage.tick(k)
        if k < last:
            plant.move(k)
        else:
            plant.finish(k)
        if progress and k % 1000 == 0:
            progress(k, last)
    found = [_finding(record, computed, s.name, s.outputs, s.undecided) for s in stages]
    return Replay(record, tuple(found), plant.held, plant.end)


def _finding(
    record: Record, computed: Computed, name: str, topics: tuple[str, ...], undecided: list[int]
) -> StageFinding:
    """Compare what a stage sent with what it should have."""
    channels = channels_of(record.scenario)
    known = set(undecided)
    ticks: set[int] = set()
    differing: set[int] = set()
    first: Difference | None = None
    largest = 0.0
    for topic in topics:
        columns = [column for column in channels[topic].columns if column]
        rows = [k for k in range(record.ticks) if record.at(topic, k) is not None and k not in known]
        if not rows:
            continue
        ticks.update(rows)
        given = [computed[topic][k] for k in rows]
        theirs = _table([record.at(topic, k) for k in rows], columns, record)
        ours = _table([messages[0] if messages else None for messages in given], columns, record)
        unlike = (theirs.view(np.int64) != ours.view(np.int64)) & ~(np.isnan(theirs) & np.isnan(ours))
        unlike |= np.array([not messages for messages in given])[:, None, None]
        if not unlike.any():
            continue
        differing.update(np.array(rows)[unlike.any(axis=(1, 2))].tolist())
        with np.errstate(invalid="ignore"):
            apart = np.where(unlike, np.abs(theirs - ours) / (1.0 + np.abs(theirs)), 0.0)
        largest = max(largest, float(np.nan_to_num(apart, nan=np.inf).max()))
        row, column, joint = (int(i) for i in np.argwhere(unlike)[0])
        found = Difference(
            rows[row],
            columns[column],
            joint,
            float(theirs[row, column, joint]),
            float(ours[row, column, joint]),
        )
        if first is None or found.tick < first.tick:
            first = found
    return StageFinding(name, len(ticks), tuple(sorted(differing)), tuple(undecided), first, largest)


def _table(said: Sequence[Message | None], columns: list[str], record: Record) -> Array:
    """Numbers of shape (ticks, columns, joints); nan where nothing is said."""
    nothing = ((np.nan,) * record.scenario.robot.joints,) * len(columns)
    return np.array([message or nothing for message in said], dtype=np.float64)


def verdict(found: Replay) -> str:
    """Say in a sentence whether a run is proved, or what differs first."""
    ticks = f"{found.record.ticks:,} ticks"
    if not found.equal:
        return f"differs {_where(found)}"
    text = f"equal, float for float: {ticks}"
    if found.undecided:
        text = f"equal, float for float, where it can be decided: {ticks}"
        text += "; not decided: " + ", ".join(
            f"{stage.name} {_ranges(stage.undecided)}" for stage in found.stages if stage.undecided
        )
    held = found.held
    if held.ticks:
        text += (
            f"; in {held.ticks:,} the plant moved with what it held: command in {held.command:,}, "
            f"disturbance in {held.disturbance:,}, safe stop in {held.safe_stop:,}"
        )
    return text


def _where(found: Replay) -> str:
    scenario, first = found.record.scenario, found.first
    if first is None:
        status, reason = found.end
        here = f"{status}: {reason}" if reason else "it goes on"
        return f"at its end: recorded as {found.record.status}, here {here}"
    unit, joint = COLUMNS[first.signal].unit, scenario.robot.joint_names[first.joint]
    what = f"{first.signal} of {joint}: recorded {first.recorded!r} {unit}"
    at = f"first at tick {first.tick}, t = {first.tick * scenario.dt:g} s: {what}"
    if first.computed != first.computed and first.recorded == first.recorded:
        return f"{at}, none here"
    return f"{at}, here {first.computed!r}: {first.apart:.2g} apart"


def _ranges(ticks: Sequence[int], most: int = 5) -> str:
    """Ticks in words: ``ticks 3, 7 to 9``."""
    found: list[list[int]] = []
    for k in ticks:
        if found and k == found[-1][1] + 1:
            found[-1][1] = k
        else:
            found.append([k, k])
    texts = [f"{a}" if a == b else f"{a} to {b}" for a, b in found[:most]]
    more = f" and {len(found) - most} more" if len(found) > most else ""
    return f"tick{'s' if len(ticks) > 1 else ''} {', '.join(texts)}{more}"


def cause(found: Replay, versions: Mapping[str, tuple[str, str]]) -> str:
    """Say in a sentence why a replay probably differs; empty if it does not.

    Args:
        found: the replay.
        versions: versions that differ: recorded, and here.
    """
    if found.equal:
        return ""
    differing = [k for stage in found.stages for k in stage.differing]
    last = found.record.ticks - 1
    others = ", ".join(f"{name} {theirs} (here {ours})" for name, (theirs, ours) in versions.items())
    if not found.ends_alike and not differing:
        text = "other limits or other code"
    elif max(stage.largest for stage in found.stages) <= ROUNDING:
        text = "single operations round differently: another processor, operating system or library"
    elif len(differing) <= FEW and max(differing) < last:
        return "the record was changed after the run: all else follows from what the replay gives there"
    elif others:
        text = "other code, or another version of a library"
    else:
        text = "other code than that of the run, though its versions are the same; or another program's node"
    return f"{text}; recorded with {others}" if others else text
