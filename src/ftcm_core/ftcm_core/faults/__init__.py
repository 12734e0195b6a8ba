# SPDX-License-Identifier: Apache-2.0
"""What is done to the plant: disturbances (always on) and faults (with a time profile), one per file.

Each gives a joint torque that is *added* to the plant's input torque.
"""

from __future__ import annotations

import math
from abc import abstractmethod
from dataclasses import dataclass

from ftcm_core.params import param
from ftcm_core.registry import Component
from ftcm_core.signals import Vector


class Disturbance(Component):
    """A torque that acts on the joints all the time."""

    @abstractmethod
    def torque(self, t: float, q: Vector, v: Vector, u: Vector) -> Vector:
        """Torque added to the plant's input.

        Args:
            t: time, s.
            q: joint positions, rad.
            v: joint velocities, rad/s.
            u: torque the drive applies, N·m.

        Returns:
            Added joint torque, N·m.
        """

    def supports(self, joints: int) -> str | None:
        """Return None if this component fits a robot with that many joints, else what it needs."""
        del joints
        return None


@dataclass(frozen=True, kw_only=True)
class Fault(Disturbance):
    """A torque with an onset and a time profile ψ (eq 4)."""

    start: float = param(
        10.0, unit="s", at_least=0.0, doc="onset T_f; the fault acts at t > T_f", source="sec. IV, t > 10 s"
    )
    profile: str = param(
        "abrupt",
        unit="-",
        choices=("abrupt", "incipient"),
        doc="time profile: abrupt (ψ steps to 1) or incipient (ψ = 1 - E^(-ν(t-T_f)))",
        source="eq 4",
    )
    rate: float = param(
        1.0, unit="1/s", above=0.0, doc="evolution rate ν of an incipient fault", source="eq 4; value chosen"
    )
    severity: float = param(
        1.0, unit="-", at_least=0.0, doc="factor on the whole fault", source="chosen: 1 is the paper's fault"
    )

    @abstractmethod
    def omega(self, t: float, q: Vector, v: Vector, u: Vector) -> Vector:
        """Fully developed fault ω as a joint torque, N·m."""

    def torque(self, t: float, q: Vector, v: Vector, u: Vector) -> Vector:
        """ψ(t - T_f) ω, N·m."""
        psi = time_profile(t, self.start, self.profile, self.rate) * self.severity
        if psi == 0.0:
            return (0.0,) * len(q)
        return tuple([psi * w for w in self.omega(t, q, v, u)])


def time_profile(t: float, start: float, profile: str, rate: float) -> float:
    """ψ(t - T_f) of eq 4: 0 up to the onset, then 1 (abrupt, ν → ∞) or 1 - E^(-ν(t-T_f)) (incipient).

    Args:
        t: time, s.
        start: onset T_f, s.
        profile: ``abrupt`` or ``incipient``.
        rate: evolution rate ν, 1/s.
    """
    if t <= start:
        return 0.0
    return 1.0 if profile == "abrupt" else 1.0 - math.exp(-rate * (t - start))


def three_joints(what: str, joints: int) -> str | None:
    """Shared answer of the components that the paper defines for three joints."""
    return None if joints == 3 else f"{what} is defined for 3 joints"
