# SPDX-License-Identifier: Apache-2.0
"""The discrete-time forms of the proposed law: the claims of docs/discretisation.md and its table."""

from __future__ import annotations

import math
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from ftcm_core.controllers.ftcm import FTCM
from ftcm_core.controllers.implicit import implicit_law, resolvent
from ftcm_core.controllers.super_twisting import implicit_super_twisting
from ftcm_core.controllers.terminal_surface import surface_and_rate
from ftcm_core.recording.metrics import evaluate
from ftcm_core.recording.trace import Trace
from ftcm_core.scenario import load
from ftcm_core.simulation import simulate

pytestmark = pytest.mark.pure

DT = 1e-3
PAGE = Path(__file__).resolve().parents[2] / "docs" / "discretisation.md"
COLUMNS = [
    ("after_transient", "torque_total_variation"),
    ("after_transient", "mean_abs_error"),
    ("after_fault", "mean_abs_error"),
    ("after_fault", "max_abs_error"),
    ("whole", "mean_abs_error"),
]
"""Window and metric of the page's columns."""

errors = st.one_of(st.floats(-2.0, 2.0), st.floats(-1e-5, 1e-5), st.floats(-1e-12, 1e-12))
rates = st.floats(-5.0, 5.0)


def shape(p: FTCM) -> tuple[float, ...]:
    """The surface's parameters."""
    return p.gamma1, p.gamma2, p.mu1, p.mu2, p.alpha, p.phi


# Explicit: the paper's law.


def printed_law(p: FTCM, e: float, de: float, dt: float, eta: float) -> tuple[float, float]:
    """Eqs 8, 17 and 33 as they stood before the law had a choice, operation for operation."""

    def logistic(x: float) -> float:
        if x >= 0.0:
            return 1.0 / (1.0 + math.exp(-x))
        return math.exp(x) / (1.0 + math.exp(x))

    def sgn(x: float) -> float:
        return float((x > 0.0) - (x < 0.0))

    z = abs(e)
    w1, w2 = logistic(p.mu1 * (z - p.phi)), logistic(-p.mu2 * (z - p.phi))
    sigma = de + 2.0 * p.gamma1 * w1 * e + 2.0 * p.gamma2 * w2 * float(z**p.alpha) * sgn(e)
    slope = (
        2.0 * p.gamma1 * w1
        + 2.0 * p.gamma1 * p.mu1 * w1 * (1.0 - w1) * z
        + 2.0 * p.gamma2 * p.alpha * w2 * max(z, p.epsilon) ** (p.alpha - 1.0)
        - 2.0 * p.gamma2 * p.mu2 * w2 * (1.0 - w2) * z**p.alpha
    )
    power = abs(sigma) ** 0.5 * sgn(sigma)
    return -(slope * de) - (p.upsilon1 * power + eta), eta + dt * p.upsilon2 * sgn(sigma)


@settings(deadline=None, max_examples=500)
@given(e=errors, de=rates, eta=st.floats(-30.0, 30.0))
def test_explicit_is_the_printed_law_bit_for_bit(e: float, de: float, eta: float) -> None:
    """And the default."""
    a, s = FTCM.law(FTCM(), e, de, DT, (eta,))
    assert (a, s) == (printed_law(FTCM(), e, de, DT, eta)[0], (printed_law(FTCM(), e, de, DT, eta)[1],))
    assert FTCM().discretisation == "explicit"


# Implicit: what is solved is solved.


@settings(deadline=None, max_examples=500)
@given(
    x=errors,
    h=st.sampled_from([1e-5, 1e-3, 0.02, 1.0]),
    p=st.builds(
        FTCM,
        gamma1=st.floats(0.01, 100.0),
        gamma2=st.floats(0.01, 100.0),
        mu1=st.floats(0.1, 10.0),
        mu2=st.floats(0.1, 10.0),
        alpha=st.floats(0.05, 0.95),
    ),
)
def test_resolvent_solves_its_equation(x: float, h: float, p: FTCM) -> None:
    """y + h g(y) = x to 1e-12 of x, g(y) the paper's surface at y, both odd in x."""
    y, g = resolvent(x, h, *shape(p))
    assert abs(y + h * g - x) <= 1e-12 * abs(x) + 1e-320
    if abs(y) > 1e-250:  # below, s = |y|^α is a normal number and y is not
        assert g == pytest.approx(surface_and_rate(y, 0.0, *shape(p), p.epsilon)[0], rel=1e-12)
    assert resolvent(-x, h, *shape(p)) == (-y, -g)


@pytest.mark.parametrize("p", [FTCM(), FTCM(gamma1=1.0, gamma2=38.0, mu1=1.0, mu2=1.0, alpha=0.5)])
@pytest.mark.parametrize("h", [DT, 0.02])
@pytest.mark.parametrize("x", [0.0, 5e-324, -1e-320, 1e-200, 1e200, -1e300])
def test_resolvent_at_the_ends_of_the_floats(x: float, h: float, p: FTCM) -> None:
    """No division by zero, no overflow."""
    assert all(map(math.isfinite, resolvent(x, h, *shape(p))))


@settings(deadline=None)
@given(x=errors, d=st.floats(1e-9, 1e-2))
def test_regularised_surface_has_slope_below_one_over_h(x: float, d: float) -> None:
    """Where the paper's own slope is unbounded."""
    low, high = (resolvent(z, DT, *shape(FTCM()))[1] for z in (x, x + d))
    assert -1e-9 <= high - low <= d / DT * (1.0 + 1e-6)


@settings(deadline=None, max_examples=500)
@given(sigma=st.floats(-5.0, 5.0), eta=st.floats(-30.0, 30.0), horizon=st.floats(1.0, 50.0))
def test_super_twisting_solves_its_inclusion(sigma: float, eta: float, horizon: float) -> None:
    """z + h Υ1 |z|^½ sgn z + h² Υ2 ξ = σ with ξ in Sgn z, where z follows from u_r and ξ from η."""
    h, upsilon1, upsilon2 = horizon * DT, 16.0, 20.0
    u_r, following = implicit_super_twisting(sigma, eta, upsilon1, upsilon2, DT, h)
    xi = (following - eta) / (DT * upsilon2)
    root = (u_r - eta - 2.0 * h * upsilon2 * xi) / upsilon1  # |z|^½ sgn z
    z = root * abs(root)
    assert z + h * upsilon1 * root + h * h * upsilon2 * xi == pytest.approx(sigma, rel=1e-12, abs=1e-12)
    assert abs(xi) <= 1.0 + 1e-10
    if abs(root) > 1e-9:
        assert xi == pytest.approx(math.copysign(1.0, z), abs=1e-10)


# Implicit: the loop.


def double_integrator(p: FTCM, w: np.ndarray, e: float, de: float, gain: float = 1.0) -> np.ndarray:
    """ë = gain * a + w, both held: rows of e, ė, x = e + dt ė/2 and s = ė + g_h(e - dt ė/2), u_r."""
    eta, rows = 0.0, []
    for w_k in w.tolist():
        h = p.horizon * DT
        s = de + resolvent(e - 0.5 * DT * de, h, *shape(p))[1]
        u_r, _ = implicit_super_twisting(s, eta, p.upsilon1, p.upsilon2, DT, h)
        rows.append((e, de, e + 0.5 * DT * de, s, u_r))
        a, (eta,) = implicit_law(p, e, de, DT, (eta,))
        a = gain * a + w_k
        e, de = e + DT * de + 0.5 * DT * DT * a, de + DT * a
    return np.array(rows)


@pytest.mark.parametrize("horizon", [1.0, 1.5, 4.0])
def test_reduction_to_two_scalar_loops_is_exact(horizon: float) -> None:
    """s_{k+1} = s_k + dt (w_k - u_r) and x_{k+1} = x_k + dt (s_{k+1} - g_h(x_k)), whatever w does."""
    p = FTCM(discretisation="implicit", horizon=horizon)
    w = np.random.default_rng(1).normal(0.0, 3.0, 2000)
    rows = double_integrator(p, w, -0.5, 0.0)
    x, s, u_r = rows[:, 2], rows[:, 3], rows[:, 4]
    g = np.array([resolvent(v, horizon * DT, *shape(p))[1] for v in x.tolist()])
    assert s[1:] == pytest.approx(s[:-1] + DT * (w[:-1] - u_r[:-1]), abs=1e-12)
    assert x[1:] == pytest.approx(x[:-1] + DT * (s[1:] - g[:-1]), abs=1e-14)


def test_sliding_variable_stays_within_slope_times_dt_squared() -> None:
    """|s| <= L dt² for a disturbance of slope L < Υ2: the least that any law can guarantee."""
    p = FTCM(discretisation="implicit", horizon=1.0)
    w = 3.0 * np.sin(5.0 * DT * np.arange(4000))
    s = double_integrator(p, w, -0.5, 0.0)[:, 3]
    assert np.abs(s[3000:]).max() <= 15.0 * DT * DT * (1.0 + 1e-3)


def test_nominal_loop_comes_to_rest() -> None:
    """Without disturbance the error goes to zero to the last digits, and stays there."""
    rows = double_integrator(FTCM(discretisation="implicit"), np.zeros(4000), -0.5, 0.0)
    assert np.abs(rows[3000:, :2]).max() < 1e-15


@pytest.mark.parametrize("horizon", [1.0, 1.5, 2.0, 4.0])
def test_gain_margin(horizon: float) -> None:
    """The reaching loop stands an input gain k < 4/(4r - r²), r = 1/horizon, of the model's, and no more."""
    r = 1.0 / horizon

    def radius(k: float) -> float:
        loop = np.array([[1.0 - 2.0 * k * r, -k], [r * r, 1.0]])  # of σ and dt η
        return float(np.abs(np.linalg.eigvals(loop)).max())

    assert radius(1.0) == pytest.approx(1.0 - r, abs=1e-6)  # a double pole
    margin = 4.0 / (4.0 * r - r * r)
    assert radius(0.999 * margin) < 1.0 < radius(1.001 * margin)
    for sigma, eta in ((1e-7, 0.0), (0.0, 1e-4)):  # the law itself, near zero, is that loop
        u_r, following = implicit_super_twisting(sigma, eta, 16.0, 20.0, DT, horizon * DT)
        assert DT * u_r == pytest.approx(2.0 * r * sigma + DT * eta, rel=1e-12)
        assert DT * following == pytest.approx(DT * eta + r * r * sigma, rel=1e-12)


@pytest.mark.parametrize(("e", "de", "eta"), [(0.3, -0.5, 0.7), (-1.2, 0.1, -3.0), (0.02, 0.4, 0.0)])
def test_limit_of_small_ticks_is_the_printed_law(e: float, de: float, eta: float) -> None:
    """The difference goes to zero with the tick; η's rate is the printed one already."""
    p = FTCM(discretisation="implicit", epsilon=1e-12)
    exact, _ = printed_law(p, e, de, DT, eta)
    off = []
    for dt in (1e-4, 1e-5, 1e-6):
        a, (following,) = implicit_law(p, e, de, dt, (eta,))
        off.append(abs(a - exact))
        assert (following - eta) / dt == pytest.approx(
            (printed_law(p, e, de, dt, eta)[1] - eta) / dt, rel=1e-6
        )
    assert off[1] < 0.15 * off[0]
    assert off[2] < 0.15 * off[1]


# The paper's experiment: the page's table is what is measured.


def documented() -> dict[str, list[list[float]]]:
    """Rows of the page's table: what to --set, and per column one number per joint."""
    rows = {}
    for line in PAGE.read_text(encoding="utf-8").splitlines():
        cells = [cell.strip() for cell in line.strip().strip("|").split("|")]
        if len(cells) == len(COLUMNS) + 1 and (found := re.fullmatch(r"`(.*=.*)`", cells[0])):
            rows[found.group(1)] = [[float(x) for x in cell.split()] for cell in cells[1:]]
    return rows


def overrides(text: str) -> list[str]:
    """Split a row's first cell as a shell does."""
    return [quoted or plain for quoted, plain in re.findall(r"'([^']*)'|(\S+)", text)]


def measure(trace: Trace) -> list[list[float]]:
    """The same from a run."""
    found: Any = evaluate(trace)
    return [found[window][metric] for window, metric in COLUMNS]


def markdown(text: str) -> str:
    """A row of the table, measured now: how the page was written."""
    values = measure(simulate(load("paper", overrides(text))))
    cells = [" ".join(f"{x:.{4 if n == len(COLUMNS) - 1 else 3}g}" for x in v) for n, v in enumerate(values)]
    return f"| `{text}` | " + " | ".join(cells) + " |"


@pytest.mark.nightly
@pytest.mark.slow
@pytest.mark.parametrize("text", documented())
def test_documented_results(text: str) -> None:
    """Every row to 10 %: chattering amplifies the last bit, so other machines differ in some."""
    for expected, found in zip(documented()[text], measure(simulate(load("paper", overrides(text))))):
        assert found == pytest.approx(expected, rel=0.1)


def test_page_has_the_rows_that_matter() -> None:
    """Both forms, both with delay, both with an encoder."""
    rows = documented()
    assert len(rows) >= 10
    for part in ("=explicit", "=implicit", "torque_delay=1", "encoder"):
        assert any(part in row for row in rows)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("common", "horizon", "peak", "table"),
    [
        ([], 1.5, 1.35, 1.006),
        (["torque_delay=1"], 4.0, 1.35, 1.015),
    ],
)
def test_without_chattering_in_the_paper(
    common: list[str], horizon: float, peak: float, table: float
) -> None:
    """A hundredth of the explicit form's torque variation, half its steady error, its transient to 2 %."""
    implicit = ["controller.discretisation=implicit", f"controller.horizon={horizon}"]
    old, new = (measure(simulate(load("paper", [*common, *more]))) for more in ([], implicit))
    assert np.all(np.array(new[0]) < 0.01 * np.array(old[0]))
    assert np.all(np.array(new[0]) < [95.0, 180.0, 34.0])
    assert np.all(np.array(new[1]) < 0.5 * np.array(old[1]))
    assert np.all(np.array(new[2]) < 0.6 * np.array(old[2]))
    assert np.all(np.array(new[3]) < peak * np.array(old[3]))
    assert np.all(np.array(new[4]) < table * np.array(old[4]))


@pytest.mark.slow
def test_what_variation_remains_is_the_motions_own() -> None:
    """But for the second of the fault's onset, that of every 50th torque alone is the same to 2 %."""
    command = simulate(load("paper", ["controller.discretisation=implicit"])).command
    for u in (command[1000:10_000], command[11_000:]):
        every = np.abs(np.diff(u, axis=0)).sum(axis=0)
        fiftieth = np.abs(np.diff(u[::50], axis=0)).sum(axis=0)
        assert every == pytest.approx(fiftieth, rel=0.02)
