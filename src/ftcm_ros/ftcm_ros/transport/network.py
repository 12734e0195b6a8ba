# SPDX-License-Identifier: Apache-2.0
"""The network settings of a process: which processes it can reach, unless the environment says so."""

from __future__ import annotations

import os
import sys
from pathlib import Path

PROFILES = Path(__file__).with_name("fastdds.xml")
"""Settings of Fast DDS."""
VIEWER_PROFILES = Path(__file__).with_name("fastdds_viewer.xml")
"""Those of what only looks at a run: it can keep no node waiting."""
SHOWN = (
    "ROS_AUTOMATIC_DISCOVERY_RANGE",
    "ROS_STATIC_PEERS",
    "ROS_LOCALHOST_ONLY",
    "ROS_SECURITY_ENABLE",
    "ROS_SECURITY_STRATEGY",
)
"""Variables that decide who takes part, besides the domain."""


def require_middleware() -> None:
    """End the process with one line if ``RMW_IMPLEMENTATION`` names a middleware that is not there.

    ROS itself would end it while rclpy is imported, in words of its own.

    Raises:
        SystemExit: it is not there.
    """
    wanted, there = os.environ.get("RMW_IMPLEMENTATION"), middlewares()
    if wanted and there and wanted not in there:
        print(
            f"ftcm_ros: error: RMW_IMPLEMENTATION={wanted}: no such middleware here; there is "
            f"{', '.join(sorted(there))}; unset it, or install the other",
            file=sys.stderr,
        )
        raise SystemExit(2)


def middlewares() -> set[str]:
    """Return the names of the middlewares that are installed, as the index of packages tells them."""
    prefixes = [*filter(None, os.environ.get("AMENT_PREFIX_PATH", "").split(os.pathsep)), sys.prefix]
    index = [Path(prefix, "share", "ament_index", "resource_index", "rmw_typesupport") for prefix in prefixes]
    there = {file.name for folder in index if folder.is_dir() for file in folder.iterdir()}
    return there - {"rmw_implementation"}


def secured() -> bool:
    """Whether the environment asks for SROS2; ROS compares with exactly this word."""
    return os.environ.get("ROS_SECURITY_ENABLE") == "true"


def enclave(name: str) -> list[str]:
    """Return the ROS arguments that give a process of the suite its identity; none without security."""
    return ["--enclave", f"/ftcm/{name}"] if secured() else []


def set_defaults(profiles: Path = PROFILES) -> str:
    """Set the network settings of this process and of those it starts, unless the user has set them.

    They then reach this machine only, and use the suite's settings of the middleware. With security, a
    process for which something is missing does not start; by default ROS would start it unsecured.

    Args:
        profiles: settings of Fast DDS.

    Returns:
        What is set, as ``NAME=value`` words.
    """
    os.environ.setdefault("FASTRTPS_DEFAULT_PROFILES_FILE", str(profiles))
    os.environ.setdefault("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    if secured():
        os.environ.setdefault("ROS_SECURITY_STRATEGY", "Enforce")
    return " ".join(f"{name}={os.environ[name]}" for name in SHOWN if os.environ.get(name))
