# SPDX-License-Identifier: Apache-2.0
"""A recorded run: columns with units, one row per tick.

The same type whether the run was simulated in process or read back from a bag.
"""

from __future__ import annotations

import dataclasses
from functools import cached_property
from typing import Any

import numpy as np
import numpy.typing as npt

from ftcm_core.controllers import Controller
from ftcm_core.robots import Robot
from ftcm_core.scenario import Scenario

Array = npt.NDArray[np.float64]

COLUMNS = {
    "position": "rad",
    "velocity": "rad/s",
    "effort": "N·m",
    "disturbance_estimate": "N·m",
    "command": "N·m",
    "disturbance": "N·m",
    "reference_position": "rad",
    "reference_velocity": "rad/s",
}
"""Recorded columns and their units: arrays of shape (ticks, joints)."""

MEASURED = {"measured_position": "rad", "measured_velocity": "rad/s"}
"""Further columns of a run whose sensor is not ideal: what observer and controller were given."""

ENDED_EARLY = ("diverged", "limit_exceeded")
"""Statuses of a run that the plant could not go on with."""


@dataclasses.dataclass(frozen=True)
class Change:
    """A component in force from a tick on; the run's own components stand at its first tick."""

    tick: int
    kind: str
    """``controller`` or ``observer``."""
    component: Any


@dataclasses.dataclass(frozen=True)
class Trace:
    """One run. Columns are float64 arrays of shape (ticks, joints), units in :data:`COLUMNS`.

    A column that a bag does not have, or a tick missing in it, is NaN. Position and velocity are the true
    motion, and so are the errors taken from them; a source that knows only the measured motion gives that.
    """

    joint_names: tuple[str, ...]
    dt: float
    """Tick length, s."""
    time_ns: npt.NDArray[np.int64]
    """Stamps t_k, ns, shape (ticks,)."""
    position: Array
    velocity: Array
    effort: Array
    """Torque applied over the tick that ended at t_k, after limits."""
    disturbance_estimate: Array
    command: Array
    disturbance: Array
    reference_position: Array
    reference_velocity: Array
    measured_position: Array | None = None
    """None where the sensor was ideal, or what it measured was not kept."""
    measured_velocity: Array | None = None
    scenario: Scenario | None = None
    status: str = "completed"
    """``completed``, ``diverged``, ``limit_exceeded``, or ``incomplete`` (ended before its duration)."""
    detail: str = ""
    """Why a run did not complete, with the time."""
    changes: tuple[Change, ...] = ()

    @property
    def ticks(self) -> int:
        """Number of ticks recorded."""
        return len(self.time_ns)

    @cached_property
    def time(self) -> Array:
        """Stamps t_k, s, shape (ticks,)."""
        return self.time_ns / 1e9

    @cached_property
    def error(self) -> Array:
        """Tracking error e = q - q_ref, rad."""
        return self.position - self.reference_position

    @cached_property
    def velocity_error(self) -> Array:
        """Velocity error, rad/s."""
        return self.velocity - self.reference_velocity

    @property
    def robot(self) -> Robot | None:
        """The robot model, if the run says which."""
        return self.scenario.robot if self.scenario else None

    def controllers(self) -> list[tuple[int, int, Controller]]:
        """Return the controllers in force as (first row, row after the last, controller)."""
        found = [(0, self.scenario.controller)] if self.scenario else []
        first = int(self.time_ns[0]) if self.ticks else 0
        step = round(self.dt * 1e9)
        for change in sorted(self.changes, key=lambda c: c.tick):
            if change.kind == "controller":
                found.append((max(0, change.tick - first // step), change.component))
        ends = [row for row, _ in found[1:]] + [self.ticks]
        return [(row, end, law) for (row, law), end in zip(found, ends) if end > row]

    @cached_property
    def sliding_variable(self) -> Array:
        """Sliding variable of the law in force at each tick; NaN where it has none."""
        out = np.full_like(self.error, np.nan)
        for row, end, law in self.controllers():
            for joint in range(out.shape[1]):
                pairs = zip(self.error[row:end, joint].tolist(), self.velocity_error[row:end, joint].tolist())
                p = law.for_joint(joint)
                values = [p.sliding_variable(e, de, 0) for e, de in pairs]
                out[row:end, joint] = [np.nan if s is None else s for s in values]
        return out

    @cached_property
    def lumped_uncertainty(self) -> Array:
        """True Δ = -M(q)^-1 disturbance (eq 6), rad/s²; NaN without a robot model."""
        return self._as_acceleration(self.position, -self.disturbance)

    @cached_property
    def lumped_uncertainty_estimate(self) -> Array:
        """Estimate Δ̂ = M(q)^-1 tau_hat, rad/s²; NaN without a robot model."""
        seen = self.position if self.measured_position is None else self.measured_position
        return self._as_acceleration(seen, self.disturbance_estimate)

    def _as_acceleration(self, position: Array, torque: Array) -> Array:
        robot = self.robot
        if robot is None:
            return np.full_like(torque, np.nan)
        rows = zip(position.tolist(), torque.tolist())
        return np.array([robot.inertia_acceleration(q, tau) for q, tau in rows]).reshape(torque.shape)
