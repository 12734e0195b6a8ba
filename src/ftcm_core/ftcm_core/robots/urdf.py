# SPDX-License-Identifier: Apache-2.0
"""Any serial arm, from a URDF file. What is read of it, and how: :mod:`~ftcm_core.robots.urdf_file`."""

from __future__ import annotations

import os
from functools import cached_property
from math import cos, sin

from ftcm_core.errors import ParameterError
from ftcm_core.params import param, per_joint
from ftcm_core.registry import register
from ftcm_core.robots import Robot, friction, solve
from ftcm_core.robots.serial_chain import (
    Body,
    Chain,
    Frame,
    Link,
    force_torque,
    frames,
    mass_matrix,
    newton_euler,
    places,
)
from ftcm_core.robots.urdf_file import PACKAGE, Arm, read_arm
from ftcm_core.signals import Vector


@register("robot", "urdf")
class Urdf(Robot):
    """Serial arm of a URDF file: M(q) a + h(q, v) + G(q) + F(v) = tau by recursive Newton-Euler (1980).

    Joints that slide have m, m/s, N and kg where those that turn have rad, rad/s, N·m and kg·m².
    """

    file: str = param(
        "package:ftcm_core/config/robots/puma560.urdf", unit="-",
        doc="path of the URDF, relative to the scenario, or package:NAME/path in an installed package",
        source="chosen: the paper's robot, from its link data",
    )  # fmt: skip
    tip: str | None = param(
        None, unit="-", optional=True, kind="str",
        doc="link at the end of the arm, joints not on the way are held at zero; null: the last that moves",
        source="chosen",
    )  # fmt: skip
    mass_factor: float = param(
        1.0, unit="-", above=0.0, per_joint=True,
        doc="factor on mass and inertia of what each joint carries up to the next one",
        source="chosen: as the file has it",
    )  # fmt: skip
    motor_inertia: float = param(
        0.0, unit="kg·m²", at_least=0.0, per_joint=True,
        doc="motor inertias seen at the joints, on the diagonal of M",
        source="chosen: a URDF does not tell them",
    )  # fmt: skip
    gravity_acceleration: float = param(
        9.81, unit="m/s²", at_least=0.0, doc="acceleration of gravity, along -z of the file's base",
        source="chosen: Earth's",
    )  # fmt: skip
    payload_mass: float = param(
        0.0, unit="kg", at_least=0.0, doc="point mass at the tip", source="chosen: none"
    )
    payload_distance: float = param(
        0.0, unit="m", at_least=-1.0, at_most=1.0, doc="from the tip to the payload, along the tip's z axis",
        source="chosen: at the tip",
    )  # fmt: skip
    viscous_friction: float | None = param(
        None, unit="N·m·s/rad", at_least=0.0, per_joint=True, optional=True, kind="float",
        doc="viscous friction of the joints; null: damping of the file", source="chosen",
    )  # fmt: skip
    coulomb_friction: float | None = param(
        None, unit="N·m", at_least=0.0, per_joint=True, optional=True, kind="float",
        doc="Coulomb friction of the joints; null: friction of the file", source="chosen",
    )  # fmt: skip
    slip_velocity: float = param(
        0.01, unit="rad/s", above=0.0, per_joint=True,
        doc="velocity scale v_s of the Coulomb friction, which grows as tanh(v/v_s)",
        source="chosen: smooth for ticks of 1 ms",
    )  # fmt: skip

    def check(self) -> None:
        """The file must be that of a serial arm, whose mass matrix is positive definite."""
        if not self.file.startswith(PACKAGE):
            object.__setattr__(self, "file", os.path.abspath(self.file))
        try:
            joints = self.joints  # reads the file
        except ParameterError as error:
            raise ParameterError(f"file: {error}") from None
        try:
            self.check_joints(joints)
        except ParameterError:  # the scenario says so
            return
        for turn in range(8):
            q = tuple([(0.7 * turn * (j + 1)) % 3.0 - 1.5 if turn else 0.0 for j in range(joints)])
            joint = self._weightless(q)
            if joint is not None:
                moves = "a body that cannot exist" if self._links[joint].body.m else "no mass"
                raise ParameterError(
                    f"file: the mass matrix is not positive definite: joint {self.joint_names[joint]!r} "
                    f"moves {moves}; expected links with mass and inertia, or a motor_inertia"
                )

    def _weightless(self, q: Vector) -> int | None:
        """The outermost joint from which on M(q) is not positive definite; None if it is."""
        m = mass_matrix(self._links, places(self._links, q), self._rotors)
        lower: list[list[float]] = []
        for j in reversed(range(len(m))):  # from the tip on: Schur complements of the joints further out
            row: list[float] = []
            for k, i in enumerate(reversed(range(j + 1, len(m)))):
                row.append((m[i][j] - sum(a * b for a, b in zip(row, lower[k]))) / lower[k][k])
            rest = m[j][j] - sum(a * a for a in row)
            if not rest > 1e-12 * m[j][j]:
                return j
            lower.append([*row, rest**0.5])
        return None

    @cached_property
    def arm(self) -> Arm:
        """What the file says."""
        return read_arm(self.file, self.tip)

    @property
    def joint_names(self) -> tuple[str, ...]:
        """Names of the joints that move, from the base to the tip."""
        return tuple([joint.name for joint in self.arm.joints])

    @cached_property
    def _tip(self) -> Vector:
        """Where payload and tip forces act, in the frame of the last joint, m."""
        return tuple([x + self.payload_distance * z for x, z in zip(self.arm.tip, self.arm.tip_axis)])

    @cached_property
    def _links(self) -> tuple[Link, ...]:
        """The links, with the payload on the last."""
        factors = per_joint(self.mass_factor, self.joints)
        bodies = [Body(*[f * x for x in link.body]) for link, f in zip(self.arm.links, factors)]
        m, (x, y, z) = self.payload_mass, self._tip
        load = (
            m, m * x, m * y, m * z, m * (y * y + z * z), m * (x * x + z * z), m * (x * x + y * y),
            -m * x * y, -m * x * z, -m * y * z,
        )  # fmt: skip
        bodies[-1] = Body(*[a + b for a, b in zip(bodies[-1], load)])
        return tuple([link._replace(body=body) for link, body in zip(self.arm.links, bodies)])

    @cached_property
    def _rotors(self) -> Vector:
        return per_joint(self.motor_inertia, self.joints)

    @cached_property
    def _friction(self) -> tuple[Vector, ...]:
        """Viscous and Coulomb friction and the scale of its growth, per joint; empty without friction."""
        viscous, coulomb = self._viscous_and_coulomb
        slip = per_joint(self.slip_velocity, self.joints)
        return tuple(zip(viscous, coulomb, slip)) if any(viscous + coulomb) else ()

    @cached_property
    def _viscous_and_coulomb(self) -> tuple[Vector, Vector]:
        n, joints = self.joints, self.arm.joints
        viscous, coulomb = self.viscous_friction, self.coulomb_friction
        return (
            tuple([x.damping for x in joints]) if viscous is None else per_joint(viscous, n),
            tuple([x.friction for x in joints]) if coulomb is None else per_joint(coulomb, n),
        )

    def chain(self) -> Chain:
        """The links with the payload, the motors, the friction and the ends of the file's joints."""
        viscous, coulomb = self._viscous_and_coulomb
        joints = self.arm.joints
        return Chain(
            self._links,
            self._rotors,
            viscous,
            coulomb,
            tuple([x.lower for x in joints]),
            tuple([x.upper for x in joints]),
            self.gravity_acceleration,
        )

    def inverse_dynamics(self, q: Vector, v: Vector, a: Vector) -> Vector:
        """Torque M(q) a + h(q, v) + G(q) + F(v), N·m."""
        links = self._links
        tau = newton_euler(links, places(links, q), v, a, self.gravity_acceleration)
        tau = tuple([t + i * x for t, i, x in zip(tau, self._rotors, a)])
        if self._friction:
            return tuple([t + friction(vi, *f) for t, vi, f in zip(tau, v, self._friction)])
        return tau

    def forward_dynamics(self, q: Vector, v: Vector, tau: Vector) -> Vector:
        """Acceleration M(q)^-1 (tau - h(q, v) - G(q) - F(v)), rad/s²."""
        links = self._links
        at = places(links, q)
        bias = newton_euler(links, at, v, (0.0,) * len(q), self.gravity_acceleration)
        rest = tuple([t - b for t, b in zip(tau, bias)])
        if self._friction:
            rest = tuple([t - friction(vi, *f) for t, vi, f in zip(rest, v, self._friction)])
        return solve(mass_matrix(links, at, self._rotors), rest)

    def gravity(self, q: Vector) -> Vector:
        """Gravity torque G(q), N·m."""
        links, rest = self._links, (0.0,) * len(q)
        return newton_euler(links, places(links, q), rest, rest, self.gravity_acceleration)

    def inertia_torque(self, q: Vector, a: Vector) -> Vector:
        """Torque M(q) a, N·m."""
        links = self._links
        tau = newton_euler(links, places(links, q), (0.0,) * len(q), a, 0.0)
        return tuple([t + i * x for t, i, x in zip(tau, self._rotors, a)])

    def inertia_acceleration(self, q: Vector, tau: Vector) -> Vector:
        """Acceleration M(q)^-1 tau, rad/s²."""
        links = self._links
        return solve(mass_matrix(links, places(links, q), self._rotors), tau)

    def tip_torque(self, q: Vector, force: Vector) -> Vector:
        """Joint torques J(q)ᵀ F of a force where the payload is, N·m.

        Args:
            q: joint positions, rad.
            force: F in the frame of the file's base, N.
        """
        fx, fy, fz = force
        c, s = cos(self.arm.base_turn), sin(self.arm.base_turn)
        links = self._links
        return force_torque(links, places(links, q), self._tip, (c * fx + s * fy, c * fy - s * fx, fz))

    def forward_kinematics(self, q: Vector) -> tuple[Frame, ...]:
        """Where the joints' frames, and last the payload, stand in that of the file's base."""
        return frames(places(self._links, q), self.arm.base_turn, self._tip)
