# SPDX-License-Identifier: Apache-2.0
"""PUMA 560 against MuJoCo: an MJCF model written from the link data, joints 4 to 6 left out (locked)."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import pytest

from ftcm_core.robots.puma560 import Puma560

sys.path.insert(0, str(Path(__file__).parents[1] / "reference"))
import puma560_matrix as links
import puma560_refit

mujoco = pytest.importorskip("mujoco", reason="the oracle is MuJoCo (pip install mujoco)")
pytestmark = pytest.mark.oracle


def mjcf() -> str:
    """Write the chain of links; no damping, no contacts. Masses and inertias are place holders."""
    bodies = ""
    for link in range(links.LINKS):
        bodies += '<body pos="{} {} {}" '.format(*links.link_placement(link)[1])
        bodies += f'euler="{links.ALPHA[link]} 0 0">'
        bodies += '<inertial pos="{} {} {}" mass="1" diaginertia="1 1 1"/>'.format(*links.CENTRE[link])
        if link < links.JOINTS:
            bodies += f'<joint axis="0 0 1" armature="{links.MOTOR_INERTIA[link]}"/>'
    return (
        f'<mujoco><compiler angle="radian"/><option gravity="0 0 {-links.GRAVITY}"/>'
        f"<worldbody>{bodies}{'</body>' * links.LINKS}</worldbody></mujoco>"
    )


class Oracle:
    """MuJoCo's smooth dynamics of the model."""

    def __init__(self) -> None:
        """Compile, then set what the compiler refuses: a massless link 1, and Ixx + Iyy < Izz of link 3."""
        self.model = mujoco.MjModel.from_xml_string(mjcf())
        self.data = mujoco.MjData(self.model)
        self.model.body_mass[1:] = links.MASS
        self.model.body_inertia[1:] = links.INERTIA
        mujoco.mj_setConst(self.model, self.data)

    def inverse_dynamics(self, q: np.ndarray, v: np.ndarray, a: np.ndarray) -> np.ndarray:
        """Torque, N·m."""
        self.data.qpos, self.data.qvel, self.data.qacc = q, v, a
        mujoco.mj_inverse(self.model, self.data)
        return self.data.qfrc_inverse.copy()

    def gravity(self, q: np.ndarray) -> np.ndarray:
        """Bias torque at rest, N·m."""
        self.data.qpos, self.data.qvel = q, np.zeros(3)
        mujoco.mj_forward(self.model, self.data)
        return self.data.qfrc_bias.copy()

    def mass_matrix(self, q: np.ndarray) -> np.ndarray:
        """Inertia matrix with the motors', kg·m², by columns: mj_fullM differs between versions."""
        self.data.qpos = q
        mujoco.mj_forward(self.model, self.data)
        columns = np.zeros((3, 3))
        for column, unit in zip(columns, np.eye(3), strict=True):
            mujoco.mj_mulM(self.model, self.data, column, unit)
        return columns.T

    def tip_torque(self, q: np.ndarray, force: np.ndarray, distance: float) -> np.ndarray:
        """Jᵀ F, N·m, at a distance (m) from the centre of the wrist along the axis of the hand."""
        self.data.qpos, self.data.qvel = q, np.zeros(3)
        mujoco.mj_forward(self.model, self.data)
        hand, jacobian = self.model.nbody - 1, np.zeros((3, 3))
        tip = self.data.xpos[hand] + self.data.xmat[hand].reshape(3, 3) @ [0.0, 0.0, distance]
        mujoco.mj_jac(self.model, self.data, jacobian, None, tip, hand)
        return jacobian.T @ force


def test_closed_form_is_mujocos_dynamics() -> None:
    """Same structure; with the constants refitted, the same torques and accelerations."""
    puma560_refit.check(Oracle())


def test_a_force_at_the_tip_is_mujocos() -> None:
    """The Jacobian of the tip, transposed, at 50 positions."""
    robot, oracle = Puma560(payload_distance=0.3), Oracle()
    for q, force in np.random.default_rng(7).uniform(-np.pi, np.pi, (50, 2, 3)):
        torque = robot.tip_torque(tuple(q.tolist()), tuple(force.tolist()))
        assert torque == pytest.approx(oracle.tip_torque(q, force, 0.3), abs=1e-12)
