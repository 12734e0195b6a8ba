# SPDX-License-Identifier: Apache-2.0
"""The stages of a tick: the in-process simulation runs all of them, a ROS node runs one.

A stage holds its state, an immutable value, and nothing else that changes but what can be dropped. It calls
the pure steps of its components. Swapping a component takes effect at a tick boundary: between two calls.
"""

from __future__ import annotations

import math
from operator import add
from typing import Any, NamedTuple, cast

from ftcm_core.controllers import Controller
from ftcm_core.detectors import Detector
from ftcm_core.disturbances import Disturbance
from ftcm_core.faults import (
    ActuatorFault,
    AdditiveFault,
    CommunicationFault,
    RobotFault,
    Seen,
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
from ftcm_core.simulation.accommodation import Pace, paced
from ftcm_core.simulation.drive import Drive, DriveState
from ftcm_core.simulation.fault_chain import FaultChain, Phase, States

Message = tuple[Vector, ...]
"""Arrays of a message."""


class Link:
    """What the communication faults of one topic do to its messages."""

    def __init__(self, scenario: Scenario, topic: str) -> None:
        """Use the scenario's faults of a topic."""
        self.chain = FaultChain(scenario, CommunicationFault, topic)
        self.faults = self.chain.faults
        self._dt = scenario.dt

    def step(self, t: float, message: Message, state: States, seen: Seen | None) -> tuple[Message, States]:
        """Return what is received in a tick of what was sent in it, and the next state.

        Args:
            t: time, s.
            message: what was sent.
            state: what the last step returned; at first ``chain.init``.
            seen: what conditions may look at.
        """
        following = []
        for fault, inner in zip(self.faults, state):
            message, inner = fault.step(t, self._dt, message, inner, seen)
            following.append(inner)
        return message, tuple(following)


class PlantState(NamedTuple):
    """The plant at t_k, all that its next tick depends on."""

    motion: Any
    """State of the engine."""
    drive: DriveState
    sensor: Any
    sensor_faults: States
    links: tuple[States, ...]
    """States of what disturbs ``joint_states``, ``joint_torques`` and ``disturbance``."""
    robot_faults: States
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
        self.sensor_faults = FaultChain(scenario, SensorFault)
        self.drive = Drive(
            scenario.limits, scenario.torque_delay, FaultChain(scenario, ActuatorFault), scenario.dt
        )
        self.links = tuple([Link(scenario, t) for t in ("joint_states", "joint_torques", "disturbance")])
        self.robot_faults = FaultChain(scenario, RobotFault)
        self.foreseen = all(f.trigger == "time" and not f.by_hand for f in self.robot_faults.faults)
        """Whether it is known from the start when the robot changes."""
        self.changes = robot_changes(scenario) if self.foreseen else ()
        """Robots to come, each with its first tick's time, ns."""
        n, start = self.robot.joints, scenario.initial_state
        motion = self.plant.init(self.robot, per_joint(start.position, n), per_joint(start.velocity, n))
        self.state = self._sensed(
            0.0,
            motion,
            self.drive.init(n),
            self.sensor.init(n, scenario.seed),
            self.sensor_faults.init(n),
            tuple([link.chain.init(n) for link in self.links]),
            self.robot_faults.init(n),
            (0.0,) * n,
        )
        self._nominal = self.robot
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
            (u,), u_link = self.links[1].step(t, (u,), u_link, (q, v, state.drive.effort))
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
        links: tuple[States, ...],
    ) -> None:
        """Let the torques act over a tick, then measure."""
        state = self.state
        q, v = self.plant.motion(state.motion)
        seen, robot_faults = (q, v, state.drive.effort), state.robot_faults
        while self.changes and time_ns >= self.changes[0][0]:
            self.robot, self.changes = self.changes[0][1], self.changes[1:]
        if not self.foreseen:
            robot_faults = self._change_robot(seconds(time_ns), robot_faults, seen)
        y_link, u_link, d_link = links
        (added,) = d
        if d_link:
            (added,), d_link = self.links[2].step(seconds(time_ns), (added,), d_link, seen)
        tau = tuple(map(add, torque, added))
        if not holds(math.isfinite(sum(u) + sum(tau))):
            self._end(
                "diverged", f"torque is not finite: command {list(u)} N·m, disturbance {list(added)} N·m"
            )
            return
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
            robot_faults,
            tau,
        )

    def _change_robot(self, t: float, states: States, seen: Seen) -> States:
        """Make the robot what the faults make of it that act at t, s."""
        robot, following = self._nominal, []
        for fault, state in zip(self.robot_faults.faults, states):
            onset, end = fault.phase(t, state, seen)
            following.append(state._replace(onset=onset))
            if onset < t <= end:
                robot = fault.changed(robot)
        if robot != self.robot:
            self.robot = robot
        return tuple(following)

    def order(self, number: int, action: str, t: float) -> None:
        """Arm or clear a fault by hand at t, s; as of :meth:`FaultChain.ordered`."""

        def after(chain: FaultChain[Any], states: States) -> States:
            return chain.ordered(states, number, action, t)

        state = self.state
        self.state = state._replace(
            drive=state.drive._replace(faults=after(self.drive.chain, state.drive.faults)),
            sensor_faults=after(self.sensor_faults, state.sensor_faults),
            links=tuple([after(link.chain, states) for link, states in zip(self.links, state.links)]),
            robot_faults=after(self.robot_faults, state.robot_faults),
        )

    def phases(self) -> dict[int, Phase]:
        """From when to when each fault of the plant acts, by its place in the scenario's list."""
        state = self.state
        found = self.drive.chain.phases(state.drive.faults)
        found |= self.sensor_faults.phases(state.sensor_faults)
        found |= self.robot_faults.phases(state.robot_faults)
        for link, states in zip(self.links, state.links):
            found |= link.chain.phases(states)
        return found

    def _sensed(
        self,
        t: float,
        motion: Any,
        drive: DriveState,
        sensor: Any,
        sensor_faults: States,
        links: tuple[States, ...],
        robot_faults: States,
        joint_torque: Vector,
    ) -> PlantState:
        """State of the plant with what the sensors make of its motion at time t, s."""
        true = self.plant.motion(motion)
        seen = (*true, drive.effort)
        q, v, sensor = self.sensor.step(self.dt, *true, sensor)
        if sensor_faults:
            following = []
            for fault, inner in zip(self.sensor_faults.faults, sensor_faults):
                q, v, inner = fault.step(t, self.dt, q, v, inner, seen)
                following.append(inner)
            sensor_faults = tuple(following)
        received: Message = (q, v, drive.effort)
        if links[0]:
            received, y_link = self.links[0].step(t, received, links[0], seen)
            links = (y_link, *links[1:])
        return PlantState(
            motion, drive, sensor, sensor_faults, links, robot_faults, Measurement(*received), joint_torque
        )

    def _end(self, status: str, reason: str) -> None:
        self.status, self.reason = status, reason


def robot_changes(scenario: Scenario) -> tuple[tuple[int, Robot], ...]:
    """Return the robots that the scenario's faults make of the true one, with the times of their first ticks.

    Args:
        scenario: the run; only faults whose time is known from the start are looked at.

    Returns:
        Time of the first tick, ns, and the robot, in the order of time.
    """
    chain = FaultChain(scenario, RobotFault)
    phases = chain.phases(chain.init(scenario.robot.joints))
    times = {t for phase in phases.values() for t in phase if t < scenario.duration}
    found = []
    for t in sorted(times):
        first = math.floor(t / scenario.dt) * scenario.dt_ns
        while seconds(first) <= t:  # a fault acts at onset < t <= end
            first += scenario.dt_ns
        robot = scenario.robot
        for number, fault in zip(chain.numbers, chain.faults):
            if phases[number].onset < seconds(first) <= phases[number].end:
                robot = fault.changed(robot)
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
    link: States
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
        self.state = ControlState(self.controller.init(n), self.link.chain.init(n))
        self.pace: Pace | None = None
        """How the reference goes on; None: as planned."""
        self._prepared: _Prepared | None = None

    def reference_at(self, time_ns: int) -> ReferencePoint:
        """Desired motion at t_k (integer ns)."""
        return paced(self.reference, self.pace, seconds(time_ns), self.model.joints)

    def slow(self, pace: Pace | None) -> None:
        """Let the reference go on at a pace from the next tick on."""
        self.pace, self._prepared = pace, None

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
            (tau_hat,), link = self.link.step(seconds(time_ns), (tau_hat,), link, None)
        u, law = self.controller.step(self.model, self.dt, y, reference, tau_hat, law, found)
        self.state = ControlState(law, link)
        return u, reference

    def order(self, number: int, action: str, t: float) -> None:
        """Arm or clear a fault by hand at t, s; as of :meth:`FaultChain.ordered`."""
        chain = self.link.chain
        self.state = self.state._replace(link=chain.ordered(self.state.link, number, action, t))

    def phases(self) -> dict[int, Phase]:
        """From when to when each fault of the estimate's topic acts."""
        return self.link.chain.phases(self.state.link)

    def _without_estimate(self, time_ns: int, y: Measurement) -> _Prepared:
        reference = self.reference_at(time_ns)
        found = self.controller.prepare(self.model, self.dt, y, reference, self.state.law)
        return time_ns, y, reference, found


class InjectorState(NamedTuple):
    """What the injector remembers between ticks."""

    disturbances: tuple[Any, ...]
    faults: States


class InjectorStage:
    """Disturbances and additive faults: one added torque per true motion and command."""

    def __init__(self, scenario: Scenario) -> None:
        """Sum the torques of all disturbances, then of all faults."""
        seed = scenario.seed
        self.disturbances: tuple[Disturbance, ...] = scenario.disturbances
        self.chain = FaultChain(scenario, AdditiveFault)
        self.robot = scenario.robot
        self.joints = scenario.robot.joints
        self.dt = scenario.dt
        states = [d.init(self.joints, stream_key(seed, f"disturbance.{i}"))
                  for i, d in enumerate(self.disturbances)]  # fmt: skip
        self.state = InjectorState(tuple(states), self.chain.init(self.joints))

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
        disturbances, faults = [], []
        for disturbance, inner in zip(self.disturbances, self.state.disturbances):
            torque, inner = disturbance.step(t, dt, position, velocity, u, inner)
            disturbances.append(inner)
            total = tuple(map(add, total, torque))
        for fault, state in zip(self.chain.faults, self.state.faults):
            torque, state = fault.step(self.robot, t, position, velocity, u, state)
            faults.append(state)
            total = tuple(map(add, total, torque))
        self.state = InjectorState(tuple(disturbances), tuple(faults))
        return TrueDisturbance(total)

    def order(self, number: int, action: str, t: float) -> None:
        """Arm or clear a fault by hand at t, s; as of :meth:`FaultChain.ordered`."""
        self.state = self.state._replace(faults=self.chain.ordered(self.state.faults, number, action, t))

    def phases(self) -> dict[int, Phase]:
        """From when to when each additive fault acts."""
        return self.chain.phases(self.state.faults)


class DetectorStage:
    """The fault detector: residuals and alarms, one set per tick."""

    def __init__(self, scenario: Scenario) -> None:
        """Start with the scenario's detector."""
        self.detector = cast(Detector, scenario.detector)
        self.model = scenario.model
        self.dt = scenario.dt
        self.state: Any = self.detector.init(self.model.joints)

    def swap(self, detector: Detector) -> None:
        """Use another detector from the next tick on; one that cannot go on with the state starts afresh."""
        if not detector.continues(self.detector):
            self.state = detector.init(self.model.joints)
        self.detector = detector

    def step(self, y: Measurement, u: Vector, tau_hat: Vector, ticks: int = 1) -> Detection:
        """Residuals (N·m) and alarms of one tick; arguments as of the other stages."""
        if not self.detector.needs_observer:  # over the graph it may be there or not
            tau_hat = (0.0,) * self.model.joints
        found, self.state = self.detector.step(self.model, ticks * self.dt, y, u, tau_hat, self.state)
        return found
