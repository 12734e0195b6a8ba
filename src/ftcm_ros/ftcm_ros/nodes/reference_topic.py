# SPDX-License-Identifier: Apache-2.0
"""The reference from ``trajectory_msgs/JointTrajectory``, as a joint_trajectory_controller takes it."""

from __future__ import annotations

from typing import Any

from trajectory_msgs.msg import JointTrajectory

from ftcm_core.errors import FtcmError
from ftcm_core.references.trajectory import Trajectory, Waypoint, followed, held
from ftcm_core.signals import NANOSECONDS, Vector, seconds
from ftcm_ros.nodes.reactive_node import ReactiveNode
from ftcm_ros.transport.plane import qos
from ftcm_ros.transport.topics import TRAJECTORY


class ReferenceTopic:
    """What the controller follows: the position measured first, then each trajectory that comes.

    A trajectory that cannot be followed is refused and counted; what is followed goes on.
    """

    def __init__(self, node: ReactiveNode, topic: str) -> None:
        """Subscribe the topic.

        Args:
            node: the controller; its ``stage`` has the reference.
            topic: name of the topic.
        """
        self._node: Any = node
        self._names = node.scenario.robot.joint_names
        self.taken = self.refused = 0
        self._refusal = ""
        # Not by the data plane: it comes now and then, from whoever there is.
        node.create_subscription(
            JointTrajectory, topic, self._on_trajectory, qos(TRAJECTORY._replace(name=topic))
        )

    def begin(self, position: Vector) -> Trajectory:
        """Return what is followed until the first trajectory comes: the robot stays where it is, rad."""
        return held(position)

    def _on_trajectory(self, message: JointTrajectory) -> None:
        self._node.on_main_thread(lambda: self.take(message))

    def take(self, message: JointTrajectory) -> None:
        """Follow a trajectory from now on, or refuse it; by whoever may touch the stage."""
        node = self._node
        try:
            node.stage.reference = self._made(message)
        except FtcmError as error:
            self.refused += 1
            self._refusal = str(error)
            node.get_logger().warning(f"trajectory refused: {error}")
            return
        self.taken += 1
        node.get_logger().info(f"trajectory of {len(message.points)} points from t = {self._now():g} s on")

    def _now(self) -> float:
        return seconds(self._node.run_ns)

    def _made(self, message: JointTrajectory) -> Trajectory:
        node, names = self._node, list(message.joint_names)
        if not node.active or node.next_tick() == 0:
            raise FtcmError("the controller has not been given a measurement yet; send it again when it has")
        if sorted(names) != sorted(self._names):
            raise FtcmError(
                f"joint_names: {', '.join(names) or 'none'}; expected each of {', '.join(self._names)} once"
            )
        order = [names.index(name) for name in self._names]

        def picked(values: Any) -> Vector:
            return tuple([values[i] for i in order]) if len(values) == len(order) else tuple(values)

        points = [
            Waypoint(
                point.time_from_start.sec + point.time_from_start.nanosec / NANOSECONDS,
                picked(point.positions),
                picked(point.velocities),
            )
            for point in message.points
        ]
        stamp = message.header.stamp.sec * NANOSECONDS + message.header.stamp.nanosec
        begin = seconds(node.run_time(stamp)) if stamp else self._now()
        limits = node.scenario.limits
        return followed(points, self._now(), begin, node.stage.reference, self._names, limits)

    def health(self, level: str, message: str) -> tuple[str, str, dict[str, Any]]:
        """Level, message and values of the diagnostics."""
        if self.refused:
            level = "warn" if level == "ok" else level
            message += f"; {self.refused} trajectories refused, last: {self._refusal}"
        return level, message, {
            "trajectories_taken": self.taken, "trajectories_refused": self.refused,
        }  # fmt: skip
