# SPDX-License-Identifier: Apache-2.0
"""Whom a process of the suite talks to, where the environment does not say."""

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
    """Keep this process, and those it starts, to this machine unless the user has said otherwise.

    The settings of the middleware, too, are the suite's unless the user names others.
    With security, also keep it from running unsecured where something is missing, as ROS does by default.

    Returns:
        What is set, as ``NAME=value`` words.
    """
    os.environ.setdefault("FASTRTPS_DEFAULT_PROFILES_FILE", str(PROFILES))
    os.environ.setdefault("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    if secured():
        os.environ.setdefault("ROS_SECURITY_STRATEGY", "Enforce")
    return " ".join(f"{name}={os.environ[name]}" for name in SHOWN if os.environ.get(name))
