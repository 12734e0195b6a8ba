# SPDX-License-Identifier: Apache-2.0
"""Bias of the position sensors, constant, drifting steadily or at random."""

from __future__ import annotations

import math
from typing import NamedTuple

from ftcm_core.faults import SensorFault, scaled
from ftcm_core.params import joint_parameters, param
from ftcm_core.random_streams import gaussian
from ftcm_core.registry import register
from ftcm_core.signals import Vector


class BiasState(NamedTuple):
    """What the fault remembers."""

    key: float
    """Its stream of random numbers."""
    drawn: float
    """Ticks for which numbers were drawn."""
    walk: Vector
    """Sum of the random steps, rad."""


@register("fault", "sensor_bias")
class SensorBias(SensorFault):
    """Sensor bias: y = q + ψ (bias + drift (t - T_f) + w), w a random walk of intensity `walk`."""

    bias: float = param(
        0.01, unit="rad", per_joint=True, doc="bias of the position", source="chosen: half a degree"
    )
    drift: float = param(
        0.0, unit="rad/s", per_joint=True, doc="growth of the bias; the velocity is off by it too",
        source="chosen: none",
    )  # fmt: skip
    walk: float = param(
        0.0, unit="rad/√s", at_least=0.0, per_joint=True,
        doc="standard deviation of the random drift after one second", source="chosen: none",
    )  # fmt: skip

    def init(self, joints: int, key: float) -> BiasState:
        """No drift yet."""
        return BiasState(key, 0.0, (0.0,) * joints)

    def step(
        self, t: float, dt: float, position: Vector, velocity: Vector, state: BiasState
    ) -> tuple[Vector, Vector, BiasState]:
        """Add the bias to the position and its steady drift to the velocity."""
        joints = len(position)
        psi, parameters = self.size(t), joint_parameters(self, joints)
        first = joints * state.drawn
        walk = tuple(
            [
                w + random_step(psi, p.walk, dt, state.key, first + j)
                for j, (p, w) in enumerate(zip(parameters, state.walk))
            ]
        )
        return (
            tuple(
                [
                    q + scaled(psi, p.bias + p.drift * (t - p.start) + w)
                    for p, q, w in zip(parameters, position, walk)
                ]
            ),
            tuple([v + scaled(psi, p.drift) for p, v in zip(parameters, velocity)]),
            BiasState(state.key, state.drawn + 1.0, walk),
        )


def random_step(psi: float, intensity: float, dt: float, key: float, counter: float) -> float:
    """One step of a random walk, rad; none before the onset.

    Args:
        psi: size of the fault.
        intensity: standard deviation after one second, rad/√s.
        dt: tick length, s.
        key: the stream.
        counter: which number of it.
    """
    if psi == 0.0 or intensity == 0.0:
        return 0.0
    return intensity * math.sqrt(dt) * gaussian(key, counter)
