# SPDX-License-Identifier: Apache-2.0
"""A serial arm from a URDF file: its links as :mod:`~ftcm_core.robots.serial_chain` wants them.

Nothing but Python's own XML parser is needed. What does not move is folded into what carries it: links behind
fixed joints, and those behind joints that are not on the way to the tip, which are held at zero. What a file
has besides (shapes, limits of controllers, transmissions) is not looked at.
"""

from __future__ import annotations

import functools
import hashlib
import importlib.util
import math
import os
import re
import xml.etree.ElementTree as ET
from collections.abc import Iterator
from importlib import metadata
from pathlib import Path
from typing import NamedTuple

from ftcm_core.errors import ParameterError, shown, suggestion
from ftcm_core.robots.serial_chain import Body, Link
from ftcm_core.signals import Vector

PACKAGE = "package:"
MAX_BYTES, MAX_LINKS = 10_000_000, 500
MOVING = ("revolute", "continuous", "prismatic")
"""Types of joints that a chain may have, besides fixed ones."""

files_read: dict[str, str] = {}
"""Files read so far, as they were named, and the begin of the SHA-256 of each: the origin of a result."""

Matrix = tuple[Vector, Vector, Vector]
UNIT: Matrix = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))
ZERO: Vector = (0.0, 0.0, 0.0)


class Joint(NamedTuple):
    """A joint as the file has it."""

    name: str
    type: str
    parent: str
    child: str
    rotation: Matrix
    """Of the child's frame in the parent's, at zero."""
    origin: Vector
    """m."""
    axis: Vector
    """In the child's frame, as written."""
    mimics: bool
    damping: float
    """N·m·s/rad, or N·s/m."""
    friction: float
    """N·m, or N."""
    effort: float | None
    """Largest torque, N·m, or force, N; None where the file says nothing, likewise below."""
    velocity: float | None
    """Largest speed, rad/s or m/s."""
    lower: float | None
    """Smallest position, rad or m."""
    upper: float | None
    """Largest position, rad or m."""


class Arm(NamedTuple):
    """A serial arm."""

    joints: tuple[Joint, ...]
    """Those that move, from the base to the tip."""
    links: tuple[Link, ...]
    base_turn: float
    """Turn about z of the frame that the first link is seen from, in that of the file's first link, rad."""
    tip: Vector
    """Origin of the tip in the frame of the last joint, m."""
    tip_axis: Vector
    """Its z axis there."""


# ---- finding the file ----


def locate(file: str) -> Path:
    """Return the path of a file, or of ``package:NAME/path``, the file of an installed package.

    NAME is an importable package, the name under which a package was installed, or a ROS package of a sourced
    workspace. Of an installed package the last part of the path is enough.

    Raises:
        ParameterError: there is no such package or file.
    """
    if not file.startswith(PACKAGE):
        return Path(file)
    name, _, rest = file.removeprefix(PACKAGE).lstrip("/").partition("/")
    if not re.fullmatch(r"\w[\w.-]*", name) or not rest:
        raise ParameterError(f"{shown(file)} names no file of a package; expected package:NAME/path")
    known = False
    for folder in _folders(name):
        known = True
        if (folder / rest).is_file():
            return folder / rest
    try:
        distribution = metadata.distribution(name)
    except (metadata.PackageNotFoundError, ValueError):
        if known:
            raise ParameterError(f"{shown(file)}: package {shown(name)} has no file {shown(rest)}") from None
        raise ParameterError(
            f"{shown(file)}: no package {shown(name)} is installed here; pip install it, or name a path"
        ) from None
    ends = [x for x in distribution.files or [] if f"/{x.as_posix()}".endswith(f"/{rest}")]
    if not ends:
        raise ParameterError(f"{shown(file)}: package {shown(name)} has no file {shown(rest)}")
    if len(ends) > 1:
        raise ParameterError(
            f"{shown(file)}: package {shown(name)} has {len(ends)} such files, e.g. {shown(str(ends[0]))} "
            f"and {shown(str(ends[1]))}; write more of the path"
        )
    return Path(str(distribution.locate_file(ends[0])))


def _folders(name: str) -> Iterator[Path]:
    """Folders in which a package of that name may have its files."""
    try:
        spec = importlib.util.find_spec(name) if name.isidentifier() else None
    except (ImportError, ValueError):
        spec = None
    yield from map(Path, (spec and spec.submodule_search_locations) or [])
    for prefix in os.environ.get("AMENT_PREFIX_PATH", "").split(os.pathsep):
        if prefix and (folder := Path(prefix, "share", name)).is_dir():
            yield folder


def read_arm(file: str, tip: str | None) -> Arm:
    """Read an arm; what was read is kept as long as the file does not change.

    Args:
        file: as of :func:`locate`.
        tip: link at the end of the chain; the last one that a joint moves, if None.

    Raises:
        ParameterError: it cannot be read, or is no serial arm.
    """
    path = locate(file)
    try:
        about = path.stat()
        arm, files_read[file] = _read(str(path), tip, about.st_mtime_ns, about.st_size)
        return arm
    except FileNotFoundError:
        raise ParameterError(f"{shown(file)}: no such file; expected a URDF file") from None
    except (OSError, ValueError) as error:
        reason = getattr(error, "strerror", None) or str(error)
        raise ParameterError(f"{shown(file)} cannot be read: {reason}; expected a URDF file") from None


@functools.lru_cache(maxsize=64)
def _read(path: str, tip: str | None, changed: int, size: int) -> tuple[Arm, str]:
    del changed  # another time of change is another entry
    if size > MAX_BYTES:
        raise ParameterError(f"{path}: larger than {MAX_BYTES} bytes; expected a URDF file")
    if not Path(path).is_file():
        raise ParameterError(f"{path}: not a regular file; expected a URDF file")
    try:
        text = Path(path).read_bytes()
        return parse_arm(text, tip), hashlib.sha256(text).hexdigest()[:12]
    except ParameterError as error:
        raise ParameterError(f"{shown(path)}: {error}") from None


# ---- the file's text ----


def parse_arm(text: bytes, tip: str | None) -> Arm:
    """Make an arm of the text of a URDF file.

    Args:
        text: the file.
        tip: as of :func:`read_arm`.

    Raises:
        ParameterError: it is no URDF, or no serial arm.
    """
    try:
        if b"<!DOCTYPE" in text or b"<!ENTITY" in text:
            raise ParameterError("declares a document type or entities; expected plain URDF")
        root = ET.fromstring(text)
    except ET.ParseError as error:
        raise ParameterError(f"not XML: {error}; expected a URDF file") from None
    except (LookupError, ValueError) as error:  # an encoding that there is not
        raise ParameterError(f"not XML: {error}; expected a URDF file") from None
    if root.tag != "robot":
        hint = "; make a URDF of it with xacro" if "xacro" in root.tag else ""
        raise ParameterError(f"the first tag is {shown(root.tag)}; expected <robot>, as of a URDF{hint}")
    if any("ros.org/" in x.tag and "xacro" in x.tag for x in root.iter()):
        raise ParameterError("has xacro macros that are not expanded; make a URDF of it with xacro")
    bodies = {_name(x): _body(x) for x in _unique(root, "link")}
    joints = [_joint(x) for x in _unique(root, "joint")]
    above = _tree(bodies, joints)
    chain = _chain(joints, above, tip)
    return _arm(bodies, joints, chain)


def _unique(root: ET.Element, tag: str) -> list[ET.Element]:
    found = root.findall(tag)
    if len(found) > MAX_LINKS:
        raise ParameterError(f"{len(found)} {tag}s; expected an arm, with at most {MAX_LINKS}")
    names = [_name(x) for x in found]
    for name in names:
        if names.count(name) > 1:
            raise ParameterError(f"two {tag}s are named {shown(name)}; expected names of their own")
    return found


def _name(tag: ET.Element) -> str:
    name = tag.get("name", "")
    if not name:
        raise ParameterError(f"a <{tag.tag}> has no name")
    return name


def _numbers(tag: ET.Element | None, key: str, where: str, default: str) -> Vector:
    """The numbers of an attribute; as many as the default has."""
    text = default if tag is None else tag.get(key, default)
    try:
        values = tuple([float(x) for x in text.split()])
    except ValueError:
        values = ()
    count = len(default.split()) or 1
    if len(values) != count or not all(map(math.isfinite, values)):
        wanted = "a number" if count == 1 else f"{count} numbers"
        raise ParameterError(f"{where}: {key}={shown(text)}; expected {wanted}")
    return values


def _placement(tag: ET.Element, where: str) -> tuple[Matrix, Vector]:
    """Rotation and origin of an <origin>: the turns roll, pitch, yaw about x, y, z, in this order."""
    origin = tag.find("origin")
    roll, pitch, yaw = _numbers(origin, "rpy", where, "0 0 0")
    turn = multiplied(turned(2, yaw), multiplied(turned(1, pitch), turned(0, roll)))
    return turn, _numbers(origin, "xyz", where, "0 0 0")


def _body(link: ET.Element) -> Body:
    """What a link weighs, about its own origin."""
    where, tag = f"link {shown(_name(link))}", link.find("inertial")
    if tag is None:
        return Body(*(0.0,) * 10)
    rotation, centre = _placement(tag, where)
    (m,) = _numbers(tag.find("mass"), "value", where, "0")
    if m < 0.0:
        raise ParameterError(f"{where}: a mass of {m:g} kg; expected none below zero")
    inertia = tag.find("inertia")
    xx, yy, zz, xy, xz, yz = [
        _numbers(inertia, f"i{x}", where, "0")[0] for x in ("xx", "yy", "zz", "xy", "xz", "yz")
    ]
    return moved(Body(m, 0.0, 0.0, 0.0, xx, yy, zz, xy, xz, yz), rotation, centre)


def _joint(tag: ET.Element) -> Joint:
    name = _name(tag)
    where = f"joint {shown(name)}"
    ends = []
    for end in ("parent", "child"):
        found = tag.find(end)
        ends.append("" if found is None else found.get("link", ""))
        if not ends[-1]:
            raise ParameterError(f"{where}: has no {end} link")
    rotation, origin = _placement(tag, where)
    dynamics, limit = tag.find("dynamics"), tag.find("limit")

    def most(key: str) -> float | None:
        return _numbers(limit, key, where, "0")[0] if limit is not None and key in limit.attrib else None

    damping, friction = [_numbers(dynamics, key, where, "0")[0] for key in ("damping", "friction")]
    if min(damping, friction) < 0.0:
        raise ParameterError(f"{where}: damping {damping:g}, friction {friction:g}; expected none below zero")
    turns_on = tag.get("type") == "continuous"
    return Joint(
        name, tag.get("type", ""), ends[0], ends[1], rotation, origin,
        axis=_numbers(tag.find("axis"), "xyz", where, "1 0 0"),
        mimics=tag.find("mimic") is not None,
        damping=damping, friction=friction,
        effort=most("effort"), velocity=most("velocity"),
        lower=None if turns_on else most("lower"), upper=None if turns_on else most("upper"),
    )  # fmt: skip


# ---- the chain ----


def _tree(bodies: dict[str, Body], joints: list[Joint]) -> dict[str, Joint]:
    """Return the joint above each link; there is one link without, the base."""
    above: dict[str, Joint] = {}
    for joint in joints:
        for link in (joint.parent, joint.child):
            if link not in bodies:
                raise ParameterError(f"joint {shown(joint.name)}: no link {shown(link)}")
        if joint.child in above:
            raise ParameterError(
                f"link {shown(joint.child)} hangs on the joints {shown(above[joint.child].name)} and "
                f"{shown(joint.name)}; expected an arm without closed loops"
            )
        above[joint.child] = joint
    bases = [link for link in bodies if link not in above]
    if len(bases) != 1:
        raise ParameterError(
            f"{len(bases)} links hang on no joint{': ' if bases else ''}{', '.join(map(shown, bases[:4]))}; "
            "expected one, the base"
        )
    for link in bodies:  # every way up ends at the base
        seen = {link}
        while link in above:
            link = above[link].parent
            if link in seen:
                raise ParameterError(f"link {shown(link)} hangs on itself; expected an arm that has a base")
            seen.add(link)
    return above


def _way(above: dict[str, Joint], link: str) -> list[Joint]:
    """The joints from the base to a link."""
    found = []
    while link in above:
        found.append(above[link])
        link = above[link].parent
    return found[::-1]


def _chain(joints: list[Joint], above: dict[str, Joint], tip: str | None) -> list[Joint]:
    """The joints from the base to the tip, fixed ones too."""
    moving = [joint for joint in joints if joint.type != "fixed"]
    if tip is None:
        ways = [_way(above, joint.child) for joint in moving]
        chain = max(ways, key=lambda way: sum(x.type != "fixed" for x in way), default=[])
        beside = next((joint for joint in moving if joint not in chain), None)
        if beside is not None:
            raise ParameterError(
                f"joint {shown(beside.name)} is not on the way to {shown(chain[-1].child)}: the arm "
                "branches; name the link at the end of the arm as tip (other joints are then held at zero)"
            )
    else:
        links = {x for joint in joints for x in (joint.parent, joint.child)}
        if tip not in links:
            raise ParameterError(f"no link {shown(tip)}, which tip names; {suggestion(tip, links)}")
        chain = _way(above, tip)
    for joint in chain:
        if joint.type not in (*MOVING, "fixed"):
            raise ParameterError(
                f"joint {shown(joint.name)} is of type {shown(joint.type)}; expected revolute, continuous, "
                "prismatic or fixed"
            )
        if joint.mimics:
            raise ParameterError(
                f"joint {shown(joint.name)} mimics another one, which no joint on the way to the tip may; "
                "name a tip before it"
            )
        if joint.type != "fixed" and not any(joint.axis):
            raise ParameterError(f"joint {shown(joint.name)}: its axis is zero; expected a direction")
    if not any(joint.type != "fixed" for joint in chain):
        raise ParameterError(f"no joint moves {shown(tip) if tip else 'anything'}; expected an arm")
    return chain


def _arm(bodies: dict[str, Body], joints: list[Joint], chain: list[Joint]) -> Arm:
    """Make the arm: bodies folded together, and frames whose z axes are those of the joints."""
    moving = [joint for joint in chain if joint.type != "fixed"]
    below: dict[str, list[Joint]] = {}
    for joint in joints:
        below.setdefault(joint.parent, []).append(joint)

    def carried(link: str) -> Body:
        """A link and all that is fixed to it, about the link's origin."""
        total = bodies[link]
        for joint in below.get(link, []):
            if joint not in moving:
                total = plus(total, moved(carried(joint.child), joint.rotation, joint.origin))
        return total

    # Frames in the one before them, at zero: first those of the file, then those with z along the axis.
    steps: list[tuple[Matrix, Vector]] = []
    rotation, origin, before = UNIT, ZERO, UNIT
    for joint in chain:
        origin = added(origin, applied(rotation, joint.origin))
        rotation = multiplied(rotation, joint.rotation)
        if joint in moving:
            aligned = along(joint.axis)
            back = transposed(before)
            steps.append((multiplied(back, multiplied(rotation, aligned)), applied(back, origin)))
            rotation, origin, before = UNIT, ZERO, aligned
    back = transposed(before)
    tip_at, tip_axis = applied(back, origin), applied(back, column(rotation, 2))

    # A frame may be turned about its own z axis: so that the next one is turned about x, then about z.
    factors = [euler(step) for step, _ in steps]
    yaws = [yaw for yaw, _, _ in factors[1:]] + [0.0]
    links = []
    yaw_before = factors[0][0]
    for joint, (_, at), (_, alpha, theta), yaw in zip(moving, steps, factors, yaws):
        x, y, z = applied(turned(2, -yaw_before), at)
        turn = multiplied(turned(2, -yaw), transposed(along(joint.axis)))
        body = moved(carried(joint.child), turn, ZERO)
        slides = int(joint.type == "prismatic")
        links.append(Link(slides, theta + yaw, math.cos(alpha), math.sin(alpha), x, y, z, body))
        yaw_before = yaw
    return Arm(tuple(moving), tuple(links), factors[0][0], tip_at, tip_axis)


# ---- three dimensions ----


def turned(axis: int, angle: float) -> Matrix:
    """Rotation about x (0), y (1) or z (2)."""
    c, s = math.cos(angle), math.sin(angle)
    if axis == 0:
        return (1.0, 0.0, 0.0), (0.0, c, -s), (0.0, s, c)
    if axis == 1:
        return (c, 0.0, s), (0.0, 1.0, 0.0), (-s, 0.0, c)
    return (c, -s, 0.0), (s, c, 0.0), (0.0, 0.0, 1.0)


def along(axis: Vector) -> Matrix:
    """A rotation whose z axis is a direction: the smallest turn of z to it."""
    length = math.hypot(*axis)
    x, y, z = [a / length for a in axis]
    if z < 0.0:  # turned over first: away from where the smallest turn is not defined
        (a, b, c), (d, e, f), (g, h, i) = along((x, -y, -z))
        return (a, b, c), (-d, -e, -f), (-g, -h, -i)
    k = 1.0 / (1.0 + z)
    return (1.0 - k * x * x, -k * x * y, x), (-k * x * y, 1.0 - k * y * y, y), (-x, -y, z)


def euler(r: Matrix) -> tuple[float, float, float]:
    """Angles of a rotation as a turn about z, then about the new x, then about the new z, rad."""
    sine = math.hypot(r[0][2], r[1][2])
    first = math.atan2(r[0][2], -r[1][2]) if sine > 1e-15 else 0.0
    rest = multiplied(turned(2, -first), r)
    return first, math.atan2(-rest[1][2], rest[2][2]), math.atan2(-rest[0][1], rest[0][0])


def moved(body: Body, rotation: Matrix, origin: Vector) -> Body:
    """A body seen from another frame, in which its own stands at ``origin``, turned by ``rotation``."""
    m, mx, my, mz, xx, yy, zz, xy, xz, yz = body
    inertia: Matrix = ((xx, xy, xz), (xy, yy, yz), (xz, yz, zz))
    (xx, xy, xz), (_, yy, yz), (_, _, zz) = multiplied(multiplied(rotation, inertia), transposed(rotation))
    mx, my, mz = applied(rotation, (mx, my, mz))
    x, y, z = origin
    ax, ay, az = x * (2.0 * mx + m * x), y * (2.0 * my + m * y), z * (2.0 * mz + m * z)
    nx, ny, nz = mx + m * x, my + m * y, mz + m * z
    return Body(
        m, nx, ny, nz, xx + ay + az, yy + ax + az, zz + ax + ay,
        xy - x * ny - y * mx, xz - x * nz - z * mx, yz - y * nz - z * my,
    )  # fmt: skip


def plus(one: Body, other: Body) -> Body:
    """Two bodies as one, seen from the same frame."""
    return Body(*[a + b for a, b in zip(one, other)])


def added(a: Vector, b: Vector) -> Vector:
    """Sum of two vectors."""
    return tuple([x + y for x, y in zip(a, b)])


def column(m: Matrix, j: int) -> Vector:
    """A column of a matrix."""
    return m[0][j], m[1][j], m[2][j]


def applied(m: Matrix, x: Vector) -> Vector:
    """Product of a matrix and a vector."""
    a, b, c = x
    return tuple([row[0] * a + row[1] * b + row[2] * c for row in m])


def transposed(m: Matrix) -> Matrix:
    """The matrix with rows and columns swapped."""
    return column(m, 0), column(m, 1), column(m, 2)


def multiplied(a: Matrix, b: Matrix) -> Matrix:
    """Product of two matrices."""
    columns = [applied(a, column(b, j)) for j in range(3)]
    return transposed((columns[0], columns[1], columns[2]))
