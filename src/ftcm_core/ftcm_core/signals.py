# SPDX-License-Identifier: Apache-2.0
"""The signals that cross a tick, their units and sign conventions.

Everything is SI and in joint space; a vector has one entry per joint.

- tracking error ``e = q - q_ref`` (rad), velocity error ``de = v - v_ref`` (rad/s);
- torques are joint torques in N·m; ``disturbance`` is what is *added* to the plant's input torque
  (faults minus friction and disturbance), so that ``M a + h + G = u + disturbance``;
- the lumped uncertainty of the paper, ``Delta = M^-1 (F_d - psi omega)`` (rad/s², eq 6), crosses
  as the torque ``tau_hat = M(q) Delta_hat`` (N·m): it estimates ``-disturbance``.
"""

from __future__ import annotations

from typing import NamedTuple

Vector = tuple[float, ...]
State = tuple[Vector, ...]
"""What a controller remembers: one small tuple of floats per joint."""

NANOSECONDS = 1_000_000_000


class Measurement(NamedTuple):
    """What the plant publishes at tick k (``joint_states``)."""

    position: Vector
    """Joint positions q_k, rad."""
    velocity: Vector
    """Joint velocities, rad/s."""
    effort: Vector
    """Torque the drive applied over the tick that ended at t_k, after limits, N·m; zero at k = 0."""


class ReferencePoint(NamedTuple):
    """Desired motion at tick k (``reference``)."""

    position: Vector
    """rad"""
    velocity: Vector
    """rad/s"""
    acceleration: Vector
    """rad/s²"""


class TrueDisturbance(NamedTuple):
    """Ground truth: the torque the injector adds. No controller or observer accepts this type."""

    torque: Vector
    """Added joint torque, N·m."""


def seconds(nanoseconds: int) -> float:
    """Time of an integer stamp, s: correctly rounded, the same in process and in a node."""
    return nanoseconds / NANOSECONDS


def saturate(torque: Vector, limits: Vector | None) -> Vector:
    """Clip a torque command to the drive's limits.

    Args:
        torque: commanded joint torques, N·m.
        limits: largest absolute torque per joint, N·m; None means no limit.

    Returns:
        The torque the drive applies, N·m.
    """
    if limits is None:
        return torque
    return tuple(max(-lim, min(lim, u)) for u, lim in zip(torque, limits))
