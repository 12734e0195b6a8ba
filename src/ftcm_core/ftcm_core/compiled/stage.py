# SPDX-License-Identifier: Apache-2.0
"""Single stages, compiled: for whoever runs one stage a tick, as a ROS node does.

A compiled stage stands in the place of a stage and has what a node calls of it. What its source does not
cover (the first tick, skipped ticks, a tick in which a law leaves its domain, a robot that changes) the stage
itself does.
"""

from __future__ import annotations

import contextlib
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from ftcm_core.compiled.program import (
    compiled,
    following,
    indented,
    module_of,
    parameters_of,
    reading,
    require_foreseen,
    require_no_policies,
)
from ftcm_core.compiled.run import require_numba
from ftcm_core.compiled.tracing import (
    Holder,
    NotCompilable,
    Steps,
    Symbol,
    Tracer,
    literal,
    numbers,
    shape,
    with_numbers,
)
from ftcm_core.recording.trace import Array
from ftcm_core.registry import Component
from ftcm_core.scenario import Scenario
from ftcm_core.signals import Detection, Measurement, ReferencePoint, TrueDisturbance, Vector
from ftcm_core.simulation import Loop

_STEP = "int64(float64[::1], float64[::1], int64, float64[::1], float64[::1])"


@dataclass(frozen=True)
class StageProgram:
    """A compiled step, for every stage of the same structure."""

    kind: str
    shape: Any
    """Structure of its state."""
    slots: dict[Steps, str]
    fixed: dict[Steps, Any]
    outputs: int
    step: Callable[..., int]
    """``step(parameters, state, time_ns, inputs, outputs)``: 1, or 0 for a tick that it does not cover."""


_programs: list[StageProgram] = []


def stage_program(kind: str, scenario: Scenario, component: Component | None = None) -> StageProgram:
    """Compile the step of a stage, or find it compiled.

    Args:
        kind: ``plant``, ``observer``, ``controller``, ``injector`` or ``detector``.
        scenario: the run.
        component: in place of the scenario's component of that kind.

    Raises:
        NotCompilable: with the reason.
        FtcmError: numba is not installed.
    """
    require_numba()
    loop = Loop(scenario)
    require_no_policies(loop)
    if component is not None:
        getattr(loop, kind).swap(component)
    if reason := loop.tick(0, False, lambda row: None):
        raise NotCompilable(f"the run ends in its first tick: {reason}")
    stage = getattr(loop, kind)
    if kind == "plant":
        require_foreseen(stage)
    structure = shape(stage.state)
    for program in _programs:
        alike = (program.kind, program.shape) == (kind, structure)
        if alike and parameters_of(stage, program.slots, program.fixed) is not None:
            return program
    tracer = Tracer()
    found: list[Any] = []  # what the step gives
    lines = tracer.lines_of(lambda: _step(tracer, kind, stage, scenario.robot.joints, found))
    count = sum(1 for _ in numbers(stage.state))
    text = module_of(
        tracer,
        [
            f"@numba.njit({_STEP!r}, cache=CACHED)",
            "def step(parameters, state, time_ns, inputs, outputs):",
            *indented(1, reading(tracer)),
            *indented(1, [f"s{i} = state[{i}]" for i in range(count)]),
            "    while True:",
            *indented(2, lines),
            *indented(2, [f"state[{i}] = s{i}" for i in range(count)]),
            "        return 1",
            "    return 0",
        ],
    )
    (step,) = compiled(text, "step")
    program = StageProgram(kind, structure, tracer.slots, tracer.fixed, len(found), step)
    compiled_stage(stage, program).warm_up()
    _programs.append(program)
    return program


def _step(tracer: Tracer, kind: str, stage: Any, joints: int, found: list[Any]) -> list[str]:
    """Follow the step of a stage; add what it gives to ``found``."""
    run: Any = Holder(tracer, stage, ())
    run.state = with_numbers(stage.state, (Symbol(tracer, f"s{i}") for i in range(10**9)))
    time_ns, count = Symbol(tracer, "time_ns"), 0

    def taken(vectors: int) -> list[Vector]:
        nonlocal count
        first, count = count, count + vectors * joints
        inputs: list[Any] = [tracer.write(f"inputs[{i}]") for i in range(first, count)]
        return [tuple(inputs[i * joints : (i + 1) * joints]) for i in range(vectors)]

    def given(*vectors: Vector) -> None:
        found.extend(x for vector in vectors for x in vector)

    if kind == "observer":
        given(run.step(Measurement(*taken(3))))
    elif kind == "controller":
        y = Measurement(*taken(3))
        u, reference = run.step(time_ns, y, *taken(1))
        given(u, reference.position, reference.velocity)
    elif kind == "injector":
        given(run.step(time_ns, *taken(3)).torque)
    elif kind == "detector":
        y = Measurement(*taken(3))
        alarms = run.step(y, *taken(2))
        given(*alarms)
    else:
        run.changes = ()  # the ticks in which the robot changes are not run by the source
        u, d = taken(2)
        run.step(time_ns, u, TrueDisturbance(d))
        given(*run.measure(), *run.motion, run.joint_torque)
    return [
        *(f"outputs[{i}] = {literal(x)}" for i, x in enumerate(found)),
        *following(stage.state, run.state),
    ]


class CompiledStage:
    """What the compiled stages share."""

    def __init__(self, stage: Any, program: StageProgram) -> None:
        """Stand in the place of a stage.

        Args:
            stage: the stage; its components and state are used.
            program: of :func:`stage_program`, for its component.
        """
        self.stage = stage
        self.joints: int = stage.joints if program.kind == "injector" else _model(stage).joints
        self._use(program)

    def _use(self, program: StageProgram) -> None:
        self._program = program
        self._outputs = np.zeros(program.outputs)
        self._inputs = np.zeros({"observer": 3, "plant": 2, "injector": 3, "controller": 4, "detector": 5}[
            program.kind
        ] * self.joints)  # fmt: skip
        self._state: Array | None = None
        """The stage's state while it is here; else the stage has it."""
        self._parameters: Array | None = None

    def _call(self, time_ns: int, *vectors: Vector) -> list[float] | None:
        """Run the compiled step; None if the stage itself has to do this tick."""
        program, state = self._program, self._state
        if state is None:
            if shape(self.stage.state) != program.shape:
                return None
            self._parameters = parameters_of(self.stage, program.slots, program.fixed)
            if self._parameters is None:
                raise NotCompilable(f"the {program.kind} is not the one that was compiled")
            state = self._state = np.array(list(numbers(self.stage.state)), dtype=np.float64)
        self._inputs[:] = [x for vector in vectors for x in vector]
        try:
            done = program.step(self._parameters, state, time_ns, self._inputs, self._outputs)
        except (ArithmeticError, ValueError):  # the stage itself says how
            done = 0
        if done:
            return self._outputs.tolist()
        self.give_back()
        return None

    def warm_up(self) -> None:
        """Call the compiled step once, to no effect: the first call of a function takes longer."""
        inputs = [(0.0,) * self.joints] * (len(self._inputs) // self.joints)
        with contextlib.suppress(ArithmeticError, ValueError):
            self._call(0, *inputs)
        self._state = None

    def remember(self) -> Any:
        """Return what :meth:`recall` takes back: all that it remembers, of the same component."""
        return self.stage.state if self._state is None else self._state.copy()

    def recall(self, memory: Any) -> None:
        """Go on from what it remembered; or from a state of the stage."""
        if isinstance(memory, np.ndarray):
            self._state = memory.copy()
        else:
            self._state, self.stage.state = None, memory

    def give_back(self) -> None:
        """Give the stage its state, so that it can go on by itself."""
        if self._state is not None:
            self.stage.state = with_numbers(self.stage.state, iter(self._state.tolist()))
            self._state = None

    def swap(self, component: Any, program: StageProgram) -> None:
        """Use another component from the next tick on, as the stage does, with its program."""
        self.give_back()
        self.stage.swap(component)
        self._use(program)

    def order(self, number: int, action: str, t: float) -> None:
        """Arm or clear a fault by hand, as the stage does."""
        self.give_back()
        self.stage.order(number, action, t)

    def phases(self) -> Any:
        """From when to when faults act, as of the stage."""
        self.give_back()
        return self.stage.phases()

    def _split(self, found: list[float]) -> list[Vector]:
        n = self.joints
        return [tuple(found[i : i + n]) for i in range(0, len(found), n)]


def _model(stage: Any) -> Any:
    return stage.robot if hasattr(stage, "robot") else stage.model


class CompiledObserver(CompiledStage):
    """As :class:`~ftcm_core.simulation.stages.ObserverStage`."""

    @property
    def observer(self) -> Any:
        """The observer in use."""
        return self.stage.observer

    def step(self, y: Measurement, ticks: int = 1) -> Vector:
        """tau_hat at t_k (N·m), as of the stage."""
        found = self._call(0, *y) if ticks == 1 else None
        if found is not None:
            return tuple(found)
        self.give_back()
        result: Vector = self.stage.step(y, ticks)
        return result


class CompiledController(CompiledStage):
    """As :class:`~ftcm_core.simulation.stages.ControllerStage`."""

    @property
    def controller(self) -> Any:
        """The law in use."""
        return self.stage.controller

    def reference_at(self, time_ns: int) -> ReferencePoint:
        """As of the stage."""
        point: ReferencePoint = self.stage.reference_at(time_ns)
        return point

    def prepare(self, time_ns: int, y: Measurement) -> None:
        """Nothing: the whole step takes less time than preparing it would save."""

    def step(self, time_ns: int, y: Measurement, tau_hat: Vector) -> tuple[Vector, ReferencePoint]:
        """u_k (N·m) and the reference at t_k, as of the stage; the reference without its acceleration."""
        found = self._call(time_ns, *y, tau_hat)
        if found is None:
            plain: tuple[Vector, ReferencePoint] = self.stage.step(time_ns, y, tau_hat)
            return plain
        u, position, velocity = self._split(found)
        return u, ReferencePoint(position, velocity, ())


class CompiledInjector(CompiledStage):
    """As :class:`~ftcm_core.simulation.stages.InjectorStage`."""

    def step(
        self, time_ns: int, position: Vector, velocity: Vector, u: Vector, ticks: int = 1
    ) -> TrueDisturbance:
        """d_k (N·m) at t_k, as of the stage."""
        found = self._call(time_ns, position, velocity, u) if ticks == 1 else None
        if found is not None:
            return TrueDisturbance(tuple(found))
        self.give_back()
        plain: TrueDisturbance = self.stage.step(time_ns, position, velocity, u, ticks)
        return plain


class CompiledDetector(CompiledStage):
    """As :class:`~ftcm_core.simulation.stages.DetectorStage`."""

    @property
    def detector(self) -> Any:
        """The detector in use."""
        return self.stage.detector

    def step(self, y: Measurement, u: Vector, tau_hat: Vector, ticks: int = 1) -> Detection:
        """Residuals and alarms, as of the stage."""
        found = self._call(0, *y, u, tau_hat) if ticks == 1 else None
        if found is not None:
            return Detection(*self._split(found))
        self.give_back()
        plain: Detection = self.stage.step(y, u, tau_hat, ticks)
        return plain


class CompiledPlant(CompiledStage):
    """As :class:`~ftcm_core.simulation.stages.PlantStage`."""

    def __init__(self, stage: Any, program: StageProgram) -> None:
        """Stand in the place of a stage."""
        super().__init__(stage, program)
        self.dt_ns: int = stage.dt_ns
        self._look()

    def _look(self) -> None:
        self.motion = self.stage.motion
        """The true joint positions (rad) and velocities (rad/s)."""
        self.joint_torque = self.stage.joint_torque
        """Torque on the joints over the tick that has just ended, N·m."""
        self._measured: Measurement = self.stage.measure()

    @property
    def status(self) -> str:
        """As of the stage."""
        return str(self.stage.status)

    @property
    def reason(self) -> str:
        """As of the stage."""
        return str(self.stage.reason)

    def measure(self) -> Measurement:
        """y_k, as of the stage."""
        return self._measured

    def step(self, time_ns: int, u: Vector, d: TrueDisturbance) -> None:
        """Move on by a tick, as the stage does."""
        changes = self.stage.changes
        found = None
        if not changes or time_ns < changes[0][0]:
            found = self._call(time_ns, u, d.torque)
        if found is None:
            self.give_back()
            self.stage.step(time_ns, u, d)
            self._look()
            return
        q, v, effort, position, velocity, self.joint_torque = self._split(found)
        self.motion = position, velocity
        self._measured = Measurement(q, v, effort)

    def safe_stop(self, time_ns: int, d: TrueDisturbance) -> None:
        """Move on by a tick with the drives braking, as the stage does."""
        self.give_back()
        self.stage.safe_stop(time_ns, d)
        self._look()


_CLASSES: dict[str, type[CompiledStage]] = {
    "plant": CompiledPlant,
    "observer": CompiledObserver,
    "controller": CompiledController,
    "injector": CompiledInjector,
    "detector": CompiledDetector,
}


def compiled_stage(stage: Any, program: StageProgram) -> Any:
    """Return what stands in the place of a stage."""
    return _CLASSES[program.kind](stage, program)
