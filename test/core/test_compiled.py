# SPDX-License-Identifier: Apache-2.0
"""Compiled runs do what the plain functions do, tick by tick, and say so when they cannot."""

import dataclasses
import importlib.util
import math
import random
import re
import subprocess
import sys
from typing import ClassVar

import numpy as np
import pytest

from ftcm_core import compiled
from ftcm_core.compiled import program, tracing
from ftcm_core.controllers import FeedbackLaw
from ftcm_core.disturbances import Disturbance
from ftcm_core.errors import FtcmError
from ftcm_core.faults import TOPICS
from ftcm_core.params import param, specs
from ftcm_core.random_streams import stream_key, uniform
from ftcm_core.recording.metrics import evaluate
from ftcm_core.registry import components
from ftcm_core.scenario import from_mapping, load, replace
from ftcm_core.simulation import Loop, simulate
from plugins import ROBOTS, robots_known, scenario_mapping
from traces import close
from written_tick import WrittenTick, state_numbers, written_as_plain

pytestmark = pytest.mark.pure

FEW_TICKS = ("duration=0.3", "transient=0.1", "injection.faults.0.start=0.2")
VARIANTS = {
    "paper": (),
    "limits and delay": (
        "torque_limits=[97.6, 186.4, 60]",
        "torque_rate_limits=4000",
        "torque_delay=2",
        "velocity_limits=9",
        "position_lower_limits=-1",
        "position_upper_limits=1",
    ),
    "incipient fault": ("injection.faults.0.profile=incipient", "injection.faults.0.start=0.01"),
    "per joint": ("observer.k1=[10000, 20000, 15000]", "reference.type=sine"),
    "other reference": ("reference.type=quintic", "injection.disturbances=[]"),
}


def started(*overrides, controller="ftcm"):
    """A run after its first ticks, as the written tick takes it over."""
    scenario = load("paper", overrides, controller)
    loop = Loop(scenario)
    for k in range(3):
        assert not loop.tick(k * scenario.dt_ns, False, lambda row: None)
    return scenario, loop


@pytest.mark.parametrize("variant", VARIANTS)
@pytest.mark.parametrize("name", sorted(components("controller")))
def test_what_is_written_is_the_plain_tick_bit_for_bit(name, variant):
    _, loop = started(*VARIANTS[variant], controller=name)
    _, other = started(*VARIANTS[variant], controller=name)
    written_as_plain(loop, other, 3, 60)


ONE_OF_EACH = {
    "implicit form": ("controller.discretisation=implicit",),
    "encoder": ("sensor={type: encoder, noise: 0.0001}",),
    "no observer": ("controller.type=smc", "observer.type=none"),
    "detector": ("detector={type: residual_threshold, threshold: 1, hold: 0.003}",),
    **{
        f"{test} of {residual}": (f"detector={{type: {test}, residual: {residual}}}",)
        for test, residual in (
            ("adaptive_threshold", "estimate"),
            ("cusum", "momentum"),
            ("glr", "motion"),
            ("residual_threshold", "momentum"),
        )
    },
    "isolating": ("detector={type: isolating, threshold: 0.1}", "injection.faults=[{type: sensor_bias}]"),
    "semi-implicit, substeps": ("plant={integrator: semi_implicit_euler, substeps: 2}",),
    "friction": ("robot.viscous_friction=1", "robot.coulomb_friction=[1, 2, 3]"),
    "other model": ("model={mass: '+20 %'}", "robot.payload_mass=2"),
    "effectiveness": ("injection.faults=[{type: loss_of_effectiveness, start: 0.01}]",),
    "condition": (
        "injection.faults=[{type: loss_of_effectiveness, start: 0.01, lifetime: timed, duration: 0.01, "
        "trigger: condition, trigger_signal: torque, trigger_joint: 2, trigger_above: 80}]",
    ),
    "bias": ("injection.faults=[{type: sensor_bias, start: 0.01, joint: 2}]",),
    "drift": ("injection.faults=[{type: sensor_drift, start: 0.01, drift: 0.1, walk: 0.01}]",),
    **{
        profile: (f"injection.faults=[{{type: sensor_bias, start: 0.01, profile: {profile}, period: 0.02}}]",)
        for profile in ("ramp", "periodic", "intermittent", "one_shot")
    },
    "bias on an encoder": (
        "injection.faults=[{type: sensor_bias, start: 0.01, profile: incipient}]",
        "sensor={type: encoder, noise: 0.0001}",
    ),
    **{
        f"lost {topic}": (f"injection.faults=[{{type: dropped_messages, start: 0.01, topic: {topic}}}]",)
        for topic in TOPICS
    },
    **{
        f"implicit {name}": (f"observer={{type: {name}, discretisation: implicit}}",)
        for name, cls in components("observer").items()
        if "discretisation" in specs(cls)
    },
}


def together(variants, most=5):
    """The same in fewer runs: a few variants in each that change different parts, their faults in a row."""
    groups = []
    for name, overrides in variants.items():
        found = dict(override.split("=", 1) for override in overrides)
        faults = found.pop("injection.faults", "")[1:-1]
        parts = {key.partition(".")[0] for key in found}
        parts |= {"observer"} if "detector" in parts else set()  # which may need one
        fits = (g for g in groups if len(g["names"]) < most and not parts & g["parts"])
        group = next(fits, None) or {"names": [], "parts": set(), "overrides": [], "faults": []}
        if not group["names"]:
            groups.append(group)
        group["names"].append(name)
        group["parts"] |= parts
        group["overrides"] += [f"{key}={value}" for key, value in found.items()]
        group["faults"] += [faults] * bool(faults)
    return {
        ", ".join(g["names"]): (*g["overrides"], f"injection.faults=[{', '.join(g['faults'])}]")
        for g in groups
    }


@pytest.mark.parametrize("variant", ONE_OF_EACH)
def test_what_is_written_of_every_kind_of_component_is_the_plain_tick(variant):
    _, loop = started(*ONE_OF_EACH[variant])
    _, other = started(*ONE_OF_EACH[variant])
    written_as_plain(loop, other, 3, 40)


LAWS_AND_OBSERVERS = [(law, "do") for law in components("controller")]
LAWS_AND_OBSERVERS += [("smc", observer) for observer in components("observer") if observer != "do"]


@pytest.mark.parametrize("robot", ROBOTS)
@pytest.mark.parametrize(("law", "observer"), LAWS_AND_OBSERVERS)
def test_what_is_written_for_any_robot_is_the_plain_tick(law, observer, robot):
    with robots_known():
        scenario = from_mapping(scenario_mapping(robot, controller=law, observer=observer))
    loops = Loop(scenario), Loop(scenario)
    for k in range(3):
        assert not any(loop.tick(k * scenario.dt_ns, False, lambda row: None) for loop in loops)
    written_as_plain(*loops, 3, 20 if ROBOTS[robot].joints == 6 else 40)


@pytest.mark.parametrize("overrides", [(), VARIANTS["limits and delay"]])
def test_a_tick_that_ends_the_run_is_left_to_plain_python(overrides):
    _, loop = started(*overrides)
    plant = loop.plant
    fast = (plant.motion[0], (20.0 if overrides else 5000.0, 0.0, 0.0))
    plant.state = plant.state._replace(motion=fast)
    written = WrittenTick(loop)
    before = list(written.state)
    assert written.run(3, 10) == 3
    assert written.reached == [3]
    assert written.state == before


def test_leaves_are_functions_of_floats_that_say_what_they_return():
    from ftcm_core.controllers.super_twisting import super_twisting
    from ftcm_core.controllers.terminal_surface import surface_and_rate
    from ftcm_core.numeric import sig
    from ftcm_core.robots.puma560 import inertia

    assert tracing.floats_returned(sig) == 0
    assert tracing.floats_returned(super_twisting) == 2
    assert tracing.floats_returned(surface_and_rate) == 2
    assert tracing.floats_returned(inertia) is None, "its length is not in its annotation: followed instead"
    assert tracing.floats_returned(uniform) == 0, "its whole numbers have a source of their own"


@pytest.mark.parametrize(("seed", "name"), [(0, "sensor.encoder"), (2**62, "fault.x.0"), (7, "")])
def test_random_numbers_are_the_same_compiled(seed, name):
    key = stream_key(seed, name)
    counters = [0.0, 1.0, 12345.0, 2.0**31, 2.0**51 - 1.0, 2.0**53 - 1.0]
    text = tracing.WHOLE_NUMBERS[uniform]
    names = {"numpy": np}
    exec(text, names)
    with np.errstate(over="ignore"):
        assert [names["uniform"](key, n) for n in counters] == [uniform(key, n) for n in counters]
    numba = pytest.importorskip("numba")
    jitted = numba.njit(names["uniform"])
    assert [jitted(key, n) for n in counters] == [uniform(key, n) for n in counters]


def test_without_numba_one_line_says_how_to_get_it(monkeypatch):
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: None)
    with pytest.raises(FtcmError, match=r'pip install "ftcm_core\[compiled\]"'):
        compiled.simulate(load("paper", ["duration=0.01"]))


def test_numba_is_imported_only_when_asked_for():
    code = (
        "import sys, ftcm_core.cli, ftcm_core.compiled, ftcm_core.campaign; sys.exit('numba' in sys.modules)"
    )
    assert (
        subprocess.run([sys.executable, "-c", code], env={"PYTHONPATH": ":".join(sys.path)}).returncode == 0
    )


def exponential(n: float) -> float:
    return 1e-300 * math.exp(20.0 * n)


def power(n: float) -> float:
    return 1e-300 * (1.0 + n) ** (4.0 * n)


def logarithm(n: float) -> float:
    return math.log(40.0 - n)


def root(n: float) -> float:
    return math.sqrt(40.5 - n)


def quotient(n: float) -> float:
    return 1.0 / (40.0 - n)


OUT_OF_THEIR_DOMAIN = (exponential, power, logarithm, root, quotient)


@dataclasses.dataclass(frozen=True, kw_only=True)
class Counting(FeedbackLaw):
    """Holds the robot, with a torque beside it that is a function of the number of the tick."""

    type_name: ClassVar[str] = "counting"
    kind: ClassVar[str] = "controller"
    function: str = param("root", unit="-", doc="function", source="chosen")

    def init(self, joints):
        return ((0.0,),) * joints

    def feedback(self, model, dt, y, reference, state):
        following = tuple([(n + 1.0,) for (n,) in state])
        u = [g + 1e-3 * self._beside(n) for g, (n,) in zip(model.gravity(y.position), state)]
        return tuple(u), following

    def _beside(self, n):
        if self.function == "exponential":
            return exponential(n)
        if self.function == "power":
            return power(n)
        if self.function == "logarithm":
            return logarithm(n)
        return root(n) if self.function == "root" else quotient(n)


@pytest.mark.slow
class TestNumba:
    @pytest.fixture(autouse=True)
    def _numba(self):
        pytest.importorskip("numba")

    def test_single_ticks_agree_from_random_states(self):
        scenario, loop = started()
        compiled_tick, parameters = program.program_for(loop)
        start = program.state_of(loop)
        numbers = list(program.numbers(start))
        choose, diverged = random.Random(1), 0
        for _ in range(200):
            k = choose.randrange(3, 39_000)
            state = [x * choose.uniform(-3.0, 3.0) for x in numbers]
            program.put_state(loop, program.with_numbers(start, iter(state)))
            moved, reached = np.array(state), np.zeros(1, dtype=np.int64)
            columns = np.zeros((8, 40_001, 3))
            at = compiled_tick.ticks(parameters, moved, k, k + 1, scenario.dt_ns, columns, reached)
            plain = []
            reason = loop.tick(k * scenario.dt_ns, False, plain.append)
            assert reached[0] == k
            assert (at == k) == bool(reason)
            if reason:
                loop.plant.reason = ""
                diverged += 1
            else:
                np.testing.assert_allclose(columns[:, k].ravel(), plain[0], rtol=1e-12, atol=1e-12)
                np.testing.assert_allclose(moved, state_numbers(loop), rtol=1e-12, atol=1e-12)
        assert diverged < 100

    def test_metrics_of_the_papers_run_agree(self):
        scenario = load("paper")
        trace, plain = compiled.simulate(scenario), simulate(scenario)
        assert (trace.engine, trace.status, trace.ticks) == ("compiled", "completed", 40_001)
        found, expected = evaluate(trace), evaluate(plain)
        for window, metrics in expected.items():
            for metric, values in metrics.items():
                assert found[window][metric] == pytest.approx(values, rel=1e-3, nan_ok=True), (window, metric)

    def test_other_numbers_need_no_other_program(self):
        compiled.simulate(load("paper", ["duration=0.01"]))
        count = len(program._programs)
        overrides = [
            "duration=0.05",
            "observer.k1=12345",
            "controller.gamma1=3",
            "injection.faults.0.start=0.02",
            "robot.mass=[0, 18, 7]",
            "model.centre_y=[0, 0.01, -0.1]",
        ]
        scenario = load("paper", overrides)
        trace, plain = compiled.simulate(scenario), simulate(scenario)
        assert len(program._programs) == count
        np.testing.assert_allclose(trace.command, plain.command, rtol=1e-9)

    def test_another_structure_needs_another_program(self):
        """One program more each; going back needs none."""
        variants = (["duration=0.01"], ["duration=0.01", "torque_delay=1"], ["duration=0.01", "seed=3"])
        compiled.simulate(load("paper", variants[0]))
        count = len(program._programs)
        compiled.simulate(load("paper", variants[1]))
        assert len(program._programs) == count + 1
        for variant in variants:
            compiled.simulate(load("paper", variant))
        assert len(program._programs) == count + 1

    @pytest.mark.parametrize(
        "overrides",
        [
            ["duration=2", "injection.faults.0.start=0.5", "injection.faults.0.severity=1e6"],
            ["velocity_limits=[0.3, 0.5, 0.5]", "duration=2"],
            ["position_upper_limits=[9, 0.05, 9]", "duration=2"],
            ["controller.upsilon1=1e308", "controller.upsilon2=1e308", "duration=1"],
            ["controller.gamma1=1e200", "controller.mu1=1e200"],
            ["observer.k1=1e9", "duration=1"],
            ["initial_state.velocity=[999, 999, -999]", "duration=1"],
            ["reference={type: constant, position: 1e308}", "duration=1"],
            ["reference={type: sine, frequency: 1e308}"],
            ["injection.disturbances.0.a=1e308", "initial_state.velocity=1"],
            ["controller.type=ctc", "controller.kd=2010", "duration=3"],
            ["controller.type=nftsmc", "controller.varpi=1e300", "duration=1"],
            ["controller.type=pid", "controller.kp=1e300", "duration=1"],
        ],
    )
    def test_a_run_that_ends_early_ends_as_the_plain_one(self, overrides):
        """Same status, detail, tick and time, also where a law overflows in the middle of a tick."""
        controller = next((x.partition("=")[2] for x in overrides if x.startswith("controller.type=")), None)
        scenario = load("paper", [x for x in overrides if "controller.type" not in x], controller)
        trace, plain = compiled.simulate(scenario), simulate(scenario)
        assert plain.status in ("diverged", "limit_exceeded")
        assert (trace.status, trace.ticks, trace.ended_at) == (plain.status, plain.ticks, plain.ended_at)
        assert trace.detail.split(": ", 1)[0] == plain.detail.split(": ", 1)[0]
        without_numbers = [re.sub(r"[-+.\de]+", "#", x.detail) for x in (trace, plain)]
        assert without_numbers[0] == without_numbers[1]
        assert list(trace.columns) == list(plain.columns)

    @pytest.mark.parametrize("overflow", OUT_OF_THEIR_DOMAIN, ids=lambda f: f.__name__)
    def test_a_law_that_leaves_its_domain_in_the_middle_ends_the_run_as_plainly(self, overflow):
        """In a compiled tick, not the first: same status, detail, time and rows."""
        with robots_known():
            scenario = from_mapping(scenario_mapping("pendulum", controller="smc"))
        scenario = replace(scenario, controller=Counting(function=overflow.__name__))
        trace, plain = compiled.simulate(scenario), simulate(scenario)
        assert (trace.engine, plain.engine) == ("compiled", "plain")
        assert plain.status == "diverged"
        assert 20 < plain.ticks < 60
        about = [(x.status, x.detail, x.ticks, x.ended_at) for x in (trace, plain)]
        assert about[0] == about[1]
        close(trace, plain)

    def test_what_cannot_be_compiled_is_refused_and_the_reason_said(self):
        """In one line that names the function; nothing is run in its stead."""

        @dataclasses.dataclass(frozen=True, kw_only=True)
        class Deciding(Disturbance):
            def torque(self, t, q, v, u):
                return (1.0,) * len(q) if q[0] > 0.0 else (0.0,) * len(q)

        scenario = replace(load("paper", ["duration=0.3"]), disturbances=(Deciding(),))
        assert simulate(scenario).engine == "plain"
        for run in (compiled.simulate, compiled.prepare):
            with pytest.raises(
                compiled.NotCompilable, match=r"torque\(\) decides on a number \(line "
            ) as error:
                run(scenario)
            assert len(str(error.value).splitlines()) == 1

    @pytest.mark.parametrize("overrides", together(ONE_OF_EACH).items(), ids=lambda x: x[0])
    def test_a_run_with_any_kind_of_component_agrees(self, overrides):
        scenario = load("paper", ["duration=0.2", *overrides[1]])
        trace = compiled.simulate(scenario)
        assert trace.engine == "compiled"
        close(trace, simulate(scenario), rtol=1e-7, atol=1e-7)

    def test_a_payload_is_picked_up_in_the_middle_of_a_compiled_run(self):
        """In its tick, once for each; before it nothing differs from the run without."""
        entries = (
            "[{type: payload_pickup, start: 0.05, mass: 2}, {type: payload_pickup, start: 0.1, mass: 1}]"
        )
        scenario = load("paper", ["duration=0.2", f"injection.faults={entries}"])
        trace, plain = compiled.simulate(scenario), simulate(scenario)
        close(trace, plain, rtol=1e-7, atol=1e-7)
        without = compiled.simulate(load("paper", ["duration=0.2", "injection.faults=[]"]))
        assert np.array_equal(trace.position[:52], without.position[:52])
        assert not np.array_equal(trace.velocity[52], without.velocity[52])
        assert np.abs(trace.velocity[102:] - without.velocity[102:]).max() > 1e-3

    # What is written for each law, observer and robot together is compared above, bit for bit; here what is
    # compiled of it, for each by itself.

    @pytest.mark.parametrize("name", sorted(components("controller")))
    def test_metrics_agree_for_any_law(self, name):
        """Of one joint: what is compiled of a law is the same for each, and more of a robot takes long."""
        with robots_known():
            scenario = from_mapping(scenario_mapping("pendulum", controller=name))
        self.metrics_agree(scenario)

    @pytest.mark.nightly
    @pytest.mark.parametrize("name", sorted(components("controller")))
    def test_metrics_agree_for_any_law_of_the_paper_s_robot(self, name):
        self.metrics_agree(load("paper", FEW_TICKS, name))

    @pytest.mark.parametrize("robot", [name for name, r in ROBOTS.items() if r.joints != 3])
    def test_metrics_agree_for_any_robot(self, robot):
        with robots_known():
            scenario = from_mapping(scenario_mapping(robot))
        self.metrics_agree(scenario)

    @pytest.mark.parametrize("observer", sorted(components("observer")))
    def test_metrics_agree_for_any_observer(self, observer):
        with robots_known():
            scenario = from_mapping(scenario_mapping("pendulum", controller="smc", observer=observer))
        self.metrics_agree(scenario)

    def metrics_agree(self, scenario):
        trace, plain = compiled.simulate(scenario), simulate(scenario)
        assert (trace.engine, trace.status, plain.status) == ("compiled", "completed", "completed")
        found, expected = evaluate(trace), evaluate(plain)
        assert expected["after_transient"]
        for window, metrics in expected.items():
            assert (found[window] is None) == (metrics is None)
            for metric, values in (metrics or {}).items():
                # An average over chattering amplifies the last bit.
                near = [None if x is None else pytest.approx(x, rel=1e-4, abs=1e-9) for x in values]
                assert found[window][metric] == near, (window, metric)
        assert found == evaluate(dataclasses.replace(trace, column_sums=None)), "sums by numpy: every bit"

    def test_a_second_process_finds_the_code_compiled(self):
        _, loop = started()
        _, text = program.write(loop)
        program.compiled(text, "ticks", "accelerations")
        ticks, _ = program.compiled(text, "ticks", "accelerations")
        assert sum(ticks.stats.cache_hits.values()) == 1
        assert not ticks.stats.cache_misses

    def test_a_folder_that_others_may_write_to_is_not_used(self, tmp_path, monkeypatch):
        tmp_path.chmod(0o777)
        monkeypatch.setenv(compiled.CACHE, str(tmp_path))
        assert program.cache_folder() is None
