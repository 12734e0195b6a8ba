# SPDX-License-Identifier: Apache-2.0
"""A robot that knows nothing of the suite's messages: `python foreign_robot.py SCENARIO TICKS FILE`.

It publishes `joint_states` as a joint_state_broadcaster does: joints in another order and one more than the
robot has, stamps of the ROS clock that jitter. It takes torques as an effort controller does, and moves by a
tick when one has come, however long that takes. What it measured goes to a file, as JSON.
"""

from __future__ import annotations

import json
import sys
import time
from pathlib import Path

import rclpy
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray

from ftcm_core.scenario import load
from ftcm_core.signals import NANOSECONDS
from ftcm_core.simulation.stages import InjectorStage, PlantStage

COMMANDS = "/effort_controller/commands"
ASK_AGAIN_SECONDS = 1.0


def order_of(names: tuple[str, ...]) -> list[str]:
    """Joints in the order of this robot's messages: the last one first."""
    return [names[-1], *names[:-1]]


def main(scenario_file: str, ticks: int, record: str) -> None:
    scenario = load(scenario_file)
    names = scenario.robot.joint_names
    order = order_of(names)
    plant, injector = PlantStage(scenario), InjectorStage(scenario)
    rclpy.init()
    node = rclpy.create_node("joint_state_broadcaster")
    publisher = node.create_publisher(JointState, "/joint_states", 10)
    commands: list[list[float]] = []
    node.create_subscription(Float64MultiArray, COMMANDS, lambda m: commands.append(list(m.data)), 10)
    first, measured, last = node.get_clock().now().nanoseconds, [], None
    for tick in range(ticks):
        y = plant.measure()
        measured.append([list(values) for values in y])
        jitter = (tick * 7919 % 61 - 30) * scenario.dt_ns // 100  # up to a third of a tick
        stamp = first + tick * scenario.dt_ns + jitter
        message = JointState(name=[*order, "gripper"])
        message.header.frame_id = "base_link"
        message.header.stamp.sec, message.header.stamp.nanosec = divmod(stamp, NANOSECONDS)
        for array, values in zip((message.position, message.velocity, message.effort), y):
            array.extend([*(values[names.index(name)] for name in order), 0.5])
        asked = 0.0
        while not commands or commands[-1] == last:  # who was asked twice may answer twice
            if time.monotonic() - asked > ASK_AGAIN_SECONDS:
                publisher.publish(message)
                asked = time.monotonic()
            rclpy.spin_once(node, timeout_sec=0.1)
        last = commands[-1]
        u = tuple(last[order.index(name)] for name in names)
        time_ns = tick * scenario.dt_ns
        plant.step(time_ns, u, injector.step(time_ns, *plant.motion, u))
    Path(record).write_text(json.dumps(measured), encoding="utf-8")
    rclpy.shutdown()


if __name__ == "__main__":
    main(sys.argv[1], int(sys.argv[2]), sys.argv[3])
