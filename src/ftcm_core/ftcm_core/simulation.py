# SPDX-License-Identifier: Apache-2.0
"""The in-process simulation: the tick loop that the ROS graph repeats node by node.

tick k, t_k = k*dt (k an integer, time an integer number of nanoseconds, never accumulated)
  y_k   = sensor.step(x_k), u_{k-1} applied     plant      -> joint_states          (stamp t_k)
  est_k = observer.step(y_k)                    observer   -> disturbance_estimate  (stamp t_k)
  u_k   = controller.step(y_k, ref(t_k), est_k) controller -> joint_torques         (stamp t_k)
  d_k   = injector.step(t_k, x_k, u_k)          injector   -> disturbance           (stamp t_k)
  record(k)
  x_{k+1} = plant.step(x_k, u_k, d_k)           torque and disturbance held over [t_k, t_{k+1}), RK4
"""

from __future__ import annotations

from array import array
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from ftcm_core.scenario import Scenario
from ftcm_core.signals import NANOSECONDS, TrueDisturbance, Vector, seconds
from ftcm_core.trace import COLUMNS, MEASURED, Array, Change, Trace


class Loop:
    """The stages of one run and the tick that composes them."""

    def __init__(self, scenario: Scenario) -> None:
        """Start at the scenario's initial state."""
        self.plant = scenario.plant_stage()
        self.observer = scenario.observer_stage()
        self.controller = scenario.controller_stage()
        self.injector = scenario.injector_stage()
        self.exact = scenario.sensor.exact

    def act(self, time_ns: int) -> tuple[Vector, Vector, TrueDisturbance]:
        """Everything of a tick before the plant moves: measure, observe, control, disturb.

        Args:
            time_ns: t_k, ns.

        Returns:
            What is recorded (:data:`~ftcm_core.trace.COLUMNS`, then, unless the sensor is exact,
            :data:`~ftcm_core.trace.MEASURED`), u_k (N·m) and d_k (N·m).
        """
        plant = self.plant
        y = plant.measure()
        tau_hat = self.observer.step(y)
        u, reference = self.controller.step(time_ns, y, tau_hat)
        d = self.injector.step(time_ns, plant.position, plant.velocity, u)
        row = (
            plant.position + plant.velocity + y.effort + tau_hat + u + d.torque + reference[0] + reference[1]
        )
        return (row if self.exact else row + y.position + y.velocity), u, d

    def tick(self, time_ns: int, last: bool, record: Callable[[Vector], object]) -> str:
        """Run one tick and move the plant, unless it is the last.

        Args:
            time_ns: t_k, ns.
            last: whether the run ends with this tick.
            record: takes the tick's row.

        Returns:
            Why the run cannot go on, with the time; empty while it can.
        """
        try:
            row, u, d = self.act(time_ns)
            record(row)
            if last:
                return ""
            self.plant.step(u, d)
        except (ArithmeticError, ValueError) as error:  # a law out of its domain: overflow, log(0), ...
            return f"at t = {seconds(time_ns):g} s: {error}"
        if self.plant.reason:
            after = seconds(time_ns + round(self.plant.dt * NANOSECONDS))
            return f"at t = {after:g} s: {self.plant.reason}"
        return ""

    def status(self, detail: str) -> str:
        """Status of a run that ended with what :meth:`tick` returned last."""
        if not detail:
            return "completed"
        return self.plant.status if self.plant.reason else "diverged"


def simulate(
    scenario: Scenario,
    changes: Sequence[Change] = (),
    progress: Callable[[int, int], None] | None = None,
) -> Trace:
    """Run a scenario in process.

    Args:
        scenario: what to run.
        changes: controllers or observers to swap in, each from its tick on.
        progress: called about every 1000 ticks with the ticks done and the last tick.

    Returns:
        The trace; a run that diverges or exceeds a limit ends there, with its status and the time.
    """
    loop = Loop(scenario)
    swaps: dict[int, list[Change]] = {}
    for change in changes:
        swaps.setdefault(change.tick, []).append(change)
    dt_ns, last = scenario.dt_ns, scenario.last_tick
    rows = array("d")
    tick, record = loop.tick, rows.extend
    detail = ""
    for k in range(last + 1):
        if k in swaps:
            for change in swaps[k]:
                (loop.controller if change.kind == "controller" else loop.observer).swap(change.component)
        detail = tick(k * dt_ns, k == last, record)
        if detail:
            break
        if progress and k % 1000 == 0:
            progress(k, last)
    return to_trace(scenario, np.frombuffer(rows, dtype=np.float64), loop.status(detail), detail, changes)


def to_trace(
    scenario: Scenario,
    rows: Array,
    status: str,
    detail: str,
    changes: Sequence[Change] = (),
    kind: type[Trace] = Trace,
) -> Trace:
    """Make a trace of recorded rows.

    Args:
        scenario: what ran.
        rows: the rows of all ticks, one after the other.
        status: how the run ended.
        detail: why it ended early; empty if it did not.
        changes: what was swapped in.
        kind: class of the trace.
    """
    names = [*COLUMNS] if scenario.sensor.exact else [*COLUMNS, *MEASURED]
    table = rows.reshape(-1, len(names), scenario.robot.joints)
    columns: dict[str, Any] = {name: np.ascontiguousarray(table[:, i]) for i, name in enumerate(names)}
    return kind(
        joint_names=scenario.robot.joint_names,
        dt=scenario.dt,
        time_ns=np.arange(len(table), dtype=np.int64) * scenario.dt_ns,
        **columns,
        scenario=scenario,
        status=status,
        detail=detail,
        changes=tuple(changes),
    )
