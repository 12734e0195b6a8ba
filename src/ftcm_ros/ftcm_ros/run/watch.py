# SPDX-License-Identifier: Apache-2.0
"""The command ``watch``: shows a run that is on, in the terminal or in a browser, and changes nothing of it.

It publishes nothing of the suite's. Its readers of data topics are best effort and of a small depth, so that
no writer waits for them; nothing is done per message, the newest are taken now and then. But for
``/diagnostics`` they are there only while the plant says that a run is on: a node that waits for the others
counts its readers.
"""

from __future__ import annotations

import argparse
import json
import os
import shutil
import signal
import sys
import time
from collections.abc import Callable, Sequence
from typing import Any

import rclpy
from rclpy.node import Node
from rclpy.qos import QoSProfile, ReliabilityPolicy

from ftcm_core.cli.output import drop_stdout
from ftcm_core.cli.watching import check_watch, watch_options
from ftcm_core.errors import FtcmError
from ftcm_core.registry import load_plugins
from ftcm_core.signals import NANOSECONDS
from ftcm_ros.run.view import SHOWN, Sample, View
from ftcm_ros.transport.joining import join_as
from ftcm_ros.transport.network import VIEWER_PROFILES
from ftcm_ros.transport.plane import message_class, qos
from ftcm_ros.transport.topics import CHANGES, DIAGNOSTICS, FAULTS, SCENARIO, Topic

LOOK_SECONDS = 0.1
"""How often messages are taken, s: at its own pace, so that a run at 1 kHz does not wake it."""
SCREEN_SECONDS, LINE_SECONDS = 0.25, 1.0
"""How often it is shown, s: on a terminal as a screen, elsewhere as a line."""
REPORT_SECONDS = 2.0
"""In so long, every node reports, s."""
DEPTH = 10
"""Messages of a data topic that wait to be taken."""
HOME_AND_CLEAR = "\x1b[H\x1b[J"


class Reader:
    """A subscription whose messages are taken when somebody wants them."""

    def __init__(self, node: Node, topic: Topic, hear: Callable[[Any], None]) -> None:
        """Subscribe: best effort; an event that is kept for whoever comes later can only be had reliably."""
        self._node, self._hear, self._class = node, hear, message_class(topic.type)
        best_effort = QoSProfile(depth=DEPTH, reliability=ReliabilityPolicy.BEST_EFFORT)
        profile = qos(topic) if topic.latched else best_effort
        self._subscription = node.create_subscription(self._class, topic.name, hear, profile)

    def take(self) -> None:
        """Hear what waits: at most as much as can wait, so that a quick writer does not keep us here."""
        for _ in range(DEPTH):
            taken = self._subscription.handle.take_message(self._class, False)
            if taken is None:
                return
            self._hear(taken[0])

    def close(self) -> None:
        """End the subscription."""
        self._node.destroy_subscription(self._subscription)


class Watch:
    """The readers, and what they have heard."""

    def __init__(self, node: Node, *, health_only: bool = False, topics: Sequence[Topic] = SHOWN) -> None:
        """Listen to the nodes' reports.

        Args:
            node: with which to listen.
            health_only: whether data topics are left alone.
            topics: the data topics that are read while a run is on.
        """
        self._data = () if health_only else topics
        self.view = View()
        self._node, self.health_only = node, health_only
        self._reports = Reader(node, DIAGNOSTICS, self._on_diagnostics)
        self._of_run: list[Reader] = []

    def look(self, now: float) -> None:
        """Take what has come; begin and cease to listen to a run with it.

        Args:
            now: steady time, s.
        """
        for reader in (self._reports, *self._of_run):
            reader.take()
        running = self.view.running(now)
        if running and not self._of_run:
            self.view.forget()
            self._of_run = [Reader(self._node, topic, hear) for topic, hear in self._topics()]
        elif not running and self._of_run:
            for reader in self._of_run:
                reader.close()
            self._of_run = []

    def _topics(self) -> list[tuple[Topic, Callable[[Any], None]]]:
        events: list[tuple[Topic, Callable[[Any], None]]] = [
            (CHANGES, self._on_change),
            (FAULTS, self._on_fault),
            (SCENARIO, lambda message: self.view.hear_scenario(message.data)),
        ]
        return [*events, *((topic, self._taker(topic)) for topic in self._data)]

    def _on_diagnostics(self, message: Any) -> None:
        for status in message.status:
            node, _, what = status.name.partition(":")
            if what.strip() == "tick":
                values = {v.key: v.value for v in status.values}
                level = int.from_bytes(status.level, "little")
                self.view.hear_health(node, level, status.message, values, time.monotonic())

    def _on_change(self, message: Any) -> None:
        for status in message.status:
            self.view.hear_component(status.name, status.message)

    def _on_fault(self, message: Any) -> None:
        for status in message.status:
            values = {v.key: v.value for v in status.values}
            if {"onset", "end"} <= values.keys():
                joint = json.loads(values.get("fault", "{}")).get("joint")
                self.view.hear_fault(status.name, float(values["onset"]), float(values["end"]), joint)

    def _taker(self, topic: Topic) -> Callable[[Any], None]:
        def hear(message: Any) -> None:
            stamp = message.header.stamp
            sample = Sample(
                tuple(message.name), tuple(message.position), tuple(message.velocity), tuple(message.effort)
            )
            self.view.hear_sample(topic.name, stamp.sec * NANOSECONDS + stamp.nanosec, sample)

        return hear


def watch(options: argparse.Namespace) -> int:
    """Show a run until the user ends it; return the exit status.

    Raises:
        FtcmError: ROS cannot start; with ``--once``, no node says anything; with ``--web``, viser is not
            installed or the port is in use.
    """
    if options.domain_id is not None:
        os.environ["ROS_DOMAIN_ID"] = str(options.domain_id)
    check_watch(options)
    where = f"ROS_DOMAIN_ID={os.environ.get('ROS_DOMAIN_ID', '0')}"
    if options.web:
        return _in_browser(options, where)
    node = join_as("watch", VIEWER_PROFILES)
    watched = Watch(node, health_only=options.health)
    try:
        if options.once:
            print(_once(watched, options.timeout, where), flush=True)
        else:
            _forever(watched, where)
    except KeyboardInterrupt:
        return 0  # so one ends it
    finally:
        node.destroy_node()
        rclpy.try_shutdown()
    return 0


def _in_browser(options: argparse.Namespace, where: str) -> int:
    from ftcm_ros.viewer.serving import serve  # only here: it needs more than a terminal does

    try:
        serve(options, where)
    except KeyboardInterrupt:
        return 0
    finally:
        rclpy.try_shutdown()
    return 0


def _once(watched: Watch, timeout: float, where: str) -> str:
    """Wait for every node's report and, of a run that is on, for its signals; return the screen.

    Whoever is found late, on a busy machine, is waited for as long as is permitted.
    """
    view = watched.view
    end = time.monotonic() + timeout
    while (now := time.monotonic()) < end:
        watched.look(now)
        if "plant" in view.health and not view.running(now):
            end = min(end, now + REPORT_SECONDS)
        elif view.expected and {*view.expected} <= {*view.health} and (view.complete or watched.health_only):
            break
        time.sleep(LOOK_SECONDS)
    if not view.health:
        reach = os.environ.get("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
        raise FtcmError(
            f"no node of the suite says anything in {where}, ROS_AUTOMATIC_DISCOVERY_RANGE={reach}, within "
            f"{timeout:g} s; expected a run that is on: set both as it says them"
        )
    return view.screen(time.monotonic(), where)


def _forever(watched: Watch, where: str) -> None:
    """Show a screen on a terminal, elsewhere a line per second."""
    terminal = sys.stdout.isatty()
    shown = 0.0
    while True:
        now = time.monotonic()
        watched.look(now)
        if now - shown >= (SCREEN_SECONDS if terminal else LINE_SECONDS):
            shown = now
            if terminal:
                columns, rows = shutil.get_terminal_size()
                lines = watched.view.screen(now, where).splitlines()[: rows - 1]
                print(HOME_AND_CLEAR + "\n".join(line[:columns] for line in lines), flush=True)
            else:
                print(watched.view.line(now), flush=True)
        time.sleep(LOOK_SECONDS)


def build_parser() -> argparse.ArgumentParser:
    """Return the command line of ``watch``."""
    parser = argparse.ArgumentParser(
        prog="watch",
        description="Show a run that is on, in the terminal or in a browser; it changes nothing of it.",
    )
    watch_options(parser)
    parser.add_argument(
        "--plugin", action="append", default=[], metavar="FILE",
        help="load components from a Python file or module first; this runs its code",
    )  # fmt: skip
    return parser


def main(argv: Sequence[str] | None = None) -> None:
    """Entry point of ``ros2 run ftcm_ros watch``."""
    options = build_parser().parse_args(argv)
    signal.signal(signal.SIGINT, signal.default_int_handler)  # a shell lets what it runs beside it ignore it
    try:
        if sys.stdout is None:
            raise OSError("standard output is closed; results go there: redirect it, e.g. > FILE")
        load_plugins(options.plugin)
        status = watch(options)
    except FtcmError as error:
        print(f"watch: error: {error}", file=sys.stderr)
        status = 2
    except BrokenPipeError:
        drop_stdout()
        status = 141
    except OSError as error:
        print(f"watch: error: {error}", file=sys.stderr)
        status = 1
    except KeyboardInterrupt:
        status = 130
    sys.exit(status)


if __name__ == "__main__":
    main()
