# SPDX-License-Identifier: Apache-2.0
"""A scenario: everything that determines a run, typed and validated."""

from __future__ import annotations

import dataclasses
from typing import Any, cast

from ftcm_core.controllers import Controller
from ftcm_core.detectors import Detector
from ftcm_core.disturbances import Disturbance
from ftcm_core.errors import ParameterError, ScenarioError, Unsuited
from ftcm_core.faults import Fault, RobotFault
from ftcm_core.limits import Limits, motion_beyond
from ftcm_core.observers import Observer
from ftcm_core.params import Parameterised, param, per_joint
from ftcm_core.plants import Plant
from ftcm_core.plants.rigid_body import RigidBody
from ftcm_core.policies import Policy
from ftcm_core.references import Reference
from ftcm_core.registry import Component, find
from ftcm_core.robots import Robot
from ftcm_core.scenario.yaml_text import dump_yaml
from ftcm_core.sensors import Sensor
from ftcm_core.sensors.ideal import Ideal
from ftcm_core.signals import NANOSECONDS, Channel, Vector, channels, recorded

MAX_TICKS = 10_000_000
SPEED_LIMIT = 1000.0
"""Joint speed beyond which a run counts as diverged, rad/s (chosen: far above any robot joint)."""

COMPONENTS = {
    "robot": "robot", "model": "robot", "plant": "plant", "reference": "reference",
    "controller": "controller", "observer": "observer", "detector": "detector", "sensor": "sensor",
}  # fmt: skip
"""Keys of a scenario that hold one component, and its kind."""
RIGID_BODY, IDEAL = RigidBody(), Ideal()
LISTS = {"disturbances": "disturbance", "faults": "fault"}
"""Keys of ``injection`` that hold a list of components, and their kind."""


@dataclasses.dataclass(frozen=True, kw_only=True)
class InitialState(Parameterised):
    """Motion of the robot at t = 0."""

    position: float = param(0.0, unit="rad", at_least=-100.0, at_most=100.0, per_joint=True,
                            doc="joint positions at t = 0", source="sec. IV: zero")  # fmt: skip
    velocity: float = param(0.0, unit="rad/s", above=-SPEED_LIMIT, below=SPEED_LIMIT, per_joint=True,
                            doc="joint velocities at t = 0", source="sec. IV: zero")  # fmt: skip


@dataclasses.dataclass(frozen=True, kw_only=True)
class Scenario(Parameterised):
    """Everything that determines a run."""

    name: str = param(
        "unnamed", unit="-", doc="name of the scenario; the file's name unless given", source="chosen"
    )
    dt: float = param(1e-3, unit="s", at_least=1e-5, at_most=0.1, doc="tick length", source="sec. IV: 1 kHz")
    duration: float = param(
        40.0, unit="s", above=0.0, at_most=100_000.0, doc="length of the run", source="sec. IV"
    )
    transient: float = param(
        1.0,
        unit="s",
        at_least=0.0,
        doc="end of the transient window of the metrics",
        source="chosen: settled by then",
    )
    torque_limits: float | None = param(
        None, unit="N·m", above=0.0, per_joint=True, optional=True, kind="float",
        doc="largest torque of each drive; null: no limit", source="sec. IV: none",
    )  # fmt: skip
    torque_rate_limits: float | None = param(
        None, unit="N·m/s", above=0.0, per_joint=True, optional=True, kind="float",
        doc="fastest change of each drive's torque; null: no limit", source="sec. IV: none",
    )  # fmt: skip
    velocity_limits: float | None = param(
        None, unit="rad/s", above=0.0, per_joint=True, optional=True, kind="float",
        doc="speed beyond which the run ends; null: no limit", source="sec. IV: none",
    )  # fmt: skip
    position_lower_limits: float | None = param(
        None, unit="rad", per_joint=True, optional=True, kind="float",
        doc="position below which the run ends; null: no limit", source="sec. IV: none",
    )  # fmt: skip
    position_upper_limits: float | None = param(
        None, unit="rad", per_joint=True, optional=True, kind="float",
        doc="position above which the run ends; null: no limit", source="sec. IV: none",
    )  # fmt: skip
    stop_damping: float = param(
        100.0, unit="N·m·s/rad", at_least=0.0, per_joint=True,
        doc="damping of the drives in a safe stop, which the plant node makes when no torque comes",
        source="chosen: the PUMA 560 sinks at under 0.4 rad/s; stable for ticks of up to 20 ms",
    )  # fmt: skip
    torque_delay: int = param(
        0, unit="ticks", at_least=0, at_most=1000,
        doc="the drive applies the command of so many ticks before; zero torque until the first arrives",
        source="sec. IV: none",
    )  # fmt: skip
    seed: int = param(
        0, unit="-", at_least=0, at_most=2**63 - 1, doc="seed of all random streams", source="chosen"
    )
    robot: Robot
    """The true robot, which the plant moves."""
    model: Robot = None  # type: ignore[assignment]  # set by check()
    """What observer, controller and detector believe of it; by default the same without payload."""
    plant: Plant = RIGID_BODY
    reference: Reference
    controller: Controller
    observer: Observer
    detector: Detector | None = None
    sensor: Sensor = IDEAL
    initial_state: InitialState = InitialState()
    disturbances: tuple[Disturbance, ...] = ()
    faults: tuple[Fault, ...] = ()
    policies: tuple[Policy, ...] = ()
    """What is done about faults that the detector tells."""
    plugins: tuple[str, ...] = ()
    """Plug-ins that its components come from, as of :func:`~ftcm_core.registry.load_plugin`."""

    def check(self) -> None:
        """Check what one value cannot tell: whole ticks, joint counts, an observer where one is needed."""
        if self.model is None:
            object.__setattr__(self, "model", self.robot.unloaded())
        ns = self.dt * NANOSECONDS
        if abs(ns - round(ns)) > 1e-6:
            raise ParameterError(
                f"dt: {self.dt!r} s is not a whole number of nanoseconds; choose e.g. {round(ns)}e-9"
            )
        count = self.duration / self.dt
        if abs(count - round(count)) > 1e-6 or round(count) < 1:
            raise ParameterError(
                f"duration: {self.duration:g} s is not a whole number of ticks of {self.dt:g} s; "
                f"choose e.g. {max(1, round(count)) * round(ns) / NANOSECONDS!r}"
            )
        if count > MAX_TICKS:
            raise ParameterError(
                f"duration: {count:.3g} ticks; expected at most {MAX_TICKS}; raise dt or shorten it"
            )
        if self.observer.type_name == "none":
            taken: list[Component] = [c for policy in self.policies for c in policy.components().values()]
            parts = [*([self.detector] if self.detector else []), *taken]
            for part, instead in ((self.controller, "ftsmc"), *((part, "") for part in parts)):
                if getattr(part, "needs_observer", False):
                    other = f", or a controller that needs none, e.g. {instead}" if instead else ""
                    raise Unsuited(
                        f"observer: none, but {part.kind} {part.type_name!r} uses the disturbance "
                        f"estimate; choose an observer, e.g. do{other}"
                    )
        if self.policies and self.detector is None:
            raise ParameterError(
                "policies: act on what a detector says; choose one, e.g. detector: isolating"
            )
        self._check_joints()
        limits, start, joints = self.limits, self.initial_state, self.robot.joints
        if limits.lower is not None and limits.upper is not None:
            for low, high in zip(limits.lower, limits.upper):
                if low >= high:
                    raise ParameterError(
                        f"position_lower_limits: {low:g} is not below position_upper_limits {high:g}"
                    )
        position, velocity = per_joint(start.position, joints), per_joint(start.velocity, joints)
        beyond = motion_beyond(limits, self.robot.joint_names, position, velocity)
        if beyond:
            raise ParameterError(f"initial_state: {beyond}; expected a start within the limits")

    def _check_joints(self) -> None:
        joints, names = self.robot.joints, self.robot.joint_names
        self.check_joints(joints)
        if self.model.joint_names != names:
            raise ParameterError(
                f"model: has the joints {list(self.model.joint_names)}; expected those of the robot, "
                f"{list(names)}"
            )
        for place, part in self.parts():
            try:
                part.check_joints(joints)
            except ParameterError as error:
                raise Unsuited(f"{place}.{error}") from None
            needs = ""
            if isinstance(part, (Fault, Policy)):
                needs = part.unsuited(self.robot)
            elif isinstance(part, Disturbance):
                needs = part.supports(joints) or ""
            if needs:
                raise ParameterError(f"{place}: {needs}; robot {self.robot.type_name!r} has {joints} joints")
            if isinstance(part, Fault) and (reason := part.too_coarse(self.robot, self.dt)):
                raise ParameterError(f"{place}.{reason}")
        if needs := self.plant.unsuited(self.robot, any(isinstance(f, RobotFault) for f in self.faults)):
            raise ParameterError(f"plant: {needs}")
        robot = self.robot
        for i, fault in sorted(enumerate(self.faults), key=lambda x: x[1].rank):
            try:
                robot = fault.changed(robot) if isinstance(fault, RobotFault) else robot
            except ParameterError as error:
                raise ParameterError(f"injection.faults.{i}: makes a robot that cannot be: {error}") from None

    def parts(self) -> list[tuple[str, Parameterised]]:
        """Return the parameter records inside this scenario with their paths."""
        return [
            *((key, getattr(self, key)) for key in COMPONENTS if getattr(self, key) is not None),
            ("initial_state", self.initial_state),
            *((f"injection.disturbances.{i}", d) for i, d in enumerate(self.disturbances)),
            *((f"injection.faults.{i}", f) for i, f in enumerate(self.faults)),
            *((f"policies.{i}", p) for i, p in enumerate(self.policies)),
            *(
                (f"policies.{i}.{kind}", component)
                for i, p in enumerate(self.policies)
                for kind, component in p.components().items()
            ),
        ]

    @property
    def dt_ns(self) -> int:
        """Tick length, integer ns."""
        return round(self.dt * NANOSECONDS)

    @property
    def last_tick(self) -> int:
        """Number N of the last tick; a run has the N + 1 ticks 0 ... N."""
        return round(self.duration / self.dt)

    @property
    def limits(self) -> Limits:
        """What drives and joints allow."""

        def each(value: float | None, factor: float = 1.0) -> Vector | None:
            if value is None:
                return None
            return tuple([x * factor for x in per_joint(value, self.robot.joints)])

        return Limits(
            torque=each(self.torque_limits),
            torque_step=each(self.torque_rate_limits, self.dt),
            velocity=each(self.velocity_limits),
            lower=each(self.position_lower_limits),
            upper=each(self.position_upper_limits),
        )

    @property
    def fault_labels(self) -> tuple[str, ...]:
        """Name of each fault: its type and its number among those of that type, from 0."""
        return _labels(self.faults)

    @property
    def policy_labels(self) -> tuple[str, ...]:
        """Name of each policy, likewise."""
        return _labels(self.policies)

    @property
    def hidden(self) -> bool:
        """Whether the true motion or torque is not what the drives report."""
        return not self.sensor.exact or any(fault.site != "dynamics" for fault in self.faults)

    @property
    def exact_engine(self) -> bool:
        """Whether the true motion follows from the robot's equations as they are at the start."""
        return isinstance(self.plant, RigidBody) and not any(isinstance(f, RobotFault) for f in self.faults)

    @property
    def columns(self) -> tuple[str, ...]:
        """Names of the recorded signals, in the order of a row."""
        return recorded(self.hidden, self.detector is not None)

    @property
    def channels(self) -> tuple[Channel, ...]:
        """The data topics of a run."""
        return channels(self.hidden, self.detector is not None, bool(self.policies))

    def with_controller(self, name: str) -> Scenario:
        """Return this scenario with another controller at its defaults; unchanged if it is the same."""
        if name == self.controller.type_name:
            return self
        return replace(self, controller=cast(Controller, find("controller", name)()))

    def warnings_of(self, part: Component) -> list[str]:
        """Conditions that the parameters of a component do not meet in this run, one line each."""
        if isinstance(part, Observer):
            return part.warnings(self.model, self.dt)
        found: list[str] = getattr(part, "warnings", list)()
        return found

    def warnings(self) -> list[str]:
        """Return the warnings of its controller, its observer and its plant."""
        start = per_joint(self.initial_state.position, self.robot.joints)
        return [
            *self.warnings_of(self.controller),
            *self.warnings_of(self.observer),
            *self.plant.warnings(self.robot, start, self.dt),
        ]

    def to_mapping(self) -> dict[str, Any]:
        """Return the complete scenario, every default written out, as plain data."""
        scalars = {k: list(v) if isinstance(v, tuple) else v for k, v in self.values.items()}
        return {
            "name": scalars.pop("name"),
            **({"plugins": list(self.plugins)} if self.plugins else {}),
            **{key: part.to_mapping() if (part := getattr(self, key)) else None for key in COMPONENTS},
            "initial_state": {
                k: list(v) if isinstance(v, tuple) else v for k, v in self.initial_state.values.items()
            },
            "injection": {key: [c.to_mapping() for c in getattr(self, key)] for key in LISTS},
            "policies": [policy.to_mapping() for policy in self.policies],
            **scalars,
        }

    def to_yaml(self) -> str:
        """Return the complete scenario as a file that reads back to an equal scenario."""
        return dump_yaml(self.to_mapping(), unicode=self.name.isprintable())


def _labels(parts: tuple[Component, ...]) -> tuple[str, ...]:
    count: dict[str, int] = {}
    labels = []
    for part in parts:
        n = count[part.type_name] = count.get(part.type_name, -1) + 1
        labels.append(f"{part.type_name}_{n}")
    return tuple(labels)


def replace(scenario: Scenario, **changes: Any) -> Scenario:
    """Return a copy with some fields changed, validated as a whole.

    Raises:
        ScenarioError: the result is not a valid scenario.
    """
    try:
        return dataclasses.replace(scenario, **changes)
    except ParameterError as error:
        raise ScenarioError(str(error)) from None
