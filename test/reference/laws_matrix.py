# SPDX-License-Identifier: Apache-2.0
"""The paper's control laws in its own matrix form; slow and readable, an oracle, for tests only.

Every law is u = -q⁻¹(x) (u_n + u_r) with q = M⁻¹ and H = M⁻¹ (C q̇ + G), gains as diagonal matrices, as the
paper writes it. Corrected signs: -H in eqs 45 and 46, η̇ = +Υ2 sgn σ in eq 33. In eqs 20 and 32 |e|^(α-1)
is taken at max(|e|, ε).
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


class Situation(NamedTuple):
    """What a law sees at one tick: rad, rad/s, rad/s² and kg·m², N·m·s, N·m."""

    q: Array
    v: Array
    q_ref: Array
    v_ref: Array
    a_ref: Array
    mass: Array
    coriolis: Array
    gravity: Array

    @property
    def e(self) -> Array:
        """Position error."""
        return self.q - self.q_ref

    @property
    def de(self) -> Array:
        """Velocity error."""
        return self.v - self.v_ref

    def torque(self, u_n_u_r: Array) -> Array:
        """u = -q⁻¹ (u_n + u_r), where u_n lacks its -H (eqs 19, 31, 45, 46)."""
        h = np.linalg.solve(self.mass, self.coriolis @ self.v + self.gravity)
        return -self.mass @ (-h + u_n_u_r)


def power(x: Array, exponent: float) -> Array:
    """|x|^exponent sgn x."""
    return np.abs(x) ** exponent * np.sign(x)


def smc(s: Situation, c: Array, gain: Array) -> tuple[Array, Array]:
    """Torque and σ of eq 45; gain is Σ + ξ."""
    sigma = s.de + np.diag(c) @ s.e
    return s.torque(np.diag(c) @ s.de - s.a_ref + np.diag(gain) @ np.sign(sigma)), sigma


def nftsmc(s: Situation, varpi: Array, l_over_q: float, gain: Array) -> tuple[Array, Array]:
    """Torque and σ of eq 46; gain is Σ + ξ."""
    varpi_matrix = np.diag(varpi)
    sigma = s.e + np.linalg.inv(varpi_matrix) @ power(s.de, l_over_q)
    terminal = varpi_matrix / l_over_q @ power(s.de, 2 - l_over_q)
    return s.torque(terminal - s.a_ref + np.diag(gain) @ np.sign(sigma)), sigma


def surface_terms(s: Situation, p: Any) -> tuple[Array, Array]:
    """σ of eq 8 and the terms of eq 17 after ë."""
    phi = (p.gamma2 / p.gamma1) ** (1 / (1 - p.alpha))
    size, sign = np.abs(s.e), np.sign(s.e)
    e1 = np.exp(-p.mu1 * (size - phi))
    e2 = np.exp(p.mu2 * (size - phi))
    sigma = (
        s.de
        + np.diag(2 * p.gamma1 / (1 + e1)) @ s.e
        + np.diag(2 * p.gamma2 / (1 + e2)) @ (size**p.alpha * sign)
    )
    rate = (
        np.diag(2 * p.gamma1 / (1 + e1)) @ s.de
        + np.diag(2 * p.gamma1 * p.mu1 * s.de * sign * e1 / (1 + e1) ** 2) @ s.e
        + np.diag(2 * p.gamma2 * p.alpha / (1 + e2)) @ (np.maximum(size, p.epsilon) ** (p.alpha - 1) * s.de)
        - np.diag(2 * p.gamma2 * p.mu2 * s.de * e2 / (1 + e2) ** 2) @ size**p.alpha
    )
    return sigma, rate


def ftsmc(s: Situation, p: Any) -> tuple[Array, Array]:
    """Torque of eqs 19 to 21, and σ."""
    sigma, rate = surface_terms(s, p)
    return s.torque(-s.a_ref + rate + np.diag(p.lambda_bound + p.rho) @ np.sign(sigma)), sigma


def ftcm(s: Situation, p: Any, delta_hat: Array, eta: Array, dt: float) -> tuple[Array, Array, Array]:
    """Torque of eqs 31 to 33, σ, and η one Euler step later."""
    sigma, rate = surface_terms(s, p)
    u_r = np.diag(p.upsilon1) @ power(sigma, 0.5) + eta
    u = s.torque(-delta_hat - s.a_ref + rate + u_r)
    return u, sigma, eta + dt * np.diag(p.upsilon2) @ np.sign(sigma)
