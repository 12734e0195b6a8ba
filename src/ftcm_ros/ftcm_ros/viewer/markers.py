# SPDX-License-Identifier: Apache-2.0
"""The command ``markers``: what RViz shows of a run that is on.

It reads a run as ``watch`` does, and publishes under ``/viewer``: the true joint positions and the desired
ones, for robot_state_publisher, and markers for torques, faults and alarms. Stamps are of this machine's
clock.
"""

from __future__ import annotations

import argparse
import math
import os
import signal
import sys
import threading
import time
from collections.abc import Sequence
from typing import Any, NamedTuple

import rclpy
from geometry_msgs.msg import Point
from rclpy.node import Node
from sensor_msgs.msg import JointState
from std_msgs.msg import ColorRGBA
from visualization_msgs.msg import Marker, MarkerArray

from ftcm_core.errors import FtcmError
from ftcm_core.registry import load_plugins
from ftcm_core.robots import Robot
from ftcm_core.scenario import from_mapping
from ftcm_ros.run.view import DRAWN, SHOWN, View
from ftcm_ros.run.watch import Watch
from ftcm_ros.transport.joining import join_as
from ftcm_ros.transport.network import VIEWER_PROFILES
from ftcm_ros.transport.topics import JOINT_STATES, REFERENCE, TRUE_STATE
from ftcm_ros.viewer import tables
from ftcm_ros.viewer.arm import drawing
from ftcm_ros.viewer.description import MARKERS, REFERENCE_STATES, STATES, WORLD

LOOK_SECONDS = 1.0 / 30.0
"""How often messages are taken and published, s."""
ARROW = 0.35
"""Length of the arrow of the largest torque of a joint so far; the arm is 1 long (chosen: it is seen)."""


class Colour(NamedTuple):
    """Red, green, blue, opacity."""

    r: float
    g: float
    b: float
    a: float


def colour(text: str, opacity: float = 1.0) -> Colour:
    """Return the colour ``#rrggbb``."""
    red, green, blue = bytes.fromhex(text.removeprefix("#"))
    return Colour(red / 255.0, green / 255.0, blue / 255.0, opacity)


class Marks:
    """Markers of joints: an arrow along the axis for the torque, a text, and a ball for fault or alarm."""

    def __init__(self, robot: Robot) -> None:
        """Nothing is known of its torques yet.

        Raises:
            FtcmError: it does not say where its joints are.
        """
        shape = drawing(robot)
        if shape is None:
            raise FtcmError(
                f"robot {robot.type_name!r} cannot be drawn; expected one that says where its joints are "
                "(forward_kinematics)"
            )
        self._robot, self._shape = robot, shape
        self._largest = [0.0] * robot.joints

    def of(self, view: View, stamp: Any) -> list[Marker]:
        """Return the markers of what has been heard.

        Args:
            view: what has been heard.
            stamp: the message's.
        """
        q = view.positions(TRUE_STATE, JOINT_STATES)
        frames = None if q is None else self._robot.forward_kinematics(q)
        if frames is None:
            return []
        alarms, faulty, found = view.alarms(), view.faulty(), []
        for j, (joint, frame) in enumerate(zip(view.joints, frames)):
            torque = view.values(joint).command
            size = self._shape.bodies[j + 1].drum.radius
            known = math.isfinite(torque)
            self._largest[j] = max(self._largest[j], abs(torque)) if known else self._largest[j]
            share = torque / self._largest[j] if known and self._largest[j] else 0.0
            ahead = ARROW * self._shape.reach * share
            tip = tuple([o + ahead * z for o, z in zip(frame.origin, frame.z)])
            arrow = _marker(
                "torque", j, Marker.ARROW, (0.4 * size, 0.8 * size, 0.0), colour(tables.colour(j)), stamp
            )
            arrow.points = [Point(x=p[0], y=p[1], z=p[2]) for p in (frame.origin, tip)]
            arrow.action = Marker.ADD if abs(ahead) > 0.01 * size else Marker.DELETE
            text = _marker(
                "text", j, Marker.TEXT_VIEW_FACING, (0.0, 0.0, size), Colour(0.1, 0.1, 0.1, 1.0), stamp
            )
            said = [f"{joint}: {torque:.3g} N·m" if known else joint]
            said += [alarms[joint]] if joint in alarms else []
            text.text = "\n".join(said)
            _place(text, frame.origin, above=2.5 * size)
            broken = tables.ALARM if joint in alarms else tables.FAULT
            ball = _marker("state", j, Marker.SPHERE, (3.2 * size,) * 3, colour(broken, 0.5), stamp)
            ball.action = Marker.ADD if joint in alarms or joint in faulty else Marker.DELETE
            _place(ball, frame.origin)
            found += [arrow, text, ball]
        return found


def _marker(space: str, number: int, kind: int, scale: Sequence[float], shade: Colour, stamp: Any) -> Marker:
    marker = Marker(
        ns=space, id=number, type=kind, color=ColorRGBA(r=shade.r, g=shade.g, b=shade.b, a=shade.a)
    )
    marker.header.frame_id, marker.header.stamp = WORLD, stamp
    marker.pose.orientation.w = 1.0
    marker.scale.x, marker.scale.y, marker.scale.z = scale
    return marker


def _place(marker: Marker, place: Sequence[float], above: float = 0.0) -> None:
    marker.pose.position.x, marker.pose.position.y = place[0], place[1]
    marker.pose.position.z = place[2] + above


class Markers:
    """What is published of a run."""

    def __init__(self, node: Node) -> None:
        """Begin to listen; publish nothing yet."""
        self._node = node
        self._watch = Watch(node, topics=(*SHOWN, *DRAWN))
        self._states, self._reference = (
            node.create_publisher(JointState, name, 10) for name in (STATES, REFERENCE_STATES)
        )
        self._markers = node.create_publisher(MarkerArray, MARKERS, 10)
        self._run = 0
        self._marks: Marks | None = None

    def look(self, now: float) -> None:
        """Take what has come, and publish what it says.

        Args:
            now: steady time, s.

        Raises:
            FtcmError: the robot of the run cannot be drawn.
        """
        self._watch.look(now)
        view = self._watch.view
        if not (view.joints and view.scenario):
            return
        if self._run != view.runs or self._marks is None:
            self._run, self._marks = view.runs, Marks(from_mapping(view.scenario).robot)
        stamp = self._node.get_clock().now().to_msg()
        shown = ((self._states, (TRUE_STATE, JOINT_STATES)), (self._reference, (REFERENCE,)))
        for publisher, topics in shown:
            if (q := view.positions(*topics)) is not None:
                message = JointState(name=[*view.joints], position=[*q])
                message.header.stamp = stamp
                publisher.publish(message)
        self._markers.publish(MarkerArray(markers=self._marks.of(view, stamp)))


def build_parser() -> argparse.ArgumentParser:
    """Return the command's parser."""
    parser = argparse.ArgumentParser(
        prog="markers",
        description="Publish what RViz shows of a run that is on: joint positions and markers.",
        epilog="viewer.launch.py starts it, with robot_state_publisher and RViz.",
    )
    parser.add_argument("--domain-id", type=int, help="ROS domain; default: ROS_DOMAIN_ID")
    parser.add_argument(
        "--plugin", action="append", default=[], metavar="FILE",
        help="load components from a Python file or module first; this runs its code",
    )  # fmt: skip
    return parser


def main(argv: Sequence[str] | None = None) -> None:
    """Entry point of ``ros2 run ftcm_ros markers``."""
    words = [*(sys.argv[1:] if argv is None else argv)]
    if "--ros-args" in words:  # as a launch file adds them
        words = words[: words.index("--ros-args")]
    options = build_parser().parse_args(words)
    ended = threading.Event()
    signal.signal(signal.SIGINT, lambda *_: ended.set())  # not in the middle of a message
    if options.domain_id is not None:
        os.environ["ROS_DOMAIN_ID"] = str(options.domain_id)
    try:
        load_plugins(options.plugin)
        markers = Markers(join_as("markers", VIEWER_PROFILES))
        while not ended.wait(LOOK_SECONDS):
            markers.look(time.monotonic())
    except FtcmError as error:
        print(f"markers: error: {error}", file=sys.stderr)
        sys.exit(2)
    finally:
        rclpy.try_shutdown()


if __name__ == "__main__":
    main()
