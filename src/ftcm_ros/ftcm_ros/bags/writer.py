# SPDX-License-Identifier: Apache-2.0
"""Writing a run to a rosbag2 bag: raw CDR as received, with everything needed to read it alone."""

from __future__ import annotations

import contextlib
import json
import os
import shutil
import sqlite3
import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from rosbags.interfaces import Qos, QosDurability, QosHistory, QosLiveliness, QosReliability, QosTime
from rosbags.rosbag2 import StoragePlugin, Writer, WriterError
from rosbags.typesys import Stores, get_typestore

from ftcm_core.errors import FtcmError
from ftcm_core.recording.provenance import provenance
from ftcm_core.scenario import Scenario
from ftcm_ros.bags import manifest
from ftcm_ros.bags.rosbags_internals import add_checksums, do_not_wait_for_the_disk, flush, keep_index_on_disk
from ftcm_ros.transport.codec import stamp_of
from ftcm_ros.transport.topics import SCENARIO, Topic, data_topics, recorded_topics

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


def reason_of(error: OSError | sqlite3.Error) -> str:
    """Say in short why a file could not be written."""
    return (isinstance(error, OSError) and error.strerror) or str(error)


def new_bag(path: Path, storage: str) -> Writer:
    """Make an empty bag and return its writer, open.

    Raises:
        FtcmError: the target exists or cannot be made.
    """
    if os.path.lexists(path):
        raise FtcmError(f"bag {str(path)!r} exists already; choose another name or remove it")
    if storage == "sqlite3" and set(str(path)) & set("?#%"):
        raise FtcmError(
            f"bag {str(path)!r} cannot be made: sqlite3 storage takes no '?', '#' or '%' in a path; "
            "choose another name, or mcap"
        )
    try:
        writer = Writer(path, version=9, storage_plugin=STORAGE[storage])
        writer.open()
        add_checksums(writer)
    except WriterError as error:  # somebody else has made it just now: it is theirs
        raise FtcmError(f"bag {str(path)!r} cannot be made: {error}") from None
    except (OSError, sqlite3.Error) as error:
        shutil.rmtree(path, ignore_errors=True)
        raise FtcmError(f"bag {str(path)!r} cannot be made: {reason_of(error)}") from None
    do_not_wait_for_the_disk(writer)
    return writer


class Recording:
    """A bag being written."""

    def __init__(self, path: Path, storage: str, scenario: Scenario) -> None:
        """Create the bag with its scenario in it, so that a bag that is never closed has it too.

        Raises:
            FtcmError: the target exists or cannot be made.
        """
        self.path = path
        self.scenario = scenario
        self.counts = {topic.name: TopicCount() for topic in data_topics(scenario)}
        self._shift = 0
        self._in_file: int | None = None
        """Stamp up to which every data topic is in the file, whatever becomes of this process, ns."""
        self._writer = new_bag(path, storage)
        typestore = get_typestore(Stores.ROS2_JAZZY)
        text = typestore.types[SCENARIO.type](scenario.to_yaml())
        try:
            keep_index_on_disk(self._writer, path)
            self._connections = {
                topic.name: self._writer.add_connection(
                    "/" + topic.name.lstrip("/"),
                    topic.type,
                    typestore=typestore,
                    offered_qos_profiles=[_qos(topic)],
                )
                for topic in recorded_topics(scenario)
            }
            self._writer.write(
                self._connections[SCENARIO.name],
                time.time_ns(),
                typestore.serialize_cdr(text, SCENARIO.type),
            )
            flush(self._writer)
        except (OSError, sqlite3.Error) as error:
            self._abort()
            shutil.rmtree(path, ignore_errors=True)  # nothing of a run is in it
            raise FtcmError(f"bag {str(path)!r} cannot be made: {reason_of(error)}") from None

    def write(self, topic: Topic, published_ns: int, data: bytes) -> None:
        """Write one message as received; a data topic's tick is counted.

        Readers of bags go by the time of publication. When the system time is set back, it goes on here
        from where it was, so that they find a topic's messages in their order.

        Raises:
            FtcmError: it cannot be written; the bag is given up, and says what it keeps.
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
        try:
            self._writer.write(self._connections[topic.name], when, data)
        except (OSError, sqlite3.Error) as error:
            raise self._given_up(error) from None
        if count is not None:
            count.add(stamp_of(data), self.scenario.dt_ns)

    def _given_up(self, error: OSError | sqlite3.Error) -> FtcmError:
        self._abort()
        kept = "no tick is" if self._in_file is None else f"every tick up to t = {self._in_file / 1e9:g} s is"
        return FtcmError(f"bag {str(self.path)!r} cannot be written: {reason_of(error)}; {kept} kept in it")

    def _abort(self) -> None:
        with contextlib.suppress(OSError, sqlite3.Error):  # what is still in memory finds no room either
            self._writer.abort()

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
        """Bring what has been written to the file, so that a killed recorder loses little.

        Raises:
            FtcmError: as :meth:`write`.
        """
        try:
            flush(self._writer)
        except (OSError, sqlite3.Error) as error:
            raise self._given_up(error) from None
        self._in_file = self.complete_to

    def close(self, extra: Mapping[str, Any] | None = None) -> None:
        """Finish the bag with scenario, versions, seed and counts in its metadata, then seal its files.

        Raises:
            FtcmError: as :meth:`write`.
        """
        self.flush()
        self._writer.set_custom_data("scenario", self.scenario.to_yaml())
        self._writer.set_custom_data("seed", str(self.scenario.seed))
        self._writer.set_custom_data("provenance", json.dumps(provenance()))
        self._writer.set_custom_data("topics", json.dumps(self.summary()))
        for key, value in (extra or {}).items():
            self._writer.set_custom_data(key, json.dumps(value))
        try:
            self._writer.close()
            manifest.write(self.path)
        except (OSError, sqlite3.Error) as error:
            raise self._given_up(error) from None


def _qos(topic: Topic) -> Qos:
    return Qos(
        history=QosHistory.KEEP_LAST,
        depth=topic.depth,
        reliability=QosReliability.RELIABLE,
        durability=QosDurability.TRANSIENT_LOCAL if topic.latched else QosDurability.VOLATILE,
        deadline=_FOREVER,
        lifespan=_FOREVER,
        liveliness=QosLiveliness.AUTOMATIC,
        liveliness_lease_duration=_FOREVER,
        avoid_ros_namespace_conventions=False,
    )
