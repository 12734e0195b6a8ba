# SPDX-License-Identifier: Apache-2.0
"""What drives and joints allow. Motion beyond a limit ends the run."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

from ftcm_core.numeric import holds
from ftcm_core.signals import Vector


class Limits(NamedTuple):
    """One number per joint each; None: no limit."""

    torque: Vector | None = None
    """Largest torque, N·m."""
    torque_step: Vector | None = None
    """Largest change of the torque from one tick to the next, N·m."""
    velocity: Vector | None = None
    """Largest speed, rad/s."""
    lower: Vector | None = None
    """Smallest position, rad."""
    upper: Vector | None = None
    """Largest position, rad."""


def command_beyond(limits: Limits, names: Sequence[str], previous: Vector, u: Vector) -> str:
    """Say which joint's command the drives cannot follow; empty if they can.

    Args:
        limits: of the robot.
        names: of the joints.
        previous: command of the tick before, N·m.
        u: command, N·m.
    """
    if limits.torque is not None:
        for name, x, most in zip(names, u, limits.torque):
            if abs(x) > most:
                return f"{name}: torque {x:g} N·m is beyond its limit of {most:g} N·m"
    if limits.torque_step is not None:
        for name, x, p, most in zip(names, u, previous, limits.torque_step):
            if abs(x - p) > most:
                return f"{name}: torque step {x - p:g} N·m is beyond its limit of {most:g} N·m per tick"
    return ""


def motion_beyond(limits: Limits, names: Sequence[str], position: Vector, velocity: Vector) -> str:
    """Say which joint is beyond its limits; empty if none is.

    Args:
        limits: of the robot.
        names: of the joints.
        position: rad.
        velocity: rad/s.
    """
    if limits.velocity is not None:
        for name, x, most in zip(names, velocity, limits.velocity):
            if not holds(abs(x) <= most):
                return f"{name}: velocity {x:g} rad/s is beyond its limit of {most:g} rad/s"
    if limits.lower is not None:
        for name, x, least in zip(names, position, limits.lower):
            if not holds(x >= least):
                return f"{name}: position {x:g} rad is below its limit of {least:g} rad"
    if limits.upper is not None:
        for name, x, most in zip(names, position, limits.upper):
            if not holds(x <= most):
                return f"{name}: position {x:g} rad is above its limit of {most:g} rad"
    return ""
