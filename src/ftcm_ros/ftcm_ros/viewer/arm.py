# SPDX-License-Identifier: Apache-2.0
"""A robot as bodies to be drawn, from nothing but its forward kinematics. No ROS, and no viewer.

A link goes from its joint's frame to the next one's: away from the joint's axis, then along it. A joint is a
drum about its axis. Thickness follows the length of the arm.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import pairwise
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from ftcm_core.robots import Robot
from ftcm_core.robots.serial_chain import Frame
from ftcm_core.signals import Vector

Floats = npt.NDArray[np.float64]

THICK, THIN = 0.042, 0.026
"""Radius of the first and the last link; the arm is 1 long (chosen: it looks like an arm)."""
SIDES = 32
"""Corners of what is round."""
PEDESTAL = 0.4
"""How far below its base an arm stands whose first joint is in it; the arm is 1 long."""


class Mesh(NamedTuple):
    """Triangles."""

    vertices: Floats
    """One row of x, y, z each, m."""
    faces: npt.NDArray[np.uint32]
    """One row of three vertices each."""


class Rod(NamedTuple):
    """A cylinder with round ends."""

    start: Vector
    """m; likewise what follows."""
    end: Vector
    radius: float


class Drum(NamedTuple):
    """A cylinder about a z axis, with flat ends."""

    centre: Vector
    """m; likewise what follows."""
    radius: float
    half: float
    """Half its length."""


class Body(NamedTuple):
    """What stands still in a frame."""

    rods: tuple[Rod, ...]
    drum: Drum
    """Of a joint; of the base: its foot."""


class Drawing(NamedTuple):
    """What an arm is drawn with."""

    bodies: tuple[Body, ...]
    """First that of the base, then one in each joint's frame."""
    floor: float
    """Height of what it stands on, in the frame of the base, m."""
    reach: float
    """Length of the stretched arm, m."""


def drawing(robot: Robot, thickness: float = 1.0) -> Drawing | None:
    """Return what a robot is drawn with; None if it does not say where its joints are.

    Args:
        robot: the robot.
        thickness: factor on that of links and joints.
    """
    n = robot.joints
    frames = robot.forward_kinematics((0.0,) * n)
    if frames is None:
        return None
    origins = [np.array(frame.origin) for frame in frames]
    reach = float(sum(np.linalg.norm(b - a) for a, b in pairwise(origins))) or 1.0
    high = float(origins[0][2]) > 0.02 * reach
    floor = 0.0 if high else -PEDESTAL * reach
    radii = [thickness * reach * (THICK + (THIN - THICK) * j / max(1, n - 1)) for j in range(n)]
    foot = Drum((0.0, 0.0, floor + 0.3 * radii[0]), 2.4 * radii[0], 0.3 * radii[0])
    thick = 1.15 * radii[0]
    low = min(floor + thick, float(origins[0][2]))  # its round end is in the foot
    bodies = [Body((Rod((0.0, 0.0, low), tuple(origins[0].tolist()), thick),), foot)]
    for j, (frame, radius) in enumerate(zip(frames, radii)):
        far = seen_from(frame, frames[j + 1].origin)
        corner = (far[0], far[1], 0.0)
        bent = min(math.hypot(*corner), abs(far[2])) > 0.02 * reach
        ends = [(0.0, 0.0, 0.0), corner, far] if bent else [(0.0, 0.0, 0.0), far]
        rods = [Rod(a, b, radius) for a, b in pairwise(ends)]
        if slides(robot, j):
            rods.append(Rod((0.0, 0.0, -0.3 * reach), (0.0, 0.0, 0.0), 0.6 * radius))
        bodies.append(Body(tuple(rods), Drum((0.0, 0.0, 0.0), 1.4 * radius, 1.5 * radius)))
    return Drawing(tuple(bodies), floor, reach)


def slides(robot: Robot, joint: int) -> bool:
    """Whether a joint, numbered from 0, slides: its frame's origin goes along with it."""
    q = [0.0] * robot.joints
    before = (robot.forward_kinematics(tuple(q)) or ())[joint]
    q[joint] = 1.0
    after = (robot.forward_kinematics(tuple(q)) or ())[joint]
    return math.dist(before.origin, after.origin) > 0.5


def seen_from(frame: Frame, place: Vector) -> Vector:
    """A place given in the frame of the base, in another frame, m."""
    away = [a - b for a, b in zip(place, frame.origin)]
    return tuple([sum(a * b for a, b in zip(away, axis)) for axis in (frame.x, frame.y, frame.z)])


def quaternion(frame: Frame) -> tuple[float, float, float, float]:
    """Rotation of a frame as w, x, y, z, w not negative."""
    (a, d, g), (b, e, h), (c, f, i) = frame.x, frame.y, frame.z
    squares = (1.0 + a + e + i, 1.0 + a - e - i, 1.0 - a + e - i, 1.0 - a - e + i)
    largest = max(range(4), key=squares.__getitem__)
    rows = (
        (squares[0], h - f, c - g, d - b),
        (h - f, squares[1], b + d, c + g),
        (c - g, b + d, squares[2], f + h),
        (d - b, c + g, f + h, squares[3]),
    )
    row = rows[largest]
    length = math.copysign(math.hypot(*row), row[0])
    w, x, y, z = [value / length for value in row]
    return w, x, y, z


# ---- triangles ----


def rods_mesh(rods: Sequence[Rod]) -> Mesh:
    """Return the surface of rods, as one."""
    return _joined([_rod(*rod) for rod in rods])


def drum_mesh(drum: Drum) -> Mesh:
    """Return the surface of a drum, whose edges are broken a little."""
    centre, radius, half = drum
    edge = 0.15 * min(radius, half)
    side = [(0.0, -half), (radius - edge, -half), (radius, edge - half)]
    profile = [*side, *[(r, -z) for r, z in reversed(side)]]
    sharp = [corner for corner in profile for _ in range(2)][1:-1]  # each twice: no shading across an edge
    return _turned(sharp, centre, (0.0, 0.0, 1.0))


def _rod(start: Vector, end: Vector, radius: float) -> Mesh:
    length = math.dist(start, end)
    quarter = [math.pi / 2 * k / (SIDES // 4) for k in range(SIDES // 4 + 1)]
    profile = [(radius * math.sin(a), -radius * math.cos(a)) for a in quarter]
    profile += [(radius * math.cos(a), length + radius * math.sin(a)) for a in quarter]
    return _turned(profile, start, [b - a for a, b in zip(start, end)] if length else (0.0, 0.0, 1.0))


def _turned(profile: Sequence[tuple[float, float]], start: Vector, axis: Sequence[float]) -> Mesh:
    """A solid of revolution: its profile (distance from the axis, place along it) turned about the axis."""
    direction = np.array(axis) / np.linalg.norm(axis)
    side = np.cross(direction, np.eye(3)[np.argmin(np.abs(direction))])
    side /= np.linalg.norm(side)
    angles = np.linspace(0.0, 2.0 * math.pi, SIDES, endpoint=False)
    around = np.outer(np.cos(angles), side) + np.outer(np.sin(angles), np.cross(direction, side))
    rings = [np.array(start) + radius * around + along * direction for radius, along in profile]
    faces = []
    for k in range(len(profile) - 1):
        if profile[k] == profile[k + 1]:
            continue
        for i in range(SIDES):
            a, b = k * SIDES + i, k * SIDES + (i + 1) % SIDES
            faces += [(a, b, b + SIDES), (a, b + SIDES, a + SIDES)]
    return Mesh(np.concatenate(rings), np.array(faces, dtype=np.uint32))


def _joined(meshes: Sequence[Mesh]) -> Mesh:
    """Several meshes as one."""
    before = np.cumsum([0, *[len(mesh.vertices) for mesh in meshes]])
    faces = [mesh.faces + np.uint32(first) for mesh, first in zip(meshes, before)]
    return Mesh(np.concatenate([mesh.vertices for mesh in meshes]), np.concatenate(faces))
