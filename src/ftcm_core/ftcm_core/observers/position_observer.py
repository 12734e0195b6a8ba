# SPDX-License-Identifier: Apache-2.0
"""What observers of the position alone have in common: per joint a chain of three integrators."""

from __future__ import annotations

from abc import abstractmethod
from typing import Any, ClassVar, NamedTuple

from ftcm_core.numeric import select
from ftcm_core.observers import Observer, middle
from ftcm_core.params import joint_parameters
from ftcm_core.robots import Robot
from ftcm_core.signals import Measurement, Vector


class PositionState(NamedTuple):
    """State at t_k."""

    position: Vector
    """q_k, rad."""
    chains: tuple[Vector, ...]
    """Per joint: position (rad), velocity (rad/s), -Δ̂ (rad/s²), then what else the observer remembers."""
    begun: float
    """0 at the first measurement, then 1."""


class PositionObserver(Observer):
    """An observer of q alone: ẋ1 = x2, ẋ2 = a + x3, x3 = -Δ, per joint, with the model's a = M⁻¹(u - h - G).

    The measured velocity is never looked at: the model is evaluated with the estimated one, at the mean of
    the two positions of a tick. In the first tick the velocity is the difference of its two positions, so
    that an observer may start while the arm moves. A subclass writes ``first`` and ``advance`` for one joint.
    """

    needs_velocity: ClassVar[bool] = False

    @staticmethod
    def first(p: Any, q: float) -> Vector:
        """Chain of one joint at its first measured position (rad), undisturbed."""
        del p
        return q, 0.0, 0.0

    @staticmethod
    @abstractmethod
    def advance(p: Any, chain: Vector, a: float, q: float, dt: float) -> Vector:
        """Chain of one joint a tick later.

        Args:
            p: parameters of the joint.
            chain: the chain at t_{k-1}.
            a: the model's acceleration over the tick, rad/s².
            q: measured position at t_k, rad.
            dt: tick length, s.
        """

    def init(self, model: Robot, y: Measurement) -> PositionState:
        """No joint's velocity is known yet."""
        parameters = joint_parameters(self, model.joints)
        chains = tuple([self.first(p, q) for p, q in zip(parameters, y.position)])
        return PositionState(y.position, chains, 0.0)

    def step(
        self, model: Robot, dt: float, y: Measurement, state: PositionState
    ) -> tuple[Vector, PositionState]:
        """Predict by the model, correct by the position; returns M(q_k) Δ̂."""
        advance = self.advance
        mean = difference(state.position, y.position, dt)
        velocity = tuple([select(state.begun, chain[1], v) for chain, v in zip(state.chains, mean)])
        acceleration = model.forward_dynamics(middle(state.position, y.position), velocity, y.effort)
        chains = tuple(
            [
                advance(p, (chain[0], select(state.begun, v, v - 0.5 * dt * a), *chain[2:]), a, q, dt)
                for p, chain, v, a, q in zip(
                    joint_parameters(self, model.joints), state.chains, velocity, acceleration, y.position
                )
            ]
        )
        delta_hat = tuple([-chain[2] for chain in chains])
        return model.inertia_torque(y.position, delta_hat), PositionState(y.position, chains, 1.0)


def difference(before: Vector, now: Vector, dt: float) -> Vector:
    """Mean velocities over a tick, rad/s, of the positions at its ends (rad)."""
    return tuple([(b - a) / dt for a, b in zip(before, now)])


def predict(x1: float, x2: float, x3: float, a: float, dt: float) -> tuple[float, float]:
    """Position (rad) and velocity (rad/s) after a tick of constant acceleration a + x3: exact.

    Args:
        x1: position, rad.
        x2: velocity, rad/s.
        x3: added acceleration, rad/s².
        a: acceleration by the model, rad/s².
        dt: tick length, s.
    """
    change = dt * (a + x3)
    return x1 + dt * (x2 + 0.5 * change), x2 + change
