# SPDX-License-Identifier: Apache-2.0
"""A broken sensor is left out: its signal is taken from the other sensor of the joint.

Analytical redundancy of the kinematics: dq/dt = v. What has come in while the fault was there but not yet
told is left out too, as far as ``lookback`` reaches. (A virtual sensor: M. Blanke et al., "Diagnosis and
Fault-Tolerant Control", 2006, ch. 7.)
"""

from __future__ import annotations

from typing import ClassVar, NamedTuple

from ftcm_core.params import param
from ftcm_core.policies import Policy
from ftcm_core.registry import register
from ftcm_core.signals import Measurement, Vector


class Past(NamedTuple):
    """One measurement of before, and the time from it to the next."""

    dt: float
    position: Vector
    velocity: Vector


class SensorMemory(NamedTuple):
    """What is remembered of measurements."""

    past: tuple[Past, ...]
    """The oldest first."""
    integrals: Vector
    """Positions as the last call gave them."""
    broken: Vector
    """As the last call was told."""


@register("policy", "replace_sensor")
class ReplaceSensor(Policy):
    """A joint's position is the integral of its velocity, or its velocity the slope of its position.

    position: q(t) = q(t0 - lookback) + ∫ v dt, by the trapezoidal rule, from the decision at t0 on.
    velocity: v(t) = (q(t) - q(t - slope)) / slope.
    """

    each_joint: ClassVar[bool] = True

    quantity: str = param(
        "position", unit="-", choices=("position", "velocity"), doc="which signal is replaced",
        source="chosen: the motion residual cannot tell which of both is wrong",
    )  # fmt: skip
    lookback: float = param(
        0.1, unit="s", at_least=0.0, at_most=1.0,
        doc="how long before the decision a position is trusted again, one tick at least",
        source="chosen: longer than `isolating` takes at 0.03 rad/s",
    )  # fmt: skip
    slope: float = param(
        0.005, unit="s", at_least=0.0, at_most=1.0,
        doc="over what time the slope of the position is taken, one tick at least; it lags by half of that",
        source="chosen: five ticks",
    )  # fmt: skip

    def memory(self, joints: int) -> SensorMemory:
        """Nothing measured yet."""
        return SensorMemory((), (0.0,) * joints, (0.0,) * joints)

    def measured(
        self, dt: float, y: Measurement, broken: Vector, memory: SensorMemory
    ) -> tuple[Measurement, SensorMemory]:
        """Return the measurement with the signals of broken joints replaced."""
        past, given = memory.past, y
        past = past and (*past[:-1], past[-1]._replace(dt=dt))
        if past and any(broken):
            if self.quantity == "position":
                given = y._replace(position=self._integrals(past, y, broken, memory))
            else:
                given = y._replace(velocity=self._slopes(past, y, broken))
        following = [*past, Past(0.0, y.position, y.velocity)]
        wanted = (self.lookback if self.quantity == "position" else self.slope) * (1.0 - 1e-9)
        length = sum([p.dt for p in following])
        while len(following) > 2 and length - following[0].dt >= wanted:
            length -= following.pop(0).dt
        return given, SensorMemory(tuple(following), given.position, broken)

    def _integrals(
        self, past: tuple[Past, ...], y: Measurement, broken: Vector, memory: SensorMemory
    ) -> Vector:
        found = []
        for j, (q, wrong) in enumerate(zip(y.position, broken)):
            if wrong:
                steps, q = past[-1:], memory.integrals[j]
                if not memory.broken[j]:  # decided just now
                    steps, q = past, past[0].position[j]
                speeds = [*[p.velocity[j] for p in steps], y.velocity[j]]
                for p, before, after in zip(steps, speeds, speeds[1:]):
                    q += 0.5 * p.dt * (before + after)
            found.append(q)
        return tuple(found)

    def _slopes(self, past: tuple[Past, ...], y: Measurement, broken: Vector) -> Vector:
        time = sum([p.dt for p in past])
        return tuple(
            [
                (q - before) / time if wrong else v
                for q, before, v, wrong in zip(y.position, past[0].position, y.velocity, broken)
            ]
        )
