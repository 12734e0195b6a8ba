# SPDX-License-Identifier: Apache-2.0
"""A robot as the text of a URDF file, for robot_state_publisher and RViz. No ROS.

That of its own file where this has something to see; else made from its forward kinematics, of the links and
drums that the page in the browser shows.
"""

from __future__ import annotations

import math
import re
import xml.etree.ElementTree as ET
from typing import NamedTuple

from ftcm_core.errors import FtcmError
from ftcm_core.robots import Robot
from ftcm_core.robots.serial_chain import Frame
from ftcm_core.robots.urdf import Urdf
from ftcm_core.robots.urdf_file import Matrix, along, applied, locate, multiplied, transposed
from ftcm_core.signals import Vector
from ftcm_ros.viewer.arm import Body, drawing, slides

WORLD = "world"
"""Frame in which everything stands."""
STATES, REFERENCE_STATES, MARKERS = "viewer/joint_states", "viewer/reference", "viewer/markers"
"""Topics of what is published for RViz."""
BASE = "base"
"""Name of the first link of what is made here."""
FAR = "1000"
"""A limit of joints that slide, m: a URDF must have one."""
COLOUR = "0.80 0.84 0.88 1"


class Description(NamedTuple):
    """A robot for robot_state_publisher."""

    text: str
    """Of a URDF file."""
    root: str
    """Name of its first link."""


def description(robot: Robot) -> Description:
    """Return what is seen of a robot.

    Raises:
        FtcmError: it does not say where its joints are.
    """
    if isinstance(robot, Urdf):
        text = locate(robot.file).read_text("utf-8")
        if "<visual" in text:
            return Description(text, _root(text))
    shape, frames = drawing(robot), robot.forward_kinematics((0.0,) * robot.joints)
    if shape is None or frames is None:
        raise FtcmError(
            f"robot {robot.type_name!r} cannot be drawn; expected one that says where its joints are "
            "(forward_kinematics)"
        )
    root = ET.Element("robot", name=robot.type_name)
    names = (BASE, *(f"{name}_link" for name in robot.joint_names))
    for name, body in zip(names, shape.bodies):
        root.append(_link(name, body))
    before = Frame((0.0, 0.0, 0.0), (1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))
    for j, (name, frame) in enumerate(zip(robot.joint_names, frames)):
        kind = "prismatic" if slides(robot, j) else "continuous"
        joint = ET.SubElement(root, "joint", name=name, type=kind)
        back = (before.x, before.y, before.z)
        away = tuple([a - b for a, b in zip(frame.origin, before.origin)])
        turn = multiplied(back, transposed((frame.x, frame.y, frame.z)))
        joint.append(_origin(applied(back, away), turn))
        ET.SubElement(joint, "parent", link=names[j])
        ET.SubElement(joint, "child", link=names[j + 1])
        ET.SubElement(joint, "axis", xyz="0 0 1")
        if kind == "prismatic":
            ET.SubElement(joint, "limit", lower=f"-{FAR}", upper=FAR, effort=FAR, velocity=FAR)
        before = frame
    ET.indent(root)
    return Description(ET.tostring(root, encoding="unicode") + "\n", BASE)


def _root(text: str) -> str:
    """Name of the link of a file that hangs on no joint."""
    tree = ET.fromstring(re.sub(r"^\s*<\?xml[^>]*\?>", "", text))
    children = {child.get("link") for child in tree.iterfind("joint/child")}
    return next(str(link.get("name")) for link in tree.iterfind("link") if link.get("name") not in children)


def _link(name: str, body: Body) -> ET.Element:
    link = ET.Element("link", name=name)
    for start, end, radius in body.rods:
        length = math.dist(start, end)
        middle = tuple([0.5 * (a + b) for a, b in zip(start, end)])
        if length:
            turn = along(tuple([b - a for a, b in zip(start, end)]))
            _visual(link, middle, turn, "cylinder", radius=radius, length=length)
        for place in (start, end):
            _visual(link, place, along((0.0, 0.0, 1.0)), "sphere", radius=radius)
    centre, radius, half = body.drum
    _visual(link, centre, along((0.0, 0.0, 1.0)), "cylinder", radius=radius, length=2.0 * half)
    return link


def _visual(link: ET.Element, place: Vector, turn: Matrix, shape: str, **sizes: float) -> None:
    visual = ET.SubElement(link, "visual")
    visual.append(_origin(place, turn))
    ET.SubElement(ET.SubElement(visual, "geometry"), shape, {k: repr(v) for k, v in sizes.items()})
    ET.SubElement(ET.SubElement(visual, "material", name="arm"), "color", rgba=COLOUR)


def _origin(place: Vector, turn: Matrix) -> ET.Element:
    """A place, and a rotation as turns about the fixed x, y, z."""
    (a, _, _), (d, e, f), (g, h, i) = turn
    across = math.hypot(a, d)
    pitch = math.atan2(-g, across)
    if across > 1e-9:
        roll, yaw = math.atan2(h, i), math.atan2(d, a)
    else:  # x and z have become one
        roll, yaw = math.atan2(-f, e), 0.0
    return ET.Element("origin", xyz=" ".join(map(repr, place)), rpy=f"{roll!r} {pitch!r} {yaw!r}")
