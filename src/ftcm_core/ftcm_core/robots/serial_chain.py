# SPDX-License-Identifier: Apache-2.0
"""Dynamics of any serial chain of revolute and prismatic joints, in plain floats.

Every joint turns about, or slides along, the z axis of its own frame. Seen from the frame before it, that
frame stands at (x, y, z) and is turned by alpha about x, then by theta about z. Any chain can be written so:
:mod:`~ftcm_core.robots.urdf_file` does it. A link is known by its mass, first moments and inertias about the
origin of its joint's frame.

Recursive Newton-Euler (Luh, Walker, Paul 1980) gives the inverse dynamics, composite rigid bodies (Walker,
Orin 1982) the mass matrix; both as in Featherstone, "Rigid Body Dynamics Algorithms" (2008), chapters 5, 6.
"""

from __future__ import annotations

from math import cos, sin
from typing import NamedTuple

from ftcm_core.signals import Vector


class Body(NamedTuple):
    """Moments of a body's mass about the origin of a frame: what dynamics are linear in."""

    m: float
    """Mass, kg."""
    mx: float
    """First moments, kg·m; likewise my, mz."""
    my: float
    mz: float
    xx: float
    """Inertias, kg·m²; xy, xz and yz as the matrix has them."""
    yy: float
    zz: float
    xy: float
    xz: float
    yz: float


class Link(NamedTuple):
    """One joint, and the body that it moves: all that the dynamics read."""

    slides: int
    """1: prismatic, 0: revolute."""
    theta: float
    """Turn about z at q = 0, rad."""
    cos_alpha: float
    sin_alpha: float
    x: float
    """Origin in the frame before, at q = 0, m; likewise y, z."""
    y: float
    z: float
    body: Body
    """Seen from the joint's frame."""


class Chain(NamedTuple):
    """All that an engine of its own needs to know of an arm."""

    links: tuple[Link, ...]
    rotors: Vector
    """What the motors add to the diagonal of M, kg·m², or kg."""
    viscous: Vector
    """Viscous friction of the joints, N·m·s/rad, or N·s/m."""
    coulomb: Vector
    """Coulomb friction of the joints, N·m, or N."""
    lower: tuple[float | None, ...]
    """Smallest position of each joint, rad or m; None where there is no end."""
    upper: tuple[float | None, ...]
    """Largest, likewise."""
    gravity: float
    """Acceleration along -z of the base, m/s²."""


Place = tuple[float, float, float, float, float, float, float]
"""A frame in the one before it: cos and sin of its turns about z and about x, and its origin (m)."""


def places(links: tuple[Link, ...], q: Vector) -> list[Place]:
    """Return where each joint's frame stands in the one before it.

    Args:
        links: the chain.
        q: joint positions, rad or m.
    """
    found: list[Place] = []
    for link, position in zip(links, q):
        slides, theta, ca, sa, x, y, z, _ = link
        if slides:
            found.append((cos(theta), sin(theta), ca, sa, x, y - sa * position, z + ca * position))
        else:
            angle = theta + position
            found.append((cos(angle), sin(angle), ca, sa, x, y, z))
    return found


class Frame(NamedTuple):
    """Where a frame stands in that of the base."""

    origin: Vector
    """m."""
    x: Vector
    """Direction of its x axis; likewise y, z."""
    y: Vector
    z: Vector


def frames(at: list[Place], turn: float, tip: Vector) -> tuple[Frame, ...]:
    """Return where each joint's frame stands in that of the base, and last the tip, turned as the last one.

    Args:
        at: where each stands in the one before, from :func:`places`.
        turn: about z, of the frame that the first is seen from, in that of the base, rad.
        tip: in the frame of the last joint, m.
    """
    found = [
        Frame((0.0, 0.0, 0.0), (cos(turn), sin(turn), 0.0), (-sin(turn), cos(turn), 0.0), (0.0, 0.0, 1.0))
    ]
    for c, s, ca, sa, *origin in at:
        above = found[-1]
        _, x, y, z = above
        y, z = combined(ca, y, sa, z), combined(ca, z, -sa, y)
        found.append(Frame(point(above, tuple(origin)), combined(c, x, s, y), combined(c, y, -s, x), z))
    last = found[-1]
    return (*found[1:], last._replace(origin=point(last, tip)))


def point(frame: Frame, place: Vector) -> Vector:
    """A place that is given in a frame, in that of the base, m."""
    a, b, c = place
    return tuple([o + a * x + b * y + c * z for o, x, y, z in zip(*frame)])


def combined(a: float, v: Vector, b: float, w: Vector) -> Vector:
    """The vector a v + b w."""
    return tuple([a * x + b * y for x, y in zip(v, w)])


def newton_euler(links: tuple[Link, ...], at: list[Place], v: Vector, a: Vector, gravity: float) -> Vector:
    """Torques of a motion, N·m, or forces of the joints that slide, N.

    Args:
        links: the chain.
        at: where its frames are, from :func:`places`.
        v: joint velocities, rad/s or m/s.
        a: joint accelerations, rad/s² or m/s².
        gravity: its acceleration along -z of the base, m/s².
    """
    w1 = w2 = w3 = r1 = r2 = r3 = d1 = d2 = 0.0
    d3 = gravity  # to be held against it is to be accelerated
    loads: list[tuple[float, float, float, float, float, float]] = []
    for link, place, rate, rate2 in zip(links, at, v, a):
        w1, w2, w3, r1, r2, r3, d1, d2, d3 = outwards(*place, w1, w2, w3, r1, r2, r3, d1, d2, d3)
        if link.slides:
            d1, d2, d3 = d1 + 2.0 * w2 * rate, d2 - 2.0 * w1 * rate, d3 + rate2
        else:
            r1, r2, r3 = r1 + w2 * rate, r2 - w1 * rate, r3 + rate2
            w3 = w3 + rate
        loads.append(load(*link.body, w1, w2, w3, r1, r2, r3, d1, d2, d3))
    f1 = f2 = f3 = n1 = n2 = n3 = 0.0
    tau = []
    for i in reversed(range(len(links))):
        g1, g2, g3, k1, k2, k3 = loads[i]
        f1, f2, f3, n1, n2, n3 = f1 + g1, f2 + g2, f3 + g3, n1 + k1, n2 + k2, n3 + k3
        tau.append(f3 if links[i].slides else n3)
        if i:
            f1, f2, f3, n1, n2, n3 = inwards(*at[i], f1, f2, f3, n1, n2, n3)
    return tuple(tau[::-1])


def mass_matrix(links: tuple[Link, ...], at: list[Place], rotors: Vector) -> tuple[Vector, ...]:
    """Rows of the lower triangle of M(q), kg·m² (kg where joints slide).

    Args:
        links: the chain.
        at: where its frames are, from :func:`places`.
        rotors: what the motors add to the diagonal.
    """
    body = Body(*(0.0,) * 10)  # all links from here on
    rows = []
    for j in reversed(range(len(links))):
        body = Body(*[x + y for x, y in zip(body, links[j].body)])
        m, mx, my, _, _, _, zz, _, xz, yz = body
        # Force and moment of a unit acceleration of this joint, carried inwards.
        f1, f2, f3, n1, n2, n3 = (
            (0.0, 0.0, m, my, -mx, 0.0) if links[j].slides else (-my, mx, 0.0, xz, yz, zz)
        )
        row = [(m if links[j].slides else zz) + rotors[j]]
        for i in reversed(range(j)):
            f1, f2, f3, n1, n2, n3 = inwards(*at[i + 1], f1, f2, f3, n1, n2, n3)
            row.append(f3 if links[i].slides else n3)
        rows.append(tuple(row[::-1]))
        if j:
            body = Body(*body_inwards(*at[j], *body))
    return tuple(rows[::-1])


def force_torque(links: tuple[Link, ...], at: list[Place], point: Vector, force: Vector) -> Vector:
    """Joint torques J(q)ᵀ F of a force, N·m, or forces of the joints that slide, N.

    Args:
        links: the chain.
        at: where its frames are, from :func:`places`.
        point: where it acts, in the frame of the last joint, m.
        force: F in the frame of the base, N.
    """
    f1, f2, f3 = force
    for c, s, ca, sa, _, _, _ in at:
        t = ca * f2 + sa * f3
        f1, f2, f3 = c * f1 + s * t, c * t - s * f1, ca * f3 - sa * f2
    x, y, z = point
    n1, n2, n3 = y * f3 - z * f2, z * f1 - x * f3, x * f2 - y * f1
    tau = []
    for i in reversed(range(len(links))):
        tau.append(f3 if links[i].slides else n3)
        f1, f2, f3, n1, n2, n3 = inwards(*at[i], f1, f2, f3, n1, n2, n3)
    return tuple(tau[::-1])


# ---- one joint; in the arguments c and s are of the turn about z, ca and sa of that about x ----


def outwards(
    c: float, s: float, ca: float, sa: float, x: float, y: float, z: float,
    w1: float, w2: float, w3: float, r1: float, r2: float, r3: float, d1: float, d2: float, d3: float,
) -> tuple[float, float, float, float, float, float, float, float, float]:  # fmt: skip
    """Angular velocity w, its rate r and the acceleration d of the origin, from the frame before to a frame.

    The joint's own motion, which adds to them, is not in it.
    """
    wp = w1 * x + w2 * y + w3 * z
    ww = w1 * w1 + w2 * w2 + w3 * w3
    d1 = d1 + r2 * z - r3 * y + w1 * wp - x * ww
    d2 = d2 + r3 * x - r1 * z + w2 * wp - y * ww
    d3 = d3 + r1 * y - r2 * x + w3 * wp - z * ww
    t = ca * w2 + sa * w3
    u = ca * r2 + sa * r3
    e = ca * d2 + sa * d3
    return (
        c * w1 + s * t, c * t - s * w1, ca * w3 - sa * w2,
        c * r1 + s * u, c * u - s * r1, ca * r3 - sa * r2,
        c * d1 + s * e, c * e - s * d1, ca * d3 - sa * d2,
    )  # fmt: skip


def load(
    m: float, mx: float, my: float, mz: float,
    xx: float, yy: float, zz: float, xy: float, xz: float, yz: float,
    w1: float, w2: float, w3: float, r1: float, r2: float, r3: float, d1: float, d2: float, d3: float,
) -> tuple[float, float, float, float, float, float]:  # fmt: skip
    """Force and moment about the origin that move a body so; arguments as of :func:`outwards`."""
    wm = w1 * mx + w2 * my + w3 * mz
    ww = w1 * w1 + w2 * w2 + w3 * w3
    h1 = xx * w1 + xy * w2 + xz * w3
    h2 = xy * w1 + yy * w2 + yz * w3
    h3 = xz * w1 + yz * w2 + zz * w3
    return (
        m * d1 + r2 * mz - r3 * my + w1 * wm - mx * ww,
        m * d2 + r3 * mx - r1 * mz + w2 * wm - my * ww,
        m * d3 + r1 * my - r2 * mx + w3 * wm - mz * ww,
        xx * r1 + xy * r2 + xz * r3 + w2 * h3 - w3 * h2 + my * d3 - mz * d2,
        xy * r1 + yy * r2 + yz * r3 + w3 * h1 - w1 * h3 + mz * d1 - mx * d3,
        xz * r1 + yz * r2 + zz * r3 + w1 * h2 - w2 * h1 + mx * d2 - my * d1,
    )


def inwards(
    c: float, s: float, ca: float, sa: float, x: float, y: float, z: float,
    f1: float, f2: float, f3: float, n1: float, n2: float, n3: float,
) -> tuple[float, float, float, float, float, float]:  # fmt: skip
    """A force and a moment about a frame's origin, seen from the frame before."""
    t = s * f1 + c * f2
    f1, f2, f3 = c * f1 - s * f2, ca * t - sa * f3, sa * t + ca * f3
    t = s * n1 + c * n2
    return (
        f1, f2, f3,
        c * n1 - s * n2 + y * f3 - z * f2,
        ca * t - sa * n3 + z * f1 - x * f3,
        sa * t + ca * n3 + x * f2 - y * f1,
    )  # fmt: skip


def body_inwards(
    c: float, s: float, ca: float, sa: float, x: float, y: float, z: float,
    m: float, mx: float, my: float, mz: float,
    xx: float, yy: float, zz: float, xy: float, xz: float, yz: float,
) -> tuple[float, float, float, float, float, float, float, float, float, float]:  # fmt: skip
    """A body seen from the frame before: turned about z, then about x, then moved."""
    t = s * mx + c * my
    mx, my, mz = c * mx - s * my, ca * t - sa * mz, sa * t + ca * mz
    cc, ss, cs = c * c, s * s, c * s
    t = 2.0 * cs * xy
    xx, yy, xy = cc * xx - t + ss * yy, ss * xx + t + cc * yy, cs * (xx - yy) + (cc - ss) * xy
    xz, yz = c * xz - s * yz, s * xz + c * yz
    cc, ss, cs = ca * ca, sa * sa, ca * sa
    t = 2.0 * cs * yz
    yy, zz, yz = cc * yy - t + ss * zz, ss * yy + t + cc * zz, cs * (yy - zz) + (cc - ss) * yz
    xy, xz = ca * xy - sa * xz, sa * xy + ca * xz
    # I + (2 p·r + m p·p) 1 - (p rᵀ + r pᵀ) - m p pᵀ, r the first moments, p where the frame stands
    ax, ay, az = x * (2.0 * mx + m * x), y * (2.0 * my + m * y), z * (2.0 * mz + m * z)
    nx, ny, nz = mx + m * x, my + m * y, mz + m * z
    return (
        m, nx, ny, nz,
        xx + ay + az, yy + ax + az, zz + ax + ay,
        xy - x * ny - y * mx, xz - x * nz - z * mx, yz - y * nz - z * my,
    )  # fmt: skip
