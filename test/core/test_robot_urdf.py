# SPDX-License-Identifier: Apache-2.0
"""Arms from URDF files: what is read, what is refused, and the mechanics, also against Pinocchio."""

from __future__ import annotations

import dataclasses
import math
import os
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

from ftcm_core import compiled
from ftcm_core.errors import ParameterError, ScenarioError
from ftcm_core.recording.metrics import evaluate
from ftcm_core.recording.provenance import provenance
from ftcm_core.robots import Robot
from ftcm_core.robots.puma560 import Puma560
from ftcm_core.robots.urdf import Urdf
from ftcm_core.robots.urdf_file import locate, parse_arm
from ftcm_core.scenario import from_mapping, load
from ftcm_core.simulation import simulate
from urdf_arms import PANDA, UR5, arm_text, joint, link, need_arms

sys.path.insert(0, str(Path(__file__).parents[1] / "reference"))
import puma560_matrix
import puma560_refit
import robot_matrices

REVOLUTE, CONTINUOUS, PRISMATIC, FIXED = "revolute", "continuous", "prismatic", "fixed"
RNG = np.random.default_rng(3)
MADE_UP = {
    "one joint": ([REVOLUTE], {}),
    "one that slides": ([PRISMATIC], {}),
    "scara": ([REVOLUTE, REVOLUTE, PRISMATIC, REVOLUTE], {}),
    "gantry": ([PRISMATIC, PRISMATIC, PRISMATIC, REVOLUTE, CONTINUOUS], {}),
    "six": ([REVOLUTE] * 6, {}),
    "seven": ([CONTINUOUS, REVOLUTE, REVOLUTE, CONTINUOUS, REVOLUTE, PRISMATIC, REVOLUTE], {}),
    "parallel axes": ([REVOLUTE] * 3, {"rpy": "0 0 0", "axis": "0 0 1"}),
    "opposite axes": ([REVOLUTE] * 3, {"rpy": "3.141592653589793 0 0", "axis": "0 0 1"}),
    "nearly parallel axes": ([REVOLUTE] * 3, {"rpy": "1e-9 2e-9 0.3", "axis": "0 0 -1"}),
    "fixed between": ([FIXED, REVOLUTE, FIXED, FIXED, REVOLUTE, FIXED], {}),
}
BRANCH = [
    link("side", RNG), joint("held", REVOLUTE, "l1", "side", RNG),
    link("far", RNG), joint("also_held", PRISMATIC, "side", "far", RNG, '<mimic joint="held"/>'),
    link("plate", RNG), joint("screwed", FIXED, "l2", "plate", RNG),
]  # fmt: skip


def write(folder: Path, text: str, name: str = "arm.urdf") -> str:
    """A file with that text."""
    (folder / name).write_text(text, encoding="utf-8")
    return str(folder / name)


def made_up(folder: Path, name: str, **parameters: Any) -> Urdf:
    """One of the made-up arms."""
    kinds, given = MADE_UP[name]
    return Urdf(file=write(folder, arm_text(kinds, 7, **given)), **parameters)


def states(joints: int, count: int = 25) -> list[tuple[tuple[float, ...], ...]]:
    """Positions, velocities, accelerations (or torques) and a force's three components in each."""
    scale = np.array([[math.pi], [3.0], [10.0]])
    drawn = np.random.default_rng(5).uniform(-scale, scale, (count, 3, joints))
    return [tuple(tuple(x) for x in sample) for sample in drawn.tolist()]


# ---- against Pinocchio ----


class Oracle:
    """Pinocchio's reading of the same file, joints that are not the robot's locked at zero."""

    def __init__(self, robot: Urdf) -> None:
        """Motor inertias and the payload are added by hand."""
        self.pin = pin = pytest.importorskip("pinocchio", reason="the oracle is Pinocchio (pip install pin)")
        full = pin.buildModelFromUrdf(str(locate(robot.file)))
        others = [full.getJointId(name) for name in full.names[1:] if name not in robot.joint_names]
        self.model = pin.buildReducedModel(full, others, pin.neutral(full))
        n = robot.joints
        self.model.armature = np.broadcast_to(robot.motor_inertia, n)
        self.model.gravity.linear = np.array([0.0, 0.0, -robot.gravity_acceleration])
        child = robot.tip or robot.arm.joints[-1].child
        self.tip = self.model.getFrameId(child, pin.FrameType.BODY)
        self.lever = np.array([0.0, 0.0, robot.payload_distance])
        at = self.model.frames[self.tip].placement.act(self.lever)
        self.model.appendBodyToJoint(
            n, pin.Inertia(robot.payload_mass, at, np.zeros((3, 3))), pin.SE3.Identity()
        )
        self.data = self.model.createData()

    def configuration(self, q: tuple[float, ...]) -> np.ndarray:
        """Joint positions as Pinocchio wants them: of one that turns on without end, cosine and sine."""
        pairs = zip(q, list(self.model.joints)[1:])
        return np.concatenate([[math.cos(x), math.sin(x)] if j.nq == 2 else [x] for x, j in pairs])

    def agrees_with(self, robot: Robot) -> None:
        """M, C v, G, both directions of the dynamics and Jᵀ F are the same at many states."""
        pin, model, data = self.pin, self.model, self.data
        assert tuple(model.names)[1:] == robot.joint_names
        for q, v, a in states(robot.joints):
            at, va, aa = self.configuration(q), np.array(v), np.array(a)
            torque = pin.rnea(model, data, at, va, aa).copy()
            gravity = pin.computeGeneralizedGravity(model, data, at).copy()
            m = pin.crba(model, data, at).copy()
            m = np.triu(m) + np.triu(m, 1).T
            size = 1e-12 * (1.0 + np.abs(torque).max())
            assert robot.gravity(q) == pytest.approx(gravity, abs=size)
            assert robot_matrices.mass_matrix(robot, q) == pytest.approx(m, abs=size)
            assert robot.inertia_torque(q, a) == pytest.approx(m @ aa, abs=size)
            velocity = pin.nonLinearEffects(model, data, at, va) - gravity
            assert robot_matrices.velocity_torque(robot, q, v) == pytest.approx(velocity, abs=size)
            assert robot.inverse_dynamics(q, v, a) == pytest.approx(torque, abs=size)
            stretch = 1e-12 * np.linalg.cond(m)
            found = robot.forward_dynamics(q, v, tuple(torque.tolist()))
            assert found == pytest.approx(aa, abs=stretch * (1.0 + np.abs(aa).max()))
            expected = np.linalg.solve(m, aa)
            assert robot.inertia_acceleration(q, a) == pytest.approx(
                expected, abs=stretch * (1.0 + np.abs(expected).max())
            )
            force = np.array([30.0, -20.0, 10.0])
            jacobian = pin.computeFrameJacobian(model, data, at, self.tip, pin.LOCAL_WORLD_ALIGNED)
            pin.framesForwardKinematics(model, data, at)
            lever = data.oMf[self.tip].rotation @ self.lever
            pushed = jacobian.reshape(6, -1).T @ np.concatenate([force, np.cross(lever, force)])
            assert robot.tip_torque(q, tuple(force.tolist())) == pytest.approx(pushed, abs=1e-12 * 100.0)


@pytest.mark.oracle
@pytest.mark.parametrize("name", MADE_UP)
def test_made_up_arms_are_pinocchios(name: str, tmp_path: Path) -> None:
    """Any mixture of joints, about any axes, with bodies of any inertia; with motors and a payload too."""
    robot = made_up(tmp_path, name)
    Oracle(robot).agrees_with(robot)
    loaded = dataclasses.replace(robot, payload_mass=1.5, payload_distance=0.2, motor_inertia=0.3)
    Oracle(loaded).agrees_with(loaded)


@pytest.mark.oracle
def test_what_is_beside_the_way_to_the_tip_is_held_at_zero(tmp_path: Path) -> None:
    """Its mass counts; it may mimic, and hang on joints that move."""
    file = write(tmp_path, arm_text([REVOLUTE, FIXED, REVOLUTE, REVOLUTE], 7, BRANCH))
    robot = Urdf(file=file, tip="l4", payload_mass=2.0, payload_distance=-0.1)
    assert robot.joint_names == ("j1", "j3", "j4")
    Oracle(robot).agrees_with(robot)
    shorter = Urdf(file=file, tip="plate", payload_mass=2.0, payload_distance=0.3)
    assert shorter.joint_names == ("j1",)
    Oracle(shorter).agrees_with(shorter)


@pytest.mark.oracle
@pytest.mark.parametrize(("arm", "joints"), [({}, 3), (UR5, 6), (PANDA, 7)], ids=["puma560", "ur5", "panda"])
def test_real_arms_are_pinocchios(arm: dict[str, Any], joints: int) -> None:
    """The PUMA 560 of this package, and UR5 and Panda of another one, with a payload."""
    if arm:
        need_arms()
    extras: Any = {"payload_mass": 1.0, "payload_distance": 0.1, "motor_inertia": 0.2}
    robot = Urdf(**arm, **extras, viscous_friction=0.0)
    assert robot.joints == joints
    Oracle(robot).agrees_with(robot)


# ---- mechanics, without an oracle ----


@pytest.mark.parametrize("name", MADE_UP)
def test_a_payload_hangs_on_the_tip(name: str, tmp_path: Path) -> None:
    """What it adds to gravity is what a force of its weight takes: Jᵀ of its weight."""
    robot = made_up(tmp_path, name, payload_distance=0.3)
    weight = (0.0, 0.0, 2.0 * robot.gravity_acceleration)
    for q, _, _ in states(robot.joints, 5):
        added = np.subtract(dataclasses.replace(robot, payload_mass=2.0).gravity(q), robot.gravity(q))
        assert added == pytest.approx(robot.tip_torque(q, weight), abs=1e-11)


@pytest.mark.parametrize("name", MADE_UP)
def test_power_is_the_rate_of_energy(name: str, tmp_path: Path) -> None:
    """Without friction vᵀτ = d/dt ½vᵀMv + vᵀG; Ṁ v by differences, as of the base class."""
    robot = made_up(tmp_path, name)
    for q, v, a in states(robot.joints, 5):
        power = np.dot(v, robot.inverse_dynamics(q, v, a))
        kinetic = np.dot(v, robot.inertia_torque(q, a)) + 0.5 * np.dot(v, robot.inertia_rate_torque(q, v))
        assert power == pytest.approx(kinetic + np.dot(v, robot.gravity(q)), rel=1e-6, abs=1e-6)


def test_an_axis_that_is_turned_over_turns_the_other_way(tmp_path: Path) -> None:
    """A joint about -z at q is one about z at -q."""
    one = Urdf(file=write(tmp_path, arm_text([REVOLUTE, PRISMATIC], 7, axis="0.2 -0.3 0.9"), "one.urdf"))
    other = Urdf(file=write(tmp_path, arm_text([REVOLUTE, PRISMATIC], 7, axis="-0.4 0.6 -1.8"), "other.urdf"))
    for state in states(2, 5):
        turned = [tuple(-x for x in vector) for vector in state]
        found = other.inverse_dynamics(*turned)
        assert [-x for x in found] == pytest.approx(one.inverse_dynamics(*state), abs=1e-12)


def test_a_heavier_arm(tmp_path: Path) -> None:
    """A factor on all masses is one on all torques; without motors."""
    arm = made_up(tmp_path, "seven")
    heavier = made_up(tmp_path, "seven", mass_factor=1.1)
    for state in states(7, 3):
        assert heavier.inverse_dynamics(*state) == pytest.approx(
            [1.1 * x for x in arm.inverse_dynamics(*state)], rel=1e-12
        )


def test_friction_is_that_of_the_file_unless_given(tmp_path: Path) -> None:
    """Damping and friction of <dynamics>; a parameter takes their place."""
    text = arm_text([REVOLUTE], 7).replace("</joint>", '<dynamics damping="0.5" friction="2"/></joint>')
    file, (q, v, a) = write(tmp_path, text), states(1, 1)[0]
    none = Urdf(file=file, viscous_friction=0.0, coulomb_friction=0.0)
    own, other = Urdf(file=file), Urdf(file=file, viscous_friction=3.0)
    coulomb = 2.0 * math.tanh(v[0] / own.slip_velocity)
    rest = none.inverse_dynamics(q, v, a)[0]
    assert own.inverse_dynamics(q, v, a)[0] - rest == pytest.approx(0.5 * v[0] + coulomb, abs=1e-12)
    assert other.inverse_dynamics(q, v, a)[0] - rest == pytest.approx(3.0 * v[0] + coulomb, abs=1e-12)
    assert own.forward_dynamics(q, v, own.inverse_dynamics(q, v, a)) == pytest.approx(a, abs=1e-9)


# ---- the PUMA 560 ----

MOTORS = tuple(puma560_matrix.MOTOR_INERTIA.tolist())
PUMA = Urdf(motor_inertia=MOTORS)


class AsModel:
    """An arm as :mod:`puma560_refit` wants a model."""

    def mass_matrix(self, q: np.ndarray) -> np.ndarray:
        """M(q), kg·m²."""
        return robot_matrices.mass_matrix(PUMA, tuple(q.tolist()))

    def gravity(self, q: np.ndarray) -> np.ndarray:
        """G(q), N·m."""
        return np.array(PUMA.gravity(tuple(q.tolist())))

    def inverse_dynamics(self, q: np.ndarray, v: np.ndarray, a: np.ndarray) -> np.ndarray:
        """Torque, N·m."""
        return np.array(PUMA.inverse_dynamics(*(tuple(x.tolist()) for x in (q, v, a))))


def test_the_pumas_file_is_its_link_data() -> None:
    """The Lagrangian in matrix form, from Armstrong's tables, gives the same torques."""
    for state in states(3):
        expected = puma560_matrix.inverse_dynamics(*map(np.array, state))
        assert PUMA.inverse_dynamics(*state) == pytest.approx(expected, abs=1e-10)


def test_the_pumas_closed_form_is_that_of_its_file() -> None:
    """Refitted to the file, Armstrong's closed form gives its torques and accelerations to rounding."""
    puma560_refit.check(AsModel())


def test_the_pumas_printed_constants_are_near_its_file() -> None:
    """‖ΔM‖/‖M‖ is 4.8 % at worst, as Armstrong's I1 and I3 are not those of his links; gravity is within 0.5 %."""
    robot, worst, weight, largest = Puma560(), 0.0, 0.0, 0.0
    for q2 in np.linspace(-math.pi, math.pi, 41).tolist():
        for q3 in np.linspace(-math.pi, math.pi, 41).tolist():
            q = (0.0, q2, q3)
            exact = robot_matrices.mass_matrix(PUMA, q)
            error = np.linalg.norm(robot_matrices.mass_matrix(robot, q) - exact)
            worst = max(worst, float(error / np.linalg.norm(exact)))
            weight = max(weight, float(np.abs(np.subtract(robot.gravity(q), PUMA.gravity(q))).max()))
            largest = max(largest, float(np.abs(PUMA.gravity(q)).max()))
    assert worst == pytest.approx(0.048, abs=5e-4)
    assert weight < 0.005 * largest
