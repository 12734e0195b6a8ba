# SPDX-License-Identifier: Apache-2.0
"""PUMA 560 against Pinocchio: a rigid-body model built from the link data, joints 4 to 6 locked."""

from __future__ import annotations

import importlib
import itertools
import sys
from pathlib import Path

import numpy as np
import pytest

from ftcm_core.params import per_joint
from ftcm_core.robots import puma560
from ftcm_core.robots.puma560 import Puma560
from plugins import ROBOTS

sys.path.insert(0, str(Path(__file__).parents[1] / "reference"))
import puma560_matrix as links
import puma560_refit
from robot_matrices import mass_matrix

pin = pytest.importorskip("pinocchio", reason="the oracle is Pinocchio (pip install pin)")
pytestmark = pytest.mark.oracle


class Oracle:
    """Pinocchio's algorithms on the model."""

    def __init__(self) -> None:
        """Six revolute joints in modified DH frames, of which the last three are then locked."""
        full, parent = pin.Model(), 0
        for link in range(links.LINKS):
            placement = pin.SE3(*links.link_placement(link))
            parent = full.addJoint(parent, pin.JointModelRZ(), placement, f"joint{link + 1}")
            full.addJointFrame(parent)
            body = pin.Inertia(links.MASS[link], links.CENTRE[link], np.diag(links.INERTIA[link]))
            full.appendBodyToJoint(parent, body, pin.SE3.Identity())
        self.model = pin.buildReducedModel(full, [4, 5, 6], np.zeros(6))
        self.model.armature = links.MOTOR_INERTIA
        self.model.gravity.linear = np.array([0.0, 0.0, -links.GRAVITY])
        self.data = self.model.createData()

    def inverse_dynamics(self, q: np.ndarray, v: np.ndarray, a: np.ndarray) -> np.ndarray:
        """Recursive Newton-Euler, N·m."""
        return pin.rnea(self.model, self.data, q, v, a).copy()

    def mass_matrix(self, q: np.ndarray) -> np.ndarray:
        """Composite rigid bodies, kg·m²."""
        return pin.crba(self.model, self.data, q).copy()

    def gravity(self, q: np.ndarray) -> np.ndarray:
        """Generalised gravity, N·m."""
        return pin.computeGeneralizedGravity(self.model, self.data, q).copy()

    def tip_torque(self, q: np.ndarray, force: np.ndarray, distance: float) -> np.ndarray:
        """Jᵀ F, N·m, at a distance (m) from the centre of the wrist along the axis of the hand."""
        hand = self.model.getFrameId("joint6")
        jacobian = pin.computeFrameJacobian(self.model, self.data, q, hand, pin.LOCAL_WORLD_ALIGNED)
        lever = pin.updateFramePlacement(self.model, self.data, hand).rotation @ [0.0, 0.0, distance]
        return jacobian.T @ np.concatenate([force, np.cross(lever, force)])


class Oracle3:
    """Three links from the robot's own parameters, the payload a point mass in the frame of the hand."""

    def __init__(self, robot: Puma560) -> None:
        """Links 4 to 6 weigh nothing; the hand's z axis is the wrist's axis."""
        full, parent = pin.Model(), 0
        values = {name: per_joint(value, 3) for name, value in robot.values.items()}
        for link in range(links.LINKS):
            placement = pin.SE3(*links.link_placement(link))
            parent = full.addJoint(parent, pin.JointModelRZ(), placement, f"joint{link + 1}")
            full.addJointFrame(parent)
            if link < 3:
                centre = np.array([values[f"centre_{x}"][link] for x in "xyz"])
                inertia = np.diag([values[f"inertia_{x}{x}"][link] for x in "xyz"])
                full.appendBodyToJoint(
                    parent, pin.Inertia(values["mass"][link], centre, inertia), pin.SE3.Identity()
                )
        tip = np.array([0.0, 0.0, robot.payload_distance])
        load = pin.Inertia(robot.payload_mass, tip, np.zeros((3, 3)))
        full.appendBodyToJoint(parent, load, pin.SE3.Identity())
        self.model = pin.buildReducedModel(full, [4, 5, 6], np.zeros(6))
        self.model.armature = np.array(values["motor_inertia"])
        self.model.gravity.linear = np.array([0.0, 0.0, -robot.gravity_acceleration])
        self.data = self.model.createData()

    def torque(self, q: np.ndarray, v: np.ndarray, a: np.ndarray) -> np.ndarray:
        """Recursive Newton-Euler, N·m."""
        return pin.rnea(self.model, self.data, q, v, a).copy()


CHANGES: list[dict[str, object]] = [
    {"mass": [0.0, 20.0, 6.05]},
    {"mass": [0.0, 17.4, 9.0]},
    {"mass": [13.0, 17.4, 6.05], "centre_x": [0.1, 0.068, -0.004194], "centre_y": [-0.2, 0.006, -0.142921]},
    {"centre_x": [0.0, 0.2, 0.1]},
    {"centre_y": [0.0, 0.1, -0.3]},
    {"centre_z": [0.0, 0.1, -0.1]},
    {"inertia_xx": [0.0, 0.3, 0.3]},
    {"inertia_yy": [0.0, 0.7, 0.1]},
    {"inertia_zz": [0.9, 0.7, 0.4]},
    {"motor_inertia": [2.0, 3.0, 1.0]},
    {"payload_mass": 2.5},
    {"payload_mass": 1.5, "payload_distance": 0.4},
    {"mass": [5.0, 12.0, 8.0], "centre_x": [0.0, 0.15, 0.05], "centre_y": [0.1, -0.05, -0.2],
     "centre_z": [0.2, 0.05, 0.03], "inertia_xx": [0.1, 0.2, 0.3], "inertia_yy": [0.2, 0.6, 0.2],
     "inertia_zz": [0.5, 0.6, 0.3], "motor_inertia": [1.0, 5.0, 0.7], "payload_mass": 2.0},
]  # fmt: skip


@pytest.mark.parametrize("change", CHANGES, ids=lambda change: " ".join(change))
def test_other_links_make_the_difference_that_they_make_in_pinocchio(change: dict[str, object]) -> None:
    """What is printed stays; torques at 50 states differ from the default's by what the links differ."""
    default, robot = Puma560(), Puma560(**change)
    before, after = Oracle3(default), Oracle3(robot)
    scale, largest = np.array([[np.pi], [5.0], [20.0]]), 0.0
    for sample in np.random.default_rng(7).uniform(-scale, scale, (50, 3, 3)):
        state = [tuple(x) for x in sample.tolist()]
        found = np.subtract(robot.inverse_dynamics(*state), default.inverse_dynamics(*state))
        expected = after.torque(*sample) - before.torque(*sample)
        assert found == pytest.approx(expected, abs=1e-10)
        largest = max(largest, float(np.abs(expected).max()))
    assert largest > 0.5, "the change is one that matters"


def test_gravity_scales_the_printed_gravity_and_that_of_other_links() -> None:
    """The links' share of it is Pinocchio's at that acceleration of gravity."""
    q, rest = (0.3, -0.4, 0.7), np.zeros(3)
    moon, loaded = Puma560(gravity_acceleration=1.62), Puma560(gravity_acceleration=1.62, payload_mass=2.0)
    expected = Oracle3(loaded).torque(np.array(q), rest, rest) - Oracle3(moon).torque(np.array(q), rest, rest)
    assert np.subtract(loaded.gravity(q), moon.gravity(q)) == pytest.approx(expected, abs=1e-12)


def physical(coefficients: dict[str, float]) -> dict[str, float]:
    """Coefficients with the motor inertias taken out of the constant ones, as Armstrong prints them."""
    c, (im1, im2, _) = dict(coefficients), puma560.Puma560().motor_inertia
    i6 = c.pop("m23")  # I6 + 2 I15
    i1, i2 = c.pop("m11") - im1, c.pop("m22") - im2 - i6
    return c | {"i1": i1, "i2": i2, "i6": i6, "im3": c.pop("m33") - i6}


def test_closed_form_is_recursive_newton_euler() -> None:
    """Same structure; with the coefficients refitted, the same torques and accelerations."""
    puma560_refit.check(Oracle())


def test_a_force_at_the_tip_is_pinocchios() -> None:
    """The Jacobian of the tip, transposed, at 50 positions."""
    robot, oracle = Puma560(payload_distance=0.3), Oracle()
    for q, force in np.random.default_rng(7).uniform(-np.pi, np.pi, (50, 2, 3)):
        torque = robot.tip_torque(tuple(q.tolist()), tuple(force.tolist()))
        assert torque == pytest.approx(oracle.tip_torque(q, force, 0.3), abs=1e-12)


def test_printed_constants_are_near_the_link_data() -> None:
    """I1 and I3 are printed 7.9 % and 13.9 % below what Armstrong's link data give, the rest within 0.5 %."""
    coefficients, _ = puma560_refit.refit(Oracle())
    own = dict(zip(puma560_refit.COEFFICIENTS, puma560.Puma560().coefficients))
    fitted, printed = physical(coefficients), physical(own)
    off = {name: printed[name] / fitted[name] - 1.0 for name in fitted}
    assert off.pop("i1") == pytest.approx(-0.0794, abs=1e-4)
    assert off.pop("i3") == pytest.approx(-0.1385, abs=1e-4)
    assert max(map(abs, off.values())) < 0.005


def test_printed_mass_matrix_is_near_the_link_data() -> None:
    """‖ΔM‖/‖M‖ of the link data is 4.8 % at worst (Frobenius; grid of q2, q3, as q1 does not matter)."""
    oracle, robot, worst = Oracle(), puma560.Puma560(), 0.0
    for q2, q3 in itertools.product(np.linspace(-np.pi, np.pi, 41), repeat=2):
        exact = oracle.mass_matrix(np.array([0.0, q2, q3]))
        error = np.linalg.norm(mass_matrix(robot, (0.0, float(q2), float(q3))) - exact)
        worst = max(worst, float(error / np.linalg.norm(exact)))
    assert worst == pytest.approx(0.048, abs=5e-4)


def test_the_six_joint_arm_of_the_tests_is_a_rigid_body() -> None:
    """Its recursive Newton-Euler, and what the base class makes of it, against Pinocchio's own algorithms."""
    arm = ROBOTS["serial_arm"]
    data = importlib.import_module(type(arm).__module__)
    model, parent = pin.Model(), 0
    for joint, (ca, sa) in enumerate(data.TURNS):
        turn = np.array([[1, 0, 0], [0, ca, -sa], [0, sa, ca]])
        offset = np.array([data.A[joint], -sa * data.D[joint], ca * data.D[joint]])
        parent = model.addJoint(parent, pin.JointModelRZ(), pin.SE3(turn, offset), f"joint{joint + 1}")
        inertia = np.diag(data.INERTIA[joint])
        body = pin.Inertia(arm.mass[joint], np.array(data.CENTRE[joint]), inertia)
        model.appendBodyToJoint(parent, body, pin.SE3.Identity())
    model.armature = np.array(arm.motor_inertia)
    model.gravity.linear = np.array([0.0, 0.0, -data.GRAVITY])
    oracle = model.createData()
    scale = np.array([[np.pi], [5.0], [20.0]])
    for sample in np.random.default_rng(7).uniform(-scale, scale, (50, 3, 6)):
        q, v, a = (tuple(x) for x in sample.tolist())
        torque = pin.rnea(model, oracle, *sample).copy()
        assert arm.inverse_dynamics(q, v, a) == pytest.approx(torque, abs=1e-9)
        assert arm.forward_dynamics(q, v, tuple(torque.tolist())) == pytest.approx(a, abs=1e-8)
        assert arm.gravity(q) == pytest.approx(
            pin.computeGeneralizedGravity(model, oracle, sample[0]), abs=1e-9
        )


def test_the_planar_arm_of_the_tests_is_a_rigid_body() -> None:
    """Its closed form: two point masses, the joints about a horizontal axis."""
    arm = ROBOTS["planar_arm"]
    model, parent, offset = pin.Model(), 0, 0.0
    for joint, (m, length) in enumerate(zip(arm.mass, arm.length, strict=True)):
        place = pin.SE3(np.eye(3), np.array([offset, 0.0, 0.0]))
        parent = model.addJoint(parent, pin.JointModelRZ(), place, f"joint{joint + 1}")
        mass = pin.Inertia(m, np.array([length, 0.0, 0.0]), np.zeros((3, 3)))
        model.appendBodyToJoint(parent, mass, pin.SE3.Identity())
        offset = length
    model.armature = np.full(2, arm.motor_inertia)
    model.gravity.linear = np.array([0.0, -9.81, 0.0])
    oracle, scale = model.createData(), np.array([[np.pi], [5.0], [20.0]])
    for sample in np.random.default_rng(7).uniform(-scale, scale, (50, 3, 2)):
        q, v, a = (tuple(x) for x in sample.tolist())
        torque = pin.rnea(model, oracle, *sample).copy()
        assert arm.inverse_dynamics(q, v, a) == pytest.approx(torque, abs=1e-10)
        assert arm.forward_dynamics(q, v, tuple(torque.tolist())) == pytest.approx(a, abs=1e-10)
