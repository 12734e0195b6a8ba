# SPDX-License-Identifier: Apache-2.0
"""PUMA 560 from its link data: a slow, readable Lagrangian in matrix form; an oracle, for tests only.

It knows masses, centres, inertias and modified Denavit-Hartenberg frames (Armstrong, Khatib, Burdick 1986)
and nothing of the closed form. Joints 4 to 6 are locked at zero. Derivatives are complex-step ones, exact
to rounding.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

ALPHA = np.radians([0.0, -90.0, 0.0, 90.0, -90.0, 90.0])
A = np.array([0.0, 0.0, 0.4318, -0.0203, 0.0, 0.0])  # m
D = np.array([0.0, 0.2435, -0.0934, 0.4331, 0.0, 0.0])  # m
MASS = np.array([0.0, 17.40, 4.80, 0.82, 0.34, 0.09])  # kg
CENTRE = np.array(  # m, in the link's frame
    [[0, 0, 0], [0.068, 0.006, -0.016], [0, -0.070, 0.014], [0, 0, -0.019], [0, 0, 0], [0, 0, 0.032]]
)
INERTIA = np.array(  # kg·m², diagonal, about the centre of mass
    [
        [0, 0, 0.35],
        [0.130, 0.524, 0.539],
        [0.066, 0.0125, 0.086],
        [1.8e-3, 1.8e-3, 1.3e-3],
        [0.30e-3, 0.30e-3, 0.40e-3],
        [0.15e-3, 0.15e-3, 0.04e-3],
    ]
)
MOTOR_INERTIA = np.array([1.14, 4.71, 0.827])  # kg·m², seen at joints 1 to 3
GRAVITY = 9.81  # m/s², along -z of the base
LINKS, JOINTS = 6, 3


def link_placement(link: int) -> tuple[Array, Array]:
    """Rotation and origin (m) of a link's frame in the one before it, joint angle zero."""
    c, s = np.cos(ALPHA[link]), np.sin(ALPHA[link])
    return np.array([[1, 0, 0], [0, c, -s], [0, s, c]]), np.array([A[link], -s * D[link], c * D[link]])


def frames(q: Array) -> list[tuple[Array, Array]]:
    """Rotation and origin (m) of every link's frame in the base, at joint positions q (rad)."""
    rotation, origin, result = np.eye(3), np.zeros(3), []
    for link, angle in enumerate([*q, 0.0, 0.0, 0.0]):
        fixed, offset = link_placement(link)
        c, s = np.cos(angle), np.sin(angle)
        origin = origin + rotation @ offset
        rotation = rotation @ fixed @ np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]])
        result.append((rotation, origin))
    return result


def mass_matrix(q: Array) -> Array:
    """M = diag(Im) + sum over links of m Jvᵀ Jv + Jwᵀ R I Rᵀ Jw, kg·m²."""
    chain = frames(q)
    total = np.diag(MOTOR_INERTIA).astype(np.asarray(q).dtype)
    for link, (rotation, origin) in enumerate(chain):
        centre = origin + rotation @ CENTRE[link]
        moved_by = chain[: min(link + 1, JOINTS)]
        jv = np.zeros((3, JOINTS), total.dtype)
        jw = np.zeros((3, JOINTS), total.dtype)
        for joint, (joint_rotation, joint_origin) in enumerate(moved_by):
            axis = joint_rotation[:, 2]
            jv[:, joint] = np.cross(axis, centre - joint_origin)
            jw[:, joint] = axis
        total += MASS[link] * jv.T @ jv + jw.T @ rotation @ np.diag(INERTIA[link]) @ rotation.T @ jw
    return total


def potential(q: Array) -> float:
    """Potential energy of the links, J."""
    return sum(m * GRAVITY * (p + r @ c)[2] for m, c, (r, p) in zip(MASS, CENTRE, frames(q), strict=True))


def gradient(function: Callable[[Array], Any], q: Array) -> Array:
    """Differentiate a function by q1, q2, q3, along a new first axis."""
    return np.array([np.imag(function(q + 1e-30j * unit)) / 1e-30 for unit in np.eye(JOINTS)])


def coriolis_matrix(q: Array, v: Array) -> Array:
    """C_ij = sum over k of ½ (∂M_ij/∂q_k + ∂M_ik/∂q_j - ∂M_jk/∂q_i) v_k, N·m·s."""
    dm = gradient(mass_matrix, q)  # dm[k, i, j]
    return 0.5 * (
        np.einsum("kij,k->ij", dm, v) + np.einsum("jik,k->ij", dm, v) - np.einsum("ijk,k->ij", dm, v)
    )


def gravity(q: Array) -> Array:
    """G = ∂U/∂q, N·m."""
    return gradient(potential, q)


def inverse_dynamics(q: Array, v: Array, a: Array) -> Array:
    """Torque M a + C v + G, N·m."""
    return mass_matrix(q) @ a + coriolis_matrix(q, v) @ v + gravity(q)
