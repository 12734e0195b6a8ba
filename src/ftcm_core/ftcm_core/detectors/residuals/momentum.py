# SPDX-License-Identifier: Apache-2.0
"""The residual of the generalised momentum p = M(q) q̇ (De Luca and Mattone 2003).

r = K (p - ∫ (τ + Cᵀq̇ - G - F + r) dt) follows a torque d that is added to that of the drives like a first-
order low-pass, ṙ = K (d - r), joint by joint. (A. De Luca, R. Mattone, "Actuator failure detection and
isolation using generalized momenta", ICRA 2003.) It needs no acceleration and no inverse of M.

Over a tick, p grows by M̄ Δq̇ + ΔM q̇̄ (the product rule of differences, bars are means). As Cᵀq̇ = Ṁq̇ -
Cq̇, the second part cancels with the integral of Ṁq̇. What is left, with the midpoint rule for the rest, is
the inverse dynamics at the midpoint less the torque of the tick. So one call of the inverse dynamics is
enough.
"""

from __future__ import annotations

import math
from typing import Any

from ftcm_core.detectors.residuals import Seen, halfway
from ftcm_core.numeric import select
from ftcm_core.robots import Robot
from ftcm_core.signals import Measurement, Vector


def momentum_residual(
    parameters: tuple[Any, ...], model: Robot, dt: float, y: Measurement, seen: Seen
) -> tuple[Vector, Seen]:
    """Return the residual, N·m, and what is remembered; zero at the first measurement.

    Args:
        parameters: per joint; ``gain`` is K, 1/s.
        model: what is believed of the robot.
        dt: tick length, s.
        y: measurement; its effort is the torque of the drives over the tick that has just ended.
        seen: what was returned last.
    """
    rate = tuple([(v - before) / dt for v, before in zip(y.velocity, seen.velocity)])
    needed = model.inverse_dynamics(
        halfway(seen.position, y.position), halfway(seen.velocity, y.velocity), rate
    )
    residual = tuple(
        [
            select(seen.started, r + (1.0 - math.exp(-p.gain * dt)) * (w - u - r), 0.0)
            for p, r, w, u in zip(parameters, seen.residual, needed, y.effort)
        ]
    )
    return residual, Seen(1.0, y.position, y.velocity, residual)
