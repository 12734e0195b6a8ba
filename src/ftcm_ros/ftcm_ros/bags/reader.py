# SPDX-License-Identifier: Apache-2.0
"""A bag to a :class:`~ftcm_core.recording.trace.Trace`: any rosbag2 bag with the suite's topics."""

from __future__ import annotations

import dataclasses
import json
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import yaml
from rosbags.rosbag2 import Reader, ReaderError
from rosbags.typesys import Stores, get_typestore

from ftcm_core.errors import FtcmError, shown
from ftcm_core.recording.trace import ENDED_EARLY, Change, Decision, FaultEvent, FaultOrder, Trace
from ftcm_core.registry import find, plugins
from ftcm_core.scenario import Scenario, from_mapping, parse_yaml
from ftcm_core.signals import NANOSECONDS, channels
from ftcm_ros.bags import checksums, digests
from ftcm_ros.bags.manifest import Comparison, compare
from ftcm_ros.bags.recovery import Message, files_of, scan
from ftcm_ros.transport.codec import JOINT_STATE, CodecError, JointStateCodec, read_joint_state
from ftcm_ros.transport.topics import (
    CHANGES,
    DETECTION,
    DIAGNOSTICS,
    EVENTS,
    FAULTS,
    JOINT_STATES,
    SCENARIO,
    TOPICS,
    TRUE_STATE,
    data_topics,
)

_WANTED = tuple(
    t.name.lstrip("/") for t in (*(topic for topic in TOPICS if topic.type == JOINT_STATE), *EVENTS)
)

Decoded = tuple[npt.NDArray[np.int64], list["npt.NDArray[np.float64] | None"]]


@dataclasses.dataclass(frozen=True)
class BagContents:
    """A bag as analysed: the trace, and what the bag says about itself."""

    path: Path
    trace: Trace
    missing: dict[str, int]
    """Ticks of the run that a data topic lacks, per topic."""
    nodes: dict[str, dict[str, str]]
    """Last diagnostics of each node."""
    metadata: dict[str, str]
    """The recorder's custom data."""
    published: dict[str, npt.NDArray[np.int64]]
    """Time at which each message was published (system clock), ns, per data topic."""
    stamps: dict[str, npt.NDArray[np.int64]]
    """Stamp of each message, ns, per data topic."""
    arrays: dict[str, list[npt.NDArray[np.float64] | None]]
    """Position, velocity and effort of each message, of shape (messages, joints), per data topic; None where
    they are not filled."""
    unusable: dict[str, int]
    """Messages left out, as they are no tick of this robot's run, per topic; empty if there are none."""
    runs: int = 1
    """Runs in the bag; the trace is the last one."""
    recovered: str = ""
    """Of a bag that was not closed: what could be read, in one line."""
    damage: str = ""
    """Of a closed bag that is not what it was: what is not, in one line."""
    checked: bool = True
    """Whether the bag has checksums, so that damage would show."""
    files: str = ""
    """What does not fit of its files, where that is no damage, in one line: names, or that nothing tells."""

    def warnings(self) -> list[str]:
        """Return what whoever uses this has to know, each in one line."""
        found = []
        if self.runs > 1:
            found.append(f"the bag holds {self.runs} runs; this is the last one")
        if self.recovered:
            found.append(f"bag was not closed; recovered: {self.recovered}")
        if self.damage:
            found.append(f"damaged: {self.damage}")
        if self.unusable:
            found.append(f"messages that are no tick left out: {self.unusable}")
        if self.missing:
            found.append(f"ticks missing in the bag: {self.missing}")
        return found

    def remarks(self) -> list[str]:
        """Return what the bag cannot prove, each in one line."""
        found = [self.files] if self.files else []
        if not (self.checked or self.recovered or self.damage):
            found.append("the bag has no checksums: damage would not show")
        return found


def read_bag(path: Path, scenario: Scenario | None = None) -> BagContents:
    """Read a bag; of one that was not closed or lost its end, what can be read.

    Args:
        path: folder of the bag.
        scenario: the scenario of the run, for a bag that does not say.

    Raises:
        FtcmError: there is no bag, it cannot be read, or it has not the topics; in one line.
    """
    closed = (path / "metadata.yaml").is_file()
    verdict, files = _integrity(path)
    digested = verdict == "whole" and any(file.suffix == ".db3" for file in files_of(path))
    raw, published, trouble = _read_messages(
        path,
        "its checksums do not fit" if verdict == "damaged" else "",
        by_index=not (digested or (closed and files.changed)),  # that of sqlite3 has no digest
    )
    changed = {name for name in files.changed if name != "metadata.yaml"}
    proven = closed and (verdict != "unchecked" or (files.sealed and not changed))
    cut = bool(trouble) and not proven
    metadata = {} if cut or "metadata.yaml" in files.changed else _custom_data(path)
    apart = (CHANGES.name, FAULTS.name, SCENARIO.name, DIAGNOSTICS.name.lstrip("/"))
    others = {name: raw.pop(name, []) for name in apart}
    if not raw.get(JOINT_STATES.name):
        if trouble or files.changed:
            reason = trouble.rstrip(".") or files.note
            raise FtcmError(f"bag {str(path)!r} cannot be read: {reason}; nothing could be recovered")
        raise FtcmError(
            f"bag {str(path)!r} has no messages on /{JOINT_STATES.name}; expected this suite's topics"
        )
    typestore = get_typestore(Stores.ROS2_JAZZY)
    texts = [typestore.deserialize_cdr(m, SCENARIO.type).data for m in others[SCENARIO.name][:1]]
    text = (texts or [metadata.get("scenario")])[0]
    if scenario is None and text:
        scenario = _recorded_scenario(path, text)
    names = scenario.robot.joint_names if scenario else _joint_names(path, raw[JOINT_STATES.name][0])
    codec = JointStateCodec(names)
    decoded: dict[str, Decoded] = {}
    unusable = {}
    for name, messages in raw.items():
        decoded[name], keep = _decode(codec, messages, scenario)
        published[name] = published[name][keep]
        if not keep.all():
            unusable[name] = int(np.count_nonzero(~keep))
    if not len(decoded[JOINT_STATES.name][0]):
        raise FtcmError(
            f"bag {str(path)!r}: no message on /{JOINT_STATES.name} is a tick of this run, "
            f"of joints {shown(names)}"
        )
    runs = _keep_last_run(decoded, published)
    recovered = metadata.get("recovered", "")
    if cut:
        recovered = _cut_ragged_end(decoded, published, scenario)
        recovered += "" if files.sealed else "; nothing says what its files were (no SHA256SUMS)"
    stamps = np.unique(np.concatenate([times for times, _ in decoded.values()]))
    dt_ns = scenario.dt_ns if scenario else int(np.median(np.diff(stamps))) if len(stamps) > 1 else 1_000_000
    columns: dict[str, Any] = _columns(decoded, stamps, len(names), scenario)
    missing = {}
    for topic in data_topics(scenario):
        have = len(np.unique(decoded[topic.name][0])) if topic.name in decoded else 0
        expected = round((int(stamps[-1]) - int(stamps[0])) / dt_ns) + 1
        if have < expected:
            missing[topic.name] = expected - have
    nodes = _last_diagnostics(typestore, others[DIAGNOSTICS.name.lstrip("/")])
    try:
        changes, decisions = _changes(typestore, others[CHANGES.name], dt_ns)
    except FtcmError as error:
        raise _naming_plugins(error, scenario.plugins if scenario else ()) from None
    events, orders = _fault_events(typestore, others[FAULTS.name])
    if scenario is not None:
        scenario, changes = _initial_components(scenario, changes, int(stamps[0]) // dt_ns)
    status, detail, ended_at = _status(scenario, nodes.get("plant", {}), int(stamps[-1]), dt_ns)
    damage = ""
    if verdict == "damaged":
        damage = _harm(decoded, scenario, stamps, dt_ns)
    elif not cut and (files.changed or (trouble and not files.sealed)):
        damage = files.note if files.changed else trouble.rstrip(".")
        damage += "; every message fits its checksum" if verdict == "whole" else ""
    if damage:
        status, detail = "damaged", damage
    stamps_of = {name: times for name, (times, _) in decoded.items()}
    trace = Trace(
        joint_names=names, dt=dt_ns / 1e9, time_ns=stamps, **columns,
        scenario=scenario, status=status, detail=detail, ended_at=ended_at,
        changes=tuple(sorted([*changes, *orders], key=lambda c: (c.tick, c.kind))),
        fault_events=tuple(events),
        decisions=decisions,
        engine="graph",
    )  # fmt: skip
    return BagContents(
        path, trace, missing, nodes, metadata, published, stamps_of,
        {name: arrays for name, (_, arrays) in decoded.items()}, unusable, runs, recovered, damage,
        verdict == "whole" or (files.sealed and not files.changed), "" if damage else files.note,
    )  # fmt: skip


def _integrity(path: Path) -> tuple[str, Comparison]:
    """Compare a bag with the checksums in its files, if it is closed, and with what says what those were.

    Returns:
        ``whole``, ``damaged``, or ``unchecked`` where that is not possible; and the other comparison.

    Raises:
        FtcmError: it cannot be read.
    """
    try:
        files = compare(path)
        if not (path / "metadata.yaml").is_file():
            return "unchecked", files
        found = {(checksums if f.suffix == ".mcap" else digests).verify(f) for f in files_of(path)}
    except OSError as error:
        raise FtcmError(f"bag {str(path)!r} cannot be read: {error.strerror or error}") from None
    verdict = "damaged" if "damaged" in found else "whole" if found == {"whole"} else "unchecked"
    if verdict == "whole" and not files.sealed:
        files = files._replace(note="no SHA256SUMS: whether its files were exchanged is not known")
    return verdict, files


def _harm(
    decoded: dict[str, Decoded], scenario: Scenario | None, stamps: npt.NDArray[np.int64], dt_ns: int
) -> str:
    """Say which ticks a damaged bag lacks on a data topic."""
    end = scenario.last_tick if scenario else int(stamps[-1]) // dt_ns
    whole = np.ones(end + 1, dtype=np.bool_)
    for topic in data_topics(scenario):
        here = np.zeros(end + 1, dtype=np.bool_)
        if topic.name in decoded:
            here[decoded[topic.name][0] // dt_ns] = True
        whole &= here
    edges = np.flatnonzero(np.diff(np.concatenate([[1], whole, [1]]).astype(np.int8)))
    ranges = [f"{a} to {b - 1}" for a, b in edges.reshape(-1, 2).tolist()]
    if not ranges:
        return "the file is not what was recorded, but every message is there and whole"
    shown = ", ".join(ranges[:5]) + (f" and {len(ranges) - 5} more" if len(ranges) > 5 else "")
    return f"the file is not what was recorded: ticks {shown} are damaged or lost, and left out"


def _recorded_scenario(path: Path, text: str) -> Scenario:
    data = parse_yaml(text, f"bag {str(path)!r}: recorded scenario")[0]
    try:
        return from_mapping(data, origin=f"{path}: recorded scenario")
    except FtcmError as error:
        named = data.get("plugins") if isinstance(data, dict) else None
        raise _naming_plugins(error, named or ()) from None


def _naming_plugins(error: FtcmError, named: Iterable[str]) -> FtcmError:
    """The same error, and which plug-ins of the run have not been loaded."""
    missing = [name for name in named if name not in plugins()]
    if not missing:
        return error
    return FtcmError(
        f"{error}; the run used the plug-ins {', '.join(map(str, missing))}: give them with --plugin"
    )


def _columns(
    decoded: dict[str, Decoded], stamps: npt.NDArray[np.int64], joints: int, scenario: Scenario | None
) -> dict[str, npt.NDArray[np.float64]]:
    """Columns of the trace, from the topics that have them."""
    if scenario is None:  # of another recorder: what its topics show
        hidden = TRUE_STATE.name in decoded
        there = channels(hidden, DETECTION.name in decoded)
    else:
        hidden, there = scenario.hidden, scenario.channels
    columns = {
        name: _column(decoded, stamps, joints, channel.topic, i)
        for channel in there
        for i, name in enumerate(channel.columns)
        if name
    }
    if not hidden and TRUE_STATE.name in decoded:
        # Ticks in which another disturbance acted than the one of that tick.
        torque = columns["effort"].copy()
        torque[1:] += columns["disturbance"][:-1]
        acted = _column(decoded, stamps, joints, TRUE_STATE.name, 2)
        columns["joint_torque"] = np.where(np.isnan(acted), torque, acted)
    return columns


def _read_messages(
    path: Path, trouble: str, *, by_index: bool
) -> tuple[dict[str, list[bytes]], dict[str, npt.NDArray[np.int64]], str]:
    """Return messages and times per topic, and what was wrong with a bag that had to be scanned.

    Args:
        path: the bag.
        trouble: what is known to be wrong with it.
        by_index: whether to go by its index and metadata, if nothing is wrong.
    """
    if not path.exists():
        raise FtcmError(f"no bag {str(path)!r}; expected the folder of a rosbag2 bag")
    try:
        if trouble:
            raise ReaderError(trouble)
        if by_index:
            with Reader(path) as reader:
                wanted = [c for c in reader.connections if _name(c) in _WANTED]
                raw, times = _by_topic(reader.messages(wanted) if wanted else ())
        else:
            raw, times = _by_topic(scan(path))
    except Exception as error:  # rosbags has many error types, none of them a programming mistake here
        trouble = " ".join(str(error).split()) or type(error).__name__
        try:
            raw, times = _by_topic(scan(path))
        except OSError as again:
            raise FtcmError(f"bag {str(path)!r} cannot be read: {again.strerror or again}") from None
    return raw, {k: np.array(v, dtype=np.int64) for k, v in times.items()}, trouble


def _name(connection: Any) -> str:
    """A namespace in front of the topics does not matter."""
    return str(connection.topic.rpartition("/")[2])


def _by_topic(messages: Iterable[Message]) -> tuple[dict[str, list[bytes]], dict[str, list[int]]]:
    raw: dict[str, list[bytes]] = {name: [] for name in _WANTED}
    times: dict[str, list[int]] = {name: [] for name in _WANTED}
    sinks: dict[str, tuple[list[bytes], list[int]] | None] = {}
    for connection, when, data in messages:
        topic = connection.topic
        if topic not in sinks:
            name = _name(connection)
            sinks[topic] = (raw[name], times[name]) if name in _WANTED else None
        sink = sinks[topic]
        if sink is not None:
            sink[0].append(bytes(data))
            sink[1].append(when)
    return {k: v for k, v in raw.items() if v}, {k: v for k, v in times.items() if v}


def _cut_ragged_end(
    decoded: dict[str, Decoded], published: dict[str, npt.NDArray[np.int64]], scenario: Scenario | None
) -> str:
    """End where the first of the topics ends that were published to the last; return what there was.

    A topic that had ended more than a second before was not cut off by the recorder's end.
    """
    every_tick = {topic.name for topic in data_topics(scenario)}
    last = {
        name: published[name].max()
        for name, (times, _) in decoded.items()
        if len(times) and name in every_tick
    }
    cut = [name for name, when in last.items() if when > max(last.values()) - NANOSECONDS]
    end = min(int(decoded[name][0].max()) for name in cut)
    ticks = ", ".join(f"{name} {len(np.unique(times))}" for name, (times, _) in decoded.items())
    for name, (stamps, arrays) in decoded.items():
        keep = stamps <= end
        decoded[name] = stamps[keep], [None if a is None else a[keep] for a in arrays]
        published[name] = published[name][keep]
    if scenario is None:
        return f"complete to t = {end / 1e9:g} s (ticks: {ticks})"
    later = "" if end >= scenario.last_tick * scenario.dt_ns else "; later ones are not in the file"
    return f"complete to t = {end / 1e9:g} s of {scenario.duration:g} s (ticks: {ticks}){later}"


def _custom_data(path: Path) -> dict[str, str]:
    """What the recorder wrote about the run; empty in a bag of another recorder."""
    file = path / "metadata.yaml"
    if not file.is_file():
        return {}
    try:
        information = yaml.safe_load(file.read_bytes())["rosbag2_bagfile_information"]
        return dict(information.get("custom_data") or {})
    except (yaml.YAMLError, ValueError, TypeError, LookupError, AttributeError):  # not what was written
        return {}


def _joint_names(path: Path, message: bytes) -> tuple[str, ...]:
    try:
        return tuple(read_joint_state(message)[1])
    except CodecError as error:
        raise FtcmError(f"bag {str(path)!r}: /{JOINT_STATES.name}: {error}") from None


def _decode(
    codec: JointStateCodec, messages: Sequence[bytes], scenario: Scenario | None
) -> tuple[Decoded, npt.NDArray[np.bool_]]:
    """Return what a topic's messages say, and which of them are ticks of the run: the others are left out."""
    keep = np.ones(len(messages), dtype=np.bool_)
    for layout in codec.layouts:
        found = layout.decode_all(messages)
        if found is not None:
            times, arrays = found
            break
    else:
        samples = []
        for i, message in enumerate(messages):
            try:
                samples.append(codec.decode(message))
            except CodecError:
                keep[i] = False
        joints = len(codec.joint_names)
        nothing = (np.nan,) * joints
        times = np.array([s.time_ns for s in samples], dtype=np.int64)
        arrays = [
            np.array([s[i] or nothing for s in samples], dtype=np.float64).reshape(-1, joints)
            for i in (1, 2, 3)
        ]
    if scenario is not None:
        of_run = (times % scenario.dt_ns == 0) & (times >= 0) & (times <= scenario.last_tick * scenario.dt_ns)
        keep[keep] = of_run
        times, arrays = times[of_run], [None if a is None else a[of_run] for a in arrays]
    return (times, arrays), keep


def _keep_last_run(decoded: dict[str, Decoded], published: dict[str, npt.NDArray[np.int64]]) -> int:
    """Keep the last of several runs in one bag: stamps begin anew with each. Return how many there were."""
    times = decoded[JOINT_STATES.name][0]
    starts = np.flatnonzero(np.diff(times) < 0) + 1
    if len(starts):
        begin = published[JOINT_STATES.name][starts[-1]]
        for name, (stamps, arrays) in decoded.items():
            keep = published[name] >= begin
            decoded[name] = stamps[keep], [None if a is None else a[keep] for a in arrays]
            published[name] = published[name][keep]
    return len(starts) + 1


def _column(
    decoded: dict[str, Decoded], stamps: npt.NDArray[np.int64], joints: int, topic: str, index: int
) -> npt.NDArray[np.float64]:
    out = np.full((len(stamps), joints), np.nan)
    if topic in decoded:
        times, arrays = decoded[topic]
        values = arrays[index]
        if values is not None:
            once, first = np.unique(times, return_index=True)  # as in the nodes, the first of a tick counts
            out[np.searchsorted(stamps, once)] = values[first]
    return out


def _last_diagnostics(typestore: Any, messages: Sequence[bytes]) -> dict[str, dict[str, str]]:
    nodes: dict[str, dict[str, str]] = {}
    for data in messages:
        for status in typestore.deserialize_cdr(data, DIAGNOSTICS.type).status:
            name, _, what = status.name.partition(":")
            if what.strip() == "tick":
                nodes[name] = {"message": status.message, **{v.key: v.value for v in status.values}}
    return nodes


def _changes(
    typestore: Any, messages: Sequence[bytes], dt_ns: int
) -> tuple[list[Change], tuple[Decision, ...]]:
    """Components put in force, and what policies decided, in the order of time."""
    found: list[Change] = []
    decisions: list[Decision] = []
    for data in messages:
        array = typestore.deserialize_cdr(data, CHANGES.type)
        tick = (array.header.stamp.sec * 1_000_000_000 + array.header.stamp.nanosec) // dt_ns
        for status in array.status:
            values = {v.key: json.loads(v.value) for v in status.values}
            if status.name == "policy":
                decisions = [d for d in decisions if d.tick <= tick]
                decisions.append(Decision(**values))
                continue
            mapping = values["component"]
            component = find(status.name, mapping.pop("type"))(**mapping)
            # An earlier tick than the last one: a new run has begun, and only the last run counts.
            found = [c for c in found if c.kind != status.name or c.tick <= tick]
            found.append(Change(tick, status.name, component, values.get("by", "")))
    return sorted(found, key=lambda c: c.tick), tuple(sorted(decisions))


def _fault_events(typestore: Any, messages: Sequence[bytes]) -> tuple[list[FaultEvent], list[Change]]:
    """What was decided of faults while the run was on, and the orders by hand among it."""
    events: list[FaultEvent] = []
    orders: list[Change] = []
    known: dict[int, tuple[float, float]] = {}
    for data in messages:
        for status in typestore.deserialize_cdr(data, FAULTS.type).status:
            values = {v.key: v.value for v in status.values}
            tick, number, action = int(values["tick"]), int(values["number"]), values["action"]
            phase = float(values["onset"]), float(values["end"])
            if tick == 0 and not action:  # as the scenario has it: a run begins
                known[number] = phase
                events = [e for e in events if e.number != number]
                orders = [c for c in orders if c.component.number != number]
            elif phase != known.get(number):
                known[number] = phase
                events.append(FaultEvent(tick, number, *phase))
            if action:
                orders.append(Change(tick, "fault", FaultOrder(number, action)))
    return sorted(events, key=lambda e: e.tick), orders


def _initial_components(
    scenario: Scenario, changes: list[Change], first: int
) -> tuple[Scenario, list[Change]]:
    """The components in force at the first tick belong to the scenario; later ones are changes."""
    initial = {c.kind: c.component for c in changes if c.tick <= first}
    return dataclasses.replace(scenario, **initial), [c for c in changes if c.tick > first]


def _status(
    scenario: Scenario | None, plant: dict[str, str], last_ns: int, dt_ns: int
) -> tuple[str, str, float | None]:
    """Status, detail, and when a run ended early, s."""
    if plant.get("state") in ENDED_EARLY:
        return plant["state"], plant.get("detail", ""), float(plant.get("ended_at", (last_ns + dt_ns) / 1e9))
    if scenario is not None and last_ns // dt_ns >= scenario.last_tick:
        return "completed", "", None
    of = f" of {scenario.duration:g} s" if scenario else ""
    return "incomplete", f"ends at t = {last_ns / 1e9:g} s{of}", None
