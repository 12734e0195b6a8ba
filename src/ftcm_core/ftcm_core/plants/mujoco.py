# SPDX-License-Identifier: Apache-2.0
"""MuJoCo as the plant: dry friction, ends of joints and contacts, by its solver.

What a model file of MuJoCo's own may have besides the arm (a table, a box that is pushed) moves with it.
"""

from __future__ import annotations

import hashlib
import os
from functools import cached_property
from math import cos, sin
from typing import Any, NamedTuple
from xml.sax.saxutils import quoteattr

import numpy as np

from ftcm_core.errors import FtcmError, ParameterError, shown, suggestion
from ftcm_core.params import param
from ftcm_core.plants import Plant
from ftcm_core.registry import register
from ftcm_core.robots import Robot
from ftcm_core.robots.serial_chain import Body, Chain
from ftcm_core.robots.urdf_file import PACKAGE, files_read, locate
from ftcm_core.signals import Vector

INTEGRATORS = {"rk4": "mjINT_RK4", "implicitfast": "mjINT_IMPLICITFAST", "euler": "mjINT_EULER"}


class MujocoState(NamedTuple):
    """All that the next step depends on."""

    values: Any
    """MuJoCo's ``mjSTATE_INTEGRATION``, of the whole model; read only."""
    position: Vector
    """Of the arm's joints, rad."""
    velocity: Vector
    """rad/s."""


class Simulator(NamedTuple):
    """A compiled model, and the memory that MuJoCo works in."""

    mujoco: Any
    """The module."""
    model: Any
    data: Any
    positions: Any
    """Where the arm's joints are in ``qpos``."""
    velocities: Any
    """Where they are in ``qvel``."""


@register("plant", "mujoco")
class Mujoco(Plant):
    """MuJoCo of Todorov, Erez and Tassa (2012): the links of the robot, or a model file, with contacts."""

    foreign = True

    file: str | None = param(
        None, unit="-", optional=True, kind="str",
        doc="MJCF or URDF file that MuJoCo reads, or package:NAME/path; its joints, friction and gravity "
        "count, its actuators do not; null: written from the links of the robot, which has no shapes that "
        "could touch",
        source="chosen: the same arm as the robot",
    )  # fmt: skip
    integrator: str = param(
        "rk4", unit="-", choices=tuple(INTEGRATORS),
        doc="MuJoCo's integrator: rk4 is of fourth order where nothing touches or sticks; implicitfast and "
        "euler are of first order, and what its manual recommends for contacts",
        source="chosen: as the plant rigid_body",
    )  # fmt: skip
    substeps: int = param(
        1, unit="-", at_least=1, at_most=1000, doc="steps of the integrator per tick", source="chosen"
    )
    joint_stops: bool = param(
        True, unit="-", kind="bool", doc="whether joints stop at the ends that their file tells",
        source="chosen: as a real arm",
    )  # fmt: skip

    def check(self) -> None:
        """The file must be there."""
        if self.file is None:
            return
        if not self.file.startswith(PACKAGE):
            object.__setattr__(self, "file", os.path.abspath(self.file))
        try:
            files_read[self.file] = hashlib.sha256(locate(self.file).read_bytes()).hexdigest()[:12]
        except ParameterError as error:
            raise ParameterError(f"file: {error}") from None
        except (OSError, ValueError) as error:
            reason = getattr(error, "strerror", None) or str(error)
            raise ParameterError(
                f"file: {shown(self.file)} cannot be read: {reason}; expected an MJCF or URDF file"
            ) from None

    def unsuited(self, robot: Robot, changes: bool) -> str:
        """It needs MuJoCo, links or a file with the robot's joints, and links for a robot that changes."""
        if self.file is None and robot.chain() is None:
            return (
                f"robot {robot.type_name!r} does not tell its links; take robot: {{type: urdf}}, or name "
                "the file of a model"
            )
        if self.file is not None and changes:
            return "the faults change the robot, but a file's masses stay; drop file, or those faults"
        try:
            self._simulator(robot)
        except FtcmError as error:
            return str(error)
        return ""

    def init(self, robot: Robot, position: Vector, velocity: Vector) -> MujocoState:
        """The arm at the given motion, all else where the model has it at first."""
        simulator = self._simulator(robot)
        data = simulator.data
        simulator.mujoco.mj_resetData(simulator.model, data)
        data.qpos[simulator.positions] = position
        data.qvel[simulator.velocities] = velocity
        return _state(simulator)

    def step(self, robot: Robot, dt: float, torque: Vector, state: MujocoState) -> MujocoState:
        """Let MuJoCo step, the torque held."""
        simulator = self._simulator(robot)
        mujoco, model, data = simulator[:3]
        model.opt.timestep = dt / self.substeps
        mujoco.mj_setState(model, data, state.values, mujoco.mjtState.mjSTATE_INTEGRATION)
        data.qfrc_applied[simulator.velocities] = torque
        mujoco.mj_step(model, data, self.substeps)
        return _state(simulator)

    def motion(self, state: MujocoState) -> tuple[Vector, Vector]:
        """Of the arm's joints."""
        return state.position, state.velocity

    @cached_property
    def _simulators(self) -> dict[Robot, Simulator]:
        return {}

    def _simulator(self, robot: Robot) -> Simulator:
        found = self._simulators.get(robot)
        if found is None:
            found = self._simulators[robot] = self._compiled(robot)
        return found

    def _compiled(self, robot: Robot) -> Simulator:
        mujoco = module()
        if self.file is None:
            chain = robot.chain()
            assert chain is not None, "unsuited() has refused the robot"
            model = from_chain(chain, robot.joint_names)
        else:
            try:
                model = mujoco.MjModel.from_xml_path(str(locate(self.file)))
            except ValueError as error:
                reason = " ".join(str(error).split())
                raise ParameterError(f"file: {shown(self.file)}: MuJoCo cannot read it: {reason}") from None
        flags = mujoco.mjtDisableBit
        model.opt.disableflags |= flags.mjDSBL_ACTUATION | flags.mjDSBL_AUTORESET
        if not self.joint_stops:
            for name in robot.joint_names:
                if (joint := mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_JOINT, name)) >= 0:
                    model.jnt_limited[joint] = 0
        model.opt.integrator = getattr(mujoco.mjtIntegrator, INTEGRATORS[self.integrator])
        places = [self._place(mujoco, model, name) for name in robot.joint_names]
        return Simulator(
            mujoco, model, mujoco.MjData(model), *[np.array(x, dtype=np.intp) for x in zip(*places)]
        )

    def _place(self, mujoco: Any, model: Any, name: str) -> tuple[int, int]:
        """Where a joint of the robot is in positions and velocities of the model."""
        kind = mujoco.mjtObj.mjOBJ_JOINT
        joint = mujoco.mj_name2id(model, kind, name)
        if joint < 0:
            known = [mujoco.mj_id2name(model, kind, i) or "" for i in range(model.njnt)]
            hint = suggestion(name, [x for x in known if x])
            raise ParameterError(f"file: {shown(self.file)} has no joint {shown(name)}; {hint}")
        if model.jnt_type[joint] < int(mujoco.mjtJoint.mjJNT_SLIDE):  # free, ball, slide, hinge
            raise ParameterError(
                f"file: joint {shown(name)} of {shown(self.file)} is free or a ball; expected a hinge or "
                "a slide"
            )
        return int(model.jnt_qposadr[joint]), int(model.jnt_dofadr[joint])


def module() -> Any:
    """Return the module ``mujoco``.

    Raises:
        FtcmError: it is not installed.
    """
    try:
        import mujoco
    except ImportError:
        raise FtcmError(
            "needs MuJoCo, which is not installed; pip install 'ftcm_core[mujoco]' or pip install mujoco"
        ) from None
    mujoco.set_mju_user_warning(_ignore)  # else it writes a log file; the run tells what diverges
    return mujoco


def _ignore(text: str) -> None:
    del text


def _state(simulator: Simulator) -> MujocoState:
    mujoco, model, data, positions, velocities = simulator
    kind = mujoco.mjtState.mjSTATE_INTEGRATION
    values = np.empty(mujoco.mj_stateSize(model, kind))
    mujoco.mj_getState(model, data, values, kind)
    return MujocoState(values, tuple(data.qpos[positions].tolist()), tuple(data.qvel[velocities].tolist()))


def from_chain(chain: Chain, names: tuple[str, ...]) -> Any:
    """Return MuJoCo's compiled model of an arm.

    Args:
        chain: the arm.
        names: of its joints.
    """
    mujoco = module()
    bodies = ""
    for name, link, rotor, viscous, coulomb, low, high in zip(
        names, chain.links, chain.rotors, chain.viscous, chain.coulomb, chain.lower, chain.upper
    ):
        # About x by alpha, then about z by theta.
        ca, sa = _half(link.cos_alpha, link.sin_alpha)
        ct, st = cos(0.5 * link.theta), sin(0.5 * link.theta)
        turn = (ca * ct, sa * ct, -sa * st, ca * st)
        ends = "" if low is None or high is None or not low < high else f' range="{low!r} {high!r}"'
        bodies += (
            f'<body pos="{link.x!r} {link.y!r} {link.z!r}" quat="{" ".join(map(repr, turn))}">'
            '<inertial pos="1 1 1" quat="1 2 3 4" mass="1" diaginertia="2 3 4"/>'  # those of the link: below
            f'<joint name={quoteattr(name)} type="{"slide" if link.slides else "hinge"}" axis="0 0 1" '
            f'armature="{rotor!r}" damping="{viscous!r}" frictionloss="{coulomb!r}"{ends}/>'
        )
    model = mujoco.MjModel.from_xml_string(
        f'<mujoco><compiler angle="radian" autolimits="true"/><option gravity="0 0 {-chain.gravity!r}"/>'
        f"<worldbody>{bodies}{'</body>' * len(names)}</worldbody></mujoco>"
    )
    for i, link in enumerate(chain.links, start=1):
        # Set after the compiler, which refuses links without mass, though a motor's inertia moves with them.
        centre, moments, axes = principal(link.body)
        model.body_mass[i], model.body_ipos[i], model.body_inertia[i] = link.body.m, centre, moments
        mujoco.mju_mat2Quat(model.body_iquat[i], axes.ravel())
    mujoco.mj_setConst(model, mujoco.MjData(model))
    return model


def _half(c: float, s: float) -> tuple[float, float]:
    """Cosine and sine of half an angle in [-pi, pi]."""
    angle = np.arctan2(s, c)
    return cos(0.5 * angle), sin(0.5 * angle)


def principal(body: Body) -> tuple[Any, Any, Any]:
    """Return a body's centre of mass (m), principal moments of inertia (kg·m²) and their axes as columns."""
    m, mx, my, mz, xx, yy, zz, xy, xz, yz = body
    inertia = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
    if m == 0.0:
        centre = np.zeros(3)
    else:
        centre = np.array([mx, my, mz]) / m
        inertia = inertia - m * (centre @ centre * np.eye(3) - np.outer(centre, centre))
    moments, axes = np.linalg.eigh(inertia)
    if np.linalg.det(axes) < 0.0:
        axes[:, 0] *= -1.0
    return centre, moments, axes
