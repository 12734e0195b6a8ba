# SPDX-License-Identifier: Apache-2.0
"""The residual of the motion: whether the measured positions and velocities of a joint belong together.

An observer of the kinematics alone, dq̂/dt = v + L (q - q̂), with r = L (q - q̂): what the positions do,
less what the velocities say, low-passed with the pole L (observer-based residuals: R. Isermann, "Fault-
Diagnosis Systems", 2006, ch. 11). Over a tick v is the mean of two measurements (trapezoid).

Neither the model nor a torque is in it, so that no fault of an actuator or of the dynamics shows. A constant
bias of the velocity, or a wrong gain, a drift or a freeze of the positions alone show for as long as they
last; a step of the position shows as a jump of L times the step, which decays with L. It cannot see what
changes position and velocity alike (a sensor that freezes at rest; a drift that the velocity has too, as
`sensor_drift` is without its random walk), and a bias of the position once the step has decayed.
"""

from __future__ import annotations

import math
from typing import Any

from ftcm_core.detectors.residuals import Seen
from ftcm_core.numeric import select
from ftcm_core.signals import Measurement, Vector


def motion_residual(
    parameters: tuple[Any, ...], dt: float, y: Measurement, seen: Seen
) -> tuple[Vector, Seen]:
    """Return the residual, rad/s, and what is remembered; zero at the first measurement.

    Args:
        parameters: per joint; ``gain`` is L, 1/s.
        dt: tick length, s.
        y: measurement.
        seen: what was returned last.
    """
    residual = tuple(
        [
            select(
                seen.started,
                r + (1.0 - math.exp(-p.gain * dt)) * ((q - q_before) / dt - 0.5 * (v + v_before) - r),
                0.0,
            )
            for p, r, q, q_before, v, v_before in zip(
                parameters, seen.residual, y.position, seen.position, y.velocity, seen.velocity
            )
        ]
    )
    return residual, Seen(1.0, y.position, y.velocity, residual)
