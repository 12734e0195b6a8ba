# SPDX-License-Identifier: Apache-2.0
"""The network settings of a process: which processes it can reach, unless the environment says so."""

from __future__ import annotations

import os
from pathlib import Path

PROFILES = Path(__file__).with_name("fastdds.xml")
"""Settings of Fast DDS."""
SHOWN = (
    "ROS_AUTOMATIC_DISCOVERY_RANGE",
    "ROS_STATIC_PEERS",
    "ROS_LOCALHOST_ONLY",
    "ROS_SECURITY_ENABLE",
    "ROS_SECURITY_STRATEGY",
)
"""Variables that decide who takes part, besides the domain."""


def secured() -> bool:
    """Whether the environment asks for SROS2; ROS compares with exactly this word."""
    return os.environ.get("ROS_SECURITY_ENABLE") == "true"


def enclave(name: str) -> list[str]:
    """Return the ROS arguments that give a process of the suite its identity; none without security."""
    return ["--enclave", f"/ftcm/{name}"] if secured() else []


def set_defaults() -> str:
    """Set the network settings of this process and of those it starts, unless the user has set them.

    They then reach this machine only, and use the suite's settings of the middleware. With security, a
    process for which something is missing does not start; by default ROS would start it unsecured.

    Returns:
        What is set, as ``NAME=value`` words.
    """
    os.environ.setdefault("FASTRTPS_DEFAULT_PROFILES_FILE", str(PROFILES))
    os.environ.setdefault("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    if secured():
        os.environ.setdefault("ROS_SECURITY_STRATEGY", "Enforce")
    return " ".join(f"{name}={os.environ[name]}" for name in SHOWN if os.environ.get(name))
