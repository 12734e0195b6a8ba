# SPDX-License-Identifier: Apache-2.0
"""What faults really did in a run: their size at every tick, and the signal that each of them added.

When each of them acts is in the trace (``Trace.fault_intervals``). The rest follows from that and the
scenario, so it need not be recorded.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from ftcm_core.errors import FtcmError
from ftcm_core.faults import (
    ActuatorFault,
    AdditiveFault,
    CommunicationFault,
    Fault,
    ProfiledFault,
    SensorFault,
)
from ftcm_core.recording.trace import Array, Trace
from ftcm_core.scenario import Scenario
from ftcm_core.signals import seconds
from ftcm_core.simulation.fault_chain import FaultChain
from ftcm_core.simulation.loop import Loop


def fault_sizes(trace: Trace) -> Array:
    """ψ times the severity of each fault at each tick; of a fault without a profile, 1 while it acts.

    Args:
        trace: a run with its scenario.

    Returns:
        Array of shape (ticks, faults), the faults in the order of the scenario.

    Raises:
        FtcmError: the trace has no scenario.
    """
    scenario = _scenario_of(trace)
    out = np.zeros((trace.ticks, len(scenario.faults)))
    chain = FaultChain(scenario, Fault)
    keys = dict(zip(chain.numbers, (state.key for state in chain.init(scenario.robot.joints))))
    times = [seconds(ns) for ns in trace.time_ns.tolist()]
    for number, onset, end in trace.fault_intervals:
        fault = scenario.faults[number]
        first, last = np.searchsorted(trace.time, [onset, end], side="right").tolist()
        for k in range(first, last):
            one = not isinstance(fault, ProfiledFault)
            out[k, number] = 1.0 if one else fault.size(times[k], onset, end, keys[number])  # type: ignore[attr-defined]
    return out


def fault_signals(trace: Trace) -> list[dict[str, Array]]:
    """What each fault added, found by running the scenario again in process.

    Args:
        trace: a run with its scenario that running it again gives anew: one in process, or in lockstep.

    Returns:
        Per fault, in the order of the scenario, arrays of shape (ticks, joints) by name: ``torque`` (N·m) of
        a fault of an actuator or of the dynamics; ``position`` (rad) and ``velocity`` (rad/s) of a sensor. Of
        the communication ``disturbed``, of shape (ticks, 1): 1 where another message was received than was
        sent. A fault of the robot has none.

    Raises:
        FtcmError: the trace has no scenario, or running it again gives another motion.
    """
    scenario = _scenario_of(trace)
    found: list[dict[str, Array]] = [{} for _ in scenario.faults]
    row = [0]

    def note(number: int, name: str, values: Any, at: int) -> None:
        if at < trace.ticks:
            table = found[number].setdefault(name, np.zeros((trace.ticks, len(values))))
            table[at] = values

    loop = Loop(scenario)
    _watch(loop, note, row)
    swaps: dict[int, list[Any]] = {}
    for change in trace.changes:
        swaps.setdefault(change.tick, []).append(change)
    position = np.full_like(trace.position, np.nan)
    for k in range(trace.ticks):
        row[0] = k
        for change in swaps.get(k, ()):
            loop.change(change, k * scenario.dt_ns)
        position[k] = loop.plant.motion[0]
        if loop.tick(k * scenario.dt_ns, k == trace.ticks - 1, lambda _: None):
            break
    if not np.array_equal(position, trace.position, equal_nan=True):
        first = int(np.argmax((position != trace.position).any(axis=1)))
        raise FtcmError(
            f"running the scenario again gives another motion from tick {first} on: what each fault added is "
            "known of runs in process and in lockstep only"
        )
    return found


class _Watched:
    """A fault whose steps are noted."""

    def __init__(self, fault: Fault, step: Callable[..., Any]) -> None:
        self._fault, self.step = fault, step

    def __getattr__(self, name: str) -> Any:
        return getattr(self._fault, name)


def _watch(loop: Loop, note: Callable[..., None], row: list[int]) -> None:
    """Have the steps of all faults of a run noted, with the tick in ``row``."""

    def difference(after: Any, before: Any) -> list[float]:
        return [a - b for a, b in zip(after, before)]

    def actuator(number: int, fault: ActuatorFault) -> Callable[..., Any]:
        def step(t: float, dt: float, torque: Any, *rest: Any) -> Any:
            out = fault.step(t, dt, torque, *rest)
            note(number, "torque", difference(out[0], torque), row[0])
            return out

        return step

    def sensor(number: int, fault: SensorFault) -> Callable[..., Any]:
        def step(t: float, dt: float, position: Any, velocity: Any, *rest: Any) -> Any:
            out = fault.step(t, dt, position, velocity, *rest)
            note(number, "position", difference(out[0], position), row[0] + 1)
            note(number, "velocity", difference(out[1], velocity), row[0] + 1)
            return out

        return step

    def additive(number: int, fault: AdditiveFault) -> Callable[..., Any]:
        def step(*arguments: Any) -> Any:
            out = fault.step(*arguments)
            note(number, "torque", out[0], row[0])
            return out

        return step

    def link(number: int, fault: CommunicationFault, ahead: int) -> Callable[..., Any]:
        def step(t: float, dt: float, message: Any, *rest: Any) -> Any:
            out = fault.step(t, dt, message, *rest)
            note(number, "disturbed", [float(out[0] != message)], row[0] + ahead)
            return out

        return step

    def watched(chain: FaultChain[Any], make: Callable[..., Any], *more: Any) -> tuple[Any, ...]:
        return tuple([_Watched(f, make(n, f, *more)) for n, f in zip(chain.numbers, chain.faults)])

    plant = loop.plant
    plant.drive.faults = watched(plant.drive.chain, actuator)
    plant.sensor_faults.faults = watched(plant.sensor_faults, sensor)
    loop.injector.chain.faults = watched(loop.injector.chain, additive)
    for place in (*plant.links, loop.controller.link):
        place.faults = watched(place.chain, link, int(place is plant.links[0]))  # which is read a tick later


def _scenario_of(trace: Trace) -> Scenario:
    if trace.scenario is None:
        raise FtcmError("this run does not say its scenario; what faults did is not known without")
    return trace.scenario
