# SPDX-License-Identifier: Apache-2.0
"""Kalman filter whose state includes the disturbance, which is modelled as constant but for a random walk.

R. E. Kalman, "A new approach to linear filtering and prediction problems", J. Basic Eng. 82 (1960) 35-45; the
disturbance as a state: A. Gelb (ed.), "Applied optimal estimation", MIT Press (1974).
"""

from __future__ import annotations

from ftcm_core.observers.position_observer import PositionObserver, predict
from ftcm_core.params import param
from ftcm_core.registry import register
from ftcm_core.signals import Vector


@register("observer", "kalman")
class Kalman(PositionObserver):
    """Kalman filter per joint: q̇ = x2, ẋ2 = M⁻¹(u - h - G) - Δ, Δ̇ = w white, q measured with white noise.

    The gain is that of the covariance, which is carried along (Joseph's form); it soon is that of the
    Riccati equation's solution, with poles of magnitude ω = (walk / (position_noise dt^½))^⅓, and stable
    for every dt. What is linearised is nothing: the model's acceleration is taken as known.
    """

    position_noise: float = param(
        2.9e-5,
        unit="rad",
        above=0.0,
        per_joint=True,
        doc="standard deviation of the measured position",
        source="chosen: an encoder of 1e-4 rad, 1e-4/√12",
    )
    walk: float = param(
        5.0,
        unit="rad/s²/√s",
        above=0.0,
        per_joint=True,
        doc="standard deviation by which Δ moves away in a second",
        source="chosen: 90 % of a step as soon as the paper's observer",
    )
    initial_velocity: float = param(
        1.0,
        unit="rad/s",
        above=0.0,
        per_joint=True,
        doc="standard deviation of the velocity at the start, about the first two positions' difference",
        source="chosen: a slow arm",
    )
    initial_disturbance: float = param(
        10.0,
        unit="rad/s²",
        above=0.0,
        per_joint=True,
        doc="standard deviation of Δ at the start, about zero",
        source="chosen: the friction of eq 43",
    )

    @staticmethod
    def first(p: Kalman, q: float) -> Vector:
        """Undisturbed, with the covariance p11, p12, p13, p22, p23, p33 that the parameters say."""
        variances = (p.position_noise, p.initial_velocity, p.initial_disturbance)
        p11, p22, p33 = [sigma * sigma for sigma in variances]
        return q, 0.0, 0.0, p11, 0.0, 0.0, p22, 0.0, p33

    @staticmethod
    def advance(p: Kalman, chain: Vector, a: float, q: float, dt: float) -> Vector:
        """Predict, then correct with the current measurement."""
        x1, x2, x3, p11, p12, p13, p22, p23, p33 = chain
        covariance = predicted_covariance(p11, p12, p13, p22, p23, p33, p.walk * p.walk, dt)
        variance = p.position_noise * p.position_noise
        k1, k2, k3 = gain(*covariance[:3], variance)
        x1, x2 = predict(x1, x2, x3, a, dt)
        error = q - x1
        return (
            x1 + k1 * error,
            x2 + k2 * error,
            x3 + k3 * error,
            *corrected_covariance(*covariance, k1, k2, k3, variance),
        )


def predicted_covariance(
    p11: float, p12: float, p13: float, p22: float, p23: float, p33: float, density: float, dt: float
) -> tuple[float, float, float, float, float, float]:
    """Φ P Φᵀ + Q over a tick, for the chain of three integrators driven by white noise.

    Args:
        p11: covariance of position, velocity and acceleration, rad², by entries.
        p12: rad²/s.
        p13: rad²/s².
        p22: rad²/s².
        p23: rad²/s³.
        p33: rad²/s⁴.
        density: of the noise that drives the acceleration, (rad/s²)²/s.
        dt: tick length, s.

    Returns:
        The six entries a tick later.
    """
    half = 0.5 * dt
    a11 = p11 + dt * (p12 + half * p13)  # Φ P
    a12 = p12 + dt * (p22 + half * p23)
    a13 = p13 + dt * (p23 + half * p33)
    a22, a23 = p22 + dt * p23, p23 + dt * p33
    noise = density * dt
    return (
        a11 + dt * (a12 + half * a13) + noise * dt * dt * dt * dt / 20.0,
        a12 + dt * a13 + noise * dt * dt * dt / 8.0,
        a13 + noise * dt * dt / 6.0,
        a22 + dt * a23 + noise * dt * dt / 3.0,
        a23 + noise * dt / 2.0,
        p33 + noise,
    )


def gain(p11: float, p12: float, p13: float, variance: float) -> tuple[float, float, float]:
    """P Hᵀ / (H P Hᵀ + R) for a measured position of that variance (rad²)."""
    innovation = p11 + variance
    return p11 / innovation, p12 / innovation, p13 / innovation


def corrected_covariance(
    p11: float, p12: float, p13: float, p22: float, p23: float, p33: float, k1: float, k2: float, k3: float,
    variance: float,
) -> tuple[float, float, float, float, float, float]:  # fmt: skip
    """(I - K H) P (I - K H)ᵀ + K R Kᵀ: a covariance for any gain, and so also after rounding.

    Args:
        p11: predicted covariance, by entries, as of :func:`predicted_covariance`.
        p12: see p11.
        p13: see p11.
        p22: see p11.
        p23: see p11.
        p33: see p11.
        k1: gain of the position.
        k2: gain of the velocity, 1/s.
        k3: gain of the acceleration, 1/s².
        variance: of the measured position, rad².

    Returns:
        The six entries after the measurement.
    """
    rest = 1.0 - k1
    b12, b13 = p12 - k2 * p11, p13 - k3 * p11  # (I - K H) P
    return (
        rest * rest * p11 + k1 * k1 * variance,
        rest * b12 + k1 * k2 * variance,
        rest * b13 + k1 * k3 * variance,
        p22 - k2 * p12 - k2 * b12 + k2 * k2 * variance,
        p23 - k2 * p13 - k3 * b12 + k2 * k3 * variance,
        p33 - k3 * p13 - k3 * b13 + k3 * k3 * variance,
    )
