# SPDX-License-Identifier: Apache-2.0
"""The tick loop that the ROS graph repeats node by node.

tick k, t_k = k*dt (k an integer, time an integer number of nanoseconds, never accumulated)
  y_k   = sensors(x_k), u_{k-1} applied            plant      -> joint_states          (stamp t_k)
  (policies: what r_{k-1} makes of y_k, of the observer, the law and the reference, from here on)
  est_k = observer.step(y_k)                       observer   -> disturbance_estimate  (stamp t_k)
  u_k   = controller.step(y_k, ref(t_k), est_k)    controller -> joint_torques         (stamp t_k)
  d_k   = injector.step(t_k, x_k, u_k)             injector   -> disturbance           (stamp t_k)
  r_k   = detector.step(y_k, u_k, est_k)           detector   -> detection             (stamp t_k)
  record(k)
  a_k   = drive(u_k)                               plant: delay, limits, actuator faults
  x_{k+1} = plant.step(x_k, a_k + d_k)             plant: torques held over [t_k, t_{k+1})
"""

from __future__ import annotations

from array import array
from bisect import bisect_left
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from ftcm_core.recording.trace import Array, Change, Decision, FaultEvent, Trace
from ftcm_core.scenario import Scenario
from ftcm_core.signals import Detection, TrueDisturbance, Vector, seconds
from ftcm_core.simulation.accommodation import Accommodation
from ftcm_core.simulation.fault_chain import Phase
from ftcm_core.simulation.stages import (
    ControllerStage,
    DetectorStage,
    InjectorStage,
    ObserverStage,
    PlantStage,
    robot_changes,
)


class Loop:
    """The stages of one run and the tick that composes them."""

    def __init__(self, scenario: Scenario) -> None:
        """Start at the scenario's initial state."""
        self.plant = PlantStage(scenario)
        self.observer = ObserverStage(scenario.observer, scenario.model, scenario.dt)
        self.controller = ControllerStage(scenario)
        self.injector = InjectorStage(scenario)
        self.detector = DetectorStage(scenario) if scenario.detector else None
        self.accommodation = Accommodation(scenario) if scenario.policies else None
        self.decisions: list[Decision] = []
        """What the policies decided so far, and the changes that they made."""
        self.made: list[Change] = []
        self._found: Detection | None = None
        self._policy_labels = scenario.policy_labels
        self.hidden = scenario.hidden
        self.fault_events: list[FaultEvent] = []
        """What was decided of faults so far."""
        self._known = self.phases()

    def act(self, time_ns: int) -> tuple[Vector, Vector, TrueDisturbance]:
        """Everything of a tick before the plant moves: measure, observe, control, disturb, detect.

        Args:
            time_ns: t_k, ns.

        Returns:
            The row that is recorded, in the order of :data:`~ftcm_core.signals.COLUMNS`; u_k (N·m) and
            d_k (N·m).
        """
        y = seen = self.plant.measure()
        if self.accommodation:
            self._accommodate(self.accommodation, time_ns // self.plant.dt_ns)
            seen = self.accommodation.measured(y)
        tau_hat = self.observer.step(seen)
        u, reference = self.controller.step(time_ns, seen, tau_hat)
        q, v = self.plant.motion
        d = self.injector.step(time_ns, q, v, u)
        row = (*q, *v, *y.effort, *tau_hat, *u, *d.torque, *reference.position, *reference.velocity)
        if self.hidden:
            row += (*y.position, *y.velocity, *self.plant.joint_torque)
        if self.detector:
            self._found = found = self.detector.step(y, u, tau_hat)
            row += (*found.residual, *found.alarm, *found.verdict)
        return row, u, d

    def tick(self, time_ns: int, last: bool, record: Callable[[Vector], object]) -> str:
        """Run one tick and move the plant, unless it is the last.

        Args:
            time_ns: t_k, ns.
            last: whether the run ends with this tick.
            record: takes the tick's row.

        Returns:
            Why the run cannot go on; empty while it can.
        """
        try:
            row, u, d = self.act(time_ns)
            record(row)
            if last:
                return ""
            self.plant.step(time_ns, u, d)
        except (ArithmeticError, ValueError) as error:  # a law out of its domain: overflow, log(0), ...
            return str(error) or type(error).__name__
        return self.plant.reason

    def _accommodate(self, accommodation: Accommodation, tick: int) -> None:
        """Do what the policies decide of what the detector said in the tick before."""
        decisions = accommodation.hear(tick, self._found) if self._found else []
        self.decisions += decisions
        for decision in decisions:
            for kind, component in accommodation.policies[decision.number].components().items():
                getattr(self, kind).swap(component)
                self.made.append(Change(tick, kind, component, self._policy_labels[decision.number]))
        if decisions:
            self.controller.slow(accommodation.pace)

    def change(self, change: Change, time_ns: int) -> None:
        """Swap a component in, or arm or clear a fault, with the tick at ``time_ns``.

        What a policy did in another run, the policy does again in this one.
        """
        if change.by:
            return
        if change.kind != "fault":
            getattr(self, change.kind).swap(change.component)
            return
        self.look_at_faults(time_ns)
        for stage in (self.plant, self.controller, self.injector):
            stage.order(change.component.number, change.component.action, seconds(time_ns))
        self.look_at_faults(time_ns)

    def phases(self) -> dict[int, Phase]:
        """From when to when each fault acts, as is known so far, by its place in the scenario's list."""
        return {**self.plant.phases(), **self.controller.phases(), **self.injector.phases()}

    def look_at_faults(self, time_ns: int) -> None:
        """Note what has been decided of faults since the last look."""
        tick, now = time_ns // self.plant.dt_ns, self.phases()
        self.fault_events += [
            FaultEvent(tick, number, *phase) for number, phase in now.items() if phase != self._known[number]
        ]
        self._known = now

    def ended(self, time_ns: int, reason: str) -> tuple[str, str, float | None]:
        """How a run ended with the tick at ``time_ns`` and what :meth:`tick` returned.

        Returns:
            Status, detail with the time, and the time, s; None if the run is complete.
        """
        if not reason:
            return "completed", "", None
        moved = bool(self.plant.reason)  # else a law or a fault left its domain before the plant moved
        t = seconds(time_ns + self.plant.dt_ns if moved else time_ns)
        return self.plant.status if moved else "diverged", f"at t = {t:g} s: {reason}", t


def simulate(
    scenario: Scenario,
    changes: Sequence[Change] = (),
    progress: Callable[[int, int], None] | None = None,
    *,
    written: bool = True,
) -> Trace:
    """Run a scenario in process.

    Args:
        scenario: what to run.
        changes: controllers, observers or detectors to swap in, faults to arm or clear, each with its tick.
        progress: called every 1000 ticks with the ticks done and the last tick.
        written: whether many ticks are run by one function written of them
            (:mod:`ftcm_core.compiled.written`), where that is possible; every bit is the same.

    Returns:
        The trace; a run that diverges or exceeds a limit ends there, with its status and the time.
    """
    from ftcm_core.compiled.written import Ahead  # which is made of this loop

    loop = Loop(scenario)
    swaps: dict[int, list[Change]] = {}
    for change in changes:
        swaps.setdefault(change.tick, []).append(change)
    dt_ns, last = scenario.dt_ns, scenario.last_tick
    exchanges = sorted({*swaps, *(time_ns // dt_ns for time_ns, _ in robot_changes(scenario)), last})
    rows = array("d")
    ahead = Ahead(loop, rows)
    reason, k = "", 0
    while True:
        if k in exchanges:
            for change in swaps.get(k, ()):
                loop.change(change, k * dt_ns)
            ahead.forget()
        reason = loop.tick(k * dt_ns, k == last, rows.extend)
        if reason or k == last:
            break
        if progress and k % 1000 == 0:
            progress(k, last)
        k += 1
        end = exchanges[bisect_left(exchanges, k)]
        if written and k < end:
            k = ahead.run(k, min(end, k + 1000 - k % 1000), end)
    ended = loop.ended(k * dt_ns, reason)
    loop.look_at_faults(k * dt_ns)
    events = tuple(loop.fault_events)
    columns = by_column(scenario, rows)
    done = sorted([*(c for c in changes if not c.by), *loop.made], key=lambda c: (c.tick, c.kind))
    return to_trace(
        scenario, columns, *ended, changes=done, fault_events=events, decisions=tuple(loop.decisions)
    )


def by_column(scenario: Scenario, rows: array[float]) -> Array:
    """Return the rows of all ticks, one after the other, as :func:`to_trace` takes them."""
    table = np.frombuffer(rows).reshape(-1, len(scenario.columns), scenario.robot.joints)
    return np.ascontiguousarray(table.swapaxes(0, 1))


def to_trace(
    scenario: Scenario,
    columns: Array,
    status: str,
    detail: str,
    ended_at: float | None,
    **more: Any,
) -> Trace:
    """Make a trace of what was recorded.

    Args:
        scenario: what ran.
        columns: shape (columns, ticks, joints), in the order of the scenario's columns; rows contiguous.
        status: how the run ended.
        detail: why it ended early; empty if it did not.
        ended_at: when it ended early, s.
        **more: further fields of the trace.
    """
    named: dict[str, Any] = dict(zip(scenario.columns, columns))
    more["changes"] = tuple(more.get("changes", ()))
    return Trace(
        joint_names=scenario.robot.joint_names,
        dt=scenario.dt,
        time_ns=np.arange(columns.shape[1], dtype=np.int64) * scenario.dt_ns,
        **named,
        scenario=scenario,
        status=status,
        detail=detail,
        ended_at=ended_at,
        **more,
    )
