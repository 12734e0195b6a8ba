# SPDX-License-Identifier: Apache-2.0
"""Faults, one effect per file: what breaks, where (the site), how much (the profile), from when to when.

========================  =================================  ====================================
site                      base class                         an effect maps
========================  =================================  ====================================
actuator                  :class:`ActuatorFault`             torque of the drive to torque on the joint
sensor                    :class:`SensorFault`               measured motion to what is reported
dynamics                  :class:`AdditiveFault`             motion and command to an added joint torque
dynamics                  :class:`RobotFault`                the robot to another robot
communication             :class:`CommunicationFault`        messages sent to the one that is received
========================  =================================  ====================================

An effect says what becomes of one joint, or of one message; these classes say when and how much. It gets the
fault's size: ψ of its profile times its severity, 0 while it does not act. Decisions on numbers stand in
functions of plain floats, so that they can be compiled.

The faults of a site act one after the other in the order of their ``rank``, whatever their order in the
scenario: in a drive first what belongs to the command, then what is lost, added, and last what overrides it.
"""

from __future__ import annotations

import math
from abc import abstractmethod
from dataclasses import dataclass
from typing import Any, ClassVar, NamedTuple

from ftcm_core.errors import ParameterError
from ftcm_core.faults.timing import (
    NEVER,
    acts,
    began,
    incipient,
    intermittent,
    one_shot,
    periodic,
    ramp,
    scaled,
    tick_number,
)
from ftcm_core.params import joint_parameters, param
from ftcm_core.registry import Component
from ftcm_core.robots import Robot
from ftcm_core.signals import Vector

__all__ = [
    "TOPICS", "ActuatorFault", "AdditiveFault", "CommunicationFault", "Fault", "FaultState", "JointFault",
    "Moment", "ProfiledFault", "RobotFault", "Seen", "SensorFault", "scaled",
]  # fmt: skip

TOPICS = ("joint_states", "disturbance_estimate", "joint_torques", "disturbance")
"""Topics whose messages can be disturbed: those that the tick waits for."""

Seen = tuple[Vector, Vector, Vector]
"""What a condition may look at: true positions, rad, true velocities, rad/s, torques of the drives, N·m."""


class FaultState(NamedTuple):
    """What a fault remembers."""

    onset: float
    """It acts at t > onset, s; :data:`~ftcm_core.faults.timing.NEVER` while it waits for its trigger."""
    end: float
    """It acts up to this, s, if its lifetime does not end it before."""
    key: float
    """Its stream of random numbers."""
    memory: Any
    """What its effect remembers."""


class Moment(NamedTuple):
    """What an effect may know of the time."""

    t: float
    """Time, s."""
    dt: float
    """Tick length, s."""
    since: float
    """Time since the onset, s; below 0 before."""
    key: float
    """The fault's stream of random numbers."""
    number: float
    """Which number of it this joint may use in this tick; of :func:`~ftcm_core.random_streams.gaussian`."""


@dataclass(frozen=True, kw_only=True)
class Fault(Component):
    """Something that breaks when it is triggered, and lasts for its lifetime."""

    site: ClassVar[str]
    """``actuator``, ``sensor``, ``dynamics`` or ``communication``."""
    rank: ClassVar[int] = 50
    """Where it acts among the faults of its site: the lowest first."""

    start: float = param(
        10.0, unit="s", at_least=0.0,
        doc="onset T_f; the fault acts at t > T_f. A condition is not looked at up to this",
        source="sec. IV, t > 10 s",
    )  # fmt: skip
    trigger: str = param(
        "time", unit="-", choices=("time", "condition", "hand"),
        doc="what sets it off: the time `start`; the first time that a condition is met; or a call of a "
        "service while the run is on",
        source="sec. IV: a time",
    )  # fmt: skip
    trigger_signal: str = param(
        "position", unit="-", choices=("position", "speed", "torque"),
        doc="what a condition looks at: true position (rad), absolute value of the true velocity (rad/s) or "
        "of the drive's torque (N·m; of an additive fault, the command)",
        source="chosen",
    )  # fmt: skip
    trigger_joint: int = param(
        1, unit="-", at_least=1, at_most=100, doc="number of the joint that a condition looks at",
        source="chosen",
    )  # fmt: skip
    trigger_above: float | None = param(
        None, unit="rad, rad/s or N·m", optional=True, kind="float",
        doc="a condition is met by more than that; null: not", source="chosen",
    )  # fmt: skip
    trigger_below: float | None = param(
        None, unit="rad, rad/s or N·m", optional=True, kind="float",
        doc="a condition is met by less than that; null: not", source="chosen",
    )  # fmt: skip
    lifetime: str = param(
        "permanent", unit="-", choices=("permanent", "timed", "until_cleared"),
        doc="how long it lasts: for good; for `duration`; or until a call of a service while the run is on",
        source="sec. IV: permanent",
    )  # fmt: skip
    duration: float = param(1.0, unit="s", above=0.0, doc="how long a timed fault lasts", source="chosen")

    def check(self) -> None:
        """A condition needs something to compare with."""
        if self.trigger == "condition" and self.trigger_above is None and self.trigger_below is None:
            raise ParameterError(
                "trigger: condition, but trigger_above and trigger_below are both null; expected one at least"
            )

    def init(self, joints: int, key: float) -> FaultState:
        """Return the state before the first tick.

        Args:
            joints: number of joints.
            key: its own stream of random numbers, see :mod:`ftcm_core.random_streams`.
        """
        onset = self.start if self.trigger == "time" else NEVER
        return FaultState(onset, NEVER, key, self.memory(joints))

    def memory(self, joints: int) -> Any:
        """Return what the effect remembers before the first tick: floats in tuples."""
        del joints
        return ()

    @property
    def by_hand(self) -> bool:
        """Whether it can be armed or cleared while a run is on."""
        return self.trigger == "hand" or self.lifetime == "until_cleared"

    def phase(self, t: float, state: FaultState, seen: Seen | None) -> tuple[float, float]:
        """Onset and end at a time, s.

        Args:
            t: time, s.
            state: what the last step returned.
            seen: what a condition may look at; None where there is nothing of it.
        """
        onset, end = state.onset, state.end
        if self.trigger == "condition" and seen is not None:
            joint = self.trigger_joint - 1
            signal = seen[("position", "speed", "torque").index(self.trigger_signal)][joint]
            value = signal if self.trigger_signal == "position" else abs(signal)
            above = math.inf if self.trigger_above is None else self.trigger_above
            below = -math.inf if self.trigger_below is None else self.trigger_below
            onset = began(onset, t, self.start, value, above, below)
        if self.lifetime == "timed":
            end = min(end, onset + self.duration)
        return onset, end

    def quiet(self, t: float, state: FaultState) -> bool:
        """Whether nothing of it can act yet: a short way that compiled code does not take."""
        return type(t) is float and t <= state.onset and self.trigger != "condition"

    def unsuited(self, robot: Robot) -> str:
        """Return why this fault cannot do what it says on a robot; empty if it can."""
        if self.trigger == "condition" and self.trigger_joint > robot.joints:
            return f"trigger_joint: {self.trigger_joint} is out of range; expected 1 to {robot.joints}"
        return ""


@dataclass(frozen=True, kw_only=True)
class ProfiledFault(Fault):
    """A fault that changes with a time profile ψ (eq 4)."""

    profile: str = param(
        "abrupt",
        unit="-",
        choices=("abrupt", "incipient", "ramp", "periodic", "intermittent", "one_shot"),
        doc="time profile ψ from the onset on: abrupt 1; incipient 1 - E^(-ν(t-T_f)); ramp, 1 after `rise`; "
        "periodic, 1 for the first `duty` of each `period`, else 0; intermittent, drawn anew for each "
        "`period`, 1 with the probability `duty`; one_shot, a single pulse sin²(π(t-T_f)/`period`)",
        source="eq 4; others: Isermann 2006, ch. 2",
    )
    rate: float = param(
        1.0, unit="1/s", above=0.0, doc="evolution rate ν of an incipient fault", source="eq 4; value chosen"
    )
    rise: float = param(
        1.0, unit="s", above=0.0, doc="how long a ramp takes to its full size", source="chosen"
    )
    period: float = param(
        0.5, unit="s", above=0.0,
        doc="period of a periodic or intermittent fault; length of a one-shot pulse", source="chosen",
    )  # fmt: skip
    duty: float = param(
        0.5, unit="-", at_least=0.0, at_most=1.0, doc="share of the time in which a periodic or intermittent "
        "fault acts", source="chosen",
    )  # fmt: skip
    severity: float = param(
        1.0, unit="-", at_least=0.0, doc="factor on the whole fault", source="chosen: 1 is the paper's fault"
    )

    def size(self, t: float, onset: float, end: float, key: float) -> float:
        """ψ(t - T_f) times the severity.

        Args:
            t: time, s.
            onset: T_f, s.
            end: up to when it acts, s.
            key: the fault's stream of random numbers.
        """
        psi, since = acts(t, onset, end), t - onset
        if self.profile == "incipient":
            psi = psi * incipient(since, self.rate)
        elif self.profile == "ramp":
            psi = psi * ramp(since, self.rise)
        elif self.profile == "periodic":
            psi = psi * periodic(since, self.period, self.duty)
        elif self.profile == "intermittent":
            psi = psi * intermittent(since, self.period, self.duty, key)
        elif self.profile == "one_shot":
            psi = psi * one_shot(since, self.period)
        return psi * self.severity

    def check_share(self) -> None:
        """Of a fault that takes the place of something there cannot be more than all."""
        if self.severity > 1.0:
            raise ParameterError(
                f"severity: {self.severity:g} is more than the whole of it; expected at most 1"
            )


@dataclass(frozen=True, kw_only=True)
class JointFault(ProfiledFault):
    """A fault of one joint, or of all."""

    joint: int = param(
        0, unit="-", at_least=0, at_most=100, doc="number of the joint that breaks; 0: all", source="chosen"
    )

    def of_joints(self, joints: int) -> list[int]:
        """Which joints break, from 0."""
        return [j for j in range(joints) if self.joint in (0, j + 1)]

    def unsuited(self, robot: Robot) -> str:
        """There must be such a joint."""
        if self.joint > robot.joints:
            return f"joint: {self.joint} is out of range; expected 0 (all) to {robot.joints}"
        return Fault.unsuited(self, robot)


@dataclass(frozen=True, kw_only=True)
class AdditiveFault(JointFault):
    """A torque added to that of the drives, ψ(t - T_f) ω."""

    site: ClassVar[str] = "dynamics"

    @abstractmethod
    def omega(self, robot: Robot, t: float, q: Vector, v: Vector, u: Vector) -> Vector:
        """Fully developed fault ω as a joint torque, N·m.

        Args:
            robot: the true robot.
            t: time, s.
            q: true joint positions, rad.
            v: true joint velocities, rad/s.
            u: commanded torque, N·m.
        """

    def step(
        self, robot: Robot, t: float, q: Vector, v: Vector, u: Vector, state: FaultState
    ) -> tuple[Vector, FaultState]:
        """Return ψ(t - T_f) ω, N·m, and the next state; arguments as of :meth:`omega`."""
        none = (0.0,) * len(q)
        if self.quiet(t, state):
            return none, state
        onset, end = self.phase(t, state, (q, v, u))
        psi = self.size(t, onset, end, state.key)
        state = state._replace(onset=onset)
        if type(psi) is float and psi == 0.0:
            return none, state
        mine = self.of_joints(len(q))
        torque = [scaled(psi, w) if j in mine else 0.0 for j, w in enumerate(self.omega(robot, t, q, v, u))]
        return tuple(torque), state


@dataclass(frozen=True, kw_only=True)
class ActuatorFault(JointFault):
    """A fault between what the drives say they apply and what the joints get."""

    site: ClassVar[str] = "actuator"
    initial: ClassVar[Vector] = ()
    """What the effect remembers of a joint before the first tick."""
    remembers: ClassVar[bool] = False
    """Whether the effect has to follow the torque while it does not act (to delay it, say)."""

    @staticmethod
    @abstractmethod
    def act(
        p: Any, size: float, now: Moment, torque: float, q: float, v: float, s: Vector
    ) -> tuple[float, Vector]:
        """Return the torque on one joint, N·m, and what is remembered of it; of size 0 the torque as it is.

        Args:
            p: the fault, its parameters reduced to the joint.
            size: ψ times the severity.
            now: the time.
            torque: torque of the drive, after delay and limits and the faults before, N·m.
            q: true joint position, rad.
            v: true joint velocity, rad/s.
            s: what was returned last.
        """

    def memory(self, joints: int) -> Any:
        """Every joint starts from ``initial``."""
        return (self.initial,) * joints

    def step(
        self,
        t: float,
        dt: float,
        torque: Vector,
        q: Vector,
        v: Vector,
        state: FaultState,
        effort: Vector | None = None,
    ) -> tuple[Vector, FaultState]:
        """Return the torque on the joints, N·m, and the next state.

        Args:
            t: time, s.
            dt: tick length, s.
            torque: torque of the drives, after delay and limits and the faults before, N·m.
            q: true joint positions, rad.
            v: true joint velocities, rad/s.
            state: what the last step returned.
            effort: torque of the drives before all faults, N·m; the same unless given.
        """
        if not self.remembers and self.quiet(t, state):
            return torque, state
        onset, end = self.phase(t, state, (q, v, torque if effort is None else effort))
        size = self.size(t, onset, end, state.key)
        if not self.remembers and type(size) is float and size == 0.0:
            return torque, state._replace(onset=onset)
        joints = len(torque)
        first = tick_number(t, dt) * joints
        applied, memory = list(torque), list(state.memory)
        parameters = joint_parameters(self, joints)
        for j in self.of_joints(joints):
            now = Moment(t, dt, t - onset, state.key, first + j)
            applied[j], memory[j] = self.act(parameters[j], size, now, torque[j], q[j], v[j], state.memory[j])
        return tuple(applied), FaultState(onset, state.end, state.key, tuple(memory))


@dataclass(frozen=True, kw_only=True)
class SensorFault(JointFault):
    """A fault between what the sensors measure and what they report."""

    site: ClassVar[str] = "sensor"
    initial: ClassVar[Vector] = ()
    """What the effect remembers of a joint before the first tick."""
    remembers: ClassVar[bool] = False
    """Whether the effect has to follow the measurement while it does not act (to freeze or delay it, say)."""

    @staticmethod
    @abstractmethod
    def sense(
        p: Any, size: float, now: Moment, position: float, velocity: float, s: Vector
    ) -> tuple[float, float, Vector]:
        """Return what is reported of one joint (rad, rad/s), and what is remembered; of size 0 as it is.

        Args:
            p: the fault, its parameters reduced to the joint.
            size: ψ times the severity.
            now: the time.
            position: measured position, after the faults before, rad.
            velocity: measured velocity, rad/s.
            s: what was returned last.
        """

    def memory(self, joints: int) -> Any:
        """Every joint starts from ``initial``."""
        return (self.initial,) * joints

    def step(
        self,
        t: float,
        dt: float,
        position: Vector,
        velocity: Vector,
        state: FaultState,
        seen: Seen | None = None,
    ) -> tuple[Vector, Vector, FaultState]:
        """Return reported positions (rad) and velocities (rad/s), and the next state.

        Args:
            t: time, s.
            dt: tick length, s.
            position: measured joint positions, rad.
            velocity: measured joint velocities, rad/s.
            state: what the last step returned.
            seen: what a condition may look at.
        """
        if not self.remembers and self.quiet(t, state):
            return position, velocity, state
        onset, end = self.phase(t, state, seen)
        size = self.size(t, onset, end, state.key)
        if not self.remembers and type(size) is float and size == 0.0:
            return position, velocity, state._replace(onset=onset)
        joints = len(position)
        first = tick_number(t, dt) * joints
        positions, velocities, memory = list(position), list(velocity), list(state.memory)
        parameters = joint_parameters(self, joints)
        for j in self.of_joints(joints):
            now = Moment(t, dt, t - onset, state.key, first + j)
            positions[j], velocities[j], memory[j] = self.sense(
                parameters[j], size, now, position[j], velocity[j], state.memory[j]
            )
        return (
            tuple(positions),
            tuple(velocities),
            FaultState(onset, state.end, state.key, tuple(memory)),
        )


@dataclass(frozen=True, kw_only=True)
class RobotFault(Fault):
    """A fault under which the true robot is another one; the model stays."""

    site: ClassVar[str] = "dynamics"

    @abstractmethod
    def changed(self, robot: Robot) -> Robot:
        """Return the robot while the fault acts."""


@dataclass(frozen=True, kw_only=True)
class CommunicationFault(ProfiledFault):
    """A fault of one topic, between its writer and who reads it."""

    site: ClassVar[str] = "communication"

    topic: str = param(
        "joint_torques", unit="-", choices=TOPICS, doc="topic whose messages are disturbed",
        source="chosen: the command",
    )  # fmt: skip

    def check(self) -> None:
        """The controller, which reads the estimate, does not know the true motion."""
        Fault.check(self)
        if self.trigger == "condition" and self.topic == "disturbance_estimate":
            raise ParameterError(
                "trigger: condition, but who reads disturbance_estimate does not know the true motion; "
                "expected time or hand"
            )

    @abstractmethod
    def receive(
        self, size: float, now: Moment, message: tuple[Vector, ...], memory: Any
    ) -> tuple[tuple[Vector, ...], Any]:
        """Return the message that is received in this tick, and what is remembered; of size 0 the one sent.

        Args:
            size: ψ times the severity.
            now: the time; numbers of the stream are per message.
            message: arrays of the message that was sent in this tick.
            memory: what was returned last; what :meth:`memory` gives before the first message. From the first
                message on it has the same structure.
        """

    def step(
        self,
        t: float,
        dt: float,
        message: tuple[Vector, ...],
        state: FaultState,
        seen: Seen | None = None,
    ) -> tuple[tuple[Vector, ...], FaultState]:
        """Return the message that is received in this tick, and the next state.

        Args:
            t: time, s.
            dt: tick length, s.
            message: arrays of the message that was sent in this tick.
            state: what the last step returned.
            seen: what a condition may look at.
        """
        onset, end = self.phase(t, state, seen)
        size = self.size(t, onset, end, state.key)
        now = Moment(t, dt, t - onset, state.key, tick_number(t, dt))
        received, memory = self.receive(size, now, message, state.memory)
        return received, FaultState(onset, state.end, state.key, memory)
