# SPDX-License-Identifier: Apache-2.0
"""What the tests of observers share: robots at rest or moving, their measurements, the estimates."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable

import numpy as np
from numpy.typing import NDArray

from ftcm_core.observers import Observer
from ftcm_core.plants.rigid_body import rk4
from ftcm_core.robots import Robot
from ftcm_core.signals import Measurement, Vector

Array = NDArray[np.float64]
DT = 1e-3
POSTURE = (0.3, -0.4, 0.7, 0.2, -0.1, 0.5)
"""Positions of up to six joints, rad."""
PUSH = (5.0, -8.0, 2.0, 1.0, -1.0, 0.5)
"""Torques on up to six joints, N·m."""


def held(robot: Robot, push: Iterable[float] = PUSH) -> Measurement:
    """A robot that its drives hold at rest against added torques (N·m)."""
    n = robot.joints
    q = POSTURE[:n]
    return Measurement(q, (0.0,) * n, tuple(g - x for g, x in zip(robot.gravity(q), push)))


def estimates(observer: Observer, robot: Robot, measured: Iterable[Measurement], dt: float = DT) -> Array:
    """tau_hat at every measurement, N·m; the first is zero."""
    found: list[Vector] = []
    state = None
    for y in measured:
        if state is None:
            estimate, state = (0.0,) * robot.joints, observer.init(robot, y)
        else:
            estimate, state = observer.step(robot, dt, y, state)
        found.append(estimate)
    return np.array(found)


def moved(
    robot: Robot, added: Callable[[int, Vector], Vector], duration: float, dt: float = DT
) -> list[Measurement]:
    """Measurements of a robot that follows slow sines by computed torque, from rest and off its reference.

    Args:
        robot: it knows its own model.
        added: torque added over the tick of a number, at the position of its start, N·m.
        duration: s.
        dt: tick length, s.
    """
    n = robot.joints
    q, v = POSTURE[:n], (0.0,) * n
    measured = [Measurement(q, v, (0.0,) * n)]
    for k in range(round(duration / dt)):
        phases = [1.5 * k * dt + j for j in range(n)]
        wanted = [(0.4 * math.sin(x), 0.6 * math.cos(x), -0.9 * math.sin(x)) for x in phases]
        a = tuple(ar - 100.0 * (x - qr) - 20.0 * (w - vr) for (qr, vr, ar), x, w in zip(wanted, q, v))
        u = robot.inverse_dynamics(q, v, a)
        q, v = rk4(robot, dt, q, v, tuple(x + d for x, d in zip(u, added(k, q))))
        measured.append(Measurement(q, v, u))
    return measured
