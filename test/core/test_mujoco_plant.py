# SPDX-License-Identifier: Apache-2.0
"""MuJoCo as the plant: the same mechanics as the robot's, what it adds to them, and what is refused."""

from __future__ import annotations

import math
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

pytest.importorskip("mujoco", reason="the plant is MuJoCo's (pip install mujoco)")

from ftcm_core import compiled
from ftcm_core.errors import ParameterError, ScenarioError
from ftcm_core.plants.mujoco import Mujoco
from ftcm_core.plants.rigid_body import RigidBody
from ftcm_core.recording.metrics import evaluate
from ftcm_core.recording.provenance import provenance
from ftcm_core.robots.puma560 import Puma560
from ftcm_core.robots.urdf import Urdf
from ftcm_core.scenario import load
from ftcm_core.simulation import simulate
from urdf_arms import arm_text

pytestmark = pytest.mark.pure

DT = 1e-3
MOTORS = "[1.14, 4.71, 0.83]"
PAPER = f"robot={{type: urdf, motor_inertia: {MOTORS}}}"
PENDULUM = """
<robot name="pendulum"><link name="base"/><link name="bob"><inertial><origin xyz="0 0 -0.5"/>
<mass value="2"/><inertia ixx="0.01" iyy="0.01" izz="0.01" ixy="0" ixz="0" iyz="0"/></inertial></link>
<joint name="swing" type="revolute"><parent link="base"/><child link="bob"/><axis xyz="0 1 0"/>
<dynamics damping="{damping}" friction="{friction}"/><limit lower="-1" upper="{upper}" effort="9"/></joint>
</robot>
"""
TABLE = """
<mujoco><option gravity="0 0 -9.81"/><worldbody>
<geom type="plane" size="2 2 0.1" pos="0 0 -0.6"/>
<body name="bob"><joint name="swing" axis="0 1 0"/><geom type="sphere" size="0.05" pos="0 0 -0.5" mass="2"/>
</body>
<body name="box" pos="0.3 0 -0.5"><freejoint name="floats"/><geom type="box" size="0.1 0.1 0.1" mass="0.5"/>
</body></worldbody>
<actuator><position joint="swing" kp="1000"/></actuator></mujoco>
"""


def written(folder: Path, text: str, name: str) -> str:
    (folder / name).write_text(text, encoding="utf-8")
    return str(folder / name)


def pendulum(folder: Path, damping: float = 0.0, friction: float = 0.0, upper: float = 3.0) -> Urdf:
    text = PENDULUM.format(damping=damping, friction=friction, upper=upper)
    return Urdf(file=written(folder, text, "pendulum.urdf"))


def moved(plant: Any, robot: Any, q: Any, v: Any, torque: Any, ticks: int) -> tuple[Any, Any]:
    """Motion after so many ticks under one torque."""
    state = plant.init(robot, q, v)
    for _ in range(ticks):
        state = plant.step(robot, DT, torque, state)
    return plant.motion(state)


@pytest.mark.parametrize(
    "kinds",
    [
        ["revolute"],
        ["prismatic", "revolute"],
        ["revolute", "fixed", "prismatic", "continuous"],
        ["revolute"] * 7,
    ],
    ids=lambda kinds: " ".join(kinds),
)
@pytest.mark.parametrize("payload", [0.0, 1.5])
def test_the_same_mechanics_as_the_robots_own(tmp_path: Path, kinds: list[str], payload: float) -> None:
    """Two implementations of one arm, 100 ticks under torque, no dry friction: rounding apart."""
    n = len([k for k in kinds if k != "fixed"])
    arm = Urdf(
        file=written(tmp_path, arm_text(kinds, 11), "arm.urdf"),
        motor_inertia=0.3, viscous_friction=0.2, coulomb_friction=0.0,
        payload_mass=payload, payload_distance=0.1,
    )  # fmt: skip
    rng = np.random.default_rng(n)
    q, v, torque = (tuple(x) for x in rng.uniform(-1.0, 1.0, (3, n)).tolist())
    ours = moved(RigidBody(), arm, q, v, torque, 100)
    theirs = moved(Mujoco(joint_stops=False), arm, q, v, torque, 100)
    assert np.ptp(ours[0]) > 1e-3 or n == 1
    assert theirs == (pytest.approx(ours[0], abs=1e-10), pytest.approx(ours[1], abs=1e-9))


def test_a_step_is_a_function_of_its_state(tmp_path: Path) -> None:
    """Stepping one state does not change another, nor how often it is asked."""
    plant, robot = Mujoco(file=written(tmp_path, TABLE, "table.xml")), pendulum(tmp_path)
    first = plant.init(robot, (1.2,), (0.0,))
    states = [first]
    for _ in range(600):
        states.append(plant.step(robot, DT, (0.0,), states[-1]))
    again = plant.step(robot, DT, (0.0,), states[500])
    assert plant.motion(first) == ((1.2,), (0.0,))
    assert plant.motion(again) == plant.motion(states[501])
    assert np.array_equal(again.values, states[501].values)
    assert np.array_equal(Mujoco(file=plant.file).init(robot, (1.2,), (0.0,)).values, first.values)


def test_dry_friction_is_the_solvers(tmp_path: Path) -> None:
    """2 N·m of friction under 1 N·m of weight, 1 s: tanh creeps 5 mrad, the solver's, also softened, 2."""
    robot, angle = pendulum(tmp_path, friction=2.0), math.asin(1.0 / (2.0 * 9.81 * 0.5))
    (smooth,), _ = moved(RigidBody(), robot, (angle,), (0.0,), (0.0,), 1000)
    (dry,), _ = moved(Mujoco(integrator="implicitfast"), robot, (angle,), (0.0,), (0.0,), 1000)
    assert abs(smooth - angle) > 3e-3
    assert abs(dry - angle) < 0.5 * abs(smooth - angle)


def test_joints_stop_at_their_ends(tmp_path: Path) -> None:
    """Pushed with 20 N·m, of which its weight takes less than half, against the end at 0.5 rad."""
    robot = pendulum(tmp_path, damping=1.0, upper=0.5)
    (held,), _ = moved(Mujoco(), robot, (0.0,), (0.0,), (-20.0,), 1000)
    (pushed,), _ = moved(Mujoco(), robot, (0.0,), (0.0,), (20.0,), 1000)
    (free,), _ = moved(Mujoco(joint_stops=False), robot, (0.0,), (0.0,), (20.0,), 1000)
    assert pushed == pytest.approx(0.5, abs=0.02)
    assert held == pytest.approx(-1.0, abs=0.02)
    assert free > 1.5


def test_what_a_model_file_has_besides_the_arm_moves_too(tmp_path: Path) -> None:
    """The bob swings into a box and pushes it away; the file's own position drive does nothing."""
    plant, robot = Mujoco(file=written(tmp_path, TABLE, "table.xml")), pendulum(tmp_path)
    nothing = moved(plant, robot, (0.0,), (0.0,), (0.0,), 100)
    assert nothing == ((0.0,), (0.0,))
    state = plant.init(robot, (0.9,), (0.0,))  # held off the box by nothing: it falls towards it
    box = slice(2, 5)  # behind the time and the swing
    before = state.values[box].copy()
    for _ in range(800):
        state = plant.step(robot, DT, (0.0,), state)
    assert np.linalg.norm(state.values[box] - before) > 0.02
    alone = moved(Mujoco(), robot, (0.9,), (0.0,), (0.0,), 800)
    assert abs(plant.motion(state)[0][0] - alone[0][0]) > 0.05


def test_the_plants_own_friction_stays_when_another_engine_is_chosen() -> None:
    """What the true robot has besides is not a parameter of the engine."""
    given = "plant={robot: {coulomb_friction: 3.0, viscous_friction: 2.0}}"
    scenario = load("paper", [PAPER, given, "plant.type=mujoco"])
    assert scenario.plant == Mujoco()
    assert isinstance(scenario.robot, Urdf)
    assert isinstance(scenario.model, Urdf)
    assert scenario.robot.chain().coulomb == (3.0,) * 3
    assert scenario.model.chain().coulomb == (0.0,) * 3
    compiled_model = scenario.plant._simulator(scenario.robot).model
    assert compiled_model.dof_frictionloss.tolist() == [3.0] * 3
    assert compiled_model.dof_damping.tolist() == [2.0] * 3


def test_a_payload_picked_up_is_felt_as_by_the_robots_own() -> None:
    """The model is made anew when a fault changes the robot."""
    fault = "injection.faults=[{type: payload_pickup, mass: 3.0, start: 0.2}]"
    other = [PAPER, "duration=0.5", "injection.disturbances=[]"]
    ours, without = (
        simulate(load("paper", [*other, fault])),
        simulate(load("paper", [*other, "injection.faults=[]"])),
    )
    theirs = simulate(load("paper", [*other, fault, "plant.type=mujoco"]))
    assert np.abs(ours.position - without.position).max() > 1e-5
    assert np.abs(theirs.position - ours.position).max() < 1e-9


def test_the_papers_run_with_its_fault_on_mujoco() -> None:
    """4 s across the fault: the laws see the same robot, so the errors are those of our own engine."""
    settings = [PAPER, "duration=4", "injection.faults.0.start=2"]
    ours, theirs = (simulate(load("paper", [*settings, f"plant.type={x}"])) for x in ("rigid_body", "mujoco"))
    assert theirs.status == "completed"
    assert np.abs(ours.disturbance[-1]).max() > 5.0
    found, expected = (evaluate(x)["after_fault"] for x in (theirs, ours))
    assert found is not None
    assert expected is not None
    assert found["max_abs_error"] == pytest.approx(expected["max_abs_error"], rel=1e-3)


def test_a_run_that_diverges_ends_as_any_other(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """MuJoCo neither begins anew by itself nor leaves a log file behind."""
    monkeypatch.chdir(tmp_path)
    trace = simulate(
        load("paper", [PAPER, "plant.type=mujoco", "duration=0.2", "controller={type: pid, kp: 1e9}"])
    )
    assert trace.status == "diverged"
    assert list(tmp_path.iterdir()) == []


def test_provenance_has_the_model_file(tmp_path: Path) -> None:
    plant = Mujoco(file=written(tmp_path, TABLE, "table.xml"))
    assert plant.file in str(provenance())


# ---- refusals ----


@pytest.mark.parametrize(
    ("settings", "words"),
    [
        (["robot.type=puma560"], "robot 'puma560' does not tell its links; take robot: {type: urdf}"),
        (["plant.file=none.xml"], "none.xml' cannot be read: No such file or directory; expected an MJCF"),
        (["plant.file=package:ftcm_core/none.xml"], "has no file"),
        (["plant.file=bad.xml"], "MuJoCo cannot read it: XML Error"),
        (["plant.file=table.xml"], "table.xml' has no joint 'joint1'; "),
        (["plant.file=ball.xml"], "joint 'joint1' of "),
        (
            ["plant.file=hinges.xml", "injection.faults=[{type: payload_pickup, mass: 1.0, start: 1.0}]"],
            "the faults change the robot, but a file's masses stay; drop file, or those faults",
        ),
        (["plant.integrator=leapfrog"], "leapfrog"),
    ],
)
def test_what_cannot_be_is_refused_in_one_line(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, settings: list[str], words: str
) -> None:
    monkeypatch.chdir(tmp_path)
    written(tmp_path, TABLE, "table.xml")
    written(tmp_path, "<mujoco><nonsense/></mujoco>", "bad.xml")
    body = '<body><joint name="joint{}" type="{}"/><geom size="0.1" mass="1"/>'
    for name, kind in (("ball.xml", "ball"), ("hinges.xml", "hinge")):
        bodies = "".join(body.format(i, kind) for i in (1, 2, 3)) + "</body>" * 3
        written(tmp_path, f"<mujoco><worldbody>{bodies}</worldbody></mujoco>", name)
    with pytest.raises(ScenarioError) as error:
        load("paper", [PAPER, "plant.type=mujoco", *settings])
    assert words in str(error.value)
    assert "\n" not in str(error.value)


def test_without_mujoco_it_is_told_what_to_install(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "mujoco", None)
    with pytest.raises(ScenarioError, match=r"plant: needs MuJoCo, .*pip install 'ftcm_core\[mujoco\]'"):
        load("paper", [PAPER, "plant.type=mujoco"])


def test_it_is_not_compiled_with_the_rest() -> None:
    pytest.importorskip("numba")
    scenario = load("paper", [PAPER, "plant.type=mujoco", "duration=0.1"])
    with pytest.raises(compiled.NotCompilable, match="the plant 'mujoco' is another library's"):
        compiled.simulate(scenario)


def test_a_robot_without_links_says_so() -> None:
    assert Puma560().chain() is None
    assert RigidBody().unsuited(Puma560(), True) == ""
    with pytest.raises(ParameterError):
        Mujoco(substeps=0)
