# SPDX-License-Identifier: Apache-2.0
"""Control laws, one per file: from measurement, reference and disturbance estimate to joint torque.

Every law of the paper has the form ``u = M(q) v + h + G`` (inverse dynamics of a commanded
acceleration v), so most laws only say how one joint's error becomes one joint's acceleration:
see :class:`AccelerationLaw`.
"""

from __future__ import annotations

from abc import abstractmethod
from operator import add
from typing import Any, ClassVar

from ftcm_core.registry import Component
from ftcm_core.robots import Robot
from ftcm_core.signals import Measurement, ReferencePoint, State, Vector


class Controller(Component):
    """A control law with explicit state: ``init`` once, then ``step`` once per tick.

    ``needs_observer`` says whether the law uses the disturbance estimate; one that does not
    neither waits for it nor sees it.
    """

    needs_observer: ClassVar[bool] = False

    @abstractmethod
    def init(self, joints: int) -> State:
        """Return the state at the start or after a swap: one tuple of floats per joint."""

    @abstractmethod
    def feedback(
        self, robot: Robot, dt: float, y: Measurement, reference: ReferencePoint, state: State
    ) -> tuple[Vector, State]:
        """Compute the torque of one tick but for the disturbance estimate.

        It can be asked for while the observer still works.

        Args:
            robot: the model the law uses.
            dt: tick length, s.
            y: measurement at t_k.
            reference: desired motion at t_k.
            state: what the last step returned.

        Returns:
            Joint torque, N·m, and the next state.
        """

    def step(
        self,
        robot: Robot,
        dt: float,
        y: Measurement,
        reference: ReferencePoint,
        disturbance_estimate: Vector,
        state: State,
    ) -> tuple[Vector, State]:
        """Compute the torque command u_k of one tick, N·m, and the next state.

        Args:
            robot: as of :meth:`feedback`.
            dt: as of :meth:`feedback`.
            y: as of :meth:`feedback`.
            reference: as of :meth:`feedback`.
            disturbance_estimate: tau_hat at t_k, N·m, added where the law uses an observer.
            state: as of :meth:`feedback`.
        """
        u, following = self.feedback(robot, dt, y, reference, state)
        return self.compensated(u, disturbance_estimate), following

    def compensated(self, u: Vector, disturbance_estimate: Vector) -> Vector:
        """Add the disturbance estimate to the feedback torque where the law uses an observer, N·m."""
        return tuple(map(add, u, disturbance_estimate)) if self.needs_observer else u

    def sliding_variable(self, e: float, de: float, joint: int) -> float | None:
        """Sliding variable of one joint (0-based) for its errors (rad, rad/s); None if the law has none."""
        del e, de, joint
        return None

    def settling_time_bound(self, e0: float, joint: int) -> float | None:
        """Upper bound of the time on the sliding surface from |e(0)| (rad) to zero, s; None if unknown."""
        del e0, joint
        return None

    def warnings(self) -> list[str]:
        """Conditions of the stability proof that these parameters do not meet, one line each."""
        return []


class AccelerationLaw(Controller):
    """A law that is one scalar function per joint, u = M(q)(ẍ_r + a) + h + G (+ tau_hat).

    A subclass writes ``law(p, e, de, dt, s) -> (a, s_next)`` with p its own parameters reduced to one
    joint, e and de in rad and rad/s, a the feedback acceleration in rad/s², s its per-joint state,
    and sets ``initial`` to the state it starts from.
    """

    initial: ClassVar[Vector] = ()

    @staticmethod
    @abstractmethod
    def law(p: Any, e: float, de: float, dt: float, s: Vector) -> tuple[float, Vector]:
        """Feedback acceleration of one joint, rad/s², and its next state."""

    @staticmethod
    def surface(p: Any, e: float, de: float) -> float | None:
        """Sliding variable of one joint; None if the law has none."""
        del p, e, de
        return None

    def init(self, joints: int) -> State:
        """Every joint starts from ``initial``."""
        return (self.initial,) * joints

    def feedback(
        self, robot: Robot, dt: float, y: Measurement, reference: ReferencePoint, state: State
    ) -> tuple[Vector, State]:
        """U = M(q) v + h + G with v = ẍ_r + law(e, ė)."""
        law = self.law
        acceleration, following = [], []
        for p, q, v, qr, vr, ar, s in zip(joint_parameters(self, robot.joints), *y[:2], *reference, state):
            a, s_next = law(p, q - qr, v - vr, dt, s)
            acceleration.append(ar + a)
            following.append(s_next)
        return robot.inverse_dynamics(y.position, y.velocity, tuple(acceleration)), tuple(following)

    def sliding_variable(self, e: float, de: float, joint: int) -> float | None:
        """Sliding variable of one joint for its errors."""
        return self.surface(self.for_joint(joint), e, de)


def joint_parameters(component: Component, joints: int) -> tuple[Any, ...]:
    """Parameters of a component, reduced to each joint in turn; kept with the component, as it is frozen."""
    kept: tuple[Any, ...] | None = component.__dict__.get("_joint_parameters")
    if kept is None or len(kept) != joints:
        component.check_joints(joints)
        kept = tuple([component.for_joint(j) for j in range(joints)])
        component.__dict__["_joint_parameters"] = kept
    return kept
