# SPDX-License-Identifier: Apache-2.0
"""One run of a scenario over the graph, recorded: its nodes, and who drives them. It ends with the run.

ros2 launch ftcm_ros experiment.launch.py scenario:=paper controller:=ftcm bag:=mybag
"""

from __future__ import annotations

from pathlib import Path

import launch.logging
from launch import LaunchContext, LaunchDescription, LaunchDescriptionEntity
from launch.actions import DeclareLaunchArgument, LogInfo, OpaqueFunction, Shutdown
from launch.events.process import ProcessExited
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node

from ftcm_ros.run.launching import EXPERIMENT_ARGUMENTS, Process, experiment, shown_default

CLOSE_SECONDS = "60"
"""How long a process may take to end when it is asked to: the recorder reads the whole bag again."""


def start(process: Process, driver: str) -> Node:
    """Return the action that starts a process; when it ends, everything ends.

    Args:
        process: what is started.
        driver: name of the process whose end, with status 0, is that of the run.
    """
    name = process.executable

    def ended(event: ProcessExited, context: LaunchContext) -> list[LaunchDescriptionEntity] | None:
        if context.is_shutdown:
            return None
        if name == driver and event.returncode == 0:
            return [Shutdown(reason="the run has ended")]
        raise RuntimeError(f"{name} has ended with status {event.returncode} before the run has")

    return Node(
        package="ftcm_ros", executable=name, arguments=[*process.arguments], parameters=[*process.parameters],
        output="screen", sigterm_timeout=CLOSE_SECONDS, on_exit=ended,
    )  # fmt: skip


def begin(context: LaunchContext) -> list[LaunchDescriptionEntity]:
    """Return what is started with these arguments."""
    given = {a.name: LaunchConfiguration(a.name).perform(context) for a in EXPERIMENT_ARGUMENTS}
    found = experiment(given, Path(launch.logging.launch_config.log_dir))
    names = [process.executable for process in found.nodes]
    law = found.scenario.controller.type_name
    return [
        LogInfo(
            msg=f"{found.scenario.name} with {law}, {given['mode']}: {', '.join(names)}; bag {found.bag}"
        ),
        *(start(process, found.driver.executable) for process in (*found.nodes, found.driver)),
    ]


def generate_launch_description() -> LaunchDescription:
    """Declare the arguments, and what is done with them."""
    declared = [
        DeclareLaunchArgument(
            a.name, default_value=shown_default(a), description=a.description, choices=[*a.choices] or None
        )
        for a in EXPERIMENT_ARGUMENTS
    ]
    return LaunchDescription([*declared, OpaqueFunction(function=begin)])
