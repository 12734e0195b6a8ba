# SPDX-License-Identifier: Apache-2.0
"""A recorded run: columns with units, one row per tick.

The same type whether the run was simulated in process or read back from a bag.
"""

from __future__ import annotations

import dataclasses
import html
from collections.abc import Callable
from functools import cached_property
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
import numpy.typing as npt

from ftcm_core.controllers import Controller
from ftcm_core.errors import FtcmError, suggestion
from ftcm_core.extras import need
from ftcm_core.faults.timing import NEVER
from ftcm_core.robots import Robot
from ftcm_core.scenario import Scenario
from ftcm_core.signals import COLUMNS

if TYPE_CHECKING:
    from matplotlib.figure import Figure
    from pandas import DataFrame

Array = npt.NDArray[np.float64]

ENDED_EARLY = ("diverged", "limit_exceeded")
"""Statuses of a run that the plant could not go on with."""


@dataclasses.dataclass(frozen=True)
class Change:
    """A component in force from a tick on; the run's own components stand at its first tick."""

    tick: int
    kind: str
    """``controller``, ``observer`` or ``detector``; ``fault`` for an order by hand."""
    component: Any
    """The component, or a :class:`FaultOrder`."""
    by: str = ""
    """Label of the policy that made the change; empty: somebody from outside the run."""


@dataclasses.dataclass(frozen=True)
class FaultOrder:
    """An order by hand, in the place of a :class:`Change`'s component: arm or clear a fault."""

    number: int
    """Place of the fault in the scenario's list."""
    action: str
    """``arm`` or ``clear``."""

    def to_mapping(self) -> dict[str, Any]:
        """Return it as plain data."""
        return {"number": self.number, "action": self.action}


class Decision(NamedTuple):
    """A policy has decided about a fault."""

    tick: int
    """First tick in which what it does is in force."""
    number: int
    """Place of the policy in the scenario's list."""
    joint: int
    """Number of the joint, from 1."""
    verdict: str
    """What the detector said of it in the tick before."""


class FaultEvent(NamedTuple):
    """From when to when a fault acts, as decided in a tick: by an order, or by a condition that was met."""

    tick: int
    number: int
    """Place of the fault in the scenario's list."""
    onset: float
    """It acts at t > onset, s."""
    end: float
    """It acts at t <= end, s; :data:`~ftcm_core.faults.timing.NEVER` where it does not end."""


class FaultInterval(NamedTuple):
    """Ground truth: a fault acts at onset < t <= end, s."""

    number: int
    """Place of the fault in the scenario's list."""
    onset: float
    end: float


@dataclasses.dataclass(frozen=True)
class Trace:
    """One run. Columns are float64 arrays of shape (ticks, joints), see :data:`~ftcm_core.signals.COLUMNS`.

    A column that a bag does not have, or a tick missing in it, is NaN; a column that the run does not have is
    None. Position and velocity are the true motion, and so are the errors taken from them; a source that
    knows only the measured motion gives that.
    """

    joint_names: tuple[str, ...]
    dt: float
    """Tick length, s."""
    time_ns: npt.NDArray[np.int64]
    """Stamps t_k, ns, shape (ticks,)."""
    position: Array
    velocity: Array
    effort: Array
    disturbance_estimate: Array
    command: Array
    disturbance: Array
    reference_position: Array
    reference_velocity: Array
    measured_position: Array | None = None
    measured_velocity: Array | None = None
    joint_torque: Array | None = None
    """None where the torque on the joints was effort and disturbance as recorded."""
    residual: Array | None = None
    alarm: Array | None = None
    verdict: Array | None = None
    scenario: Scenario | None = None
    status: str = "completed"
    """``completed``, ``diverged``, ``limit_exceeded``, or ``incomplete`` (ended before its duration)."""
    detail: str = ""
    """Why a run did not complete, with the time."""
    ended_at: float | None = None
    """When a run ended early, s."""
    changes: tuple[Change, ...] = ()
    fault_events: tuple[FaultEvent, ...] = ()
    """What was decided of faults while the run was on, in the order of time."""
    decisions: tuple[Decision, ...] = ()
    """What the policies decided, in the order of time."""
    engine: str = "plain"
    """How it was run: ``plain``, ``compiled``, or ``graph`` for one that was recorded."""
    accelerations: Callable[[Array, Array], Array] | None = None
    """M(q)^-1 tau of the model, compiled: of positions (rad) and torques (N·m), row by row."""
    column_sums: Callable[[Array], Array] | None = None
    """What :meth:`sums` does, compiled."""

    @property
    def columns(self) -> dict[str, Array]:
        """The columns that this run has, by name, in the order of :data:`~ftcm_core.signals.COLUMNS`."""
        found = {name: getattr(self, name) for name in COLUMNS}
        return {name: values for name, values in found.items() if values is not None}

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

    def plot(self, joint: str | None = None) -> Figure:
        """Draw error, torque, and disturbance with its estimate, at a glance.

        Args:
            joint: name of the joint; the last one by default.

        Returns:
            A figure of matplotlib, which a notebook shows.

        Raises:
            FtcmError: there is no such joint, or no matplotlib.
        """
        from ftcm_core.report.figures import glance
        from ftcm_core.report.panels import styled

        if joint is not None and joint not in self.joint_names:
            raise FtcmError(f"joint {joint!r}; {suggestion(joint, self.joint_names)}")
        label = self.scenario.controller.type_name if self.scenario else "run"
        with styled():
            return glance([(label, self)], None if joint is None else self.joint_names.index(joint))

    def to_pandas(self) -> DataFrame:
        """Return the columns as a table of pandas: index ``time`` (s), columns such as ``error.joint1``.

        Raises:
            FtcmError: pandas is not installed.
        """
        need("pandas", "notebook", "a table of pandas")
        import pandas

        return pandas.DataFrame(self.table(), index=pandas.Index(self.time, name="time"))

    def table(self) -> dict[str, Array]:
        """Return the columns and the errors, one array of shape (ticks,) for each joint: ``error.joint1``."""
        columns = {**self.columns, "error": self.error, "velocity_error": self.velocity_error}
        return {
            f"{name}.{joint}": values[:, j]
            for name, values in columns.items()
            for j, joint in enumerate(self.joint_names)
        }

    def _repr_html_(self) -> str:
        """What a notebook shows of a run: how it ended, and its errors."""
        from ftcm_core.recording.metrics import evaluate

        law = self.scenario.controller.type_name if self.scenario else ""
        end = f"{self.status}: {self.detail}" if self.detail else self.status
        rows = "".join(
            f"<tr><td>{window.replace('_', ' ')}</td>"
            + "".join(f"<td>{x:.3g}</td>" for x in (*found["mean_abs_error"], *found["max_abs_error"]))
            + "</tr>"
            for window, found in evaluate(self).items()
            if found
        )
        heads = "".join(
            f"<th>{what} |e|, rad: {html.escape(name)}</th>"
            for what in ("mean", "largest")
            for name in self.joint_names
        )
        return (
            f"<p><b>{html.escape(law)}</b>, {self.ticks:,} ticks of {self.dt:g} s, {html.escape(end)}</p>"
            f"<table><tr><th>window</th>{heads}</tr>{rows}</table>"
        )

    def sums(self, values: Array) -> Array:
        """Return the sums over rows, shape (joints,), of an array of shape (n, joints).

        numpy adds such an array row after row, and so does the compiled function: every bit is equal.
        """
        if self.column_sums is None or not len(values):
            return np.asarray(np.sum(values, axis=0))
        return self.column_sums(values)

    @property
    def model(self) -> Robot | None:
        """What observer and controller believe of the robot, if the run says so."""
        return self.scenario.model if self.scenario else None

    @cached_property
    def fault_intervals(self) -> tuple[FaultInterval, ...]:
        """From when to when each fault acts, by onset: as planned, and as decided while the run was on."""
        if self.scenario is None:
            return ()
        now = {number: fault.planned() for number, fault in enumerate(self.scenario.faults)}
        found = []
        for event in self.fault_events:
            onset, end = now[event.number]
            if onset < event.onset < NEVER:  # armed again: what there was is over
                found.append(FaultInterval(event.number, onset, min(end, event.onset)))
            now[event.number] = (event.onset, event.end)
        found += [FaultInterval(number, *phase) for number, phase in now.items()]
        return tuple(sorted((x for x in found if x.onset < min(x.end, NEVER)), key=lambda x: x.onset))

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
        """True Δ (eq 6), rad/s²: acceleration by the model less the true one; NaN without a model.

        Where the plant is the model and nothing is hidden, it is -M(q)^-1 disturbance. Elsewhere it is taken
        from the motion: what the model would make of the torque that the drives report, less the change of
        the velocity over the tick; in the last tick, that of the one before.
        """
        scenario = self.scenario
        if scenario is None or self.ticks < 2:
            return np.full_like(self.disturbance, np.nan)
        if self.joint_torque is None and scenario.model == scenario.robot and scenario.exact_engine:
            return self._as_acceleration(self.position, -self.disturbance)
        rows = zip(self.position[:-1].tolist(), self.velocity[:-1].tolist(), self.effort[1:].tolist())
        forward = scenario.model.forward_dynamics
        believed = np.array([forward(tuple(q), tuple(v), tuple(u)) for q, v, u in rows])
        found = believed - np.diff(self.velocity, axis=0) / self.dt
        return np.vstack([found, found[-1:]])

    @cached_property
    def lumped_uncertainty_estimate(self) -> Array:
        """Estimate Δ̂ = M(q)^-1 tau_hat, rad/s²; NaN without a robot model."""
        seen = self.position if self.measured_position is None else self.measured_position
        return self._as_acceleration(seen, self.disturbance_estimate)

    @cached_property
    def observer_error(self) -> Array:
        """The observer's error Δ - Δ̂, rad/s²; NaN without a robot model."""
        return self.lumped_uncertainty - self.lumped_uncertainty_estimate

    def _as_acceleration(self, position: Array, torque: Array) -> Array:
        if self.model is None:
            return np.full_like(torque, np.nan)
        if self.accelerations is not None:
            return self.accelerations(position, np.ascontiguousarray(torque))
        rows = zip(position.tolist(), torque.tolist())
        convert = self.model.inertia_acceleration
        return np.array([convert(tuple(q), tuple(tau)) for q, tau in rows]).reshape(torque.shape)
