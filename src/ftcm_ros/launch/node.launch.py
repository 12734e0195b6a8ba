# SPDX-License-Identifier: Apache-2.0
"""One node of the suite, as ``ros2 run`` starts it, to be included in launch files of your own.

ros2 launch ftcm_ros node.launch.py node:=plant scenario:=paper mode:=lockstep
"""

from __future__ import annotations

from launch import LaunchContext, LaunchDescription, LaunchDescriptionEntity
from launch.actions import DeclareLaunchArgument, OpaqueFunction
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node

from ftcm_ros.parameters.node_parameters import ALL_NODES
from ftcm_ros.run.launching import NODE_ARGUMENTS, single


def begin(context: LaunchContext) -> list[LaunchDescriptionEntity]:
    """Return the action that starts the node."""
    process = single({a.name: LaunchConfiguration(a.name).perform(context) for a in NODE_ARGUMENTS})
    return [
        Node(
            package="ftcm_ros", executable=process.executable, parameters=[*process.parameters],
            output="screen", sigterm_timeout="60",
        )
    ]  # fmt: skip


def generate_launch_description() -> LaunchDescription:
    """Declare the arguments, and what is done with them."""
    which, *others = NODE_ARGUMENTS
    return LaunchDescription(
        [
            DeclareLaunchArgument(which.name, description=which.description, choices=[*ALL_NODES]),
            *(DeclareLaunchArgument(a.name, default_value="", description=a.description) for a in others),
            OpaqueFunction(function=begin),
        ]
    )
