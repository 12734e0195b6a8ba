# SPDX-License-Identifier: Apache-2.0
"""Dynamics of any serial chain of revolute and prismatic joints, in plain floats.

Every joint turns about, or slides along, the z axis of its own frame. Seen from the frame before it, that
frame stands at (x, y, z) and is turned by alpha about x, then by theta about z. Any chain can be written so:
:mod:`~ftcm_core.robots.urdf_file` does it. A link is known by its mass, first moments and inertias about the
origin of its joint's frame, in which its dynamics are linear.

Recursive Newton-Euler (Luh, Walker, Paul 1980) gives the inverse dynamics, composite rigid bodies (Walker,
Orin 1982) the mass matrix; both as in Featherstone, "Rigid Body Dynamics Algorithms" (2008), chapters 5, 6.
"""

from __future__ import annotations

from math import cos, sin
from typing import NamedTuple

from ftcm_core.signals import Vector


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
    m: float
    """Mass, kg."""
    mx: float
    """First moments of the mass in the joint's frame, kg·m; likewise my, mz."""
    my: float
    mz: float
    xx: float
    """Inertias about the frame's origin, kg·m²; xy, xz and yz as the matrix has them."""
    yy: float
    zz: float
    xy: float
    xz: float
    yz: float


Place = tuple[float, ...]
"""A frame in the one before it: cos and sin of its turns about z and x, and its origin (m)."""


def places(links: tuple[Link, ...], q: Vector) -> list[Place]:
    """Return where each joint's frame stands in the one before it.

    Args:
        links: the chain.
        q: joint positions, rad or m.
    """
    found: list[Place] = []
    for link, position in zip(links, q):
        slides, theta, ca, sa, x, y, z = link[:7]
        if slides:
            found.append((cos(theta), sin(theta), ca, sa, x, y - sa * position, z + ca * position))
        else:
            angle = theta + position
            found.append((cos(angle), sin(angle), ca, sa, x, y, z))
    return found


def newton_euler(
    links: tuple[Link, ...], at: list[Place], v: Vector, a: Vector, gravity: float
) -> tuple[float, ...]:
    """Torques of a motion, N·m, or forces of the joints that slide, N.

    Args:
        links: the chain.
        at: where its frames are, from :func:`places`.
        v: joint velocities, rad/s or m/s.
        a: joint accelerations, rad/s² or m/s².
        gravity: its acceleration along -z of the base, m/s².
    """
    # Outwards: angular velocity w, its rate dw, and acceleration d of the frame's origin, against gravity.
    w1 = w2 = w3 = ww = dw1 = dw2 = dw3 = d1 = d2 = 0.0
    d3 = gravity
    loads: list[tuple[float, ...]] = []
    for link, place, rate, rate2 in zip(links, at, v, a):
        slides, _, _, _, _, _, _, m, mx, my, mz, xx, yy, zz, xy, xz, yz = link
        c, s, ca, sa, x, y, z = place
        if loads:  # the base is at rest
            wp = w1 * x + w2 * y + w3 * z
            d1 = d1 + dw2 * z - dw3 * y + w1 * wp - x * ww
            d2 = d2 + dw3 * x - dw1 * z + w2 * wp - y * ww
            d3 = d3 + dw1 * y - dw2 * x + w3 * wp - z * ww
            t = ca * w2 + sa * w3
            w1, w2, w3 = c * w1 + s * t, c * t - s * w1, ca * w3 - sa * w2
            t = ca * dw2 + sa * dw3
            dw1, dw2, dw3 = c * dw1 + s * t, c * t - s * dw1, ca * dw3 - sa * dw2
        t = ca * d2 + sa * d3
        d1, d2, d3 = c * d1 + s * t, c * t - s * d1, ca * d3 - sa * d2
        if slides:
            d1, d2, d3 = d1 + 2.0 * w2 * rate, d2 - 2.0 * w1 * rate, d3 + rate2
        else:
            dw1, dw2, dw3 = dw1 + w2 * rate, dw2 - w1 * rate, dw3 + rate2
            w3 = w3 + rate
        wm = w1 * mx + w2 * my + w3 * mz
        ww = w1 * w1 + w2 * w2 + w3 * w3
        h1 = xx * w1 + xy * w2 + xz * w3
        h2 = xy * w1 + yy * w2 + yz * w3
        h3 = xz * w1 + yz * w2 + zz * w3
        loads.append((
            m * d1 + dw2 * mz - dw3 * my + w1 * wm - mx * ww,
            m * d2 + dw3 * mx - dw1 * mz + w2 * wm - my * ww,
            m * d3 + dw1 * my - dw2 * mx + w3 * wm - mz * ww,
            xx * dw1 + xy * dw2 + xz * dw3 + w2 * h3 - w3 * h2 + my * d3 - mz * d2,
            xy * dw1 + yy * dw2 + yz * dw3 + w3 * h1 - w1 * h3 + mz * d1 - mx * d3,
            xz * dw1 + yz * dw2 + zz * dw3 + w1 * h2 - w2 * h1 + mx * d2 - my * d1,
        ))  # fmt: skip
    # Inwards: force f and moment n about the frame's origin.
    f1 = f2 = f3 = n1 = n2 = n3 = 0.0
    tau = []
    for link, place, (g1, g2, g3, k1, k2, k3) in zip(reversed(links), reversed(at), reversed(loads)):
        c, s, ca, sa, x, y, z = place
        f1, f2, f3, n1, n2, n3 = f1 + g1, f2 + g2, f3 + g3, n1 + k1, n2 + k2, n3 + k3
        tau.append(f3 if link[0] else n3)
        if len(tau) == len(links):
            break
        t = s * f1 + c * f2
        f1, f2, f3 = c * f1 - s * f2, ca * t - sa * f3, sa * t + ca * f3
        t = s * n1 + c * n2
        n1, n2, n3 = (
            c * n1 - s * n2 + y * f3 - z * f2,
            ca * t - sa * n3 + z * f1 - x * f3,
            sa * t + ca * n3 + x * f2 - y * f1,
        )
    return tuple(tau[::-1])


def mass_matrix(links: tuple[Link, ...], at: list[Place], rotors: Vector) -> tuple[Vector, ...]:
    """Rows of the lower triangle of M(q), kg·m² (kg where joints slide).

    Args:
        links: the chain.
        at: where its frames are, from :func:`places`.
        rotors: what the motors add to the diagonal.
    """
    m = mx = my = mz = xx = yy = zz = xy = xz = yz = 0.0  # of all links from here on
    rows = []
    for j in reversed(range(len(links))):
        slides, _, _, _, _, _, _, m_, mx_, my_, mz_, xx_, yy_, zz_, xy_, xz_, yz_ = links[j]
        m, mx, my, mz = m + m_, mx + mx_, my + my_, mz + mz_
        xx, yy, zz, xy, xz, yz = xx + xx_, yy + yy_, zz + zz_, xy + xy_, xz + xz_, yz + yz_
        # Force and moment of a unit acceleration of this joint, carried inwards.
        if slides:
            f1, f2, f3, n1, n2, n3 = 0.0, 0.0, m, my, -mx, 0.0
        else:
            f1, f2, f3, n1, n2, n3 = -my, mx, 0.0, xz, yz, zz
        row = [(f3 if slides else n3) + rotors[j]]
        for i in reversed(range(j)):
            c, s, ca, sa, x, y, z = at[i + 1]
            t = s * f1 + c * f2
            f1, f2, f3 = c * f1 - s * f2, ca * t - sa * f3, sa * t + ca * f3
            t = s * n1 + c * n2
            n1, n2, n3 = (
                c * n1 - s * n2 + y * f3 - z * f2,
                ca * t - sa * n3 + z * f1 - x * f3,
                sa * t + ca * n3 + x * f2 - y * f1,
            )
            row.append(f3 if links[i][0] else n3)
        rows.append(tuple(row[::-1]))
        if j == 0:
            break
        # All of it seen from the frame before: turned, then moved.
        c, s, ca, sa, x, y, z = at[j]
        t = s * mx + c * my
        mx, my, mz = c * mx - s * my, ca * t - sa * mz, sa * t + ca * mz
        cc, ss, cs = c * c, s * s, c * s
        xx, yy, xy = (
            cc * xx - 2.0 * cs * xy + ss * yy,
            ss * xx + 2.0 * cs * xy + cc * yy,
            cs * (xx - yy) + (cc - ss) * xy,
        )
        xz, yz = c * xz - s * yz, s * xz + c * yz
        cc, ss, cs = ca * ca, sa * sa, ca * sa
        yy, zz, yz = (
            cc * yy - 2.0 * cs * yz + ss * zz,
            ss * yy + 2.0 * cs * yz + cc * zz,
            cs * (yy - zz) + (cc - ss) * yz,
        )
        xy, xz = ca * xy - sa * xz, sa * xy + ca * xz
        # (2 p·r + m p·p) 1 - (p rᵀ + r pᵀ) - m p pᵀ, r the first moments and p the way to the frame before.
        px, py, pz = 2.0 * mx + m * x, 2.0 * my + m * y, 2.0 * mz + m * z
        ax, ay, az = x * px, y * py, z * pz
        xx, yy, zz = xx + ay + az, yy + ax + az, zz + ax + ay
        rx, ry = mx, my
        mx, my, mz = mx + m * x, my + m * y, mz + m * z
        xy, xz, yz = xy - x * my - y * rx, xz - x * mz - z * rx, yz - y * mz - z * ry
    return tuple(rows[::-1])


def force_torque(links: tuple[Link, ...], at: list[Place], point: Vector, force: Vector) -> tuple[float, ...]:
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
    for link, (c, s, ca, sa, x, y, z) in zip(reversed(links), reversed(at)):
        tau.append(f3 if link[0] else n3)
        t = s * f1 + c * f2
        f1, f2, f3 = c * f1 - s * f2, ca * t - sa * f3, sa * t + ca * f3
        t = s * n1 + c * n2
        n1, n2, n3 = (
            c * n1 - s * n2 + y * f3 - z * f2,
            ca * t - sa * n3 + z * f1 - x * f3,
            sa * t + ca * n3 + x * f2 - y * f1,
        )
    return tuple(tau[::-1])
