# SPDX-License-Identifier: Apache-2.0
"""Boundary layer, integral, continuous terminal, fixed-time and adaptive sliding mode: what each claims."""

from __future__ import annotations

import math
from collections.abc import Callable
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from double_integrator import run, variation
from ftcm_core.controllers import Controller
from ftcm_core.controllers.adaptive_super_twisting import AdaptiveSuperTwisting, adapted
from ftcm_core.controllers.boundary_layer_smc import BoundaryLayerSMC
from ftcm_core.controllers.continuous_tsmc import ContinuousTSMC, terminal_time
from ftcm_core.controllers.ctc import CTC
from ftcm_core.controllers.fixed_time_nftsmc import (
    FixedTimeNFTSMC,
    fixed_time,
    fixed_time_feedback,
    fixed_time_surface,
)
from ftcm_core.controllers.integral_smc import IntegralSMC
from ftcm_core.controllers.smc import SMC
from ftcm_core.errors import ParameterError
from ftcm_core.numeric import sat, sgn, sig

pytestmark = pytest.mark.pure

DT = 1e-3
quick = settings(deadline=None, max_examples=200)
errors, rates = st.floats(-4.0, 4.0), st.floats(-5.0, 5.0)


def sine(t: float) -> float:
    """10 rad/s² at 1 Hz."""
    return 10.0 * math.sin(2.0 * math.pi * t)


def square(t: float) -> float:
    """±10 rad/s², jumping every half second."""
    return 10.0 if math.floor(2.0 * t) % 2 else -10.0


DISTURBANCES = [lambda t: 0.0, lambda t: 10.0, sine, square]
every_disturbance = pytest.mark.parametrize(
    "disturbance", DISTURBANCES, ids=["none", "constant", "sine", "square"]
)


def test_saturated_sign() -> None:
    """Linear within the width, the sign beyond; a width of zero is the sign."""
    assert [sat(x, 2.0) for x in (-3.0, -2.0, -1.0, 0.0, 0.5, 5.0)] == [-1.0, -1.0, -0.5, 0.0, 0.25, 1.0]
    assert [sat(x, 0.0) for x in (-1e-300, 0.0, 1e-300)] == [-1.0, 0.0, 1.0]


# Boundary layer.


@quick
@given(e=errors, de=rates)
def test_boundary_layer_smc_is_smc_outside_of_its_layer(e: float, de: float) -> None:
    """Float for float; inside it is linear."""
    law, hard = BoundaryLayerSMC(), SMC()
    sigma = law.surface(law, e, de)
    if abs(sigma) >= law.layer:
        assert law.law(law, e, de, DT, ()) == hard.law(hard, e, de, DT, ())
    near = de - sigma + 0.5 * law.layer
    assert law.law(law, e, near, DT, ())[0] == pytest.approx(-law.c * near - 0.5 * 20.01, rel=1e-9)


@every_disturbance
def test_boundary_layer_leaves_the_error_that_it_says(disturbance: Callable[[float], float]) -> None:
    """|σ| <= Φ D/K and |e| <= Φ D/(c K) in the end; what a tick adds is dt/2 times |ë|."""
    law, d, late = BoundaryLayerSMC(), 10.0, slice(-4000, None)
    moved = run(law, 8.0, -0.5, disturbance=disturbance)
    held = 0.5 * DT * np.abs(moved.dde[late]).max()
    bound = law.layer / (law.sigma_gain + law.xi) * (d + law.c * held)
    assert np.abs(moved.de + law.c * moved.e)[late].max() <= bound
    assert np.abs(moved.e[late]).max() <= (bound + held) / law.c


def test_boundary_layer_leaves_just_that_of_a_constant_disturbance() -> None:
    """E = Φ d/(c K) at rest: it is no bound only, and in proportion to d and Φ."""
    for d, layer in ((10.0, 0.025), (5.0, 0.025), (10.0, 0.05), (-10.0, 0.1)):
        law = BoundaryLayerSMC(layer=layer)
        e = run(law, 15.0, 0.5, disturbance=lambda t, d=d: d).e[-1]
        assert e == pytest.approx(layer * d / (law.c * (law.sigma_gain + law.xi)), rel=1e-9)


def test_boundary_layer_spares_the_torque_what_the_sign_costs() -> None:
    """The torque varies as the disturbance does, by 4·4·10 rad/s² in 4 s; beyond dt K/Φ = 2 it rings."""
    soft, hard = (run(law, 4.0, disturbance=sine).u for law in (BoundaryLayerSMC(), SMC()))
    assert variation(soft) == pytest.approx(160.0, rel=0.01)
    assert variation(hard) > 500.0 * 160.0
    held, ringing = (run(BoundaryLayerSMC(layer=DT * 20.01 / x), 4.0, disturbance=sine).u for x in (1.8, 2.2))
    assert variation(held) < 2.0 * 160.0
    assert variation(ringing) > 50.0 * 160.0


# Integral.


@quick
@given(e=errors, de=rates, layer=st.sampled_from([0.0, 0.025]))
def test_integral_smc_starts_on_its_surface(e: float, de: float, layer: float) -> None:
    """In the first tick it is computed torque, wherever it starts; no sign acts yet."""
    law, nominal = IntegralSMC(layer=layer), CTC()
    assert law.law(law, e, de, DT, law.initial)[0] == nominal.law(nominal, e, de, DT, ())[0]


def sliding(law: IntegralSMC, **how: object) -> tuple[np.ndarray, np.ndarray]:
    """Errors and σ of a run from -0.5 rad, 1 rad/s; σ_{k+1} = ė_{k+1} + z, z being the state after tick k."""
    moved = run(law, 4.0, -0.5, 1.0, **how)  # type: ignore[arg-type]
    z = np.array([-1.0, *[s[1] for s in moved.state[:-1]]])
    return moved.e, moved.de + z


@every_disturbance
def test_integral_smc_has_no_reaching_phase(disturbance: Callable[[float], float]) -> None:
    """From the first tick on |σ| <= Φ D/K with a layer, and <= dt (K + D) with the sign."""
    gain, d = 20.01, 10.0
    for layer, bound in ((0.025, 0.025 * d / gain), (0.0, DT * (gain + d))):
        _, sigma = sliding(IntegralSMC(layer=layer), disturbance=disturbance)
        assert sigma[0] == 0.0
        assert np.abs(sigma).max() <= bound * (1.0 + 1e-9)


@every_disturbance
@pytest.mark.parametrize("layer", [0.0, 0.025])
def test_integral_smc_moves_as_without_disturbance(
    disturbance: Callable[[float], float], layer: float
) -> None:
    """As computed torque alone: what differs is σ through s/(s² + kd s + kp), at most its gain times |σ|."""
    e, sigma = sliding(IntegralSMC(layer=layer), disturbance=disturbance)
    law = CTC()
    nominal = run(law, 4.0, -0.5, 1.0).e
    a = np.array([[1.0, DT], [0.0, 1.0]]) - np.outer([DT * DT / 2, DT], [law.kp, law.kd])
    answers, x = [], np.array([DT / 2, 1.0])  # of e to one step of σ, which is one of the velocity
    for _ in range(4000):
        answers.append(x[0])
        x = a @ x
    steps = np.abs(np.diff(answers, prepend=0.0)).sum()
    assert np.abs(e - nominal).max() <= steps * np.abs(sigma).max() * (1.0 + 1e-9)
    alone = run(law, 4.0, -0.5, 1.0, disturbance=disturbance).e
    if disturbance(0.1):
        assert np.abs(e - nominal).max() < 0.05 * np.abs(alone - nominal).max()


def test_integral_smc_leaves_no_error_of_a_constant_disturbance() -> None:
    """Though it has a layer: the integral of the error settles instead."""
    assert abs(run(IntegralSMC(), 4.0, -0.5, disturbance=lambda t: 10.0).e[-1]) < 1e-12


# Continuous terminal.


@pytest.mark.parametrize("e0", [0.01, 0.1, 0.5, 2.0])
def test_terminal_error_vanishes_in_finite_time(e0: float) -> None:
    """Started on the surface: at the time the formula gives, not before; then it stays at the ripple."""
    law = ContinuousTSMC()
    bound = law.settling_time_bound(e0, 0)
    assert bound == law.settling_time_bound(-e0, 0) == terminal_time(e0, law.beta, law.gamma)
    moved = run(law, 1.5 * bound, e0, -((e0 / law.beta) ** (1.0 / law.gamma)), dt=1e-4)
    when = moved.t[np.abs(moved.e) > 1e-4 * e0][-1]
    missing = law.settling_time_bound(1e-4 * e0, 0)
    assert when == pytest.approx(bound - missing, abs=0.01 * bound)
    assert np.abs(moved.e[moved.t > 1.1 * bound]).max() < 1e-5


def largest_sigma(law: ContinuousTSMC, d: float) -> float:
    """φ of k1 φ + k2 φ^½ = d, for ρ = ½: what a disturbance d leaves of σ, rad."""
    assert law.rho == 0.5
    return ((math.sqrt(law.k2 * law.k2 + 4.0 * law.k1 * d) - law.k2) / (2.0 * law.k1)) ** 2


@every_disturbance
def test_terminal_reaching_law_leaves_what_it_says(disturbance: Callable[[float], float]) -> None:
    """|σ| <= φ with k1 φ + k2 φ^ρ = D; where |e| > φ it falls, so |e| <= φ in the end, and β |ė|^γ <= 2 φ."""
    law = ContinuousTSMC()
    moved = run(law, 8.0, -0.5, disturbance=disturbance)
    phi, late = largest_sigma(law, 10.0), slice(-6000, None)
    e, de = moved.e[late], moved.de[late]
    assert np.abs(e + law.beta * np.abs(de) ** law.gamma * np.sign(de)).max() <= phi
    assert np.abs(e).max() <= phi
    assert np.abs(de).max() <= (2.0 * phi / law.beta) ** (1.0 / law.gamma)


def test_terminal_law_rejects_more_than_the_linear_one_of_the_same_stiffness() -> None:
    """A constant disturbance leaves e = φ; k1 alone would leave D/k1, ten times as much and more."""
    law = ContinuousTSMC(k1=100.0, k2=100.0)
    e = run(law, 8.0, 0.0, disturbance=lambda t: 2.0).e[-1]
    assert e == pytest.approx(largest_sigma(law, 2.0), rel=1e-3)
    assert e < 0.1 * 2.0 / 100.0


# Fixed time.


@pytest.mark.parametrize(("alpha", "beta", "m", "r"), [(2.0, 2.0, 2.0, 0.7), (1.0, 3.0, 1.8, 0.6)])
def test_fixed_time_bounds_the_time_from_anywhere(alpha: float, beta: float, m: float, r: float) -> None:
    """∫ dx/(α x^m + β x^r) from 0, in ln x: below the bound up to 1e12, and more than half of it."""
    log = np.linspace(math.log(1e-40), math.log(1e12), 200_001)
    x = np.exp(log)
    speed = x / (alpha * x**m + beta * x**r)
    time = np.concatenate([[0.0], np.cumsum(0.5 * (speed[1:] + speed[:-1]) * np.diff(log))])
    bound = fixed_time(alpha, beta, m, r)
    assert 0.5 * bound < time[-1] < bound
    assert time[np.searchsorted(x, 1.0)] < time[np.searchsorted(x, 1e3)] < bound


@quick
@given(e=errors, de=rates, d=st.floats(-10.0, 10.0))
def test_fixed_time_feedback_gives_the_reaching_law(e: float, de: float, d: float) -> None:
    """σ̇ along e + ė t + a t²/2 is -μ (α2 |σ|^m2 + β2 |σ|^r2) sgn σ plus x/(r1 g) times d."""
    assume(abs(e) > 0.05)
    assume(abs(de) > 0.05)
    p = FixedTimeNFTSMC()
    shape, h = (p.alpha1, p.beta1, p.m1, p.r1), 1e-6
    a = fixed_time_feedback(e, de, *shape, p.alpha2, p.beta2, p.m2, p.r2, p.tau) + d
    sigma, w, g = fixed_time_surface(e, de, *shape)
    after, before = (fixed_time_surface(e + de * t + a * t * t / 2, de + a * t, *shape)[0] for t in (h, -h))
    x = abs(w) ** (1.0 / p.r1 - 1.0)
    mu = 1.0 if x >= p.tau else math.sin(math.pi * x / (2.0 * p.tau))
    reaching = mu * (p.alpha2 * sig(sigma, p.m2) + p.beta2 * sig(sigma, p.r2))
    expected = x / (p.r1 * g) * d - reaching
    assert (after - before) / (2 * h) == pytest.approx(expected, rel=1e-5, abs=1e-5 * (1 + abs(a)))


@quick
@given(e=st.floats(-10.0, 10.0), de=st.sampled_from([0.0, 1e-300, -1e-12, 1e-3]))
def test_fixed_time_feedback_is_bounded_at_rest(e: float, de: float) -> None:
    """Where dividing by |w|^(1/r1-1) would be singular: below its value at ė = 0."""
    p = FixedTimeNFTSMC()
    a = fixed_time_feedback(e, de, p.alpha1, p.beta1, p.m1, p.r1, p.alpha2, p.beta2, p.m2, p.r2, p.tau)
    g = p.alpha1 * abs(e) ** (p.m1 - p.r1) + p.beta1
    sigma = abs(e) + 0.01
    largest = p.r1 * g * math.pi / (2 * p.tau) * (p.alpha2 * sigma**p.m2 + p.beta2 * sigma**p.r2)
    assert abs(a) <= largest + p.r1 * g * g * 0.1


STARTS = [1e-3, 1e-2, 0.1, 1.0, 10.0, 100.0]


def times(law: Controller, duration: float, disturbance: Callable[[float], float], dt: float) -> list[float]:
    """Times after which |e| stays below 0.1 mrad, from each start at rest, s."""
    found = []
    for e0 in STARTS:
        moved = run(law, duration, e0, disturbance=disturbance, dt=dt)
        found.append(float(moved.t[np.abs(moved.e) > 1e-4][-1]))
    return found


@pytest.mark.parametrize("disturbance", [DISTURBANCES[0], sine], ids=["none", "sine"])
def test_fixed_time_law_is_at_zero_within_its_bound(disturbance: Callable[[float], float]) -> None:
    """From 1 mrad to 100 rad; the bound is that of reaching and sliding. 100 rad take 3 % longer than 10."""
    p = FixedTimeNFTSMC(layer=0.0)
    bound = fixed_time(p.alpha2, p.beta2, p.m2, p.r2) + p.settling_time_bound(123.0, 0)
    found = times(p, 4.0, disturbance, 2e-4)
    assert bound == pytest.approx(2 * (0.5 + 1 / 0.6))
    assert found == sorted(found)
    assert found[-1] < 1.03 * found[-2] < 0.5 * bound


def test_finite_time_is_not_fixed_time() -> None:
    """From ten times the error the finite-time law takes 10^(1-1/γ) as long, 2.5 times, again and again."""
    found = times(ContinuousTSMC(), 20.0, DISTURBANCES[0], DT)[2:]
    assert all(2.0 < b / a < 3.0 for a, b in pairwise(found))


def test_fixed_time_holds_for_a_tick_short_enough_only() -> None:
    """From 1000 rad, at 1 kHz: dt α m |x| = 4. The torque overshoots, and no float can hold what follows."""
    with pytest.raises(OverflowError):
        run(FixedTimeNFTSMC(), 1.0, 1e3)
    assert abs(run(FixedTimeNFTSMC(), 4.0, 10.0).e[-1]) < 1e-3


@every_disturbance
def test_fixed_time_law_with_a_layer_leaves_a_small_error(disturbance: Callable[[float], float]) -> None:
    """|e| <= Φ D/(Σ + ξ) in the end, by a torque that varies as the disturbance does, and ripples by 2e-4."""
    law = FixedTimeNFTSMC()
    moved = run(law, 5.0, -0.5, disturbance=disturbance)
    assert np.abs(moved.e[-2000:]).max() <= law.layer * 10.0 / (law.sigma_gain + law.xi)
    assert variation(moved.u[-2001:]) <= 1.1 * variation([disturbance(t) for t in moved.t[-2001:]]) + 1.0


def test_fixed_time_law_without_a_layer_is_as_exact_as_the_tick_is_short() -> None:
    """An error of the order of dt at least, at the price of a torque that jumps in every tick."""
    left = {}
    for dt in (1e-3, 1e-4):
        moved = run(FixedTimeNFTSMC(layer=0.0), 4.0, -0.5, disturbance=sine, dt=dt)
        left[dt] = np.abs(moved.e[moved.t > 3.0]).max()
    assert left[1e-4] < 0.1 * left[1e-3] < 1e-4
    assert variation(moved.u[moved.t > 3.0]) > 1e5


def test_fixed_time_law_refuses_a_surface_of_unbounded_rate() -> None:
    """m1 - r1 > 1, joint by joint."""
    with pytest.raises(ParameterError, match=r"^m1: m1 - r1 = 1\.6 - 0\.7 is out of range; expected above 1"):
        FixedTimeNFTSMC(m1=1.6)
    with pytest.raises(ParameterError, match=r"m1 - r1 = 1\.7 - 0\.8"):
        FixedTimeNFTSMC(m1=[2.0, 1.7], r1=[0.7, 0.8])
    assert FixedTimeNFTSMC(m1=[2.0, 1.7], r1=[0.9, 0.6]).settling_time_bound(1.0, 1) == pytest.approx(
        1 / (2 * 0.7) + 1 / (2 * 0.4)
    )


# Adaptive super-twisting.


def test_adaptation_step() -> None:
    """Up above μ, down below it, not below the floor; at the floor up at its own rate."""
    step = dict(mu=0.1, rate=100.0, floor=4.0, floor_rate=1.0, dt=0.01)
    assert adapted(10.0, 0.2, **step) == adapted(10.0, -0.2, **step) == 11.0
    assert adapted(10.0, 0.05, **step) == 9.0
    assert adapted(10.0, 0.1, **step) == 10.0
    assert adapted(4.5, 0.0, **step) == 4.0
    assert adapted(4.0, 0.0, **step) == adapted(1.0, 0.0, **step) == 4.01


def swinging(size: float) -> Callable[[float], float]:
    """A disturbance of an amplitude that the law is not told, at 1 Hz."""
    return lambda t: size * math.sin(2.0 * math.pi * t)


def test_adaptive_gain_becomes_what_is_needed() -> None:
    """For amplitudes over two decades |σ| <= μ about half of the time, and α grows with the disturbance.

    Between, α falls until it is too small, σ leaves, and α grows again: |σ| is up to some ten times μ.
    """
    law, needed = AdaptiveSuperTwisting(), []
    for size in (0.3, 3.0, 30.0):
        moved = run(law, 8.0, -0.2, disturbance=swinging(size), dt=5e-4)
        alpha, late = np.array([s[1] for s in moved.state]), moved.t > 4.0
        sigma = np.abs(moved.de + law.c * moved.e)[late]
        assert np.median(sigma) < 1.05 * law.mu
        assert sigma.max() < 20.0 * law.mu
        assert alpha.min() >= law.alpha_floor
        assert alpha[late].max() < 1.01 * alpha[~late].max(), "bounded: what it reached at first is enough"
        needed.append(alpha[late].max())
    assert needed[0] == pytest.approx(law.alpha_floor, abs=0.05)
    assert 2.0 * needed[0] < needed[1] < 0.5 * needed[2]


def test_adaptive_gain_falls_when_it_is_no_longer_needed_and_grows_again() -> None:
    """The disturbance pauses: α goes to its floor, and is back two seconds after it begins again.

    In these the error is as large as what the floor's gain leaves: the adaptation has a price.
    """
    law = AdaptiveSuperTwisting()
    moved = run(law, 12.0, disturbance=lambda t: 0.0 if 4.0 < t < 8.0 else swinging(30.0)(t), dt=5e-4)
    alpha, e = np.array([s[1] for s in moved.state]), np.abs(moved.e)
    times = ((3.0, 4.0), (7.0, 8.0), (8.0, 10.0), (11.0, 12.0))
    before, pause, begin, again = ((moved.t > a) & (moved.t < b) for a, b in times)
    assert alpha[pause].max() == pytest.approx(law.alpha_floor, abs=0.05)
    assert min(alpha[before].max(), alpha[again].max()) > 10.0 * law.alpha_floor
    assert max(e[before].max(), e[again].max()) < 0.005
    assert e[begin].max() > 0.05


def test_adaptive_gain_needs_a_mu_above_the_ripple_of_the_tick() -> None:
    """Below it, |σ| > μ whatever the gain, which then grows without end: as fast as it can."""
    law = AdaptiveSuperTwisting(mu=1e-7)
    alpha = [s[1] for s in run(law, 4.0, disturbance=sine).state]
    assert alpha[-1] > alpha[0] + 0.9 * 4.0 * law.omega
    enough = AdaptiveSuperTwisting()
    alpha = [s[1] for s in run(enough, 4.0, disturbance=sine).state]
    assert max(alpha) < 2.0 * math.sqrt(enough.mu) / DT, "where its ripple would be μ"


@quick
@given(e=errors, de=rates)
def test_sliding_variables(e: float, de: float) -> None:
    """What the report shows; integral sliding mode has none that e and ė determine."""
    assert AdaptiveSuperTwisting(c=3.0).sliding_variable(e, de, 0) == de + 3.0 * e
    assert BoundaryLayerSMC(c=3.0).sliding_variable(e, de, 0) == de + 3.0 * e
    assert IntegralSMC().sliding_variable(e, de, 0) is None
    p = ContinuousTSMC()
    assert p.sliding_variable(e, de, 0) == pytest.approx(e + 0.5 * abs(de) ** (5 / 3) * sgn(de), rel=1e-14)
    q = FixedTimeNFTSMC()
    slow = -(q.alpha1 * sig(e, q.m1) + q.beta1 * sig(e, q.r1))
    assert q.sliding_variable(e, slow, 0) == pytest.approx(0.0, abs=1e-12)
