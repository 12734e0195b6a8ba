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

import numpy as np

from ftcm_core.scenario import Scenario
from ftcm_core.signals import seconds
from ftcm_core.trace import COLUMNS, MEASURED, Change, Trace


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
        The trace; a run that diverges ends there, with its status and the time.
    """
    plant = scenario.plant_stage()
    observer = scenario.observer_stage()
    controller = scenario.controller_stage()
    injector = scenario.injector_stage()
    swaps: dict[int, list[Change]] = {}
    for change in changes:
        swaps.setdefault(change.tick, []).append(change)
    joints, dt_ns, last = scenario.robot.joints, scenario.dt_ns, scenario.last_tick
    rows = array("d")
    record = rows.extend
    measured = array("d")
    record_measured = None if scenario.sensor.exact else measured.extend
    status, detail = "completed", ""
    for k in range(last + 1):
        time_ns = k * dt_ns
        for change in swaps.get(k, ()):
            (controller if change.kind == "controller" else observer).swap(change.component)
        try:
            y = plant.measure()
            tau_hat = observer.step(y)
            u, reference = controller.step(time_ns, y, tau_hat)
            d = injector.step(time_ns, plant.position, plant.velocity, u)
            record(
                plant.position
                + plant.velocity
                + y.effort
                + tau_hat
                + u
                + d.torque
                + reference[0]
                + reference[1]
            )
            if record_measured:
                record_measured(y.position + y.velocity)
            if k < last:
                plant.step(u, d)
        except (
            ArithmeticError,
            ValueError,
        ) as error:  # a law driven out of its domain: overflow, log(0), ...
            status, detail = "diverged", f"at t = {seconds(time_ns):g} s: {error}"
            break
        if plant.diverged:
            status, detail = "diverged", f"at t = {seconds(time_ns + dt_ns):g} s: {plant.diverged}"
            break
        if progress and k % 1000 == 0:
            progress(k, last)
    table = np.frombuffer(rows, dtype=np.float64).reshape(-1, len(COLUMNS), joints)
    seen = np.frombuffer(measured, dtype=np.float64).reshape(-1, len(MEASURED), joints)
    return Trace(
        joint_names=scenario.robot.joint_names,
        dt=scenario.dt,
        time_ns=np.arange(len(table), dtype=np.int64) * dt_ns,
        **{name: np.ascontiguousarray(table[:, i]) for i, name in enumerate(COLUMNS)},
        **{name: np.ascontiguousarray(seen[:, i]) for i, name in enumerate(MEASURED) if record_measured},
        scenario=scenario,
        status=status,
        detail=detail,
        changes=tuple(changes),
    )
