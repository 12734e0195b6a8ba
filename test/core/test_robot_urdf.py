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
from ftcm_core.robots.urdf_file import locate
from ftcm_core.scenario import from_mapping, load
from ftcm_core.simulation import Loop, simulate
from urdf_arms import PANDA, UR5, arm_text, joint, link, need_arms
from written_tick import written_as_plain

sys.path.insert(0, str(Path(__file__).parents[1] / "reference"))
import puma560_matrix
import puma560_refit
import robot_matrices

ROOT = Path(__file__).resolve().parents[2]
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


@pytest.mark.parametrize("name", MADE_UP)
def test_the_tip_moves_as_the_frames_say_and_as_a_force_on_it_is_felt(name: str, tmp_path: Path) -> None:
    robot = made_up(tmp_path, name, payload_distance=0.1)
    slides = [joint.type == PRISMATIC for joint in robot.arm.joints]
    for q, _, _ in states(robot.joints, 5):
        *joints, tip = robot.forward_kinematics(q)
        assert len(joints) == robot.joints
        for frame in (*joints, tip):
            axes = np.array([frame.x, frame.y, frame.z])
            assert axes @ axes.T == pytest.approx(np.eye(3), abs=1e-12)
            assert np.linalg.det(axes) == pytest.approx(1.0)
        lever = [np.subtract(tip.origin, frame.origin) for frame in joints]
        jacobian = np.array(
            [
                frame.z if straight else np.cross(frame.z, arm)
                for frame, arm, straight in zip(joints, lever, slides)
            ]
        )
        for force in np.eye(3):
            assert robot.tip_torque(q, tuple(force.tolist())) == pytest.approx(jacobian @ force, abs=1e-12)
        for j in range(robot.joints):
            ahead, behind = (
                robot.forward_kinematics(tuple(x + d * (i == j) for i, x in enumerate(q)))[-1].origin
                for d in (1e-5, -1e-5)
            )
            moves = np.subtract(ahead, behind) / 2e-5
            assert moves == pytest.approx(jacobian[j], abs=1e-9), "its derivative, off by h²/6 of the third"


def test_the_pumas_frames_are_those_of_its_file() -> None:
    for q, _, _ in states(3, 5):
        ours, files = (
            np.array([(frame.origin, frame.z) for frame in robot.forward_kinematics(q)])
            for robot in (Puma560(), Urdf(tip="tip"))
        )
        assert ours[:3] == pytest.approx(files[:3], abs=1e-15)
        assert ours[3, 0] == pytest.approx(files[3, 0], abs=1e-15)


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
    """‖ΔM‖/‖M‖ is 4.8 % at worst, as Armstrong's I1 and I3 are not those of his links; G is within 0.5 %."""
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


# ---- what is read ----


def test_bodies_that_do_not_move_are_folded(tmp_path: Path) -> None:
    """A mass behind fixed joints is that mass on the link that carries them."""
    base = '<link name="base"/><joint name="j" type="revolute"><parent link="base"/><child link="l"/></joint>'
    inertia = '<inertia ixx="0" ixy="0" ixz="0" iyy="0" iyz="0" izz="0"/></inertial></link>'
    apart = f"""<robot name="r">{base}<link name="l"/><link name="m"/>
        <link name="n"><inertial><mass value="2"/>{inertia}
        <joint name="f" type="fixed"><parent link="l"/><child link="m"/><origin xyz="0 1 0"/></joint>
        <joint name="g" type="fixed"><parent link="m"/><child link="n"/>
        <origin xyz="0 0 1" rpy="1 2 3"/></joint>
        </robot>"""
    together = f"""<robot name="r">{base}
        <link name="l"><inertial><mass value="2"/><origin xyz="0 1 1"/>{inertia}</robot>"""
    one, other = (
        Urdf(file=write(tmp_path, apart, "one.urdf")),
        Urdf(file=write(tmp_path, together, "two.urdf")),
    )
    assert one.arm.links[0].body == pytest.approx(other.arm.links[0].body, abs=1e-15)
    assert one.inertia_torque((0.3,), (1.0,)) == pytest.approx((4.0,)), "about x, the default axis: 2 (1 + 1)"


def test_limits_of_the_file_are_told() -> None:
    """They are not applied: a scenario has its own."""
    joint = Urdf().arm.joints[1]
    assert (joint.name, joint.effort, joint.velocity, joint.lower, joint.upper) == (
        "joint2", 186.4, 0.93, -3.92, 0.78,
    )  # fmt: skip


def test_the_tip_is_the_last_link_that_moves_unless_named() -> None:
    """Of the PUMA: the centre of the wrist's third link's frame, or the flange."""
    q, down = (0.4, -0.3, 0.2), (0.0, 0.0, -1.0)
    flange, closed = Urdf(tip="tip"), Puma560(payload_distance=0.056)
    assert flange.tip_torque(q, down) == pytest.approx(closed.tip_torque(q, down), abs=1e-12)
    assert Urdf().tip_torque(q, down)[2] == 0.0, "the origin of link 3 lies on its own axis"


def test_the_puma_of_six_joints_with_its_wrist_at_zero_is_that_of_three() -> None:
    six, three = Urdf(file=str(ROOT / "config/robots/puma560_six.urdf")), Urdf()
    for q in np.random.default_rng(4).uniform(-2, 2, (5, 3)).tolist():
        whole = (*q, 0.0, 0.0, 0.0)
        assert six.gravity(whole)[:3] == pytest.approx(three.gravity(tuple(q)), abs=1e-12)
        a = tuple(np.random.default_rng(5).uniform(-1, 1, 3).tolist())
        torque = six.inertia_torque(whole, (*a, 0.0, 0.0, 0.0))[:3]
        assert torque == pytest.approx(three.inertia_torque(tuple(q), a), rel=1e-12, abs=1e-12)


# ---- where the file is ----


def test_a_file_of_a_package(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Of an importable one, of an installed one by the end of its path, of a ROS package of a workspace."""
    assert locate("package:ftcm_core/config/robots/puma560.urdf").is_file()
    folder = tmp_path / "site"
    info = folder / "some_arms-1.0.dist-info"
    for name in ("some/arms/one.urdf", "some/arms/two.urdf", "other/arms/two.urdf"):
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_text("")
    info.mkdir()
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: some-arms\nVersion: 1.0\n")
    (info / "RECORD").write_text("some/arms/one.urdf,,\nsome/arms/two.urdf,,\nother/arms/two.urdf,,\n")
    monkeypatch.syspath_prepend(str(folder))
    assert locate("package:some-arms/arms/one.urdf") == folder / "some/arms/one.urdf"
    assert locate("package:some-arms/some/arms/two.urdf") == folder / "some/arms/two.urdf"
    with pytest.raises(ParameterError, match=r"has 2 such files.*write more of the path"):
        locate("package:some-arms/arms/two.urdf")
    with pytest.raises(ParameterError, match=r"'some-arms' has no file 'three\.urdf'"):
        locate("package:some-arms/three.urdf")
    shared = tmp_path / "install/share/my_arm/urdf"
    shared.mkdir(parents=True)
    (shared / "arm.urdf").write_text("")
    monkeypatch.setenv("AMENT_PREFIX_PATH", os.pathsep.join([str(tmp_path), str(tmp_path / "install")]))
    for form in ("package:my_arm/urdf/arm.urdf", "package://my_arm/urdf/arm.urdf"):
        assert locate(form) == shared / "arm.urdf"


def scenario_text(folder: Path, file: str, **more: Any) -> str:
    """A scenario file for an arm, ``arms/arm.urdf`` beside it."""
    (folder / "arms").mkdir(exist_ok=True)
    write(folder / "arms", arm_text([REVOLUTE] * 2, 7))
    data = {
        "robot": {"type": "urdf", "file": file}, "reference": "constant", "controller": "ctc",
        "observer": "none", "duration": 0.01, **more,
    }  # fmt: skip
    return write(folder, yaml.safe_dump(data), "mine.yaml")


def test_a_path_is_relative_to_the_scenario(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Of robot, model and plant; on the command line to the working folder. What is recorded is absolute."""
    absolute = str(tmp_path / "arms" / "arm.urdf")
    again = {"type": "urdf", "file": "arms/arm.urdf", "mass_factor": 1.1}
    text = scenario_text(tmp_path, "arms/arm.urdf", plant={"robot": again}, model=again)
    monkeypatch.chdir(tmp_path / "arms")
    scenario = load(text)
    assert [x.to_mapping()["file"] for x in (scenario.robot, scenario.model)] == [absolute] * 2
    assert from_mapping(scenario.to_mapping()) == scenario
    named = load(text, ["robot={type: urdf, file: arm.urdf}", "plant=null", "model=null"])
    assert named.robot.values["file"] == absolute


def test_a_file_that_changed_is_read_again_and_told(tmp_path: Path) -> None:
    """The origin of a result names the file by its digest."""
    file = write(tmp_path, arm_text([REVOLUTE], 7))
    first, digest = Urdf(file=file), provenance()[f"robot {file}"]
    write(tmp_path, arm_text([REVOLUTE], 8) + " ")
    second = Urdf(file=file)
    assert first.gravity((0.3,)) != second.gravity((0.3,))
    assert len(digest) == 12
    assert provenance()[f"robot {file}"] != digest


# ---- what is refused ----

ARM = arm_text([REVOLUTE, REVOLUTE], 7)
LINK = '<link name="{}"/>'
LOOSE = '<joint name="j3" type="{}"><parent link="l2"/><child link="l3"/>{}</joint><link name="l3"/></robot>'
BAD_TEXTS = {
    "no XML": ("hello", "not XML: syntax error.*; expected a URDF file"),
    "empty": ("", "not XML: no element found"),
    "unknown encoding": ('<?xml version="1.0" encoding="nope"?><robot/>', "not XML"),
    "another root": ("<sdf/>", "the first tag is 'sdf'; expected <robot>"),
    "entities": ('<!DOCTYPE r [<!ENTITY a "b">]><robot/>', "declares a document type or entities"),
    "xacro": (
        '<robot xmlns:xacro="http://www.ros.org/wiki/xacro"><xacro:include/></robot>',
        "macros that are not expanded; make a URDF of it with xacro",
    ),
    "nothing": ('<robot name="r"/>', "0 links hang on no joint; expected one, the base"),
    "no joint": (f"<robot>{LINK.format('a')}</robot>", "no joint moves anything; expected an arm"),
    "too many": (f"<robot>{LINK.format('a') * 501}</robot>", "501 links; expected an arm, with at most 500"),
    "two bases": (
        ARM.replace("</robot>", LINK.format("x") + "</robot>"),
        "2 links hang on no joint: 'base', 'x'",
    ),
    "two names": (ARM.replace('"l2"', '"l1"'), "two links are named 'l1'"),
    "no name": (ARM.replace('link name="l1"', "link"), "a <link> has no name"),
    "no parent": (ARM.replace('<parent link="base"/>', ""), "joint 'j1': has no parent link"),
    "no such link": (ARM.replace('<child link="l2"/>', '<child link="x"/>'), "joint 'j2': no link 'x'"),
    "a loop": (ARM.replace('<parent link="base"/>', '<parent link="l2"/>'), "hangs on itself"),
    "two parents": (
        ARM.replace(
            "</robot>", LOOSE.format(FIXED, "").replace("l3", "l1", 1).replace(LINK.format("l3"), "")
        ),
        "link 'l1' hangs on the joints 'j1' and 'j3'; expected an arm without closed loops",
    ),
    "planar": (
        ARM.replace("</robot>", LOOSE.format("planar", "")),
        "joint 'j3' is of type 'planar'; expected revolute, continuous, prismatic or fixed",
    ),
    "floating": (ARM.replace("</robot>", LOOSE.format("floating", "")), "joint 'j3' is of type 'floating'"),
    "no type": (ARM.replace('type="revolute"', ""), "joint 'j1' is of type ''"),
    "mimic": (
        ARM.replace("</robot>", LOOSE.format(REVOLUTE, '<mimic joint="j1"/>')),
        "joint 'j3' mimics another one, .*name a tip before it",
    ),
    "branches": (
        ARM.replace("</robot>", LOOSE.format(REVOLUTE, "").replace("l2", "base")),
        "joint 'j3' is not on the way to 'l2': the arm branches; name the link at the end",
    ),
    "no axis": (
        ARM.replace("</robot>", LOOSE.format(REVOLUTE, '<axis xyz="0 0 0"/>')),
        "joint 'j3': its axis is zero",
    ),
    "text for a number": (
        ARM.replace("</robot>", LOOSE.format(REVOLUTE, '<axis xyz="0 0 z"/>')),
        "joint 'j3': xyz='0 0 z'; expected 3 numbers",
    ),
    "too few": (
        ARM.replace("</robot>", LOOSE.format(FIXED, '<origin xyz="0 1"/>')),
        "joint 'j3': xyz='0 1'; expected 3 numbers",
    ),
    "no finite number": (
        ARM.replace('mass value="2.0"', 'mass value="nan"'),
        "link 'base': value='nan'; expected a number",
    ),
    "a negative mass": (ARM.replace('mass value="2.0"', 'mass value="-1"'), "link 'base': a mass of -1 kg"),
    "a friction that drives": (
        ARM.replace("</joint>", '<dynamics damping="-0.1"/></joint>'),
        "joint 'j1': damping -0.1, friction 0; expected none below zero",
    ),
    "no inertia": (
        ARM.replace("</robot>", LOOSE.format(REVOLUTE, "")),
        "mass matrix is not positive definite: joint 'j3' moves no mass; expected links with mass",
    ),
    "an impossible body": (
        ARM.replace('ixx="', 'ixx="-9'),
        "joint 'j2' moves a body that cannot exist",
    ),
}


@pytest.mark.parametrize("case", BAD_TEXTS)
def test_what_is_no_serial_arm_is_refused_in_one_line(case: str, tmp_path: Path) -> None:
    """The line begins with the parameter's name, and names the file, the place and what was expected."""
    text, message = BAD_TEXTS[case]
    with pytest.raises(ParameterError, match=f"^file: .*{message}") as error:
        Urdf(file=write(tmp_path, text))
    assert len(str(error.value)) < 450
    scenario = scenario_text(tmp_path, "arms/arm.urdf")
    write(tmp_path / "arms", text)
    with pytest.raises(ScenarioError, match=r"^mine\.yaml:\d+: robot\.file: "):
        load(scenario)


@pytest.mark.parametrize(
    ("file", "message"),
    [
        ("nowhere.urdf", r"nowhere\.urdf'?: no such file; expected a URDF file"),
        (".", "not a regular file"),
        ("package:nobody_has_this/arm.urdf", "no package 'nobody_has_this' is installed here; pip install"),
        ("package:ftcm_core/no.urdf", r"package 'ftcm_core' has no file 'no\.urdf'"),
        ("package:ftcm_core", "names no file of a package; expected package:NAME/path"),
        ("package:../x/arm.urdf", "names no file of a package"),
        ("a\0b", "cannot be read"),
        ("x" * 5000, "cannot be read: File name too long"),
    ],
)
def test_a_file_that_is_not_there_is_refused_in_one_line(file: str, message: str) -> None:
    """A path, or a package's."""
    with pytest.raises(ParameterError, match=f"^file: .*{message}") as error:
        Urdf(file=file)
    assert len(str(error.value)) < 450


def test_other_refusals(tmp_path: Path) -> None:
    """A link that there is not, lists that do not fit, a file that is too large."""
    file = write(tmp_path, ARM)
    with pytest.raises(ParameterError, match=r"no link 'l3', which tip names; did you mean 'l\d'\?"):
        Urdf(file=file, tip="l3")
    with pytest.raises(ParameterError, match="no joint moves 'base'"):
        Urdf(file=file, tip="base")
    scenario = scenario_text(tmp_path, "arms/arm.urdf")
    message = r"robot\.motor_inertia: \[0\.1\] has 1 entries; expected one per joint \(2\)"
    with pytest.raises(ScenarioError, match=message):
        load(scenario, ["robot.motor_inertia=[0.1]"])
    large = write(tmp_path, ARM + " " * 10_000_000, "large.urdf")
    with pytest.raises(ParameterError, match="larger than 10000000 bytes"):
        Urdf(file=large)


def test_a_joint_without_mass_may_have_a_motor(tmp_path: Path) -> None:
    """Its mass matrix is then positive definite."""
    file = write(tmp_path, ARM.replace("</robot>", LOOSE.format(REVOLUTE, "")))
    assert Urdf(file=file, motor_inertia=[0.0, 0.0, 0.1]).joints == 3


# ---- runs ----


def arm_run(name: str, *overrides: str, controller: str = "ftcm") -> Any:
    """The run of a scenario of a real arm, with its faults after a second."""
    need_arms()
    short = ["duration=1", "transient=0.5", "injection.faults.0.start=0.6", "injection.faults.1.start=0.6"]
    return simulate(load(str(ROOT / "config" / "arms" / f"{name}.yaml"), [*short, *overrides], controller))


@pytest.mark.slow
@pytest.mark.parametrize(("name", "most"), [("ur5", 2.5e-3), ("panda", 6e-3)])
def test_ftcm_holds_a_real_arm_after_its_faults(name: str, most: float) -> None:
    """No joint is off by more than some mrad, at the onset; the law without an estimate by tens of them."""
    held, lost = arm_run(name), arm_run(name, controller="ctc")
    assert (held.status, lost.status) == ("completed", "completed")
    found, other = evaluate(held)["after_fault"], evaluate(lost)["after_fault"]
    assert found is not None
    assert other is not None
    assert max(found["max_abs_error"]) < most
    assert max(other["max_abs_error"]) > 50.0 * most
    assert np.abs(held.error[-1]).max() < 2e-3


@pytest.mark.parametrize("name", ["ur5", "panda"])
def test_limits_of_the_arms_scenarios_are_those_of_their_files(name: str) -> None:
    """Torques and speeds, and positions where the scenario has them."""
    need_arms()
    scenario = load(str(ROOT / "config" / "arms" / f"{name}.yaml"))
    assert isinstance(scenario.robot, Urdf)
    joints, limits = scenario.robot.arm.joints, scenario.limits
    assert limits.torque == tuple(x.effort for x in joints)
    assert limits.velocity == tuple(x.velocity for x in joints)
    if limits.lower is not None:
        assert limits.lower == tuple(x.lower for x in joints)
        assert limits.upper == tuple(x.upper for x in joints)


def made_up_scenario(folder: Path, name: str, **more: Any) -> Any:
    """An arm with motors follows slow sines; a quarter of the torque of joint 1 is lost after 0.1 s."""
    robot = made_up(folder, name, motor_inertia=0.5)
    fault = {"type": "loss_of_effectiveness", "joint": 1, "loss": 0.25, "start": 0.1}
    return from_mapping(
        {
            "robot": robot.to_mapping(), "controller": "ftcm", "observer": "do", "duration": 0.4,
            "reference": {"type": "sine", "amplitude": 0.3, "frequency": 0.5}, "transient": 0.1,
            "injection": {"faults": [fault]}, **more,
        }
    )  # fmt: skip


@pytest.mark.parametrize("name", ["gantry", "six", "seven"])
def test_ftcm_holds_any_arm_after_a_fault(name: str, tmp_path: Path) -> None:
    """Gains are those of the PUMA 560: the laws command accelerations."""
    trace = simulate(made_up_scenario(tmp_path, name))
    assert trace.status == "completed"
    assert np.abs(trace.error[300:]).max() < 1e-3


@pytest.mark.parametrize("name", ["gantry", "seven"])
def test_what_is_written_for_an_arm_is_the_plain_tick(name: str, tmp_path: Path) -> None:
    """Bit for bit, joints that slide too."""
    scenario = made_up_scenario(tmp_path, name)
    loop, other = Loop(scenario), Loop(scenario)
    for k in range(3):
        assert not any(x.tick(k * scenario.dt_ns, False, lambda row: None) for x in (loop, other))
    written_as_plain(loop, other, 3, 20)


@pytest.mark.slow
def test_a_compiled_run_of_an_arm_is_the_plain_run(tmp_path: Path) -> None:
    """But for the rounding of single operations; a payload is picked up on the way."""
    pytest.importorskip("numba", reason="numba is not installed")
    pickup = {"type": "payload_pickup", "mass": 1.0, "start": 0.2}
    scenario = made_up_scenario(tmp_path, "scara", injection={"faults": [pickup]})
    plain, trace = simulate(scenario), compiled.simulate(scenario)
    assert (plain.status, trace.status) == ("completed", "completed")
    assert np.abs(trace.position - plain.position).max() < 1e-12
    assert np.abs(plain.command[210] - plain.command[190]).max() > 1.0, "the payload matters"


# ---- the page ----


def test_the_gains_by_rule_of_the_page() -> None:
    """Its code runs; pid, adrc and tdc follow with them on the PUMA 560 of the file."""
    page = (ROOT / "docs" / "arms.md").read_text("utf-8")
    code = page.partition("```python\n")[2].partition("```")[0]
    gains: dict[str, Any] = {"PUMA": PUMA}
    exec(code.replace('Urdf(file="my_arm.urdf", tip="tool0")', "PUMA"), gains)
    least, mean, safe = gains["least"], gains["mean"], gains["safe"]
    assert all(np.linalg.eigvalsh(m - np.diag(safe))[0] > 0.0 for m in gains["matrices"])
    assert (safe < least).all()
    for law in (
        {"type": "pid", "kp": (100 * mean).tolist(), "kd": (20 * mean).tolist(), "ki": (100 * mean).tolist()},
        {"type": "adrc", "b0": (1 / mean).tolist()},
        {"type": "tdc", "m_bar": safe.tolist()},
    ):
        trace = simulate(
            from_mapping(
                {
                    "robot": PUMA.to_mapping(), "reference": {"type": "sine", "amplitude": 0.3},
                    "observer": "none", "controller": law, "duration": 1.5,
                }
            )
        )  # fmt: skip
        assert trace.status == "completed"
        assert np.abs(trace.error[-1]).max() < 0.02


def test_friction_that_is_too_stiff_for_the_step_is_told(tmp_path: Path) -> None:
    """A light joint with Coulomb friction: one step per tick makes a motion that ten do not have."""
    arm = {"type": "urdf", "file": write(tmp_path, arm_text([REVOLUTE] * 3, 7)), "motor_inertia": 0.002}
    data = {
        "robot": arm, "controller": "ctc", "observer": "do", "duration": 0.05,
        "reference": {"type": "sine", "amplitude": 0.1, "frequency": 0.5}, "initial_state": {"position": 0.0},
        "plant": {"robot": {"coulomb_friction": 3.0, "slip_velocity": 0.005}},
    }  # fmt: skip

    def warned(**plant: Any) -> list[str]:
        return from_mapping({**data, "plant": {**data["plant"], **plant}}).warnings()

    lines = warned()
    assert lines
    assert all("is too stiff for the step: rk4 follows a decay of up to 2.78 per step" in x for x in lines)
    (least,) = {int(x.rsplit("plant.substeps to ", 1)[1].split()[0]) for x in lines[-1:]}
    assert not [x for x in warned(substeps=200) if "stiff" in x]
    assert not [x for x in warned(robot={"coulomb_friction": 3.0, "slip_velocity": 5.0}) if "stiff" in x]
    assert least > 1
    fine, coarse = (
        simulate(from_mapping({**data, "plant": {**data["plant"], "substeps": n}})) for n in (40, 1)
    )
    right = simulate(from_mapping({**data, "plant": {**data["plant"], "substeps": 80}}))
    off = [np.abs(t.velocity - right.velocity).max() for t in (fine, coarse)]
    assert off[0] < 0.1 * off[1]
