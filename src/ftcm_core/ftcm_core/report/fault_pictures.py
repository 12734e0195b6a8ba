# SPDX-License-Identifier: Apache-2.0
"""Pictures of faults: what each does at its site, from steps or a run of that very class.

A fault between two signals (of an actuator, a sensor, a topic) gets a test signal, made up; one of the
dynamics a run of the paper's scenario. Needs matplotlib, which is optional.
"""

from __future__ import annotations

import io
import math
import re
from array import array
from collections.abc import Callable, Sequence
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from ftcm_core.errors import FtcmError, ScenarioError, shown
from ftcm_core.faults import (
    ActuatorFault,
    AdditiveFault,
    CommunicationFault,
    Fault,
    JointFault,
    ProfiledFault,
    RobotFault,
    SensorFault,
)
from ftcm_core.faults.timing import NEVER
from ftcm_core.params import specs
from ftcm_core.recording.trace import Array, Trace
from ftcm_core.report.panels import grid, legend, mark_onsets, styled
from ftcm_core.scenario import Scenario, load, replace
from ftcm_core.signals import Vector, seconds
from ftcm_core.simulation.fault_chain import FaultChain, Phase
from ftcm_core.simulation.loop import Loop, by_column, simulate, to_trace

if TYPE_CHECKING:
    from matplotlib.figure import Figure

SUFFIXES = (".svg", ".png", ".pdf")
LONGEST = 100.0
"""Latest onset of a fault that needs a run, s."""
_BEFORE, _AFTER = 500, 1500
"""How many ticks, of 1 ms, a fault is shown before and after its onset."""
_FEW_BEFORE, _FEW_AFTER = 10, 60
"""The same of a topic, where single messages are seen."""
_GIVEN, _MADE, _BETWEEN = "#f0a830", "#17257a", "#a63c00"
"""Colours of what is true or sent, of what the fault makes of it, and of the difference."""
_JOINTS = ("#e69f00", "#2f86c1", "#17257a")
"""Colours of the joints of the paper's robot."""
_SHORT = 0.1
"""A fault over after this, s, is shown at its own scale."""


class Panel(NamedTuple):
    """Curves over the same time."""

    title: str
    """What it is of, and its unit."""
    curves: tuple[tuple[str, Array, str], ...]
    """Name, values and colour of each."""


class Shown(NamedTuple):
    """What a fault does, tick by tick."""

    time: Array
    """Stamps, s."""
    rows: tuple[tuple[Panel, ...], ...]
    """Panels, row by row, each row with as many."""
    size: Array
    """ψ times severity, or where there is no such thing 1 while the fault acts."""
    onset: float
    """When it sets in, s; :data:`~ftcm_core.faults.timing.NEVER` if it does not."""
    stepped: bool = False
    """Whether values hold up to the next tick."""


def shown_of(fault: Fault) -> Shown:
    """Let a fault act at its site.

    Raises:
        FtcmError: it cannot act there; the message says why.
    """
    for base, show in _SITES:
        if isinstance(fault, base):
            return show(fault)
    raise FtcmError(f"fault {fault.type_name!r} is of no site that can be drawn")


def write_picture(fault: Fault, file: Path) -> None:
    """Draw what a fault does.

    Args:
        fault: with the parameters wanted.
        file: where to; its suffix, one of :data:`SUFFIXES`, says what it is to be.

    Raises:
        FtcmError: another suffix; matplotlib is not installed; or as of :func:`shown_of`.
    """
    write_figure(lambda: picture(shown_of(fault), f"{fault.type_name} ({fault.site})"), file)


def write_profiles(file: Path) -> None:
    """Draw the time profiles of faults at their defaults; as :func:`write_picture`."""
    write_figure(profiles, file)


def write_figure(draw: Callable[[], Figure], file: Path) -> None:
    """Draw a figure and write it, an SVG with no more digits than can be seen."""
    if file.suffix.lower() not in SUFFIXES:
        raise FtcmError(f"picture {shown(str(file))}: expected a name that ends with {', '.join(SUFFIXES)}")
    with styled():
        buffer = io.BytesIO()
        suffix = file.suffix.lower().removeprefix(".")
        draw().savefig(buffer, format=suffix, dpi=150)
    content = buffer.getvalue()
    if suffix == "svg":
        content = small(content.decode()).encode()
    file.write_bytes(content)


def small(svg: str) -> str:
    """Return an SVG of matplotlib without what is not seen: the date, digits, names of groups, white space.

    Each look is said once, as a class of its own; that what follows M in a path are lines is not said.
    """
    svg = re.sub(r"<!DOCTYPE.*?>|<metadata>.*?</metadata>", "", svg, flags=re.DOTALL)
    svg = re.sub(r'(?<=<g) id="[^"]*"', "", svg)
    svg = re.sub(r">\s+<", "><", re.sub(r"\s*\n\s*", " ", svg))
    svg = re.sub(r' (?:d|x|y)="[^"]*"', lambda found: re.sub(r"(\.\d)\d+", r"\1", found[0]), svg)
    svg = re.sub(r' d="[-\d. MLz]*"', lambda found: found[0].replace(" L", ""), svg)
    svg = re.sub(r"(?<=font-family: )[^;\"]*", "'DejaVu Sans', Verdana, sans-serif", svg)
    looks: dict[str, str] = {}
    svg = re.sub(
        r' style="([^"]*)"', lambda found: f' class="{looks.setdefault(found[1], f"l{len(looks)}")}"', svg
    )
    declared = "".join([f".{name}{{{look}}}" for look, name in looks.items()])
    return svg.replace("</style>", declared + "</style>")


def picture(found: Shown, title: str) -> Figure:
    """Draw the panels, and the size of the fault below them."""
    columns = len(found.rows[0])
    heights = [1.6, *([1.0] * (len(found.rows) - 1)), 0.5]
    figure, axes = grid(len(heights), columns, title, heights=heights, height=1.25, hspace=0.35)
    size = Panel("", (("size: ψ × severity", found.size, "0.35"),))
    for row, panels in zip(axes, [*found.rows, (size,) * columns]):
        for ax, p in zip(row, panels):
            for k, (name, values, colour) in enumerate(p.curves):
                t, x = thinned(found.time, values, found.onset, 160 // columns)
                style = "steps-post" if found.stepped or p is size else "default"
                width = 1.0 + 0.9 * (len(p.curves) - 1 - k)  # none hides one before
                ax.plot(t, x, color=colour, linewidth=width, drawstyle=style, label=name)
            ax.set_xlim(found.time[0], found.time[-1])
            mark_onsets(ax, [found.onset])
            ax.set_title(p.title)
            ax.tick_params(labelbottom=row is axes[-1])
            ax.locator_params(axis="x", nbins=8 // columns, prune="upper")
            ax.locator_params(axis="y", nbins=2 if p is size else 4)
    legend(figure, axes)
    return figure


def profiles() -> Figure:
    """Each time profile over the time since the onset."""
    choices = specs(ProfiledFault)["profile"].choices
    time = np.arange(-0.25, 3.0, 0.005)
    figure, axes = grid(2, 3, "Time profiles ψ(t - T_f) at their defaults", height=1.4, hspace=0.45)
    for ax, choice in zip((ax for row in axes for ax in row), choices):
        fault = ProfiledFault(profile=choice)
        psi = np.array([fault.size(t, 0.0, NEVER, 7.0) for t in time.tolist()])
        ax.plot(*thinned(time, psi, 0.0, 160), color=_MADE, drawstyle="steps-post")
        ax.set_ylim(-0.1, 1.1)
        ax.locator_params(axis="y", nbins=2)
        ax.set_title(choice)
    for ax in axes[-1]:
        ax.set_xlabel("t - T_f, s")
    return figure


def thinned(time: Array, values: Array, onset: float, bins: int) -> tuple[Array, Array]:
    """Reduce a long curve to its smallest and largest value in each of some intervals, where they are.

    Args:
        time: stamps, s.
        values: one per stamp.
        onset: the values at both its sides are kept, s.
        bins: number of intervals.
    """
    if len(time) <= 2 * bins:
        return time, values
    edges = np.linspace(0, len(time), bins + 1).astype(np.int64)
    after = int(np.clip(np.searchsorted(time, onset, side="right"), 1, len(time) - 1))
    kept = {0, after - 1, after, len(time) - 1}
    for first, last in pairwise(edges.tolist()):
        kept |= {first + int(np.argmin(values[first:last])), first + int(np.argmax(values[first:last]))}
    rows = sorted(kept)
    return time[rows], values[rows]


# ---- faults between two signals ----


def _scenario(fault: Fault, **more: Any) -> Scenario:
    """The paper's scenario with this fault alone; with a payload where the fault needs one."""
    paper = load("paper")
    robot = paper.robot
    if fault.unsuited(robot) or (isinstance(fault, RobotFault) and fault.changed(robot) == robot):
        robot = robot.loaded(2.0) or robot
    try:
        return replace(paper, robot=robot, disturbances=(), faults=(fault,), **more)
    except ScenarioError as error:
        raise FtcmError(str(error).removeprefix("injection.faults.0").lstrip(".: ")) from None


def _size(fault: Fault, t: float, phase: Phase, key: float) -> float:
    if isinstance(fault, ProfiledFault):
        return fault.size(t, *phase, key)
    return 1.0 if phase.onset < t <= phase.end else 0.0


def _stepped(
    fault: Fault, ticks: tuple[int, int], step: Callable[[Any, int, float, float, Any], tuple[Vector, Any]]
) -> tuple[Array, Array, Array, float]:
    """Step a fault through some ticks before and after its onset.

    Args:
        fault: the fault.
        ticks: how many before and after.
        step: of the fault, the tick since the onset, the time (s), its length (s) and the state: what is to
            be kept, and the next state.

    Returns:
        Stamps (s), what is kept, the sizes, and the onset (s).
    """
    scenario = _scenario(fault)
    dt, dt_ns = scenario.dt, scenario.dt_ns
    chain = FaultChain(scenario, Fault)
    (state,) = chain.init(scenario.robot.joints)
    middle = _onset_tick(fault, scenario)
    first = max(0, middle - ticks[0])
    time, kept, sizes = [], [], []
    for k in range(first, middle + ticks[1] + 1):
        t = seconds(k * dt_ns)
        if fault.trigger == "hand" and k == middle:
            (state,) = chain.ordered((state,), 0, "arm", t)
        found, state = step(fault, k - middle, t, dt, state)
        phase = chain.phases((state,))[0]
        time.append(t)
        kept.append(found)
        sizes.append(_size(fault, t, phase, state.key))
    return np.array(time), np.array(kept), np.array(sizes), phase.onset


def _joint(fault: JointFault) -> int:
    """The joint that is shown, from 0."""
    return max(fault.joint - 1, 0)


def _motion(k: int, dt: float) -> tuple[float, float, float]:
    """Test position (rad), velocity (rad/s) and torque (N·m) in tick k after the onset: sines of 1 Hz."""
    x = 2.0 * math.pi * k * dt + 0.5
    return 0.5 * math.sin(x), math.pi * math.cos(x), 60.0 * math.sin(x + 0.5)


def _of_actuator(fault: ActuatorFault) -> Shown:
    def step(fault: Any, k: int, t: float, dt: float, state: Any) -> tuple[Vector, Any]:
        q, v, torque = ((x,) * 3 for x in _motion(k, dt))
        applied, state = fault.step(t, dt, torque, q, v, state)
        return (torque[0], applied[_joint(fault)]), state

    time, found, size, onset = _stepped(fault, (_BEFORE, _AFTER), step)
    return _compared(time, size, onset, [Pair("torque, N·m", "of the drive", "on the joint", *found.T)])


def _of_sensor(fault: SensorFault) -> Shown:
    def step(fault: Any, k: int, t: float, dt: float, state: Any) -> tuple[Vector, Any]:
        q, v, torque = ((x,) * 3 for x in _motion(k, dt))
        position, velocity, state = fault.step(t, dt, q, v, state, (q, v, torque))
        return (q[0], position[_joint(fault)], v[0], velocity[_joint(fault)]), state

    time, found, size, onset = _stepped(fault, (_BEFORE, _AFTER), step)
    position = Pair("position, rad", "true", "reported", *found.T[:2])
    velocity = Pair("velocity, rad/s", "true", "reported", *found.T[2:])
    both = [position, velocity]
    changed = [pair for pair in both if (pair.before != pair.after).any()]
    return _compared(time, size, onset, changed or both)


def _of_topic(fault: CommunicationFault) -> Shown:
    def step(fault: Any, k: int, t: float, dt: float, state: Any) -> tuple[Vector, Any]:
        q, v, torque = ((x,) * 3 for x in _motion(k, dt))
        ((received,),), state = fault.step(t, dt, ((float(k),),), state, (q, v, torque))
        return (float(k), received), state

    time, found, size, onset = _stepped(fault, (_FEW_BEFORE, _FEW_AFTER), step)
    pair = Pair("number of the message", "sent", "received", *found.T)
    return _compared(time, size, onset, [pair])._replace(stepped=True)


class Pair(NamedTuple):
    """A signal before and after a fault."""

    title: str
    given: str
    made: str
    before: Array
    after: Array


def _compared(time: Array, size: Array, onset: float, pairs: Sequence[Pair]) -> Shown:
    """Panels of both signals, and of their difference below."""
    both = [Panel(p.title, ((p.given, p.before, _GIVEN), (p.made, p.after, _MADE))) for p in pairs]
    differences = [Panel("", ((f"{p.made} - {p.given}", p.after - p.before, _BETWEEN),)) for p in pairs]
    return Shown(time, (tuple(both), tuple(differences)), size, onset)


# ---- faults of the dynamics ----


def _run(fault: Fault, scenario: Scenario) -> tuple[Trace, Array, float]:
    """Run a scenario: the trace, the fault's sizes by tick, and its onset (s)."""
    loop, rows, sizes = Loop(scenario), array("d"), []
    (first,) = FaultChain(scenario, Fault).init(scenario.robot.joints)
    phase, reason, k = Phase(NEVER, NEVER), "", 0
    for k in range(scenario.last_tick + 1):
        time_ns = k * scenario.dt_ns
        if fault.trigger == "hand" and k == _onset_tick(fault, scenario):
            for stage in (loop.plant, loop.injector):
                stage.order(0, "arm", seconds(time_ns))
        reason = loop.tick(time_ns, k == scenario.last_tick, rows.extend)
        phase = {**loop.plant.phases(), **loop.injector.phases()}[0]
        sizes.append(_size(fault, seconds(time_ns), phase, first.key))
        if reason:
            break
    trace = to_trace(scenario, by_column(scenario, rows), *loop.ended(k * scenario.dt_ns, reason))
    return trace, np.array(sizes[: trace.ticks]), phase.onset


def _onset_tick(fault: Fault, scenario: Scenario) -> int:
    return math.floor(fault.start / scenario.dt + 0.5)


def _long_enough(fault: Fault) -> tuple[Scenario, int]:
    """The scenario of a fault up to where it has been seen, and the first tick that is shown."""
    if fault.start > LONGEST:
        raise FtcmError(
            f"start: {fault.start:g} s is too late for a picture, which takes a run; "
            f"expected at most {LONGEST:g}"
        )
    scenario = _scenario(fault)
    middle = _onset_tick(fault, scenario)
    duration = seconds((middle + _AFTER) * scenario.dt_ns)
    return replace(scenario, duration=duration), max(0, middle - _BEFORE)


def _of_torque(fault: AdditiveFault) -> Shown:
    scenario, first = _long_enough(fault)
    trace, size, onset = _run(fault, scenario)
    rows = slice(first, None)
    acting = trace.time[trace.disturbance.any(axis=1)]
    if len(acting) and acting[-1] - onset < _SHORT:
        span = acting[-1] - onset
        rows = slice(*np.searchsorted(trace.time, [onset - span, onset + 3.0 * span]).tolist())
    panel = Panel("added torque, N·m" + _ended(trace), _by_joint(trace, trace.disturbance[rows]))
    return Shown(trace.time[rows], ((panel,),), size[rows], onset)


def _of_robot(fault: RobotFault) -> Shown:
    scenario, first = _long_enough(fault)
    trace, size, onset = _run(fault, scenario)
    healthy = simulate(replace(scenario, faults=()))
    rows = slice(first, min(trace.ticks, healthy.ticks))

    def change(title: str, column: Callable[[Trace], Array]) -> tuple[Panel]:
        return (Panel(title + _ended(trace), _by_joint(trace, column(trace)[rows] - column(healthy)[rows])),)

    panels = (
        change("change of the estimate by the fault, N·m", lambda x: x.disturbance_estimate),
        change("change of the tracking error by the fault, rad", lambda x: x.error),
    )
    return Shown(trace.time[rows], panels, size[rows], onset)


def _ended(trace: Trace) -> str:
    return "" if trace.status == "completed" else f" ({trace.status})"


def _by_joint(trace: Trace, table: Array) -> tuple[tuple[str, Array, str], ...]:
    """A curve for each joint, of an array of shape (ticks, joints)."""
    return tuple([(name, x, colour) for name, x, colour in zip(trace.joint_names, table.T, _JOINTS)])


_SITES: tuple[tuple[type[Fault], Callable[[Any], Shown]], ...] = (
    (ActuatorFault, _of_actuator),
    (SensorFault, _of_sensor),
    (CommunicationFault, _of_topic),
    (AdditiveFault, _of_torque),
    (RobotFault, _of_robot),
)
