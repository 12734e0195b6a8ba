# SPDX-License-Identifier: Apache-2.0
"""Writing a run to a rosbag2 bag: raw CDR as received, with everything needed to read it alone."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from rosbags.interfaces import Qos, QosDurability, QosHistory, QosLiveliness, QosReliability, QosTime
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.typesys import Stores, get_typestore

from ftcm_core.errors import FtcmError
from ftcm_core.provenance import provenance
from ftcm_core.scenario import Scenario
from ftcm_ros.codec import stamp_of
from ftcm_ros.topics import DEPTH, EVENTS, Topic, data_topics

STORAGE = {"mcap": StoragePlugin.MCAP, "sqlite3": StoragePlugin.SQLITE3}
_FOREVER = QosTime(0x7FFFFFFFFFFFFFFF // 10**9, 0x7FFFFFFFFFFFFFFF % 10**9)


class TopicCount:
    """Which ticks of a data topic have been recorded."""

    def __init__(self) -> None:
        """None yet."""
        self.messages = 0
        self.last: int | None = None
        """Stamp of the newest tick, ns."""
        self.missing = 0
        """Ticks skipped between recorded ones, and before the first."""
        self.repeated = 0
        """Messages for a tick that was recorded before."""
        self.published = 0
        """When the newest message was published, as recorded, ns."""
        self.shift = 0
        """What is added to times of publication, ns."""

    def add(self, time_ns: int, dt_ns: int) -> None:
        """Count one message."""
        self.messages += 1
        new_run = self.last is None or time_ns == 0 < self.last
        before = -dt_ns if new_run or self.last is None else self.last
        if time_ns <= before:
            self.repeated += 1
            return
        self.missing += (time_ns - before) // dt_ns - 1
        self.last = time_ns


class Recording:
    """A bag being written."""

    def __init__(self, path: Path, storage: str, scenario: Scenario) -> None:
        """Create the bag.

        Raises:
            FtcmError: the target exists or cannot be made.
        """
        self.path = path
        self.scenario = scenario
        self.counts = {topic.name: TopicCount() for topic in data_topics(scenario)}
        self._shift = 0
        if path.exists():
            raise FtcmError(f"bag {str(path)!r} exists already; choose another name or remove it")
        self._writer = Writer(path, version=9, storage_plugin=STORAGE[storage])
        try:
            self._writer.open()
        except OSError as error:
            raise FtcmError(f"bag {str(path)!r} cannot be made: {error.strerror or error}") from None
        typestore = get_typestore(Stores.ROS2_JAZZY)
        self._connections = {
            topic.name: self._writer.add_connection(
                "/" + topic.name.lstrip("/"),
                topic.type,
                typestore=typestore,
                offered_qos_profiles=[_qos(topic)],
            )
            for topic in (*data_topics(scenario), *EVENTS)
        }

    def write(self, topic: Topic, published_ns: int, data: bytes) -> None:
        """Write one message as received; a data topic's tick is counted.

        Readers of bags go by the time of publication. When the system time is set back, it goes on here
        from where it was, so that they find a topic's messages in their order.
        """
        count = self.counts.get(topic.name)
        if count is None:
            when = published_ns + self._shift
        else:
            when = published_ns + count.shift
            if when < count.published:
                if published_ns + self._shift < count.published:  # the first topic to show it
                    self._shift = count.published - published_ns
                count.shift = self._shift
                when = published_ns + count.shift
            count.published = when
            count.add(stamp_of(data), self.scenario.dt_ns)
        self._writer.write(self._connections[topic.name], when, data)

    @property
    def complete_to(self) -> int | None:
        """Stamp up to which every data topic has been recorded, ns; None before the first tick."""
        stamps = [count.last for count in self.counts.values()]
        return None if None in stamps else min(s for s in stamps if s is not None)

    def summary(self) -> dict[str, dict[str, int | None]]:
        """Return per topic: messages, last tick, ticks missing, messages repeated."""
        dt = self.scenario.dt_ns
        return {
            name: {
                "messages": c.messages,
                "last_tick": None if c.last is None else c.last // dt,
                "missing": c.missing,
                "repeated": c.repeated,
            }
            for name, c in self.counts.items()
        }

    def flush(self) -> None:
        """Bring what has been written to the file, so that a killed recorder loses little."""
        storage: Any = self._writer.storage
        if hasattr(storage, "close_chunk"):
            if storage.chunk.bio.tell():
                storage.close_chunk()
            storage.bio.flush()
        elif hasattr(storage, "conn"):
            storage.conn.commit()

    def close(self, extra: Mapping[str, Any] | None = None) -> None:
        """Finish the bag with scenario, versions, seed and counts in its metadata."""
        self._writer.set_custom_data("scenario", self.scenario.to_yaml())
        self._writer.set_custom_data("seed", str(self.scenario.seed))
        self._writer.set_custom_data("provenance", json.dumps(provenance()))
        self._writer.set_custom_data("topics", json.dumps(self.summary()))
        for key, value in (extra or {}).items():
            self._writer.set_custom_data(key, json.dumps(value))
        self._writer.close()


def _qos(topic: Topic) -> Qos:
    return Qos(
        history=QosHistory.KEEP_LAST,
        depth=100 if topic.latched else DEPTH,
        reliability=QosReliability.RELIABLE,
        durability=QosDurability.TRANSIENT_LOCAL if topic.latched else QosDurability.VOLATILE,
        deadline=_FOREVER,
        lifespan=_FOREVER,
        liveliness=QosLiveliness.AUTOMATIC,
        liveliness_lease_duration=_FOREVER,
        avoid_ros_namespace_conventions=False,
    )
