# SPDX-License-Identifier: Apache-2.0
"""What observer and controller believe of the robot, and what it truly is: given apart, in a scenario."""

from __future__ import annotations

import math
from collections.abc import Iterator
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from ftcm_core.campaign import Campaign, parse_variation
from ftcm_core.errors import ScenarioError
from ftcm_core.plants.rigid_body import RigidBody
from ftcm_core.robots.puma560 import Puma560
from ftcm_core.scenario import from_mapping, load, parse_yaml
from ftcm_core.simulation import simulate
from plugins import robots_known, scenario_mapping
from traces import rows_of, same

pytestmark = pytest.mark.pure

NOMINAL = Puma560()


@pytest.fixture(autouse=True)
def _robots() -> Iterator[None]:
    """The robots of test/support, beside the suite's own."""
    with robots_known():
        yield


@pytest.mark.parametrize(
    ("text", "name", "expected"),
    [
        ("model={mass: '+20 %'}", "mass", (0.0, 17.4 * 1.2, 6.05 * 1.2)),
        ("model={mass: '-50%'}", "mass", (0.0, 17.4 * 0.5, 6.05 * 0.5)),
        ("model={mass: ' + 2.5 % '}", "mass", (0.0, 17.4 * 1.025, 6.05 * 1.025)),
        ("model={mass: [1, '+10 %', '-10 %']}", "mass", (1.0, 17.4 * 1.1, 6.05 * 0.9)),
        ("model={mass: [1, 18, 7]}", "mass", (1.0, 18.0, 7.0)),
        ("model={motor_inertia: 2}", "motor_inertia", 2.0),
        ("model.gravity_acceleration=+100 %", "gravity_acceleration", 2 * 9.81),
        ("model={payload_mass: 1.5}", "payload_mass", 1.5),
        ("model={viscous_friction: ['+10 %', 1, 2]}", "viscous_friction", (0.0, 1.0, 2.0)),
    ],
)
def test_the_model_differs_in_what_is_said(text: str, name: str, expected: Any) -> None:
    """Absolute, in percent of the nominal value, for all joints or joint by joint; nothing else changes."""
    scenario = load("paper", [text])
    assert scenario.robot == NOMINAL
    values, nominal = scenario.model.values, NOMINAL.values
    assert values.pop(name) == pytest.approx(expected, rel=1e-14)
    nominal.pop(name)
    assert values == nominal


def test_the_true_robot_can_be_another_than_the_nominal_one() -> None:
    """``plant.robot`` changes the robot that is moved; the model is the nominal one, in percent too."""
    scenario = load("paper", ["plant={substeps: 2, robot: {mass: '+20 %', payload_mass: 1}}"])
    assert scenario.robot == Puma560(mass=[x * 1.2 for x in NOMINAL.mass], payload_mass=1.0)
    assert scenario.model == NOMINAL
    assert scenario.plant == RigidBody(substeps=2)
    both = load("paper", ["plant.robot.mass=+20 %", "model.mass=-10 %", "robot.mass=[0, 10, 5]"])
    assert both.robot.mass == pytest.approx((0.0, 12.0, 6.0))
    assert both.model.mass == pytest.approx((0.0, 9.0, 4.5))
    assert load("paper", ["plant={robot: {}}"]) == load("paper")


def test_the_model_does_not_have_the_payload() -> None:
    """Unless it is told; a payload of the true robot alone is none of the model's either way."""
    loaded = load("paper", ["robot.payload_mass=2"])
    assert (loaded.robot.payload_mass, loaded.model.payload_mass) == (2.0, 0.0)
    told = load("paper", ["robot.payload_mass=2", "model={payload_mass: 2}"])
    assert told.model == told.robot
    apart = load("paper", ["plant.robot.payload_mass=2"])
    assert (apart.robot, apart.model) == (loaded.robot, loaded.model)


@pytest.mark.parametrize(
    "overrides",
    [
        ["model={mass: '+20 %'}"],
        ["robot.payload_mass=2"],
        ["robot.payload_mass=2", "model={payload_mass: '+0 %'}"],
        ["plant={integrator: semi_implicit_euler, robot: {mass: '+7 %', viscous_friction: [1, 2, 3]}}"],
        ["plant.robot.mass=-20 %", "model.centre_y=+5 %", "detector=residual_threshold"],
    ],
)
def test_round_trip(tmp_path: Path, overrides: list[str]) -> None:
    """Written out, both robots stand there with all their values; the file reads back equal."""
    scenario = load("paper", overrides)
    assert scenario.robot != scenario.model
    mapping = scenario.to_mapping()
    assert mapping["robot"] == scenario.robot.to_mapping()
    assert mapping["model"] == scenario.model.to_mapping()
    assert from_mapping(mapping) == scenario
    data, _ = parse_yaml(scenario.to_yaml(), "written")
    assert data == mapping
    path = tmp_path / "mine.yaml"
    path.write_text(scenario.to_yaml())
    assert load(str(path)) == scenario
    assert same(
        simulate(load(str(path), ["duration=0.05"])), simulate(load("paper", [*overrides, "duration=0.05"]))
    )


@pytest.mark.parametrize(
    ("override", "message"),
    [
        ("model={mass: '20 %'}", "model.mass: '20 %' is not a number, nor a change in percent such as"),
        ("model={mass: '+10'}", "model.mass: '+10' is not a number"),
        ("model={mass: '+x %'}", "model.mass: '+x %' is not a number"),
        ("model={mass: '+1e2 %'}", "model.mass: '+1e2 %' is not a number"),
        ("model={mass: '+10 % %'}", "model.mass: '+10 % %' is not a number"),
        ("model={mass: [1, '5 %', 2]}", "model.mass: '5 %' is not a number"),
        ("model={mass: '-150 %'}", "model.mass: -8.7 is out of range"),
        ("model={mass: [1, 2]}", "model.mass: [1.0, 2.0] has 2 entries; expected one per joint (3)"),
        ("model={mass: true}", "model.mass: True is not a number"),
        ("model={masss: 1}", "model.masss: unknown key; did you mean 'mass'?"),
        ("model={type: puma, mass: 1}", "model.type: no robot 'puma'"),
        ("model=3", "model: 3 is not a component"),
        ("model={type: planar_arm}", "model: has the joints ['shoulder', 'elbow']; expected those of"),
        ("robot={type: puma560, mass: '+10 %'}", "robot.mass: '+10 %' is not a number"),
        ("plant={robot: {mass: '20 %'}}", "plant.robot.mass: '20 %' is not a number"),
        ("plant={robot: {masss: 1}}", "plant.robot.masss: unknown key; did you mean 'mass'?"),
        ("plant={robot: {mass: 0, inertia_zz: 0, motor_inertia: 0}}", "plant.robot.mass: with these masses"),
        ("plant={robots: {mass: 1}}", "plant.robots: unknown key"),
    ],
)  # fmt: skip
def test_a_mistake_is_one_line_with_its_place(override: str, message: str) -> None:
    """Value, what was expected, and a suggestion where there is one."""
    with pytest.raises(ScenarioError) as error:
        load("paper", [override])
    assert message in str(error.value)
    assert len(str(error.value).splitlines()) == 1


def test_a_percentage_of_another_robot_s_value() -> None:
    """It is of the value that the scenario's robot has; a model of another type is a robot of its own."""
    data = scenario_mapping("pendulum", model={"mass": "+50 %", "damping": 0.3})
    scenario = from_mapping(data)
    assert (scenario.model.mass, scenario.model.damping) == (3.0, 0.3)
    assert (scenario.robot.mass, scenario.robot.damping) == (2.0, 0.0)


# What it does in a run.


def test_each_part_of_a_run_has_its_own_robot() -> None:
    """The plant moves the true one, the first command comes from the model; without mismatch both agree."""
    trace = simulate(load("paper", ["duration=0.05", "model={mass: '+20 %'}", "controller=ctc"]))
    believing = simulate(load("paper", ["duration=0.05", "robot.mass=[0, 20.88, 7.26]", "controller=ctc"]))
    assert trace.command[0] == pytest.approx(believing.command[0], rel=1e-13)
    rows, plant = rows_of(trace), RigidBody()
    for now, after in pairwise(rows):
        tau = tuple(map(float.__add__, after["effort"], now["disturbance"]))
        assert plant.step(NOMINAL, 1e-3, tau, (now["position"], now["velocity"])) == (
            after["position"],
            after["velocity"],
        )
    assert trace.model == trace.scenario.model != trace.scenario.robot
    agreed = load("paper", ["duration=0.05", "robot.mass=[0, 20, 7]", "model={mass: [0, 20, 7]}"])
    assert same(simulate(agreed), simulate(load("paper", ["duration=0.05", "robot.mass=[0, 20, 7]"])))


@pytest.mark.parametrize(
    "override", ["model={mass: '+20 %'}", "robot.payload_mass=2", "plant.robot.viscous_friction=30"]
)
def test_a_mismatch_is_a_lumped_uncertainty_that_the_observer_finds(override: str) -> None:
    """Δ is the model's acceleration less the true one at the recorded torque; Δ̂ goes there."""
    quiet = ["injection={disturbances: [], faults: []}", "duration=1.5"]
    trace = simulate(load("paper", [*quiet, override]))
    scenario, delta = trace.scenario, trace.lumped_uncertainty
    for k in (300, 600, 1200):
        q, v = tuple(trace.position[k].tolist()), tuple(trace.velocity[k].tolist())
        u = tuple(trace.effort[k + 1].tolist())
        off = np.subtract(scenario.model.forward_dynamics(q, v, u), scenario.robot.forward_dynamics(q, v, u))
        assert delta[k] == pytest.approx(off, abs=0.05 * max(1.0, np.abs(off).max()))
    assert np.abs(delta[1000:-1]).max() > 0.05
    error = np.abs(delta - trace.lumped_uncertainty_estimate)[1000:-1]
    assert error.max() < 0.25 * np.abs(delta[1000:-1]).max()
    none = simulate(load("paper", quiet)).lumped_uncertainty
    assert not none.any()


def test_a_wrong_model_costs_a_law_without_observer_accuracy() -> None:
    """The paper's law, which has one, is hardly worse for it."""
    quiet = ["injection={disturbances: [], faults: []}", "duration=3"]

    def late(controller: str, *more: str) -> float:
        trace = simulate(load("paper", [*quiet, *more], controller))
        return float(np.abs(trace.error[2000:]).max())

    assert late("ctc", "model={mass: '+20 %'}") > 20 * late("ctc")
    assert late("ftcm", "model={mass: '+20 %'}") < 1e-4


def test_a_campaign_varies_what_is_believed() -> None:
    """Percentages are values like others."""
    wanted = Campaign(
        "paper", runs=12, seed=1, variations=(parse_variation("model.mass=choice(+10 %, -10 %)"),)
    )
    masses = {round(wanted.scenario(run).model.mass[1] / 17.4, 9) for run in wanted.run_list()}
    assert masses == {1.1, 0.9}
    assert math.isclose(wanted.scenario(wanted.run_list()[0]).robot.mass[1], 17.4)
