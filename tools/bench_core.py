# SPDX-License-Identifier: Apache-2.0
"""Speed of the core: ``python tools/bench_core.py [--json] [--quick]``.

Every row is the median of several repetitions with the smallest and the largest, all measured in one process
and taken in turns, so that a change of the machine's load meets all rows alike. Rows of Pinocchio and MuJoCo
are there where those are installed: their forward dynamics of the same kind of arm (three joints, rigid links
of the PUMA 560) from the same Python loop.
"""

from __future__ import annotations

import argparse
import importlib
import importlib.util
import os
import resource
import statistics
import sys
import time
from collections.abc import Callable
from typing import Any, cast

import numpy as np

from ftcm_core import campaign, compiled
from ftcm_core.faults.dropped_messages import DroppedMessages
from ftcm_core.faults.loss_of_effectiveness import LossOfEffectiveness
from ftcm_core.faults.sensor_bias import SensorBias
from ftcm_core.faults.vo_kang_fault import VoKangFault
from ftcm_core.plants.rigid_body import Motion, RigidBody, rk4
from ftcm_core.recording.provenance import provenance
from ftcm_core.report.results import to_json
from ftcm_core.robots import Robot
from ftcm_core.robots.puma560 import Puma560
from ftcm_core.scenario import Scenario, load, replace
from ftcm_core.signals import Vector
from ftcm_core.simulation import Loop, simulate

CALLS = 2000
"""Calls per repetition of a row that times one step."""
LINKS = (
    ((0.0, 0.0, 0.0), 0.0, (0.0, 0.0, 0.0), (0.0, 0.0, 0.35)),
    ((0.0, 0.0, 0.2435), 17.40, (0.068, 0.006, -0.016), (0.130, 0.524, 0.539)),
    ((0.4318, 0.0, -0.0934), 4.80, (0.0, -0.070, 0.014), (0.066, 0.0125, 0.086)),
)
"""Links of the rigid-body models: offset (m), mass (kg), centre (m), inertia (kg·m²); Armstrong 1986."""

WAITING = (
    LossOfEffectiveness(start=1e3), SensorBias(start=1e3), VoKangFault(start=1e3), DroppedMessages(start=1e3),
)  # fmt: skip
"""One fault of each site; none acts while it is timed."""

Step = Callable[[Vector, Vector, Vector], Any]


def main(argv: list[str] | None = None) -> int:
    """Measure and print.

    Args:
        argv: arguments; those of the process by default.
    """
    parser = argparse.ArgumentParser(prog="python tools/bench_core.py", description="Speed of the core.")
    parser.add_argument("--json", action="store_true", help="print one JSON object")
    parser.add_argument(
        "--quick", action="store_true", help="fewer repetitions; a campaign of 50 runs, scaled"
    )
    parser.add_argument(
        "--jobs", type=int, metavar="N", help="processes of the campaign; default: one per core"
    )
    arguments = parser.parse_args(argv)
    found = measure(quick=arguments.quick, jobs=arguments.jobs)
    print(to_json(found, indent=1) if arguments.json else text(found))
    return 0


def measure(*, quick: bool = False, jobs: int | None = None) -> dict[str, Any]:
    """Measure everything that can be measured here.

    Args:
        quick: fewer repetitions, and a campaign of 50 runs whose time is scaled to 1,000.
        jobs: processes of the campaign.

    Returns:
        Plain data: ``rows`` and the machine.
    """
    load_before = os.getloadavg()
    scenario = load("paper")
    robot = scenario.robot
    numba = importlib.util.find_spec("numba") is not None
    whole: dict[str, Callable[[], Any]] = {
        "plain run of 40 s": lambda: simulate(scenario),
        "plain run of 40 s, stage by stage": lambda: simulate(scenario, written=False),
    }
    if numba:
        compiled.simulate(scenario)  # compiles
        whole["compiled run of 40 s"] = lambda: compiled.simulate(scenario)
    rows = []
    for name, samples in _in_turns(whole, 3 if quick else 7).items():
        rows.append(_row(name, samples, "s"))
        rows.append(
            _row(name.replace(" of 40 s", ""), [scenario.duration / x for x in samples], "× real time")
        )

    steps: dict[str, Step] = {"ftcm_core": robot.forward_dynamics, **_others()}
    point: tuple[Vector, Vector, Vector] = ((0.3, -0.4, 0.7), (0.5, -0.6, 0.8), (10.0, -20.0, 5.0))

    def repeat(step: Step) -> Callable[[], None]:
        def run() -> None:
            for _ in range(CALLS):
                step(*point)

        return run

    def ticks(step: Step) -> Callable[[], None]:
        def run() -> None:
            loop = Loop(scenario) if step is robot.forward_dynamics else loop_with(scenario, step)
            for k in range(CALLS):
                loop.tick(k * scenario.dt_ns, False, lambda row: None)

        return run

    repetitions = 5 if quick else 15
    jobs_list = {f"forward dynamics, {name}": repeat(step) for name, step in steps.items()}
    jobs_list |= {f"whole tick, plant by {name}": ticks(step) for name, step in steps.items()}
    found = _in_turns(jobs_list, repetitions)
    for name, samples in found.items():
        rows.append(_row(name, [1e6 * x / CALLS for x in samples], "µs"))
    if numba:
        tick = [1e6 * r["median"] / scenario.last_tick for r in rows if r["name"] == "compiled run of 40 s"]
        rows.append(_row("whole tick, compiled", tick, "µs"))
    for kind, own in (("forward dynamics, ", "ftcm_core"), ("whole tick, plant by ", "ftcm_core")):
        for other in list(steps)[1:]:
            ratios = [b / a for a, b in zip(found[kind + own], found[kind + other])]
            rows.append(_row(f"{kind.strip(', ')}: {other} / ftcm_core", ratios, "×"))

    waiting = {
        "no fault": replace(scenario, faults=()),
        "the paper's fault, not yet acting": scenario,
        "a fault of each site, none acting": replace(scenario, faults=WAITING),
    }
    turns = _in_turns({name: _ticks_of(one) for name, one in waiting.items()}, 2 * repetitions)
    for name, samples in turns.items():
        rows.append(_row(f"whole tick, {name}", [1e6 * x / CALLS for x in samples], "µs"))
        ratios = [b / a for a, b in zip(turns["no fault"], samples)]
        if name != "no fault":
            rows.append(_row(f"whole tick: {name} / no fault", ratios, "×"))

    runs = 50 if quick else 1000
    planned = campaign.Campaign(
        "paper", runs=runs, seed=1,
        variations=(campaign.parse_variation("injection.faults.0.start=uniform(5, 15)"),
                    campaign.parse_variation("observer.k1=uniform(15000, 25000)")),
    )  # fmt: skip
    if numba:
        begin = time.perf_counter()
        campaign.run_campaign(planned, engine="compiled", jobs=jobs)
        passed = time.perf_counter() - begin
        rows.append(_row(f"campaign of {runs} compiled runs, metrics included", [passed], "s"))
        largest = resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss / 1024
        rows.append(_row("largest process of the campaign", [largest], "MB"))
        if quick:
            rows.append(_row("scaled to 1,000 runs, not measured", [passed * 1000 / runs], "s"))
    about = {**provenance(), "cores": os.cpu_count()}
    return {"rows": rows, "machine": about, "load": {"before": load_before, "after": os.getloadavg()}}


def text(found: dict[str, Any]) -> str:
    """Return the rows as a table, with the machine."""
    width = max(len(r["name"]) for r in found["rows"])
    machine, load_ = found["machine"], found["load"]
    lines = [f"{'':{width}}  {'median':>9}  {'least':>9}  {'most':>9}     n"]
    lines += [
        f"{r['name']:{width}}  "
        + "  ".join(f"{r[x]:9.4g}" for x in ("median", "least", "most"))
        + f"  {r['n']:4}  {r['unit']}"
        for r in found["rows"]
    ]
    lines.append(
        f"{machine.get('processor', '?')}, {machine['cores']} cores, Python {machine['python']}, "
        f"numpy {machine['numpy']}; load {load_['before'][0]:.2f} before, {load_['after'][0]:.2f} after"
    )
    return "\n".join(lines)


def _ticks_of(scenario: Scenario) -> Callable[[], None]:
    """Some ticks of a scenario, without what it takes to make them."""

    def run() -> None:
        loop = Loop(scenario)
        for k in range(CALLS):
            loop.tick(k * scenario.dt_ns, False, lambda row: None)

    return run


def _in_turns(functions: dict[str, Callable[[], Any]], repetitions: int) -> dict[str, list[float]]:
    """Time functions in turns; return seconds by name."""
    found: dict[str, list[float]] = {name: [] for name in functions}
    for _ in range(repetitions):
        for name, function in functions.items():
            begin = time.perf_counter()
            function()
            found[name].append(time.perf_counter() - begin)
    return found


def _row(name: str, samples: list[float], unit: str) -> dict[str, Any]:
    return {
        "name": name, "unit": unit, "n": len(samples), "median": statistics.median(samples),
        "least": min(samples), "most": max(samples),
    }  # fmt: skip


class _Dynamics:
    """What the integrator asks of a robot, by another library."""

    def __init__(self, step: Step) -> None:
        self.forward_dynamics = step


def loop_with(scenario: Scenario, step: Step) -> Loop:
    """Return the loop with other forward dynamics in the plant; observer and controller keep their model."""
    dynamics = cast(Robot, _Dynamics(step))

    class Engine(RigidBody):
        """The plant by another library."""

        def step(self, robot: Robot, dt: float, torque: Vector, state: Motion) -> Motion:
            """One step, whatever the scenario's robot is."""
            return rk4(dynamics, dt, *state, torque)

    return Loop(replace(scenario, plant=Engine()))


def _others() -> dict[str, Step]:
    """Forward dynamics of the rigid-body libraries that are installed, from tuples to a tuple."""
    found: dict[str, Step] = {}
    rotor = np.array(Puma560().motor_inertia)
    if importlib.util.find_spec("pinocchio"):
        found["pinocchio"] = _pinocchio(rotor)
    if importlib.util.find_spec("mujoco"):
        found["mujoco"] = _mujoco(rotor)
    return found


def _pinocchio(rotor: np.typing.NDArray[np.float64]) -> Step:
    pin = importlib.import_module("pinocchio")
    model = pin.Model()
    parent = 0
    for i, (offset, mass, centre, inertia) in enumerate(LINKS):
        turn = pin.utils.rotate("x", -np.pi / 2) if i == 1 else np.eye(3)
        placement = pin.SE3(turn, np.array(offset))
        parent = model.addJoint(parent, pin.JointModelRZ(), placement, f"joint{i + 1}")
        body = pin.Inertia(mass, np.array(centre), np.diag(inertia))
        model.appendBodyToJoint(parent, body, pin.SE3.Identity())
    model.armature = rotor
    data = model.createData()

    def step(q: Vector, v: Vector, tau: Vector) -> Vector:
        return tuple(pin.aba(model, data, np.array(q), np.array(v), np.array(tau)).tolist())

    return step


def _mujoco(rotor: np.typing.NDArray[np.float64]) -> Step:
    mujoco = importlib.import_module("mujoco")
    inner = ""
    for i in reversed(range(len(LINKS))):
        offset, mass, centre, inertia = LINKS[i]
        numbers = [" ".join(map(str, x)) for x in (offset, centre, [max(x, 1e-3) for x in inertia])]
        turn = ' euler="-90 0 0"' if i == 1 else ""
        inner = (
            f'<body pos="{numbers[0]}"{turn}><joint axis="0 0 1" armature="{rotor[i]}"/>'
            f'<inertial pos="{numbers[1]}" mass="{max(mass, 1e-3)}" diaginertia="{numbers[2]}"/>'
            f"{inner}</body>"
        )
    model = mujoco.MjModel.from_xml_string(
        '<mujoco><compiler balanceinertia="true"/><option><flag contact="disable"/></option>'
        f"<worldbody>{inner}</worldbody></mujoco>"
    )
    data = mujoco.MjData(model)

    def step(q: Vector, v: Vector, tau: Vector) -> Vector:
        data.qpos[:], data.qvel[:], data.qfrc_applied[:] = q, v, tau
        mujoco.mj_forward(model, data)
        return tuple(data.qacc.tolist())

    return step


if __name__ == "__main__":
    sys.exit(main())
