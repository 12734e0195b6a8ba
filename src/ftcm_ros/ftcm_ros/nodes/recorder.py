# SPDX-License-Identifier: Apache-2.0
"""The recorder node: every topic of the suite into a rosbag2 bag."""

from __future__ import annotations

import math
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

from builtin_interfaces.msg import Time

from ftcm_core.errors import FtcmError
from ftcm_core.signals import NANOSECONDS
from ftcm_ros.bags.writer import Recording
from ftcm_ros.nodes.main import run
from ftcm_ros.nodes.suite_node import SuiteNode
from ftcm_ros.transport.topics import DISTURBANCE, EVENTS, RECORDED, Topic, recorded_topics

ACKNOWLEDGE_TICKS = 100
"""How often the recorder says how far it is."""
BATCH_SECONDS = 0.01
FLUSH_SECONDS = 0.25
"""A recorder that is killed shall lose a second at most, on a busy machine too."""
QUIET_SECONDS = 1.0
"""At the end of a run, how long nothing may come before the bag is closed incomplete."""


class RecorderNode(SuiteNode):
    """Writes what it receives, as received, and knows what is missing."""

    gathers = DISTURBANCE  # in real time, between the end of a tick's work and the next tick

    def __init__(self) -> None:
        """Subscribe everything."""
        super().__init__("recorder")
        self._path = Path(self.setting("bag") or time.strftime("ftcm-%Y%m%d-%H%M%S"))
        self._storage: str = self.setting("storage")
        self.recording: Recording | None = None
        self._summary: dict[str, Any] = {}
        self._acknowledge = self.plane.publisher(RECORDED)
        self._acknowledged = -1
        self._last_message = 0.0
        self._flushed = 0.0
        self._lost = ""
        """Why the bag could not be written further."""
        for topic in recorded_topics(self.scenario):
            self.plane.subscribe(topic, self._handler(topic))

    def _handler(self, topic: Topic) -> Callable[[bytes, int], None]:
        def handle(data: bytes, published_ns: int) -> None:
            recording = self.recording
            if recording is None:
                return
            if topic not in EVENTS:  # diagnostics never cease
                if self.decode(topic, data) is None:
                    return
                self._last_message = time.monotonic()
            recording.write(topic, published_ns, data)

        return handle

    def activate(self) -> None:
        """Make the bag."""
        self.recording = Recording(self._path, self._storage, self.scenario)
        self._acknowledged = -1
        self._lost = ""
        self.get_logger().info(f"recording to {self._path}")

    def deactivate(self) -> None:
        """Take in what is still under way, then close the bag."""
        try:
            self._close()
        except FtcmError as error:
            self._give_up(error)
            raise

    def _give_up(self, error: FtcmError) -> None:
        """Take nothing more in, and say why on /diagnostics; the caller ends the run with the same line."""
        self.recording, self._lost = None, str(error)
        self.report()

    def _close(self) -> None:
        recording = self.recording
        if recording is None:
            return
        last = self.scenario.last_tick * self.scenario.dt_ns
        self._last_message = time.monotonic()
        end = time.monotonic() + QUIET_SECONDS if self.stopping else math.inf  # then the others may go on
        while (
            recording.complete_to != last
            and time.monotonic() - self._last_message < QUIET_SECONDS
            and time.monotonic() < end
        ):
            self.plane.collect(BATCH_SECONDS)
        self.recording = None
        recording.close()
        self._summary = recording.summary()
        missing = {name: c["missing"] for name, c in self._summary.items() if c["missing"]}
        if missing:
            self.get_logger().warning(f"ticks missing in the bag: {missing}")
        self.get_logger().info(f"closed {self._path}: {recording.counts['joint_states'].messages} ticks")

    def abandon(self) -> None:
        """Close the bag with what is in it."""
        if self.recording is not None:
            self.recording.close()

    def step(self) -> None:
        """Take messages in, say how far the recording is, flush now and then.

        Raises:
            FtcmError: the bag cannot be written; a run that is not recorded shall not go on unnoticed, so
                the process ends.
        """
        try:
            self._record()
        except FtcmError as error:
            self._give_up(error)
            raise

    def _record(self) -> None:
        self.plane.collect(BATCH_SECONDS)  # the queues hold seconds of messages
        recording = self.recording
        if recording is None:
            return
        done = recording.complete_to
        if done is not None:
            self.ticks = done // self.scenario.dt_ns + 1
            behind = self.ticks - self._acknowledged
            if not 0 <= behind < ACKNOWLEDGE_TICKS or (behind and self.ticks > self.scenario.last_tick):
                self._acknowledged = self.ticks
                sec, nanosec = divmod(done, NANOSECONDS)
                self._acknowledge(Time(sec=sec, nanosec=nanosec))
        now = time.monotonic()
        if now - self._flushed > FLUSH_SECONDS:
            self._flushed = now
            recording.flush()

    def health(self) -> tuple[str, str, dict[str, Any]]:
        """What is recorded and what is missing."""
        if self._lost:
            return "error", self._lost, {"bag": str(self._path)}
        recording = self.recording
        summary = recording.summary() if recording else self._summary
        missing = sum(c["missing"] or 0 for c in summary.values())
        level = "error" if missing else "ok"
        message = "recording" if recording else "closed" if summary else "idle"
        values = {f"{topic}_{key}": v for topic, c in summary.items() for key, v in c.items()}
        return (
            level,
            f"{message}, {missing} ticks missing" if missing else message,
            {"bag": str(self._path), **values},
        )


def main() -> None:
    """Entry point of ``ros2 run ftcm_ros recorder``."""
    sys.exit(run(RecorderNode))


if __name__ == "__main__":
    main()
