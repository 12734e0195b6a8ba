# SPDX-License-Identifier: Apache-2.0
"""RViz for a run that is on or will be: the arm, the reference as a ghost, torques, faults and alarms.

ros2 launch ftcm_ros viewer.launch.py scenario:=paper
"""

from __future__ import annotations

from launch import LaunchContext, LaunchDescription, LaunchDescriptionEntity
from launch.actions import DeclareLaunchArgument, OpaqueFunction
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node

from ftcm_ros.run.launching import VIEWER_ARGUMENTS, shown_default, viewer


def begin(context: LaunchContext) -> list[LaunchDescriptionEntity]:
    """Return what is started with these arguments."""
    started = viewer({a.name: LaunchConfiguration(a.name).perform(context) for a in VIEWER_ARGUMENTS})
    return [
        Node(
            package=process.package, executable=process.executable, name=process.name, output="screen",
            arguments=[*process.arguments], parameters=[*process.parameters],
            remappings=[*process.remappings],
        )
        for process in started
    ]  # fmt: skip


def generate_launch_description() -> LaunchDescription:
    """Declare the arguments, and what is done with them."""
    declared = [
        DeclareLaunchArgument(
            a.name, default_value=shown_default(a), description=a.description, choices=[*a.choices] or None
        )
        for a in VIEWER_ARGUMENTS
    ]
    return LaunchDescription([*declared, OpaqueFunction(function=begin)])
