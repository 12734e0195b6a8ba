# SPDX-License-Identifier: Apache-2.0
"""What ``ftcm doctor`` says of ROS. It works where ROS does not: nothing of it is imported here."""

from __future__ import annotations

import os
import shutil
from pathlib import Path

import ftcm_ros
from ftcm_core.cli.doctor import MISSING, OK, WARNING, Finding, importing, package, suite_package, version_of
from ftcm_ros.transport.network import SHOWN, middlewares

NEEDED = {"mcap": "1.2", "psutil": "5.9.8", "rosbags": "0.11.9"}
"""What runs over the graph need from the package index, with the oldest version, as in ``setup.py``."""
MESSAGES = (
    "builtin_interfaces", "diagnostic_msgs", "lifecycle_msgs", "rcl_interfaces", "rosgraph_msgs",
    "sensor_msgs", "std_msgs", "trajectory_msgs",
)  # fmt: skip
"""Packages of messages that the nodes use."""
DISTRIBUTION, MIDDLEWARE = "jazzy", "rmw_fastrtps_cpp"
"""What the suite was made for and is tested with."""
GET_ROS = (
    "source /opt/ros/jazzy/setup.bash, or python -m pip install 'ros-jazzy-rclpy[fastrtps]' "
    "ros-jazzy-common-interfaces"
)


def examine() -> list[Finding]:
    """Examine what runs over the ROS graph need."""
    version, folder = ftcm_ros.__version__, Path(ftcm_ros.__file__).parent
    return [
        suite_package("ftcm_ros", f"{version} ({folder})", needed=False),
        *(package(name, oldest, needed=False) for name, oldest in NEEDED.items()),
        *ros(),
        middleware(),
        network(),
        command_line(),
    ]


def ros() -> list[Finding]:
    """ROS 2, of which world it is, and the messages."""
    wheel, sourced = version_of(f"ros-{DISTRIBUTION}-rclpy"), os.environ.get("ROS_DISTRO", "")
    reasons = importing(["rclpy", *(f"{name}.msg" for name in MESSAGES), "std_srvs.srv"])
    if (why := reasons.pop("rclpy", None)) is not None:
        return [Finding("ROS 2", MISSING, f"rclpy cannot be imported: {why}", GET_ROS)]
    world = f"sourced ({sourced})" if sourced else f"{DISTRIBUTION} from the package index"
    version = wheel if wheel and not sourced else version_of("rclpy")
    value = f"{world}, rclpy {version}".removesuffix(", rclpy ")
    found = Finding("ROS 2", OK, value)
    if sourced and sourced != DISTRIBUTION:
        found = Finding("ROS 2", WARNING, value, f"tested with {DISTRIBUTION} only")
    if not reasons:
        return [found, Finding("messages", OK, f"{len(MESSAGES) + 1} packages")]
    names = ", ".join(sorted(name.partition(".")[0] for name in reasons))
    return [found, Finding("messages", MISSING, f"cannot be imported: {names}", GET_ROS)]


def middleware() -> Finding:
    """The middleware that ROS would use."""
    wanted, there = os.environ.get("RMW_IMPLEMENTATION"), middlewares()
    if not there:
        return Finding("middleware", MISSING, "none is installed", GET_ROS)
    names = ", ".join(sorted(there))
    if wanted and wanted not in there:
        advice = "unset it, or install the other"
        return Finding("middleware", MISSING, f"RMW_IMPLEMENTATION={wanted}, but there is {names}", advice)
    if wanted and wanted != MIDDLEWARE:
        return Finding(
            "middleware", WARNING, f"RMW_IMPLEMENTATION={wanted}", f"tested with {MIDDLEWARE} only"
        )
    if MIDDLEWARE not in there:
        return Finding("middleware", WARNING, names, f"tested with {MIDDLEWARE} only")
    return Finding("middleware", OK, MIDDLEWARE if wanted or len(there) == 1 else f"{MIDDLEWARE}, of {names}")


def network() -> Finding:
    """Whom nodes started by hand reach; ``experiment`` has a domain of its own."""
    domain = os.environ.get("ROS_DOMAIN_ID", "0")
    said = [f"{name}={os.environ[name]}" for name in SHOWN if os.environ.get(name)]
    if "ROS_AUTOMATIC_DISCOVERY_RANGE" not in os.environ:
        said.insert(0, "ROS_AUTOMATIC_DISCOVERY_RANGE=LOCALHOST (the nodes' default; other programs: SUBNET)")
    return Finding("network", OK, " ".join([f"ROS_DOMAIN_ID={domain}", *said]))


def command_line() -> Finding:
    """The command ``ros2``, and its verb ``launch``."""
    where = shutil.which("ros2")
    if where is None:
        advice = (
            "only ros2 run, launch and the like need it; the package index has none: the programs are in "
            "install/ftcm_ros/lib/ftcm_ros"
        )
        return Finding("ros2", MISSING, "not on the PATH", advice)
    if importing(["ros2launch.command.launch"]):
        return Finding("ros2", WARNING, f"{where}, without the verb launch", "install ros-jazzy-ros2launch")
    return Finding("ros2", OK, where)
