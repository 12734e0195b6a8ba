# SPDX-License-Identifier: Apache-2.0
"""Time-delay control, and NFTSMC with a fault estimate by time delay: what each claims."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
import pytest

from double_integrator import DoubleIntegrator, run
from ftcm_core.controllers.continuous_tsmc import terminal_time
from ftcm_core.controllers.ctc import CTC
from ftcm_core.controllers.nftsmc import NFTSMC
from ftcm_core.controllers.tdc import TDC
from ftcm_core.controllers.tde_nftsmc import TDENFTSMC, fast_surface, fast_surface_feedback
from ftcm_core.robots.puma560 import Puma560
from ftcm_core.scenario import load
from ftcm_core.signals import Measurement, ReferencePoint
from ftcm_core.simulation import simulate
from robot_matrices import mass_matrix

pytestmark = pytest.mark.pure

DT = 1e-3


def slope(t: float) -> float:
    """100 rad/s³."""
    return 100.0 * t


# Time-delay control.


@pytest.mark.parametrize("d", [0.0, 10.0, -300.0])
def test_a_constant_disturbance_is_cancelled_from_the_second_tick_on(d: float) -> None:
    """Where M̄ is the inertia the motion then is that of computed torque without it, to rounding."""
    law = TDC(m_bar=2.0)
    moved = run(law, 2.0, 0.3, disturbance=lambda t: d, mass=2.0)
    rest = moved.dde + law.kd * moved.de + law.kp * moved.e
    assert rest[0] == pytest.approx(d, abs=1e-9)
    assert np.abs(rest[1:]).max() < 1e-9 * (1.0 + abs(d))
    nominal = run(CTC(), 2.0 - DT, moved.e[1], moved.de[1])
    assert moved.e[1:] == pytest.approx(nominal.e, abs=1e-9)


def test_of_a_disturbance_with_a_slope_the_slope_times_the_tick_is_left() -> None:
    """100 rad/s³ leave 0.1 rad/s², so 1 mrad in the end where kp = 100; at a tenth of the tick a tenth."""
    for dt in (1e-3, 1e-4):
        law = TDC()
        moved = run(law, 1.0, disturbance=slope, dt=dt)
        rest = moved.dde + law.kd * moved.de + law.kp * moved.e
        assert rest[1:] == pytest.approx(100.0 * dt, rel=1e-6)
        assert moved.e[-1] == pytest.approx(100.0 * dt / law.kp, rel=0.01)


@pytest.mark.parametrize("ratio", [0.2, 0.5, 1.5, 1.9])
def test_with_another_inertia_the_rest_shrinks_by_the_factor_that_it_says(ratio: float) -> None:
    """By 1 - M̄/M a tick: slower for less, alternating for more."""
    law = TDC(m_bar=ratio, kp=1e-3, kd=0.0)  # slow, so that the motion does not hide it
    moved = run(law, 0.02, disturbance=lambda t: 10.0)
    rest = moved.dde + law.kp * moved.e
    assert rest[1:10] / rest[:9] == pytest.approx(1.0 - ratio, abs=1e-4)


def test_twice_the_inertia_is_too_much() -> None:
    """Within the unit circle it settles, outside it diverges."""
    settled, diverging = (run(TDC(m_bar=ratio), 2.0, 0.1, disturbance=lambda t: 1.0) for ratio in (1.9, 2.1))
    assert abs(settled.e[-1]) < 1e-6
    assert np.abs(diverging.dde[-1]) > 1e6


def test_default_inertia_meets_the_condition_all_over_the_puma_s_workspace() -> None:
    """The eigenvalues of I - M(q)⁻¹ M̄ lie in (0, 1): M̄ is below the smallest of M(q)."""
    m_bar, found = TDC().m_bar, []
    for q2 in np.linspace(-math.pi, math.pi, 25):
        for q3 in np.linspace(-math.pi, math.pi, 25):
            mass = mass_matrix(Puma560(), (0.0, float(q2), float(q3)))
            found.extend(np.linalg.eigvals(np.eye(3) - m_bar * np.linalg.inv(mass)).real)
    assert 0.0 < min(found) < max(found) < 0.9


def test_time_delay_control_needs_no_model_after_the_first_tick() -> None:
    """A model that is wrong by a factor changes the first torque at most."""
    one, other = (run(TDC(), 0.5, 0.2, model=DoubleIntegrator(mass=m)) for m in (1.0, 17.0))
    assert np.array_equal(one.u, other.u)
    y, r = Measurement((0.1, 0.2, 0.3), (0.0,) * 3, (1.0, 2.0, 3.0)), ReferencePoint(*((0.0,) * 3,) * 3)
    law, loaded, empty = TDC(), Puma560(payload_mass=10.0), Puma560()
    for started, same in ((0.0, False), (1.0, True)):
        state = ((started, 0.1),) * 3
        u = [
            law.step(m, DT, y, r, (0.0,) * 3, state, law.prepare(m, DT, y, r, state))[0]
            for m in (loaded, empty)
        ]
        assert (u[0] == u[1]) is same


def test_time_delay_control_does_not_wind_up_at_a_torque_limit() -> None:
    """It starts from the torque that acted: after a start at the limit it settles as without one."""
    options = ["duration=6", "injection.faults=[]", "initial_state.position=-1"]
    free, limited = (simulate(load("paper", [*options, *more], "tdc")) for more in ([], ["torque_limits=80"]))
    assert np.abs(limited.command).max() > 80.0
    for trace in (free, limited):
        assert np.abs(trace.error[-500:]).max() < 1e-4


# NFTSMC with time-delay estimation.


@pytest.mark.parametrize("e", [-1.0, -0.1, 0.0, 0.01, 0.7])
@pytest.mark.parametrize("de", [-0.5, 0.02, 1.3])
def test_feedback_keeps_the_surface(e: float, de: float) -> None:
    """σ̇ = 0 along e + ė t + a t²/2, by central differences."""
    shape = (0.5, 2.0, 0.5, 5.0 / 3.0)
    a, h = fast_surface_feedback(e, de, *shape), 1e-6
    after, before = (fast_surface(e + de * t + a * t * t / 2, de + a * t, *shape) for t in (h, -h))
    assert (after - before) / (2 * h) == pytest.approx(0.0, abs=1e-5)
    law = TDENFTSMC()
    assert law.sliding_variable(e, de, 0) == fast_surface(e, de, *shape)


@pytest.mark.parametrize("d", [0.0, 10.0, -300.0])
def test_a_constant_fault_is_estimated_from_the_second_tick_on(d: float) -> None:
    """The motion then is that without it, from where the first tick has led."""
    law = TDENFTSMC(k4=0.0)  # without its memory, so that the two can be compared
    moved = run(law, 2.0, 0.3, disturbance=lambda t: d)
    without = run(law, 2.0 - DT, moved.e[1], moved.de[1])
    assert moved.e[1:] == pytest.approx(without.e, abs=1e-6)
    assert np.abs(moved.dde[1:100] - without.dde[:99]).max() < 1e-6 * (1.0 + abs(d))


@pytest.mark.parametrize(
    "disturbance",
    [lambda t: 0.0, lambda t: 100.0, lambda t: 100.0 * math.sin(t), slope],
    ids=["none", "constant", "sine", "slope"],
)
def test_the_error_vanishes_in_finite_time_under_any_slow_fault(
    disturbance: Callable[[float], float],
) -> None:
    """Of 100 rad/s² and more, five times what NFTSMC can bear; less than 1e-6 rad is left."""
    moved = run(TDENFTSMC(), 4.0, -0.5, disturbance=disturbance)
    assert np.abs(moved.e[moved.t > 2.0]).max() < 1e-6
    assert moved.t[np.abs(moved.e) > 1e-4][-1] == pytest.approx(1.21, abs=0.01), "whatever the fault"
    if disturbance(3.0) > 30.0:
        assert np.abs(run(NFTSMC(), 4.0, -0.5, disturbance=disturbance).e[-1]) > 1.0


def test_what_is_left_shrinks_with_the_tick() -> None:
    """Ten times shorter, a tenth and less."""
    left = []
    for dt in (1e-3, 1e-4):
        moved = run(TDENFTSMC(), 3.0, -0.5, disturbance=lambda t: 100.0 * math.sin(t), dt=dt)
        left.append(np.abs(moved.e[moved.t > 2.0]).max())
    assert left[1] < 0.1 * left[0]


@pytest.mark.parametrize("e0", [0.1, 0.5, 2.0])
def test_time_on_the_surface_is_below_its_bound(e0: float) -> None:
    """Also with the k1 term, which makes it shorter; without it the bound is the time."""
    for k1 in (0.0, 0.5):
        law = TDENFTSMC(k1=k1)
        bound = law.settling_time_bound(e0, 0)
        assert bound == terminal_time(e0, law.k2, law.beta)
        speed = ((e0 + k1 * e0**law.alpha) / law.k2) ** (1.0 / law.beta)
        moved = run(law, bound, e0, -speed, dt=1e-4)
        when = moved.t[np.abs(moved.e) > 1e-4 * e0][-1] + law.settling_time_bound(1e-4 * e0, 0)
        assert when <= 1.005 * bound
        if k1 == 0.0:
            assert when == pytest.approx(bound, rel=0.005)


def test_surface_exponents_are_warned_of() -> None:
    """α > β, per joint where joints differ."""
    assert TDENFTSMC().warnings() == []
    assert TDENFTSMC(alpha=1.5).warnings() == [
        "controller tde_nftsmc, all joints: alpha=1.5, beta=1.66667; the surface of Van, Ge and Ren asks for "
        "alpha > beta"
    ]
    (line,) = TDENFTSMC(alpha=[2.0, 1.5, 2.0]).warnings()
    assert line.startswith("controller tde_nftsmc, joint 2: alpha=1.5")
