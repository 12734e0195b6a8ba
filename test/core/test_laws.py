# SPDX-License-Identifier: Apache-2.0
"""The control laws: their equations, the paper's claims about them, and agreement with a matrix form."""

from __future__ import annotations

import math
import sys
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from ftcm_core.controllers import Controller
from ftcm_core.controllers.ctc import CTC
from ftcm_core.controllers.ftcm import FTCM
from ftcm_core.controllers.ftsmc import FTSMC
from ftcm_core.controllers.nftsmc import NFTSMC
from ftcm_core.controllers.pid import PID
from ftcm_core.controllers.smc import SMC
from ftcm_core.controllers.super_twisting import gain_condition, largest_bound, least_upsilon2, super_twisting
from ftcm_core.controllers.terminal_surface import settling_time_bound, surface_and_rate, switch_error
from ftcm_core.errors import ParameterError
from ftcm_core.numeric import logistic, sgn, sig
from ftcm_core.robots.puma560 import Puma560
from ftcm_core.signals import Measurement, ReferencePoint, Vector

sys.path.insert(0, str(Path(__file__).parents[1] / "reference"))
import laws_matrix
from robot_matrices import coriolis_matrix, mass_matrix

pytestmark = pytest.mark.pure

ROBOT, DT = Puma560(), 1e-3
ZERO = (0.0, 0.0, 0.0)
errors, rates = st.floats(-4.0, 4.0), st.floats(-5.0, 5.0)
gains = st.floats(0.5, 5.0)
surfaces = st.builds(
    dict, gamma1=gains, gamma2=gains, mu1=gains, mu2=gains, alpha=st.floats(0.3, 0.9), phi=st.floats(0.2, 2.0)
)
TABLE1 = {"gamma1": 2.0, "gamma2": 2.0, "mu1": 1.2, "mu2": 1.4, "alpha": 0.6, "phi": 1.0}
quick = settings(deadline=None, max_examples=200)


def vectors(bound: float) -> st.SearchStrategy[Vector]:
    """Three joint values up to a bound."""
    return st.tuples(*[st.floats(-bound, bound)] * 3)


def surface(e: float, de: float, epsilon: float = 1e-4, **p: float) -> float:
    """σ alone; ε has no part in it."""
    return surface_and_rate(e, de, epsilon=epsilon, **p)[0]


def surface_rate(e: float, de: float, **p: float) -> float:
    """S alone."""
    return surface_and_rate(e, de, **p)[1]


def step(
    law: Controller, dt: float, y: Measurement, r: ReferencePoint, tau_hat: Vector, state: Any
) -> tuple[Vector, Any]:
    """One tick of a law, prepared as the stage does it."""
    return law.step(ROBOT, dt, y, r, tau_hat, state, law.prepare(ROBOT, dt, y, r, state))


# Scalar helpers.


def test_signed_power_and_sign() -> None:
    """Real for negative numbers, zero at zero, where ** is complex or raises."""
    assert [sgn(x) for x in (-2.0, -0.0, 0.0, 1e-300)] == [-1.0, 0.0, 0.0, 1.0]
    assert sig(-8.0, 1 / 3) == pytest.approx(-2.0, rel=1e-14)
    assert [sig(0.0, 0.5), sig(-0.0, 2.0), sig(4.0, 0.5)] == [0.0, 0.0, 2.0]


@given(st.floats(-1e308, 1e308))
def test_logistic_never_overflows(x: float) -> None:
    """In [0, 1], and 1 with its mirror image."""
    assert 0.0 <= logistic(x) <= 1.0
    assert logistic(x) + logistic(-x) == pytest.approx(1.0, abs=3e-16)


# The terminal surface: eqs 8 and 13 to 17.


@pytest.mark.parametrize(
    ("e", "de", "sigma"),
    [
        (0.0, 0.7, 0.7),
        (1.0, 0.0, 4.0),  # both weights are one half at |e| = φ
        (-1.0, 0.5, -3.5),
        (0.5, 0.0, 4 / (1 + math.exp(0.6)) * 0.5 + 4 / (1 + math.exp(-0.7)) * 0.5**0.6),
        (-2.0, 0.0, -(4 / (1 + math.exp(-1.2)) * 2.0 + 4 / (1 + math.exp(1.4)) * 2.0**0.6)),
    ],
)
def test_surface_at_hand_computed_points(e: float, de: float, sigma: float) -> None:
    """Eq 8 with Table 1's parameters."""
    assert surface(e, de, **TABLE1) == pytest.approx(sigma, rel=1e-14)


@quick
@given(e=errors, de=rates, p=surfaces)
def test_surface_and_rate_are_odd(e: float, de: float, p: dict[str, float]) -> None:
    """Exactly: the law does not prefer a direction."""
    assert surface(-e, -de, **p) == -surface(e, de, **p)
    assert surface_rate(-e, -de, **p, epsilon=1e-4) == -surface_rate(e, de, **p, epsilon=1e-4)


@quick
@given(e=errors, de=st.floats(-2.0, 2.0), dde=st.floats(-20.0, 20.0), p=surfaces)
def test_rate_is_the_derivative_along_a_trajectory(
    e: float, de: float, dde: float, p: dict[str, float]
) -> None:
    """σ̇ = S(e, ė) + ë for e(t) = e + ė t + ½ ë t² (eq 17), away from the singularity."""
    assume(abs(e) > 0.05)
    h = 1e-6

    def sigma(t: float) -> float:
        return surface(e + de * t + 0.5 * dde * t * t, de + dde * t, **p)

    numeric = (sigma(h) - sigma(-h)) / (2 * h)
    assert surface_rate(e, de, **p, epsilon=1e-4) + dde == pytest.approx(numeric, abs=2e-8)


@quick
@given(e=errors, p=surfaces)
def test_surface_is_continuous_and_grows_with_the_error(e: float, p: dict[str, float]) -> None:
    """Also at e = 0, where it grows like |e|^α, and at |e| = φ; σ has the sign of e."""
    for at in (e, 0.0, p["phi"]):
        gap = abs(surface(at + 1e-12, 0.0, **p) - surface(at, 0.0, **p))
        assert gap <= 4 * p["gamma2"] * 1e-12 ** p["alpha"] + 1e-10
    assert sgn(surface(e, 0.0, **p)) == sgn(e)


@quick
@given(e=errors, de=rates, p=surfaces, epsilon=st.floats(1e-8, 0.1))
def test_epsilon_acts_only_below_itself(e: float, de: float, p: dict[str, float], epsilon: float) -> None:
    """Above ε nothing changes; at e = 0 the slope is that of |e| = ε; S is continuous across ε."""
    assert surface(e, de, **p, epsilon=epsilon) == surface(e, de, **p)
    if abs(e) >= epsilon:
        assert surface_rate(e, de, **p, epsilon=epsilon) == surface_rate(e, de, **p, epsilon=1e-300)
    z, a, phi = 0.0, p["alpha"], p["phi"]
    w1, w2 = 1 / (1 + math.exp(-p["mu1"] * (z - phi))), 1 / (1 + math.exp(p["mu2"] * (z - phi)))
    slope = 2 * p["gamma1"] * w1 + 2 * p["gamma2"] * a * w2 * epsilon ** (a - 1)
    assert surface_rate(0.0, de, **p, epsilon=epsilon) == pytest.approx(slope * de, rel=1e-13)
    across = [surface_rate(epsilon * (1 + x), de, **p, epsilon=epsilon) for x in (-1e-12, 1e-12)]
    assert across[0] == pytest.approx(across[1], rel=1e-10)


@pytest.mark.parametrize(
    ("gamma1", "gamma2", "alpha", "phi"),
    [(2.0, 2.0, 0.6, 1.0), (1.0, 2.0, 0.5, 4.0), (2.0, 1.0, 0.75, 0.0625)],
)
def test_switch_error(gamma1: float, gamma2: float, alpha: float, phi: float) -> None:
    """φ = (γ2/γ1)^(1/(1-α)): there the linear and the terminal gain give the same rate, γ1 φ = γ2 φ^α."""
    assert switch_error(gamma1, gamma2, alpha) == pytest.approx(phi, rel=1e-14)
    assert gamma1 * phi == pytest.approx(gamma2 * phi**alpha, rel=1e-14)
    assert FTCM(gamma1=gamma1, gamma2=gamma2, alpha=alpha).phi == pytest.approx(phi, rel=1e-14)


def time_on_surface(e0: float, p: dict[str, float]) -> float:
    """Time from e0 to zero on σ = 0 (eq 10), s; Gauss quadrature over |e|^(1-α) removes the singularity."""
    nodes, weights = np.polynomial.legendre.leggauss(200)
    power = 1 / (1 - p["alpha"])
    top = e0 ** (1 / power)
    x = 0.5 * top * (nodes + 1)
    speed = np.array([surface(float(z), 0.0, **p) for z in x**power])
    return float(0.5 * top * weights @ (power * x ** (power - 1) / speed))


@pytest.mark.parametrize("e0", [0.01, 0.5, 1.0, 2.0, 10.0])
@pytest.mark.parametrize(("gamma1", "gamma2", "alpha"), [(2.0, 2.0, 0.6), (1.0, 2.0, 0.5), (3.0, 1.0, 0.7)])
def test_settling_time_bound_holds(e0: float, gamma1: float, gamma2: float, alpha: float) -> None:
    """Eqs 13 to 15 against eq 10 integrated: above the true time, by less than a factor of 2.5."""
    p = dict(
        gamma1=gamma1, gamma2=gamma2, mu1=1.2, mu2=1.4, alpha=alpha, phi=switch_error(gamma1, gamma2, alpha)
    )
    bound = settling_time_bound(e0, gamma1, gamma2, alpha)
    assert 1.0 < bound / time_on_surface(e0, p) < 2.5
    assert bound == settling_time_bound(-e0, gamma1, gamma2, alpha)
    assert bound == FTSMC(gamma1=[1, gamma1, 1], gamma2=gamma2, alpha=alpha).settling_time_bound(e0, 1)


def test_settling_time_bound_at_hand_computed_points() -> None:
    """Table 1: φ = 1, so ln(e²)/2 + 1/(2·0.4) from e², and 0.5^0.4/0.8 from the paper's 0.5 rad."""
    assert settling_time_bound(math.e**2, 2.0, 2.0, 0.6) == pytest.approx(1.0 + 1.25, rel=1e-14)
    assert settling_time_bound(0.5, 2.0, 2.0, 0.6) == pytest.approx(0.5**0.4 / 0.8, rel=1e-14)
    assert settling_time_bound(0.0, 2.0, 2.0, 0.6) == 0.0


@pytest.mark.parametrize(("gamma1", "gamma2"), [(2.0, 1.0), (1.0, 2.0), (1e300, 1e-300), (1e-300, 1e300)])
def test_extreme_switch_errors_do_not_raise(gamma1: float, gamma2: float) -> None:
    """φ under- or overflows when α is near 1; surface and settling time must still be numbers."""
    law = FTCM(gamma1=gamma1, gamma2=gamma2, alpha=0.9999)
    assert not math.isnan(law.sliding_variable(0.5, 0.1, 0))
    assert law.settling_time_bound(0.5, 0) >= 0.0


# Super-twisting: eqs 33 and 34.


def test_super_twisting_step() -> None:
    """u_r at t_k uses η at t_k; then η grows with +Υ2 sgn σ."""
    assert super_twisting(4.0, 0.5, 16.0, 20.0, 0.01) == (32.5, 0.7)
    assert super_twisting(-4.0, 0.5, 16.0, 20.0, 0.01) == (-31.5, pytest.approx(0.3, rel=1e-14))
    assert super_twisting(0.0, 0.5, 16.0, 20.0, 0.01) == (0.5, 0.5)


@pytest.mark.parametrize(("sign", "stable"), [(1.0, True), (-1.0, False)])
def test_super_twisting_sign(sign: float, stable: bool) -> None:
    """σ̇ = d - u_r: with +Υ2 σ vanishes and η becomes d; with the printed -Υ2 it runs away."""
    sigma, eta, d, dt = 0.5, 0.0, 3.0, 1e-4
    for _ in range(20_000):
        u_r, eta = super_twisting(sigma, eta, 16.0, sign * 20.0, dt)
        sigma += dt * (d - u_r)
    assert (abs(sigma) < 1e-5) is stable
    assert (abs(eta - d) < 0.01) is stable


@quick
@given(upsilon1=st.floats(0.1, 100.0), upsilon2=st.floats(0.1, 1000.0), share=st.floats(0.0, 2.0))
def test_gain_condition_is_one_condition(upsilon1: float, upsilon2: float, share: float) -> None:
    """Met exactly below the largest Π, above the least Υ2; eq 34 as printed decides."""
    assume(abs(share - 1) > 1e-9)
    pi = share * largest_bound(upsilon1, upsilon2)
    printed = upsilon1 > 2 * pi and upsilon2 > upsilon1 * (5 * pi * upsilon1 + 4 * pi**2) / (
        2 * (upsilon1 - 2 * pi)
    )
    assert gain_condition(upsilon1, upsilon2, pi) is (share < 1) is printed
    assert (least_upsilon2(upsilon1, pi) < upsilon2) is (share < 1)


def test_gain_condition_of_table_1() -> None:
    """Υ = (16, 20) allows Π < 0.4606; beyond Υ1 = 2 Π no Υ2 will do."""
    assert largest_bound(16.0, 20.0) == pytest.approx(0.4606, abs=5e-5)
    assert least_upsilon2(16.0, 0.4) == pytest.approx(16 * (5 * 0.4 * 16 + 4 * 0.16) / (2 * 15.2), rel=1e-14)
    assert least_upsilon2(16.0, 8.0) == math.inf
    assert gain_condition(16.0, 20.0, 0.46)
    assert not gain_condition(16.0, 20.0, 0.461)
    assert FTCM().warnings() == []


def test_warnings_give_the_numbers() -> None:
    """One line: the gains, what eq 34 asks of them, and the Π they allow; per joint where joints differ."""
    assert FTCM(pi=0.5).warnings() == [
        "controller ftcm, all joints: the gain condition (eq 34) fails: upsilon1=16, upsilon2=20, pi=0.5; "
        "it needs upsilon1 > 1 and upsilon2 > 21.87; these gains allow pi < 0.4606"
    ]
    (line,) = FTCM(upsilon2=[20, 20, 10]).warnings()
    assert line.startswith(
        "controller ftcm, joint 3: the gain condition (eq 34) fails: upsilon1=16, upsilon2=10"
    )
    assert "upsilon1 > 1 and upsilon2 > inf" in FTCM(upsilon1=1, pi=0.5).warnings()[0]
    assert [law().warnings() for law in (SMC, NFTSMC, FTSMC, CTC, PID)] == [[]] * 5


# Against the matrix form.


def situation(y: Measurement, r: ReferencePoint) -> laws_matrix.Situation:
    """The same tick as arrays, with the robot's matrices."""
    return laws_matrix.Situation(
        *map(np.array, (*y[:2], *r)),
        mass_matrix(ROBOT, y.position),
        coriolis_matrix(ROBOT, y.position, y.velocity),
        np.array(ROBOT.gravity(y.position)),
    )


def arrays(law: Controller) -> Any:
    """Parameters as arrays, one entry per joint, under the law's names."""
    return SimpleNamespace(**{k: np.broadcast_to(v, 3) for k, v in law.values.items()})


def matrix_form(
    law: Controller, s: laws_matrix.Situation, tau_hat: Vector, eta: Vector
) -> tuple[Any, Any, Any]:
    """Torque, σ and next η of the oracle."""
    p = arrays(law)
    if isinstance(law, SMC):
        return *laws_matrix.smc(s, p.c, p.sigma_gain + p.xi), None
    if isinstance(law, NFTSMC):
        return *laws_matrix.nftsmc(s, p.varpi, law.l / law.q, p.sigma_gain + p.xi), None
    if isinstance(law, FTSMC):
        return *laws_matrix.ftsmc(s, p), None
    return laws_matrix.ftcm(s, p, np.linalg.solve(s.mass, tau_hat), np.array(eta), DT)


one = st.floats(0.5, 20.0)
either = st.one_of(one, st.lists(one, min_size=3, max_size=3))
exponent, sharpness = st.floats(0.3, 0.75), st.floats(0.5, 4.0)
terminal = {
    **dict.fromkeys(("gamma1", "gamma2"), st.floats(1.0, 3.0)),
    **dict.fromkeys(("mu1", "mu2"), st.one_of(sharpness, st.lists(sharpness, min_size=3, max_size=3))),
    "alpha": st.one_of(exponent, st.lists(exponent, min_size=3, max_size=3)),
    "epsilon": st.sampled_from([1e-8, 1e-4, 0.1]),
}
laws = st.one_of(
    st.sampled_from([SMC(), NFTSMC(), FTSMC(), FTCM()]),
    st.builds(SMC, c=either, sigma_gain=either, xi=either),
    st.builds(NFTSMC, l=st.sampled_from([7, 9]), q=st.just(5), varpi=either, sigma_gain=either, xi=either),
    st.builds(FTSMC, **terminal, lambda_bound=either, rho=either),
    st.builds(FTCM, **terminal, upsilon1=either, upsilon2=either),
)


@settings(deadline=None, max_examples=500)
@given(
    law=laws,
    y=st.builds(Measurement, vectors(3.0), vectors(3.0), st.just(ZERO)),
    r=st.builds(ReferencePoint, vectors(3.0), vectors(3.0), vectors(20.0)),
    tau_hat=vectors(50.0),
    eta=vectors(20.0),
)
def test_one_step_agrees_with_the_matrix_form(
    law: Controller, y: Measurement, r: ReferencePoint, tau_hat: Vector, eta: Vector
) -> None:
    """Torque (to 1e-12 of its largest term), σ and η; where sgn σ is not a matter of rounding."""
    s = situation(y, r)
    expected, sigma, eta_next = matrix_form(law, s, tau_hat, eta)
    assume(np.all((np.abs(sigma) > 1e-6) | (sigma == 0)))
    state = tuple((x,) for x in eta) if isinstance(law, FTCM) else law.init(3)
    u, following = step(law, DT, y, r, tau_hat, state)
    found = [law.sliding_variable(e, de, j) for j, (e, de) in enumerate(zip(s.e.tolist(), s.de.tolist()))]
    assert found == pytest.approx(sigma, rel=1e-14, abs=1e-13)
    assert u == pytest.approx(expected, rel=0, abs=1e-12 * max(100.0, np.abs(expected).max()))
    if eta_next is not None:
        assert [x for (x,) in following] == pytest.approx(eta_next, rel=1e-14, abs=1e-15)


def test_first_torque_of_the_paper() -> None:
    """At rest, 0.5 rad off: u(0), N·m; the switching laws begin alike, for ė = 0 leaves only sgn e."""
    y, r = Measurement(ZERO, ZERO, ZERO), ReferencePoint((0.5,) * 3, ZERO, (-1 / (5 * math.pi) ** 2,) * 3)
    golden = {
        FTCM: (92.634475422, 138.797617516, 34.269263113),
        SMC: (73.680662995, 102.837934950, 27.308423934),
    }
    golden[NFTSMC] = golden[SMC]
    for law, expected in golden.items():
        u, _ = step(law(), DT, y, r, ZERO, law().init(3))
        assert u == pytest.approx(expected, abs=1e-9)


def test_parameters_are_those_of_table_1() -> None:
    """The defaults."""
    smc, nftsmc, ftcm = SMC(), NFTSMC(), FTCM()
    assert (smc.c, smc.xi, smc.sigma_gain) == (2, 0.01, 20)
    assert (nftsmc.l, nftsmc.q, nftsmc.varpi, nftsmc.xi, nftsmc.sigma_gain) == (5, 3, 2, 0.01, 20)
    assert (ftcm.gamma1, ftcm.gamma2, ftcm.mu1, ftcm.mu2) == (2.0, 2.0, 1.2, 1.4)
    assert (ftcm.phi, ftcm.alpha, ftcm.upsilon1, ftcm.upsilon2) == (1, 0.6, 16, 20)


@pytest.mark.parametrize(("l", "q"), [(3, 3), (2, 1), (7, 3), (4, 3), (5, 4)])
def test_nftsmc_refuses_singular_exponents(l: int, q: int) -> None:  # noqa: E741
    """1 < l/q < 2, both odd."""
    with pytest.raises(ParameterError):
        NFTSMC(l=l, q=q)


# Baselines.


@quick
@given(q=vectors(3.0), v=vectors(3.0), qr=vectors(3.0), vr=vectors(3.0), ar=vectors(20.0))
def test_computed_torque_gives_linear_error_dynamics(
    q: Vector, v: Vector, qr: Vector, vr: Vector, ar: Vector
) -> None:
    """ë + kd ė + kp e = 0 on the nominal robot."""
    law = CTC(kp=[50, 60, 70], kd=[5, 6, 7])
    u, _ = step(law, DT, Measurement(q, v, ZERO), ReferencePoint(qr, vr, ar), ZERO, law.init(3))
    a = ROBOT.forward_dynamics(q, v, u)
    for j in range(3):
        feedback = law.kd[j] * (v[j] - vr[j]) + law.kp[j] * (q[j] - qr[j])
        assert a[j] - ar[j] + feedback == pytest.approx(0.0, abs=1e-10)


def pid_step(law: PID, e: float, state: Any) -> tuple[Vector, Any]:
    """One tick of joint errors e at rest at q = 0; the torque without gravity."""
    rest = ReferencePoint((-e,) * 3, ZERO, ZERO)
    u, state = step(law, 0.01, Measurement(ZERO, ZERO, ZERO), rest, ZERO, state)
    return tuple(x - g for x, g in zip(u, ROBOT.gravity(ZERO))), state


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_pid_integral_is_limited_and_unwinds(sign: float) -> None:
    """It grows as ki ∫e to its limit, no further, and shrinks at once when the error turns."""
    law = PID(kp=100.0, kd=0.0, ki=200.0, integral_limit=[30.0, 20.0, 10.0])
    state, integrals = law.init(3), []
    for e in [sign] * 50 + [-sign] * 5:
        u, state = pid_step(law, e, state)
        integrals.append([-sign * x - 100.0 * sign * e for x in u])
    grown, turned = np.array(integrals[:50]), np.array(integrals[50:])
    expected = np.minimum(2.0 * np.arange(50)[:, None], law.integral_limit)
    assert grown == pytest.approx(expected, abs=1e-12)
    assert turned == pytest.approx(np.array(law.integral_limit) - 2.0 * np.arange(5)[:, None], abs=1e-12)


def test_pid_obeys_a_lowered_limit_at_once() -> None:
    """A swap keeps the integral; the torque of the next tick must be within the new limit already."""
    _, state = pid_step(PID(kp=100.0, kd=0.0), 0.0, ((25.0,),) * 3)
    u, _ = pid_step(PID(kp=100.0, kd=0.0, integral_limit=10.0), 0.0, state)
    assert max(map(abs, u)) <= 10.0 + 1e-12
