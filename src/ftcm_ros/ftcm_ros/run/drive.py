# SPDX-License-Identifier: Apache-2.0
"""The command ``drive``: takes nodes that somebody else has started through a run, and ends with it.

The nodes are configured in the order of the tick, and the plant is activated last: no tick is published
before every endpoint is matched. When the plant has ended, the recorder closes its bag.

Exit status: 0 done (a run that diverges is a result), 1 a node failed, 2 a mistake in what was asked, 130
interrupted.
"""

from __future__ import annotations

import argparse
import contextlib
import signal
import sys
from typing import Any

import rclpy
from diagnostic_msgs.msg import DiagnosticArray
from rclpy.utilities import remove_ros_args

from ftcm_core.errors import FtcmError
from ftcm_core.recording.trace import ENDED_EARLY
from ftcm_core.registry import load_plugins
from ftcm_core.scenario import Scenario, load
from ftcm_ros.parameters.node_parameters import nodes_of
from ftcm_ros.run.graph_run import (
    BYTES_PER_SECOND,
    CLOSE_SECONDS,
    MATCHING_ORDER,
    STOP_SECONDS,
    Interrupted,
)
from ftcm_ros.run.lifecycle import Managed, drive
from ftcm_ros.run.progress import Progress, say
from ftcm_ros.run.watchdog import CHAIN, Watchdog
from ftcm_ros.transport.joining import join_as
from ftcm_ros.transport.topics import DIAGNOSTICS

TICK_BYTES = 1000.0
"""So much of a bag is one tick, at most: 0.9 MB a second at 1 kHz."""
PATIENCE_SECONDS = 5.0
"""How long a node may be silent, or make no tick, before the run ends, s."""


def build_parser() -> argparse.ArgumentParser:
    """Return the command line of ``drive``."""
    parser = argparse.ArgumentParser(
        prog="drive",
        description="Take nodes that are started by somebody else, with autostart:=false and "
        "await_graph:=true, through a run, in the environment's ROS domain.",
        epilog="example: ros2 run ftcm_ros drive my_scenario.yaml",
    )
    parser.add_argument("scenario", nargs="?", default="paper", help="that of the nodes (default: paper)")
    parser.add_argument(
        "--plugin", action="append", default=[], metavar="FILE",
        help="load components from a Python file or module first; this runs its code",
    )  # fmt: skip
    parser.add_argument(
        "--wait", type=float, default=60.0, metavar="SECONDS",
        help="how long a node may take to come up (default: 60)",
    )  # fmt: skip
    parser.add_argument(
        "--patience", type=float, default=PATIENCE_SECONDS, metavar="SECONDS",
        help="how long a node may be silent, or make no tick, before the run ends; 2 or more (default: 5)",
    )  # fmt: skip
    return parser


class Driver:
    """Drives the nodes of one run, as a node of its own with the name of the one that ``experiment`` has."""

    def __init__(self, scenario: Scenario, options: argparse.Namespace) -> None:
        """Join the graph.

        Raises:
            JoinError: that is not possible.
        """
        self.scenario, self.options = scenario, options
        self.nodes = nodes_of(scenario)
        self.stop_requested = False
        self.health: dict[str, dict[str, str]] = {}
        self._watchdog: Watchdog | None = None
        self.node = join_as("experiment")
        self._managed = {name: Managed(self.node, name) for name in self.nodes}
        self.node.create_subscription(DiagnosticArray, DIAGNOSTICS.name, self._on_diagnostics, 100)

    def run(self) -> None:
        """From configuration to the closed bag.

        Raises:
            FtcmError: a node did not come up, did not do what it was asked to, fell silent or made no tick.
            Interrupted: the user stopped it.
        """
        for name in MATCHING_ORDER:
            if name in self.nodes:
                self._transition("configure", (name,))
        self._transition("activate", tuple(n for n in self.nodes if n != "plant"))
        self.health.clear()  # what is said of a run before
        self._transition("activate", ("plant",))
        with Progress(
            self.scenario.controller.type_name, self.scenario.last_tick, self.scenario.dt
        ) as progress:
            self._follow(progress)
        size = self.scenario.last_tick * TICK_BYTES  # which the recorder reads again
        self._transition("deactivate", ("recorder",), CLOSE_SECONDS + size / BYTES_PER_SECOND)
        with contextlib.suppress(FtcmError):  # what they had to do is done
            self._transition("deactivate", tuple(n for n in CHAIN if n in self.nodes), STOP_SECONDS)

    def _transition(self, name: str, nodes: tuple[str, ...], seconds: float | None = None) -> None:
        wait = self.options.wait if seconds is None else seconds
        failed = drive([self._managed[n] for n in nodes], name, self._spin, wait)
        if failed:
            raise FtcmError(f"node {failed!r} did not {name}, for which it has {wait:g} s; see its output")

    def _spin(self) -> None:
        rclpy.spin_once(self.node, timeout_sec=0.05)
        if self.stop_requested:
            raise Interrupted

    def _follow(self, progress: Progress) -> None:
        """Follow the ticks to the end of the run."""
        while True:
            self._spin()
            plant = self.health.get("plant", {})
            tick, missed = int(plant.get("tick", 0)), int(plant.get("missed_deadlines", 0))
            if plant.get("state") in ("completed", *ENDED_EARLY):
                progress.finish(tick, missed)
                say(f"{plant['state']}: {plant['detail']}")
                return
            progress.show(tick, missed)
            if self._watchdog is None:
                self._begin_to_watch()
                continue
            name, reason = self._watchdog.culprit()
            if name:
                said = self.health.get(name, {}).get("message", "")
                raise FtcmError(f"node {name!r} {reason}, at tick {tick}; its last diagnostics {said!r}")

    def _begin_to_watch(self) -> None:
        plant, controller = self.health.get("plant"), self.health.get("controller")
        if plant and controller:
            waits = plant["mode"] == "lockstep" or plant["process"] == controller["process"]
            self._watchdog = Watchdog(waits, self.options.patience, nodes=self.nodes)

    def _on_diagnostics(self, message: DiagnosticArray) -> None:
        for status in message.status:
            name, _, what = status.name.partition(":")
            if name in self.nodes and what.strip() == "tick":
                health = {"message": status.message, **{v.key: v.value for v in status.values}}
                self.health[name] = health
                if self._watchdog is not None:
                    self._watchdog.hear(name, int(health["ticks"]), health.get("paused") == "True")

    def close(self) -> None:
        """Leave the graph."""
        self.node.destroy_node()
        rclpy.try_shutdown()


def run_drive(options: argparse.Namespace) -> int:
    """Do what the options say; return the exit status.

    Raises:
        FtcmError: the scenario is not valid, or ROS cannot start.
    """
    if not options.patience >= 2.0:  # nodes speak once a second
        raise FtcmError(f"--patience {options.patience:g} is too short; expected 2 s or more")
    load_plugins(options.plugin)
    driver = Driver(load(options.scenario), options)

    def stop(signum: int, frame: Any) -> None:
        driver.stop_requested = True

    signal.signal(signal.SIGINT, stop)
    signal.signal(signal.SIGTERM, stop)
    try:
        driver.run()
    except Interrupted:
        return 130
    except FtcmError as error:
        say(f"drive: error: {error}")
        return 1
    finally:
        driver.close()
    return 0


def main() -> None:
    """Entry point of ``ros2 run ftcm_ros drive``."""
    options = build_parser().parse_args(remove_ros_args(sys.argv)[1:])  # which launch always gives
    try:
        status = run_drive(options)
    except FtcmError as error:
        say(f"drive: error: {error}")
        status = 2
    except KeyboardInterrupt:
        status = 130
    sys.exit(status)


if __name__ == "__main__":
    main()
