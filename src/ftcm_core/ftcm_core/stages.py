# SPDX-License-Identifier: Apache-2.0
"""The steps of a tick as the drivers run them: the simulation composes all, a ROS node runs one.

A stage keeps the state between ticks and calls the pure step of its component. Swapping a
component takes effect at a tick boundary: between two calls.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from operator import add
from typing import Any

from ftcm_core.controllers import Controller
from ftcm_core.faults import Disturbance
from ftcm_core.limits import Limits, drive_torque, motion_beyond
from ftcm_core.observers import Observer
from ftcm_core.references import Reference
from ftcm_core.robots import Robot
from ftcm_core.sensors import Sensor
from ftcm_core.sensors.ideal import Ideal
from ftcm_core.signals import Measurement, ReferencePoint, State, TrueDisturbance, Vector, seconds

SPEED_LIMIT = 1000.0
"""Joint speed beyond which a run counts as diverged, rad/s (chosen: far above any robot joint)."""


class PlantStage:
    """The robot: measures, then integrates one tick with torque and disturbance held (RK4).

    ``position`` and ``velocity`` are the true motion; :meth:`measure` is what the sensor makes of it.
    ``effort`` is the torque the drives applied over the tick that has just ended.
    """

    def __init__(
        self,
        robot: Robot,
        dt: float,
        position: Vector,
        velocity: Vector,
        limits: Limits | None = None,
        sensor: Sensor | None = None,
        seed: int = 0,
        torque_delay: int = 0,
        stop_damping: Vector | None = None,
    ) -> None:
        """Start at the given position (rad) and velocity (rad/s).

        Args:
            robot: the model.
            dt: tick length, s.
            position: rad.
            velocity: rad/s.
            limits: of drives and joints; None: none.
            sensor: the sensor model; None: ideal.
            seed: the scenario's seed, for the sensor's noise.
            torque_delay: the drive applies the command of that many ticks before.
            stop_damping: of the safe stop, N·m·s/rad per joint; None: zero torque.
        """
        self.robot = robot
        self.dt = dt
        self.limits = limits or Limits()
        self.position = position
        self.velocity = velocity
        self.effort: Vector = (0.0,) * robot.joints
        self.sensor = sensor or Ideal()
        self._sensor_state = self.sensor.init(robot.joints, seed)
        self._delay = DelayLine(torque_delay, robot.joints)
        self._sense()
        self.stop_damping = stop_damping or (0.0,) * robot.joints
        self.status = "running"
        """``diverged`` or ``limit_exceeded`` once the run cannot go on."""
        self.reason = ""
        """Why it cannot; empty while it can."""

    def measure(self) -> Measurement:
        """y_k: measured motion and the torque applied over the tick that has just ended.

        The sensor works once per tick; asking again in the same tick gives the same.
        """
        return Measurement(*self._measured, self.effort)

    def _sense(self) -> None:
        *measured, self._sensor_state = self.sensor.step(
            self.dt, self.position, self.velocity, self._sensor_state
        )
        self._measured: tuple[Vector, Vector] = (measured[0], measured[1])

    def step(self, u: Vector, d: TrueDisturbance) -> None:
        """Integrate from t_k to t_{k+1} with the command u_k and the disturbance d_k (N·m) held.

        Sets ``status`` and ``reason`` when the torque is not finite, a joint is faster than any can be, or
        beyond its limits; the plant is not stepped further then.
        """
        self._step(u, self._delay.step(u), d)

    def safe_stop(self, d: TrueDisturbance) -> None:
        """Integrate one tick with the drives braking: torque -stop_damping·velocity, within their limits."""
        u = tuple([-c * v for c, v in zip(self.stop_damping, self.velocity)])
        self._delay.step(u)  # in place of a command, so that none from before comes out afterwards
        self._step(u, u, d)

    def _step(self, u: Vector, wanted: Vector, d: TrueDisturbance) -> None:
        self.effort = drive_torque(self.limits, self.effort, wanted)
        tau = tuple(map(add, self.effort, d.torque))
        if not math.isfinite(sum(u) + sum(tau)):
            self._end(
                "diverged",
                f"torque is not finite: command {list(u)} N·m, disturbance {list(d.torque)} N·m",
            )
            return
        self.position, self.velocity = rk4(self.robot, self.dt, self.position, self.velocity, tau)
        if not all(-SPEED_LIMIT < v < SPEED_LIMIT for v in self.velocity):
            self._end(
                "diverged", f"joint velocity {list(self.velocity)} rad/s is beyond {SPEED_LIMIT:g} rad/s"
            )
            return
        beyond = motion_beyond(self.limits, self.robot.joint_names, self.position, self.velocity)
        if beyond:
            self._end("limit_exceeded", beyond)
            return
        self._sense()

    def _end(self, status: str, reason: str) -> None:
        self.status, self.reason = status, reason


class DelayLine:
    """Commands on their way to the drive: each comes out a number of ticks later, zeros before the first."""

    def __init__(self, ticks: int, joints: int) -> None:
        """Start with zeros (N·m) for as many ticks."""
        self._waiting: tuple[Vector, ...] = ((0.0,) * joints,) * ticks

    def step(self, u: Vector) -> Vector:
        """Put in the command of this tick, N·m; return the one that arrives in it."""
        if not self._waiting:
            return u
        arrived, *rest = self._waiting
        self._waiting = (*rest, u)
        return arrived


def rk4(robot: Robot, dt: float, q: Vector, v: Vector, tau: Vector) -> tuple[Vector, Vector]:
    """One classical Runge-Kutta step of q̈ = forward_dynamics(q, q̇, tau), tau held.

    Args:
        robot: the model.
        dt: step, s.
        q: positions, rad.
        v: velocities, rad/s.
        tau: total joint torque, N·m.

    Returns:
        Positions and velocities after the step.
    """
    acceleration = robot.forward_dynamics
    h = 0.5 * dt
    a1 = acceleration(q, v, tau)
    v2 = tuple([x + h * a for x, a in zip(v, a1)])
    a2 = acceleration(tuple([x + h * d for x, d in zip(q, v)]), v2, tau)
    v3 = tuple([x + h * a for x, a in zip(v, a2)])
    a3 = acceleration(tuple([x + h * d for x, d in zip(q, v2)]), v3, tau)
    v4 = tuple([x + dt * a for x, a in zip(v, a3)])
    a4 = acceleration(tuple([x + dt * d for x, d in zip(q, v3)]), v4, tau)
    w = dt / 6.0
    return (
        tuple([x + w * (d1 + 2.0 * (d2 + d3) + d4) for x, d1, d2, d3, d4 in zip(q, v, v2, v3, v4)]),
        tuple([x + w * (b1 + 2.0 * (b2 + b3) + b4) for x, b1, b2, b3, b4 in zip(v, a1, a2, a3, a4)]),
    )


class ObserverStage:
    """The disturbance observer: one estimate per measurement."""

    def __init__(self, observer: Observer, robot: Robot, dt: float) -> None:
        """The state is made from the first measurement."""
        self.observer = observer
        self.robot = robot
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

    def step(self, y: Measurement) -> Vector:
        """tau_hat at t_k (N·m); zeros at the first measurement."""
        if self.state is None:
            self.state = self.observer.init(self.robot, y)
            return (0.0,) * self.robot.joints
        tau_hat, self.state = self.observer.step(self.robot, self.dt, y, self.state)
        return tau_hat


_Prepared = tuple[int, Measurement, ReferencePoint, Vector, State]
"""A tick's stamp (ns) and measurement; its reference, the torque without the estimate, and the next state."""


class ControllerStage:
    """Reference and control law: one torque per measurement and estimate."""

    def __init__(self, controller: Controller, reference: Reference, robot: Robot, dt: float) -> None:
        """Start from the law's initial state."""
        self.controller = controller
        self.reference = reference
        self.robot = robot
        self.dt = dt
        self.state: State = controller.init(robot.joints)
        self._prepared: _Prepared | None = None

    def swap(self, controller: Controller) -> None:
        """Use another law from the next tick on.

        The same law with other parameters keeps its state (integral terms); another law starts
        from its initial state, at the robot's present motion.
        """
        if type(controller) is not type(self.controller):
            self.state = controller.init(self.robot.joints)
        self.controller = controller
        self._prepared = None

    def prepare(self, time_ns: int, y: Measurement) -> None:
        """Compute what of a tick does not need the estimate; :meth:`step` then only adds that."""
        self._prepared = self._without_estimate(time_ns, y)

    def step(self, time_ns: int, y: Measurement, tau_hat: Vector) -> tuple[Vector, ReferencePoint]:
        """u_k (N·m) and the reference at t_k (integer ns)."""
        prepared, self._prepared = self._prepared, None
        if prepared is None or prepared[:2] != (time_ns, y):
            prepared = self._without_estimate(time_ns, y)
        _, _, reference, u, self.state = prepared
        return self.controller.compensated(u, tau_hat), reference

    def _without_estimate(self, time_ns: int, y: Measurement) -> _Prepared:
        reference = self.reference.at(seconds(time_ns), self.robot.joints)
        u, state = self.controller.feedback(self.robot, self.dt, y, reference, self.state)
        return time_ns, y, reference, u, state


class InjectorStage:
    """Disturbances and faults: one added torque per measurement and command."""

    def __init__(
        self,
        sources: Sequence[Disturbance],
        joints: int,
        limits: Limits | None = None,
        torque_delay: int = 0,
    ) -> None:
        """Sum the torques of all sources; they see the torque the drive applies, after delay and limits."""
        self.sources = tuple(sources)
        self.joints = joints
        self.limits = limits or Limits()
        self.applied: Vector = (0.0,) * joints
        self._delay = DelayLine(torque_delay, joints)

    def step(self, time_ns: int, position: Vector, velocity: Vector, u: Vector) -> TrueDisturbance:
        """d_k (N·m) at t_k (integer ns) for the true state and the command u_k; once per tick."""
        t = seconds(time_ns)
        self.applied = drive_torque(self.limits, self.applied, self._delay.step(u))
        total: Vector = (0.0,) * self.joints
        for source in self.sources:
            total = tuple(map(add, total, source.torque(t, position, velocity, self.applied)))
        return TrueDisturbance(total)
