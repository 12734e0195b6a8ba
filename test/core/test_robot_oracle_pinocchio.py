# SPDX-License-Identifier: Apache-2.0
"""PUMA 560 against Pinocchio: a rigid-body model built from the link data, joints 4 to 6 locked."""

from __future__ import annotations

import itertools
import sys
from pathlib import Path

import numpy as np
import pytest

from ftcm_core.robots import puma560

sys.path.insert(0, str(Path(__file__).parents[1] / "reference"))
import puma560_matrix as links
import puma560_refit

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


def physical(constants: dict[str, float]) -> dict[str, float]:
    """Constants with the motor inertias taken out of the lumped ones, as Armstrong prints them."""
    c = dict(constants)
    i6 = c.pop("M23_CONSTANT")  # I6 + 2 I15
    i1, i2 = c.pop("M11_CONSTANT") - puma560.IM1, c.pop("M22_CONSTANT") - puma560.IM2 - i6
    return c | {"I1": i1, "I2": i2, "I6": i6, "IM3": c.pop("M33") - i6}


def test_closed_form_is_recursive_newton_euler(monkeypatch: pytest.MonkeyPatch) -> None:
    """Same structure; with the constants refitted, the same torques and accelerations."""
    puma560_refit.check(Oracle(), monkeypatch)


def test_printed_constants_are_near_the_link_data() -> None:
    """I1 and I3 are printed 7.9 % and 13.9 % below what Armstrong's link data give, the rest within 0.5 %."""
    constants, _ = puma560_refit.refit(Oracle())
    fitted, printed = physical(constants), physical({name: getattr(puma560, name) for name in constants})
    off = {name: printed[name] / fitted[name] - 1.0 for name in fitted}
    assert off.pop("I1") == pytest.approx(-0.0794, abs=1e-4)
    assert off.pop("I3") == pytest.approx(-0.1385, abs=1e-4)
    assert max(map(abs, off.values())) < 0.005


def test_printed_mass_matrix_is_near_the_link_data() -> None:
    """‖ΔM‖/‖M‖ of the link data is 4.8 % at worst (Frobenius; grid of q2, q3, as q1 does not matter)."""
    oracle, robot, worst = Oracle(), puma560.Puma560(), 0.0
    for q2, q3 in itertools.product(np.linspace(-np.pi, np.pi, 41), repeat=2):
        exact = oracle.mass_matrix(np.array([0.0, q2, q3]))
        error = np.linalg.norm(robot.mass_matrix((0.0, q2, q3)) - exact)
        worst = max(worst, float(error / np.linalg.norm(exact)))
    assert worst == pytest.approx(0.048, abs=5e-4)
