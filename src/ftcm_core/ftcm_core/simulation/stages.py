# SPDX-License-Identifier: Apache-2.0
"""The stages of a tick: the in-process simulation runs all of them, a ROS node runs one.

A stage holds its state, an immutable value, and nothing else that changes but what can be dropped. It calls
the pure steps of its components. Swapping a component takes effect at a tick boundary: between two calls.
"""

from __future__ import annotations

import math
from operator import add
from typing import Any, NamedTuple, TypeVar, cast

from ftcm_core.controllers import Controller
from ftcm_core.detectors import Detector
from ftcm_core.disturbances import Disturbance
from ftcm_core.faults import (
    ActuatorFault,
    AdditiveFault,
    CommunicationFault,
    Fault,
    RobotFault,
    SensorFault,
)
from ftcm_core.limits import motion_beyond
from ftcm_core.numeric import holds
from ftcm_core.observers import Observer
from ftcm_core.params import per_joint
from ftcm_core.random_streams import stream_key
from ftcm_core.robots import Robot
from ftcm_core.scenario import SPEED_LIMIT, Scenario
from ftcm_core.signals import (
    Detection,
    Measurement,
    ReferencePoint,
    State,
    TrueDisturbance,
    Vector,
    seconds,
)
from ftcm_core.simulation.drive import Drive, DriveState

F = TypeVar("F", bound=Fault)
Message = tuple[Vector, ...]
"""Arrays of a message."""


def faults_of(scenario: Scenario, kind: type[F]) -> tuple[list[F], list[float]]:
    """Return the scenario's faults of a kind of site, and the stream of random numbers of each.

    A stream belongs to the n-th fault of a type: a fault of another type shifts none.
    """
    count: dict[str, int] = {}
    faults, keys = [], []
    for fault in scenario.faults:
        number = count[fault.type_name] = count.get(fault.type_name, -1) + 1
        if isinstance(fault, kind):
            faults.append(fault)
            keys.append(stream_key(scenario.seed, f"fault.{fault.type_name}.{number}"))
    return faults, keys


class Link:
    """What the communication faults of one topic do to its messages."""

    def __init__(self, scenario: Scenario, topic: str) -> None:
        """Use the scenario's faults of a topic."""
        faults, keys = faults_of(scenario, CommunicationFault)
        mine = [(f, k) for f, k in zip(faults, keys) if f.topic == topic]
        self.faults = tuple([f for f, _ in mine])
        self._keys = tuple([k for _, k in mine])
        self._dt = scenario.dt

    def init(self, joints: int) -> tuple[Any, ...]:
        """Return the state before the first message."""
        return tuple([fault.init(joints, key) for fault, key in zip(self.faults, self._keys)])

    def step(self, t: float, message: Message, state: tuple[Any, ...]) -> tuple[Message, tuple[Any, ...]]:
        """Return what is received in a tick of what was sent in it, and the next state."""
        following = []
        for fault, inner in zip(self.faults, state):
            message, inner = fault.step(t, self._dt, message, inner)
            following.append(inner)
        return message, tuple(following)


class PlantState(NamedTuple):
    """The plant at t_k, all that its next tick depends on."""

    motion: Any
    """State of the engine."""
    drive: DriveState
    sensor: Any
    sensor_faults: tuple[Any, ...]
    links: tuple[tuple[Any, ...], ...]
    """States of what disturbs ``joint_states``, ``joint_torques`` and ``disturbance``."""
    measured: Measurement
    """y_k as it is published."""
    joint_torque: Vector
    """Torque on the joints over the tick that has just ended, N·m."""


class PlantStage:
    """The robot and what belongs to it: sensors, drives and the engine that moves it."""

    def __init__(self, scenario: Scenario) -> None:
        """Start at the scenario's initial state."""
        self.robot: Robot = scenario.robot
        self.plant = scenario.plant
        self.dt, self.dt_ns = scenario.dt, scenario.dt_ns
        self.limits = scenario.limits
        self.stop_damping = per_joint(scenario.stop_damping, self.robot.joints)
        self.sensor = scenario.sensor
        self.sensor_faults, keys = faults_of(scenario, SensorFault)
        self.drive = Drive(
            scenario.limits, scenario.torque_delay, *faults_of(scenario, ActuatorFault), scenario.dt
        )
        self.links = tuple([Link(scenario, t) for t in ("joint_states", "joint_torques", "disturbance")])
        self.changes = robot_changes(scenario)
        """Robots to come, each with its first tick's time, ns."""
        n, start = self.robot.joints, scenario.initial_state
        motion = self.plant.init(self.robot, per_joint(start.position, n), per_joint(start.velocity, n))
        self.state = self._sensed(
            0.0,
            motion,
            self.drive.init(n),
            self.sensor.init(n, scenario.seed),
            tuple([f.init(n, key) for f, key in zip(self.sensor_faults, keys)]),
            tuple([link.init(n) for link in self.links]),
            (0.0,) * n,
        )
        self.status = "running"
        """``diverged`` or ``limit_exceeded`` once the run cannot go on."""
        self.reason = ""
        """Why it cannot; empty while it can."""

    @property
    def motion(self) -> tuple[Vector, Vector]:
        """The true joint positions (rad) and velocities (rad/s)."""
        return self.plant.motion(self.state.motion)

    @property
    def joint_torque(self) -> Vector:
        """Torque on the joints over the tick that has just ended, N·m."""
        return self.state.joint_torque

    def measure(self) -> Measurement:
        """y_k: measured motion, and the torque of the drives over the tick that has just ended.

        The sensor works once per tick; asking again in the same tick gives the same.
        """
        return self.state.measured

    def step(self, time_ns: int, u: Vector, d: TrueDisturbance) -> None:
        """Move on from t_k (integer ns) by a tick, the command u_k and the disturbance d_k (N·m) held.

        Sets ``status`` and ``reason`` when the torque is not finite, a joint is faster than any can be, or
        beyond its limits; the plant is not stepped further then.
        """
        t, state, (y_link, u_link, d_link) = seconds(time_ns), self.state, self.state.links
        q, v = self.plant.motion(state.motion)
        if u_link:
            (u,), u_link = self.links[1].step(t, (u,), u_link)
        torque, drive = self.drive.step(t, u, q, v, state.drive)
        self._move(time_ns, u, torque, d, drive, (y_link, u_link, d_link))

    def safe_stop(self, time_ns: int, d: TrueDisturbance) -> None:
        """Move on by a tick with the drives braking, for want of a command."""
        state = self.state
        q, v = self.plant.motion(state.motion)
        torque, drive = self.drive.brake(seconds(time_ns), self.stop_damping, q, v, state.drive)
        self._move(time_ns, torque, torque, d, drive, state.links)

    def _move(
        self,
        time_ns: int,
        u: Vector,
        torque: Vector,
        d: TrueDisturbance,
        drive: DriveState,
        links: tuple[tuple[Any, ...], ...],
    ) -> None:
        """Let the torques act over a tick, then measure."""
        while self.changes and time_ns >= self.changes[0][0]:
            self.robot, self.changes = self.changes[0][1], self.changes[1:]
        y_link, u_link, d_link = links
        (added,) = d
        if d_link:
            (added,), d_link = self.links[2].step(seconds(time_ns), (added,), d_link)
        tau = tuple(map(add, torque, added))
        if not holds(math.isfinite(sum(u) + sum(tau))):
            self._end(
                "diverged", f"torque is not finite: command {list(u)} N·m, disturbance {list(added)} N·m"
            )
            return
        state = self.state
        motion = self.plant.step(self.robot, self.dt, tau, state.motion)
        q, v = self.plant.motion(motion)
        for x in v:
            if not holds(abs(x) < SPEED_LIMIT):
                self._end("diverged", f"joint velocity {list(v)} rad/s is beyond {SPEED_LIMIT:g} rad/s")
                return
        if beyond := motion_beyond(self.limits, self.robot.joint_names, q, v):
            self._end("limit_exceeded", beyond)
            return
        self.state = self._sensed(
            seconds(time_ns + self.dt_ns),
            motion,
            drive,
            state.sensor,
            state.sensor_faults,
            (y_link, u_link, d_link),
            tau,
        )

    def _sensed(
        self,
        t: float,
        motion: Any,
        drive: DriveState,
        sensor: Any,
        sensor_faults: tuple[Any, ...],
        links: tuple[tuple[Any, ...], ...],
        joint_torque: Vector,
    ) -> PlantState:
        """State of the plant with what the sensors make of its motion at time t, s."""
        q, v, sensor = self.sensor.step(self.dt, *self.plant.motion(motion), sensor)
        if sensor_faults:
            following = []
            for fault, inner in zip(self.sensor_faults, sensor_faults):
                q, v, inner = fault.step(t, self.dt, q, v, inner)
                following.append(inner)
            sensor_faults = tuple(following)
        received: Message = (q, v, drive.effort)
        if links[0]:
            received, y_link = self.links[0].step(t, received, links[0])
            links = (y_link, *links[1:])
        return PlantState(motion, drive, sensor, sensor_faults, links, Measurement(*received), joint_torque)

    def _end(self, status: str, reason: str) -> None:
        self.status, self.reason = status, reason


def robot_changes(scenario: Scenario) -> tuple[tuple[int, Robot], ...]:
    """Return the robots that the scenario's faults make of the true one, with the times of their first ticks.

    Args:
        scenario: the run.

    Returns:
        Time of the first tick, ns, and the robot, in the order of time.
    """
    faults, _ = faults_of(scenario, RobotFault)
    found, robot = [], scenario.robot
    for fault in sorted((f for f in faults if f.start < scenario.duration), key=lambda f: f.start):
        robot = fault.changed(robot)
        first = math.floor(fault.start / scenario.dt) * scenario.dt_ns
        while seconds(first) <= fault.start:  # the fault acts at t > start
            first += scenario.dt_ns
        found.append((first, robot))
    return tuple(found)


class ObserverStage:
    """The disturbance observer: one estimate per measurement."""

    def __init__(self, observer: Observer, model: Robot, dt: float) -> None:
        """The state is made from the first measurement."""
        self.observer = observer
        self.model = model
        self.dt = dt
        self.state: Any = None

    def swap(self, observer: Observer) -> None:
        """Use another observer from the next tick on.

        The same kind with other parameters keeps its state; another kind starts afresh, its
        estimate from zero, at the next measurement.
        """
        if type(observer) is not type(self.observer):
            self.state = None
        self.observer = observer

    def step(self, y: Measurement, ticks: int = 1) -> Vector:
        """tau_hat at t_k (N·m); zeros at the first measurement.

        Args:
            y: the measurement.
            ticks: how many ticks after the last one it is.
        """
        tau_hat: Vector = (0.0,) * self.model.joints
        if self.state is None:
            self.state = self.observer.init(self.model, y)
            return tau_hat
        for _ in range(ticks):
            tau_hat, self.state = self.observer.step(self.model, self.dt, y, self.state)
        return tau_hat


class ControlState(NamedTuple):
    """What the controller's side remembers between ticks."""

    law: State
    link: tuple[Any, ...]
    """State of what disturbs ``disturbance_estimate``."""


_Prepared = tuple[int, Measurement, ReferencePoint, Any]
"""A tick's stamp (ns) and measurement, its reference, and what the law has prepared."""


class ControllerStage:
    """Reference and control law: one torque per measurement and estimate."""

    def __init__(self, scenario: Scenario, controller: Controller | None = None) -> None:
        """Start from the initial state of the scenario's law, or of another."""
        self.controller = controller or scenario.controller
        self.reference = scenario.reference
        self.model = scenario.model
        self.dt = scenario.dt
        self.link = Link(scenario, "disturbance_estimate")
        n = self.model.joints
        self.state = ControlState(self.controller.init(n), self.link.init(n))
        self._prepared: _Prepared | None = None

    def swap(self, controller: Controller) -> None:
        """Use another law from the next tick on.

        The same law with other parameters keeps its state (integral terms); another law starts
        from its initial state, at the robot's present motion.
        """
        if type(controller) is not type(self.controller):
            self.state = self.state._replace(law=controller.init(self.model.joints))
        self.controller = controller
        self._prepared = None

    def prepare(self, time_ns: int, y: Measurement) -> None:
        """Compute what of a tick does not need the estimate, ahead of :meth:`step`."""
        self._prepared = self._without_estimate(time_ns, y)

    def step(self, time_ns: int, y: Measurement, tau_hat: Vector) -> tuple[Vector, ReferencePoint]:
        """u_k (N·m) and the reference at t_k (integer ns)."""
        prepared, self._prepared = self._prepared, None
        if prepared is None or prepared[:2] != (time_ns, y):
            prepared = self._without_estimate(time_ns, y)
        _, _, reference, found = prepared
        law, link = self.state
        if not self.controller.needs_observer:  # over the graph it may be there or not
            tau_hat = (0.0,) * self.model.joints
        if link:
            (tau_hat,), link = self.link.step(seconds(time_ns), (tau_hat,), link)
        u, law = self.controller.step(self.model, self.dt, y, reference, tau_hat, law, found)
        self.state = ControlState(law, link)
        return u, reference

    def _without_estimate(self, time_ns: int, y: Measurement) -> _Prepared:
        reference = self.reference.at(seconds(time_ns), self.model.joints)
        found = self.controller.prepare(self.model, self.dt, y, reference, self.state.law)
        return time_ns, y, reference, found


class InjectorStage:
    """Disturbances and additive faults: one added torque per true motion and command."""

    def __init__(self, scenario: Scenario) -> None:
        """Sum the torques of all disturbances, then of all faults."""
        faults, keys = faults_of(scenario, AdditiveFault)
        seed, count = scenario.seed, range(len(scenario.disturbances))
        self.sources: tuple[Disturbance, ...] = (*scenario.disturbances, *faults)
        self.joints = scenario.robot.joints
        self.dt = scenario.dt
        every = [*(stream_key(seed, f"disturbance.{i}") for i in count), *keys]
        self.state = tuple([source.init(self.joints, key) for source, key in zip(self.sources, every)])

    def step(
        self, time_ns: int, position: Vector, velocity: Vector, u: Vector, ticks: int = 1
    ) -> TrueDisturbance:
        """d_k (N·m) at t_k (integer ns); once per tick.

        Args:
            time_ns: t_k, ns.
            position: true joint positions, rad.
            velocity: true joint velocities, rad/s.
            u: command u_k, N·m.
            ticks: how many ticks after the last one it is.
        """
        t, dt = seconds(time_ns), ticks * self.dt
        total: Vector = (0.0,) * self.joints
        following = []
        for source, inner in zip(self.sources, self.state):
            torque, inner = source.step(t, dt, position, velocity, u, inner)
            following.append(inner)
            total = tuple(map(add, total, torque))
        self.state = tuple(following)
        return TrueDisturbance(total)


class DetectorStage:
    """The fault detector: residuals and alarms, one set per tick."""

    def __init__(self, scenario: Scenario) -> None:
        """Start with the scenario's detector."""
        self.detector = cast(Detector, scenario.detector)
        self.model = scenario.model
        self.dt = scenario.dt
        self.state: Any = self.detector.init(self.model.joints)

    def swap(self, detector: Detector) -> None:
        """Use another detector from the next tick on; one of another kind starts afresh."""
        if type(detector) is not type(self.detector):
            self.state = detector.init(self.model.joints)
        self.detector = detector

    def step(self, y: Measurement, u: Vector, tau_hat: Vector, ticks: int = 1) -> Detection:
        """Residuals (N·m) and alarms of one tick; arguments as of the other stages."""
        if not self.detector.needs_observer:  # over the graph it may be there or not
            tau_hat = (0.0,) * self.model.joints
        found, self.state = self.detector.step(self.model, ticks * self.dt, y, u, tau_hat, self.state)
        return found
