# SPDX-License-Identifier: Apache-2.0
"""Faults, one per file: what breaks, where (the site), and from when on.

========================  =================================  ====================================
site                      base class                         a step maps
========================  =================================  ====================================
actuator                  :class:`ActuatorFault`             torque of the drive to torque on the joint
sensor                    :class:`SensorFault`               measured motion to what is reported
dynamics                  :class:`AdditiveFault`             motion and command to an added joint torque
dynamics                  :class:`RobotFault`                the robot to another robot
communication             :class:`CommunicationFault`        a message to the one that is received
========================  =================================  ====================================

Every fault may have a state (what it latches, counts or integrates), gets the tick length, and has a stream
of random numbers of its own. Decisions on numbers stand in functions of plain floats, so that they can be
compiled.
"""

from __future__ import annotations

import math
from abc import abstractmethod
from dataclasses import dataclass
from functools import cached_property
from typing import Any, ClassVar

from ftcm_core.disturbances import Disturbance
from ftcm_core.params import param
from ftcm_core.registry import Component
from ftcm_core.robots import Robot
from ftcm_core.signals import Vector

TOPICS = ("joint_states", "disturbance_estimate", "joint_torques", "disturbance")
"""Topics whose messages can be disturbed: those that the tick waits for."""


@dataclass(frozen=True, kw_only=True)
class Fault(Component):
    """Something that breaks at an onset."""

    site: ClassVar[str]
    """``actuator``, ``sensor``, ``dynamics`` or ``communication``."""

    start: float = param(
        10.0, unit="s", at_least=0.0, doc="onset T_f; the fault acts at t > T_f", source="sec. IV, t > 10 s"
    )

    def init(self, joints: int, key: float) -> Any:
        """Return the state before the first tick.

        Args:
            joints: number of joints.
            key: its own stream of random numbers, see :mod:`ftcm_core.random_streams`.
        """
        del joints, key
        return ()

    def unsuited(self, robot: Robot) -> str:
        """Return why this fault cannot do what it says on a robot; empty if it can."""
        del robot
        return ""


@dataclass(frozen=True, kw_only=True)
class ProfiledFault(Fault):
    """A fault that grows with a time profile ψ (eq 4)."""

    profile: str = param(
        "abrupt",
        unit="-",
        choices=("abrupt", "incipient"),
        doc="time profile: abrupt (ψ steps to 1) or incipient (ψ = 1 - E^(-ν(t-T_f)))",
        source="eq 4",
    )
    rate: float = param(
        1.0, unit="1/s", above=0.0, doc="evolution rate ν of an incipient fault", source="eq 4; value chosen"
    )
    severity: float = param(
        1.0, unit="-", at_least=0.0, doc="factor on the whole fault", source="chosen: 1 is the paper's fault"
    )

    @cached_property
    def evolution(self) -> float:
        """Evolution rate ν, 1/s; infinite for an abrupt fault."""
        return math.inf if self.profile == "abrupt" else self.rate

    def size(self, t: float) -> float:
        """ψ(t - T_f) times the severity."""
        return time_profile(t, self.start, self.evolution) * self.severity


@dataclass(frozen=True, kw_only=True)
class AdditiveFault(ProfiledFault, Disturbance):
    """A torque added to that of the drives, ψ(t - T_f) ω."""

    site: ClassVar[str] = "dynamics"

    @abstractmethod
    def omega(self, t: float, q: Vector, v: Vector, u: Vector) -> Vector:
        """Fully developed fault ω as a joint torque, N·m; arguments as of ``Disturbance.torque``."""

    def torque(self, t: float, q: Vector, v: Vector, u: Vector) -> Vector:
        """ψ(t - T_f) ω, N·m."""
        psi = self.size(t)
        if type(psi) is float and psi == 0.0:  # a short way that compiled code does not take
            return (0.0,) * len(q)
        return tuple([scaled(psi, w) for w in self.omega(t, q, v, u)])

    def unsuited(self, robot: Robot) -> str:
        """As of :meth:`supports`."""
        return self.supports(robot.joints) or ""


@dataclass(frozen=True, kw_only=True)
class ActuatorFault(ProfiledFault):
    """A fault between what the drives say they apply and what the joints get."""

    site: ClassVar[str] = "actuator"

    @abstractmethod
    def step(
        self, t: float, dt: float, torque: Vector, q: Vector, v: Vector, state: Any
    ) -> tuple[Vector, Any]:
        """Return the torque on the joints, N·m, and the next state.

        Args:
            t: time, s.
            dt: tick length, s.
            torque: torque of the drives, after delay and limits, N·m.
            q: true joint positions, rad.
            v: true joint velocities, rad/s.
            state: what the last step returned.
        """


@dataclass(frozen=True, kw_only=True)
class SensorFault(ProfiledFault):
    """A fault between what the sensors measure and what they report."""

    site: ClassVar[str] = "sensor"

    @abstractmethod
    def step(
        self, t: float, dt: float, position: Vector, velocity: Vector, state: Any
    ) -> tuple[Vector, Vector, Any]:
        """Return reported positions (rad) and velocities (rad/s), and the next state.

        Args:
            t: time, s.
            dt: tick length, s.
            position: measured joint positions, rad.
            velocity: measured joint velocities, rad/s.
            state: what the last step returned.
        """


@dataclass(frozen=True, kw_only=True)
class RobotFault(Fault):
    """A fault after which the true robot is another one; the model stays."""

    site: ClassVar[str] = "dynamics"

    @abstractmethod
    def changed(self, robot: Robot) -> Robot:
        """Return the robot after the onset."""


@dataclass(frozen=True, kw_only=True)
class CommunicationFault(Fault):
    """A fault of one topic, between its writer and who reads it."""

    site: ClassVar[str] = "communication"

    topic: str = param(
        "joint_torques", unit="-", choices=TOPICS, doc="topic whose messages are disturbed",
        source="chosen: the command",
    )  # fmt: skip

    @abstractmethod
    def step(
        self, t: float, dt: float, message: tuple[Vector, ...], state: Any
    ) -> tuple[tuple[Vector, ...], Any]:
        """Return the message that is received in this tick, and the next state.

        Args:
            t: time, s.
            dt: tick length, s.
            message: arrays of the message that was sent in this tick.
            state: what the last step returned.
        """


def time_profile(t: float, start: float, rate: float) -> float:
    """ψ(t - T_f) of eq 4: 0 up to the onset, then 1 - E^(-ν(t-T_f)), which is 1 for ν → ∞ (abrupt).

    Args:
        t: time, s.
        start: onset T_f, s.
        rate: evolution rate ν, 1/s; may be infinite.
    """
    if t <= start:
        return 0.0
    return 1.0 - math.exp(-rate * (t - start))


def scaled(psi: float, x: float) -> float:
    """ψ x; zero for ψ = 0, whatever x is."""
    return 0.0 if psi == 0.0 else psi * x
