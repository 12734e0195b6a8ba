# SPDX-License-Identifier: Apache-2.0
"""Coloured noise of the joint sensors: a first-order Gauss-Markov process."""

from __future__ import annotations

import math
from typing import Any, ClassVar

from ftcm_core.faults import Moment, SensorFault
from ftcm_core.faults.timing import shifted
from ftcm_core.params import param
from ftcm_core.random_streams import gaussian_pair
from ftcm_core.registry import register
from ftcm_core.signals import Vector


@register("fault", "coloured_noise")
class ColouredNoise(SensorFault):
    """Coloured noise: position = q + ψ noise x_1, velocity = q̇ + ψ velocity_noise x_2, x_i Gauss-Markov.

    dx/dt = -x / correlation_time + white noise, of standard deviation 1 from the onset on. From tick to tick
    this is, exactly: x_k = φ x_(k-1) + √(1 - φ²) n_k, φ = E^(-dt / correlation_time), n_k ~ N(0, 1).

    Source: Gillespie (1996), Exact numerical simulation of the Ornstein-Uhlenbeck process and its integral,
    Phys. Rev. E 54.
    """

    rank: ClassVar[int] = 30
    initial: ClassVar[Vector] = (0.0, 0.0, 0.0)
    """x_1, x_2, and whether they have begun."""

    correlation_time: float = param(
        0.1, unit="s", above=0.0, per_joint=True, doc="after this the autocorrelation is 1/e", source="chosen"
    )
    noise: float = param(
        1e-3, unit="rad", at_least=0.0, per_joint=True, doc="standard deviation of the position's noise",
        source="chosen: ten steps of the encoder",
    )  # fmt: skip
    velocity_noise: float = param(
        1e-2, unit="rad/s", at_least=0.0, per_joint=True, doc="standard deviation of the velocity's noise",
        source="chosen",
    )  # fmt: skip

    @staticmethod
    def sense(
        p: Any, size: float, now: Moment, position: float, velocity: float, s: Vector
    ) -> tuple[float, float, Vector]:
        """Add the noise; while the fault does not act it stays where it is."""
        x = markov_step(size, s[0], s[1], s[2], now.dt / p.correlation_time, now.key, now.number)
        return shifted(size, position, p.noise * x[0]), shifted(size, velocity, p.velocity_noise * x[1]), x


def markov_step(
    size: float, first: float, second: float, begun: float, step: float, key: float, number: float
) -> tuple[float, float, float]:
    """Next values of two Gauss-Markov processes of standard deviation 1, and that they have begun.

    Args:
        size: of the fault; 0: no step.
        first: value of the one.
        second: value of the other.
        begun: 0 where the first values are still to be drawn.
        step: tick length, in correlation times.
        key: stream of random numbers.
        number: which number of it.
    """
    if size == 0.0:
        return first, second, begun
    one, other = gaussian_pair(key, number)
    if begun == 0.0:
        return one, other, 1.0
    kept, fresh = math.exp(-step), math.sqrt(-math.expm1(-2.0 * step))
    return kept * first + fresh * one, kept * second + fresh * other, 1.0
