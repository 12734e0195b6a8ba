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

from ftcm_core.params import joint_parameters
from ftcm_core.registry import Component
from ftcm_core.robots import Robot
from ftcm_core.signals import Measurement, ReferencePoint, State, Vector


class Controller(Component):
    """A control law with explicit state: ``init`` once, then once per tick ``prepare`` and ``step``.

    ``needs_observer`` says whether the law uses the disturbance estimate; one that does not
    neither waits for it nor sees it.
    """

    needs_observer: ClassVar[bool] = False

    @abstractmethod
    def init(self, joints: int) -> State:
        """Return the state at the start or after a swap: one tuple of floats per joint."""

    def prepare(
        self, model: Robot, dt: float, y: Measurement, reference: ReferencePoint, state: State
    ) -> Any:
        """Compute what of a tick does not need the disturbance estimate; by default nothing.

        It runs while the observer still works, and has no effect: its result is handed to :meth:`step`.

        Args:
            model: what the law believes of the robot.
            dt: tick length, s.
            y: measurement at t_k.
            reference: desired motion at t_k.
            state: what the last step returned.
        """
        del model, dt, y, reference, state

    @abstractmethod
    def step(
        self,
        model: Robot,
        dt: float,
        y: Measurement,
        reference: ReferencePoint,
        disturbance_estimate: Vector,
        state: State,
        prepared: Any,
    ) -> tuple[Vector, State]:
        """Compute the torque command u_k of one tick.

        Args:
            model: what the law believes of the robot.
            dt: tick length, s.
            y: measurement at t_k.
            reference: desired motion at t_k.
            disturbance_estimate: tau_hat at t_k, N·m; zeros for a law that needs no observer.
            state: what the last step returned.
            prepared: what :meth:`prepare` returned for the same arguments.

        Returns:
            Joint torque, N·m, and the next state.
        """

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


class FeedbackLaw(Controller):
    """A law to whose feedback the disturbance estimate is added: ``feedback`` is all that it says."""

    @abstractmethod
    def feedback(
        self, model: Robot, dt: float, y: Measurement, reference: ReferencePoint, state: State
    ) -> tuple[Vector, State]:
        """Compute the torque without the estimate (N·m) and the next state; arguments as of ``prepare``."""

    def prepare(
        self, model: Robot, dt: float, y: Measurement, reference: ReferencePoint, state: State
    ) -> tuple[Vector, State]:
        """All but the estimate."""
        return self.feedback(model, dt, y, reference, state)

    def step(
        self,
        model: Robot,
        dt: float,
        y: Measurement,
        reference: ReferencePoint,
        disturbance_estimate: Vector,
        state: State,
        prepared: tuple[Vector, State],
    ) -> tuple[Vector, State]:
        """Add the estimate where the law uses an observer."""
        u, following = prepared
        return tuple(map(add, u, disturbance_estimate)) if self.needs_observer else u, following


class AccelerationLaw(FeedbackLaw):
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
        self, model: Robot, dt: float, y: Measurement, reference: ReferencePoint, state: State
    ) -> tuple[Vector, State]:
        """U = M(q) v + h + G with v = ẍ_r + law(e, ė)."""
        law = self.law
        acceleration, following = [], []
        for p, q, v, qr, vr, ar, s in zip(joint_parameters(self, model.joints), *y[:2], *reference, state):
            a, s_next = law(p, q - qr, v - vr, dt, s)
            acceleration.append(ar + a)
            following.append(s_next)
        return model.inverse_dynamics(y.position, y.velocity, tuple(acceleration)), tuple(following)

    def sliding_variable(self, e: float, de: float, joint: int) -> float | None:
        """Sliding variable of one joint for its errors."""
        return self.surface(self.for_joint(joint), e, de)
