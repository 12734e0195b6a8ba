# SPDX-License-Identifier: Apache-2.0
"""The command ``composed``: the nodes of a tick in one process (:mod:`~ftcm_ros.transport.composed`)."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence

from rclpy.utilities import remove_ros_args

from ftcm_ros.nodes.controller import ControllerNode
from ftcm_ros.nodes.detector import DetectorNode
from ftcm_ros.nodes.injector import InjectorNode
from ftcm_ros.nodes.main import run
from ftcm_ros.nodes.observer import ObserverNode
from ftcm_ros.nodes.plant import PlantNode
from ftcm_ros.nodes.suite_node import SuiteNode
from ftcm_ros.transport.composed import Composition

CLASSES = {
    "plant": PlantNode,
    "observer": ObserverNode,
    "controller": ControllerNode,
    "injector": InjectorNode,
    "detector": DetectorNode,
}
"""What can be composed, in the order of a tick."""


def compose(names: Sequence[str]) -> list[SuiteNode]:
    """Make the nodes of one process.

    Args:
        names: which; none: those that a run of the scenario has. The plant, if there, is the first.
    """
    composition = Composition()
    nodes: list[SuiteNode] = []
    for name, cls in CLASSES.items():
        wanted = name in names if names else name != "detector" or nodes[0].scenario.detector is not None
        if wanted:
            nodes.append(cls(composition))
    return nodes


def main() -> None:
    """Entry point of ``ros2 run ftcm_ros composed``."""
    parser = argparse.ArgumentParser(
        prog="composed",
        description="Run several nodes of the suite in one process; ROS arguments follow after "
        "--ros-args. The recorder is a process of its own.",
    )
    parser.add_argument(
        "--nodes", nargs="+", choices=[*CLASSES], default=[], metavar="NODE",
        help="which of " + ", ".join(CLASSES) + "; default: all, a detector where the scenario has one",
    )  # fmt: skip
    options = parser.parse_args(remove_ros_args(sys.argv)[1:])
    sys.exit(run(lambda: compose(options.nodes), "composed"))


if __name__ == "__main__":
    main()
