# SPDX-License-Identifier: Apache-2.0
"""The Kalman filter with the disturbance as a state: its gain, its covariance, its innovations."""

from __future__ import annotations

import numpy as np
import pytest

from ftcm_core.observers.kalman import Kalman, corrected_covariance, gain, predicted_covariance
from ftcm_core.observers.position_observer import predict
from ftcm_core.robots import Robot
from ftcm_core.robots.puma560 import Puma560
from ftcm_core.signals import Measurement
from observing import DT, PUSH, Array, estimates, held, moved
from plugins import ROBOTS

pytestmark = pytest.mark.pure

ROBOT = Puma560()


def model(p: Kalman, dt: float) -> tuple[Array, Array, float]:
    """Transition and noise of the chain, and the variance of its measurement, in matrix form."""
    phi = np.array([[1.0, dt, dt * dt / 2.0], [0.0, 1.0, dt], [0.0, 0.0, 1.0]])
    # ∫ b bᵀ ds over the tick with b = (s²/2, s, 1), by Gauss's rule, which is exact for its powers.
    nodes, weights = np.polynomial.legendre.leggauss(4)
    q = np.zeros((3, 3))
    for s, w in zip(0.5 * dt * (nodes + 1.0), 0.5 * dt * weights):
        b = np.array([s * s / 2.0, s, 1.0])
        q += w * p.walk**2 * np.outer(b, b)
    return phi, q, p.position_noise**2


def matrix(entries: tuple[float, ...]) -> Array:
    """The covariance of its six entries."""
    a, b, c, d, e, f = entries
    return np.array([[a, b, c], [b, d, e], [c, e, f]])


def riccati(p: Kalman, dt: float) -> Array:
    """Predicted covariance that the Riccati equation has as its solution, by its stable subspace.

    In units of dt and of the noise, as the entries differ by many orders of magnitude.
    """
    phi, q, _ = model(p, dt)
    units = np.diag([1.0, dt, dt * dt]) / p.position_noise
    a = (units @ phi @ np.linalg.inv(units)).T
    q, g = units @ q @ units, np.diag([1.0, 0.0, 0.0])
    inverse = np.linalg.inv(a).T
    symplectic = np.block([[a + g @ inverse @ q, -g @ inverse], [-inverse @ q, inverse]])
    values, vectors = np.linalg.eig(symplectic)
    stable = vectors[:, np.argsort(np.abs(values))[:3]]
    found = (stable[3:] @ np.linalg.inv(stable[:3])).real
    kept = found - np.outer(found[0], found[0]) / (found[0, 0] + 1.0)
    assert a.T @ kept @ a + q == pytest.approx(found, rel=1e-6), "it solves the equation"
    return np.array(np.linalg.inv(units) @ found @ np.linalg.inv(units))


def chain_after(p: Kalman, ticks: int, dt: float) -> tuple[float, ...]:
    """The filter's memory of a joint that does not move."""
    chain = p.first(p, 0.0)
    for _ in range(ticks):
        chain = p.advance(p, chain, 0.0, 0.0, dt)
    return chain


@pytest.mark.parametrize(
    ("given", "dt"), [({}, 1e-3), ({"walk": 200.0}, 1e-3), ({"position_noise": 1e-3, "walk": 1.0}, 1e-2)]
)
def test_the_gain_becomes_that_of_the_riccati_equation(given: dict[str, float], dt: float) -> None:
    """Solved independently, by eigenvectors of its symplectic matrix."""
    p = Kalman(**given)
    covariance = predicted_covariance(*chain_after(p, 3000, dt)[3:], p.walk**2, dt)
    solution = riccati(p, dt)
    assert matrix(covariance) == pytest.approx(solution, rel=1e-6)
    found = gain(*covariance[:3], p.position_noise**2)
    assert found == pytest.approx(solution[0] / (solution[0, 0] + p.position_noise**2), rel=1e-6)
    poles = np.linalg.eigvals((np.eye(3) - np.outer(found, [1.0, 0.0, 0.0])) @ model(p, dt)[0])
    assert np.abs(poles).max() < 1.0
    rate = (p.walk / (p.position_noise * dt**0.5)) ** (1.0 / 3.0)
    if rate * dt < 0.2:
        assert np.abs(np.log(poles)) / dt == pytest.approx([rate] * 3, rel=0.01)


def test_the_covariance_is_that_of_the_matrix_form() -> None:
    """Every entry of prediction and correction, from the start on: Joseph's form beside P - K H P."""
    p = Kalman(position_noise=1e-3, walk=50.0)
    phi, q, r = model(p, DT)
    entries = p.first(p, 0.0)[3:]
    full = matrix(entries)
    for _ in range(200):
        entries, full = predicted_covariance(*entries, p.walk**2, DT), phi @ full @ phi.T + q
        assert matrix(entries) == pytest.approx(full, rel=1e-9)
        k = gain(*entries[:3], r)
        entries = corrected_covariance(*entries, *k, r)
        full = full - np.outer(full[:, 0], full[0]) / (full[0, 0] + r)
        assert matrix(entries) == pytest.approx(full, rel=1e-6)
        assert np.linalg.eigvalsh(matrix(entries)).min() > 0.0


def simulated(p: Kalman, ticks: int, seed: int) -> tuple[Array, Array, Array]:
    """One joint that is as the filter's model: squared errors in units of P, innovations, their variances."""
    rng = np.random.default_rng(seed)
    phi, q, r = model(p, DT)
    root = np.linalg.cholesky(q)
    chain = p.first(p, 0.0)
    true = np.array(
        [rng.normal(0.0, s) for s in (p.position_noise, p.initial_velocity, p.initial_disturbance)]
    )
    nees, innovations, variances = [], [], []
    for _ in range(ticks):
        true = phi @ true + np.array([0.5 * DT * DT, DT, 0.0]) * 2.0 + root @ rng.normal(size=3)
        y = float(true[0]) + rng.normal(0.0, p.position_noise)
        innovations.append(y - predict(*chain[:3], 2.0, DT)[0])
        variances.append(predicted_covariance(*chain[3:], p.walk**2, DT)[0] + r)
        chain = p.advance(p, chain, 2.0, y, DT)
        off = true - chain[:3]
        nees.append(off @ np.linalg.solve(matrix(chain[3:]), off))
    return np.array(nees), np.array(innovations), np.array(variances)


def test_the_errors_are_as_large_as_the_covariance_says() -> None:
    """Mean of 200 runs of eᵀP⁻¹e at several ticks, also in the transient: 3, within four deviations."""
    runs = np.array([simulated(Kalman(), 60, seed)[0] for seed in range(200)])
    spread = (2.0 * 3.0 / 200.0) ** 0.5
    for tick in (0, 1, 5, 20, 59):
        assert runs[:, tick].mean() == pytest.approx(3.0, abs=4.0 * spread), tick


def test_the_innovations_are_white_and_of_the_variance_that_it_expects() -> None:
    """In a long run: mean square 1 in units of their variance, correlations within four deviations."""
    _, innovations, variances = simulated(Kalman(), 10_000, 1)
    e = (innovations / np.sqrt(variances))[100:]
    count = len(e)
    assert np.mean(e * e) == pytest.approx(1.0, abs=4.0 * (2.0 / count) ** 0.5)
    correlation = [float(np.mean(e[lag:] * e[: count - lag])) for lag in range(1, 21)]
    assert np.abs(correlation).max() < 4.0 / count**0.5


def test_with_another_gain_they_are_not() -> None:
    """The same run with a filter that expects ten times the noise: what the test above would notice."""
    right, wrong = Kalman(), Kalman(position_noise=2.9e-4)
    rng = np.random.default_rng(1)
    phi, q, _ = model(right, DT)
    root, true, chain, e = np.linalg.cholesky(q), np.zeros(3), wrong.first(wrong, 0.0), []
    for _ in range(5000):
        true = phi @ true + root @ rng.normal(size=3)
        y = float(true[0]) + rng.normal(0.0, right.position_noise)
        e.append(y - predict(*chain[:3], 0.0, DT)[0])
        chain = wrong.advance(wrong, chain, 0.0, y, DT)
    found = np.array(e[100:]) / np.std(e[100:])
    assert np.mean(found[1:] * found[:-1]) > 0.5


def test_on_a_moving_arm_the_errors_are_as_the_covariance_says() -> None:
    """The PUMA, its positions noisy, Δ a random walk: mean square of Δ̂ - Δ over P33, to 20 %."""
    p, rng = Kalman(), np.random.default_rng(2)
    walk = np.cumsum(rng.normal(0.0, p.walk * DT**0.5, (3001, 3)), axis=0)
    measured = moved(ROBOT, lambda k, q: ROBOT.inertia_torque(q, tuple(-walk[k])), 3.0)
    noisy = [
        y._replace(position=tuple(x + rng.normal(0.0, p.position_noise) for x in y.position))
        for y in measured
    ]
    state, ratios = p.init(ROBOT, noisy[0]), []
    for k, y in enumerate(noisy[1:]):
        _, state = p.step(ROBOT, DT, y, state)
        ratios.append([(-c[2] - walk[k, j]) ** 2 / c[8] for j, c in enumerate(state.chains)])
    assert np.mean(ratios[200:], axis=0) == pytest.approx([1.0] * 3, abs=0.2)


@pytest.mark.parametrize("robot", ROBOTS.values(), ids=ROBOTS)
def test_a_constant_torque_on_a_robot_at_rest_is_found(robot: Robot) -> None:
    """To 1e-6 within 0.4 s on any of them."""
    found = estimates(Kalman(), robot, [held(robot)] * 400)
    assert found[-1] == pytest.approx([-x for x in PUSH[: robot.joints]], abs=1e-6)


def test_a_velocity_that_it_does_not_know_at_the_start_is_soon_found() -> None:
    """Three positions tell it: that is what the variances of the start are for."""
    robot, v = ROBOTS["pendulum"], 0.8
    ys = [Measurement((v * k * DT,), (0.0,), robot.gravity((v * k * DT,))) for k in range(40)]
    state = Kalman().init(robot, ys[0])
    for y in ys[1:]:
        _, state = Kalman().step(robot, DT, y, state)
    assert state.chains[0][1] == pytest.approx(v, abs=1e-3)
