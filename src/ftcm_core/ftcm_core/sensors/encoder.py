# SPDX-License-Identifier: Apache-2.0
"""A joint encoder: quantised, noisy positions; velocities by differencing and a low-pass."""

from __future__ import annotations

import math
from typing import NamedTuple

from ftcm_core.params import joint_parameters, param
from ftcm_core.random_streams import gaussian, stream_key
from ftcm_core.registry import register
from ftcm_core.sensors import Sensor
from ftcm_core.signals import Vector


class EncoderState(NamedTuple):
    """What the encoder remembers after a measurement."""

    key: float
    """Stream of the noise."""
    taken: float
    """Measurements taken."""
    position: Vector
    """Last measured positions, rad."""
    velocity: Vector
    """Last velocity estimate, rad/s."""


@register("sensor", "encoder")
class Encoder(Sensor):
    """Encoder: y = resolution * round((q + noise) / resolution); the velocity is its filtered difference."""

    resolution: float = param(
        1e-4,
        unit="rad",
        at_least=0.0,
        at_most=1.0,
        per_joint=True,
        doc="step of the positions; 0: none",
        source="chosen: 16 bits per turn",
    )
    noise: float = param(
        0.0,
        unit="rad",
        at_least=0.0,
        at_most=1.0,
        per_joint=True,
        doc="standard deviation of the Gaussian noise before rounding",
        source="chosen: rounding alone",
    )
    cutoff: float = param(
        50.0,
        unit="Hz",
        at_least=0.0,
        per_joint=True,
        doc="first-order low-pass on the differenced velocity; 0: none",
        source="chosen: the paper's experiment tracks best with it",
    )

    def init(self, joints: int, seed: int) -> EncoderState:
        """No measurement yet."""
        return EncoderState(stream_key(seed, f"sensor.{self.type_name}"), 0.0, (), (0.0,) * joints)

    def step(
        self, dt: float, position: Vector, velocity: Vector, state: EncoderState
    ) -> tuple[Vector, Vector, EncoderState]:
        """Measure positions, difference them, filter; the first velocity is zero, whatever the true one."""
        joints = len(position)
        first = joints * state.taken
        measured = tuple(
            [
                encode(noisy(q, p.noise, state.key, first + j), p.resolution)
                for j, (p, q) in enumerate(zip(joint_parameters(self, joints), position))
            ]
        )
        estimate = tuple(
            [
                low_pass(v, (q - q_before) / dt, p.cutoff, dt)
                for p, v, q, q_before in zip(
                    joint_parameters(self, joints), state.velocity, measured, state.position or measured
                )
            ]
        )
        return measured, estimate, EncoderState(state.key, state.taken + 1.0, measured, estimate)


def noisy(q: float, noise: float, key: float, counter: float) -> float:
    """Add Gaussian noise to a position, rad.

    Args:
        q: position, rad.
        noise: standard deviation, rad; 0: none.
        key: stream of random numbers.
        counter: which number of it.
    """
    return q if noise == 0.0 else q + noise * gaussian(key, counter)


def encode(q: float, resolution: float) -> float:
    """Round a position to whole steps.

    Args:
        q: position, rad.
        resolution: step, rad; 0: none.
    """
    if resolution == 0.0:
        return q
    steps = q / resolution
    # Beyond 2^52 steps a float is a whole number of them already.
    return resolution * round(steps) if abs(steps) < 2.0**52 else q


def low_pass(filtered: float, raw: float, cutoff: float, dt: float) -> float:
    """First-order low-pass with the exact discrete pole e^(-2π f dt).

    Args:
        filtered: output at t_{k-1}.
        raw: input at t_k.
        cutoff: f, Hz; 0: no filter.
        dt: tick length, s.
    """
    return (
        raw if cutoff == 0.0 else filtered + (1.0 - math.exp(-2.0 * math.pi * cutoff * dt)) * (raw - filtered)
    )
