# SPDX-License-Identifier: Apache-2.0
"""Made-up arms as URDF texts, and the arms of the package example-robot-data, for tests."""

from __future__ import annotations

from collections.abc import Sequence
from importlib import metadata
from typing import Any

import numpy as np
import pytest

DATA = "example-robot-data"
UR5: dict[str, Any] = {"file": f"package:{DATA}/ur_description/urdf/ur5_robot.urdf"}
PANDA: dict[str, Any] = {"file": f"package:{DATA}/panda_description/urdf/panda.urdf", "tip": "panda_hand_tcp"}


def need_arms() -> None:
    """Skip the test where the arms are not installed."""
    try:
        metadata.distribution(DATA)
    except metadata.PackageNotFoundError:
        pytest.skip(f"the URDF files of real arms are not installed (pip install {DATA})")


def link(name: str, rng: np.random.Generator, mass: float = 2.0) -> str:
    """A link of any mass, centre and inertia that a body can have."""
    points = rng.uniform(-0.2, 0.2, (4, 3))  # it is four point masses
    rotation = " ".join(map(repr, rng.uniform(-3, 3, 3).tolist()))
    inertia = sum(0.25 * mass * (p @ p * np.eye(3) - np.outer(p, p)) for p in points)
    entries = zip(("xx", "xy", "xz", "yy", "yz", "zz"), inertia[np.triu_indices(3)].tolist())
    tensor = " ".join(f'i{x}="{value!r}"' for x, value in entries)
    xyz = " ".join(map(repr, rng.uniform(-0.1, 0.1, 3).tolist()))
    return (
        f'<link name="{name}"><inertial><mass value="{mass}"/><origin xyz="{xyz}" rpy="{rotation}"/>'
        f"<inertia {tensor}/></inertial></link>"
    )


def joint(
    name: str, kind: str, parent: str, child: str, rng: np.random.Generator, more: str = "", **given: str
) -> str:
    """A joint anywhere, about any axis, unless it is given."""
    values = {
        key: " ".join(map(repr, rng.uniform(-most, most, 3).tolist()))
        for key, most in (("xyz", 0.4), ("rpy", 3.0), ("axis", 1.0))
    } | given
    return (
        f'<joint name="{name}" type="{kind}"><parent link="{parent}"/><child link="{child}"/>'
        f'<origin xyz="{values["xyz"]}" rpy="{values["rpy"]}"/><axis xyz="{values["axis"]}"/>'
        f'<limit lower="-3" upper="3" effort="50" velocity="2"/>{more}</joint>'
    )


def arm_text(kinds: Sequence[str], seed: int, more: Sequence[str] = (), **given: Any) -> str:
    """A chain base, l1, l2, ... of joints j1, j2, ..., and further tags.

    Args:
        kinds: types of the joints, fixed ones too.
        seed: of its numbers.
        more: further links and joints.
        **given: as of :func:`joint`, of all joints.
    """
    rng = np.random.default_rng(seed)
    names = ["base", *[f"l{i + 1}" for i in range(len(kinds))]]
    tags = [link(name, rng) for name in names]
    tags += [joint(f"j{i + 1}", kind, names[i], names[i + 1], rng, **given) for i, kind in enumerate(kinds)]
    return f'<robot name="arm">{"".join([*tags, *more])}</robot>'
