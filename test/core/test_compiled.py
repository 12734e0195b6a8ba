# SPDX-License-Identifier: Apache-2.0
"""Compiled runs do what the plain functions do, tick by tick, and say so when they cannot."""

import importlib.util
import math
import random
import subprocess
import sys

import numpy as np
import pytest

from ftcm_core import compiled, tracing
from ftcm_core.errors import FtcmError
from ftcm_core.metrics import evaluate
from ftcm_core.registry import components
from ftcm_core.scenario import load
from ftcm_core.simulation import Loop, simulate
from ftcm_core.trace import COLUMNS

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


@pytest.fixture(scope="module", autouse=True)
def _cache(tmp_path_factory):
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv(compiled.CACHE, str(tmp_path_factory.mktemp("compiled")))
        yield


def started(*overrides, controller="ftcm"):
    """A run after its first ticks, as the written tick takes it over."""
    scenario = load("paper", overrides, controller)
    loop = Loop(scenario)
    for k in range(3):
        assert not loop.tick(k * scenario.dt_ns, False, lambda row: None)
    return scenario, loop


def as_plain_python(loop):
    """The written tick, run by Python itself."""
    tracer, text = compiled.write(loop)
    names = {name: function for function, name in tracer.leaves.items()} | {"math": math}
    exec(text, names)
    known = {}
    return names["ticks"], [tracing.look_up(loop, steps, known) for steps in tracer.slots]


class Rows(dict):
    def table(self, width):
        ticks = sorted({k for k, _ in self})
        return [[self[k, i] for i in range(width)] for k in ticks]


@pytest.mark.parametrize("variant", VARIANTS)
@pytest.mark.parametrize("name", sorted(components("controller")))
def test_what_is_written_is_the_plain_tick_bit_for_bit(name, variant):
    scenario, loop = started(*VARIANTS[variant], controller=name)
    _, other = started(*VARIANTS[variant], controller=name)
    ticks, parameters = as_plain_python(loop)
    state, rows, last = list(compiled.flat(loop)), Rows(), 60
    assert ticks(parameters, state, 3, last, scenario.dt_ns, rows) == last
    plain = []
    for k in range(3, last):
        assert not other.tick(k * scenario.dt_ns, False, plain.append)
    assert rows.table(len(plain[0])) == [list(row) for row in plain]
    assert state == list(compiled.flat(other))


def test_written_tick_of_the_implicit_form():
    scenario, loop = started("controller.discretisation=implicit")
    _, other = started("controller.discretisation=implicit")
    ticks, parameters = as_plain_python(loop)
    state = list(compiled.flat(loop))
    assert ticks(parameters, state, 3, 20, scenario.dt_ns, Rows()) == 20
    for k in range(3, 20):
        other.tick(k * scenario.dt_ns, False, lambda row: None)
    assert state == list(compiled.flat(other))


@pytest.mark.parametrize("overrides", [(), VARIANTS["limits and delay"]])
def test_a_tick_that_ends_the_run_is_left_to_plain_python(overrides):
    scenario, loop = started(*overrides)
    ticks, parameters = as_plain_python(loop)
    loop.plant.velocity = (20.0 if overrides else 5000.0, 0.0, 0.0)
    loop.plant._sense()
    state = list(compiled.flat(loop))
    before = list(state)
    assert ticks(parameters, state, 3, 10, scenario.dt_ns, Rows()) == 3
    assert state == before


def test_leaves_are_functions_of_floats_that_say_what_they_return():
    from ftcm_core.controllers.super_twisting import super_twisting
    from ftcm_core.numeric import sig
    from ftcm_core.robots.puma560 import inertia
    from ftcm_core.streams import uniform

    assert tracing.leaf_returns(sig) == 0
    assert tracing.leaf_returns(super_twisting) == 2
    assert tracing.leaf_returns(inertia) is None, "its length is not in its annotation: followed instead"
    assert tracing.leaf_returns(uniform) is None, "whole numbers beyond 64 bits mean something else compiled"


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


class TestNumba:
    @pytest.fixture(autouse=True)
    def _numba(self):
        pytest.importorskip("numba")

    def test_single_ticks_agree_from_random_states(self):
        scenario, loop = started()
        program, parameters = compiled._program(loop)
        start = list(compiled.flat(loop))
        choose = random.Random(1)
        for _ in range(200):
            k = choose.randrange(3, 39_000)
            state = [x * choose.uniform(-3.0, 3.0) if x != scenario.dt else x for x in start]
            compiled.put(loop, state)
            moved = np.array(state)
            rows = np.zeros((40_001, 24))
            reached = program.ticks(parameters, moved, k, k + 1, scenario.dt_ns, rows)
            plain = []
            diverged = loop.tick(k * scenario.dt_ns, False, plain.append)
            assert (reached == k) == bool(diverged)
            if not diverged:
                np.testing.assert_allclose(rows[k], plain[0], rtol=1e-12, atol=1e-12)
                np.testing.assert_allclose(moved, list(compiled.flat(loop)), rtol=1e-12, atol=1e-12)

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
        count = len(compiled._programs)
        overrides = [
            "duration=0.05",
            "observer.k1=12345",
            "controller.gamma1=3",
            "injection.faults.0.start=0.02",
        ]
        scenario = load("paper", overrides)
        trace, plain = compiled.simulate(scenario), simulate(scenario)
        assert len(compiled._programs) == count
        np.testing.assert_allclose(trace.command, plain.command, rtol=1e-9)

    def test_a_run_that_diverges_ends_as_the_plain_one(self):
        scenario = load(
            "paper", ["duration=2", "injection.faults.0.start=0.5", "injection.faults.0.severity=1e6"]
        )
        trace, plain = compiled.simulate(scenario), simulate(scenario)
        assert plain.status == "diverged"
        assert (trace.status, trace.ticks) == (plain.status, plain.ticks)
        assert trace.detail.split(":")[0] == plain.detail.split(":")[0]

    def test_what_cannot_be_compiled_runs_plainly_and_says_why(self):
        scenario = load("paper", ["duration=0.3", "sensor={type: encoder, noise: 1e-4}"])
        trace, plain = compiled.simulate(scenario), simulate(scenario)
        assert trace.engine.startswith("plain: ")
        for name in COLUMNS:
            assert np.array_equal(getattr(trace, name), getattr(plain, name))
        assert np.array_equal(trace.measured_position, plain.measured_position)

    def test_a_second_process_finds_the_code_compiled(self):
        _, loop = started()
        tracer, text = compiled.write(loop)
        compiled._compile(tracer, text)
        ticks, _ = compiled._compile(*compiled.write(loop))
        assert sum(ticks.stats.cache_hits.values()) == 1
        assert not ticks.stats.cache_misses

    def test_a_folder_that_others_may_write_to_is_not_used(self, tmp_path, monkeypatch):
        tmp_path.chmod(0o777)
        monkeypatch.setenv(compiled.CACHE, str(tmp_path))
        assert compiled._cache_folder() is None
