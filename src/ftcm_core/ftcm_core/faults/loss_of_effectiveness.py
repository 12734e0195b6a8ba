# SPDX-License-Identifier: Apache-2.0
"""Loss of effectiveness of the drives: only a share of their torque reaches the joints."""

from __future__ import annotations

from ftcm_core.errors import ParameterError
from ftcm_core.faults import ActuatorFault, time_profile
from ftcm_core.params import joint_parameters, param
from ftcm_core.registry import register
from ftcm_core.signals import Vector

NEVER = 1e12
"""Onset of what has not happened, s."""


@register("fault", "loss_of_effectiveness")
class LossOfEffectiveness(ActuatorFault):
    """Loss of effectiveness: torque on the joint = (1 - ψ loss) torque of the drive.

    The drive does not notice: it reports the torque that it believes to apply.
    """

    loss: float = param(
        0.3, unit="-", at_least=0.0, at_most=1.0, per_joint=True, doc="share of the torque that is lost",
        source="chosen: the amplitude of eq 47's loss",
    )  # fmt: skip
    overload: float | None = param(
        None, unit="N·m", above=0.0, per_joint=True, optional=True, kind="float",
        doc="torque whose first excess after the start breaks the drive for good; null: it breaks at start",
        source="chosen: a fault by time",
    )  # fmt: skip

    def init(self, joints: int, key: float) -> Vector:
        """When each drive broke, s: at the start, or not yet."""
        del key
        return (self.start if self.overload is None else NEVER,) * joints

    def step(
        self, t: float, dt: float, torque: Vector, q: Vector, v: Vector, state: Vector
    ) -> tuple[Vector, Vector]:
        """(1 - ψ loss) of each torque."""
        parameters = joint_parameters(self, len(torque))
        if self.overload is not None:
            state = tuple([onset(s, t, p.start, x, p.overload) for p, x, s in zip(parameters, torque, state)])
        return tuple(
            [
                x * (1.0 - p.loss * (time_profile(t, s, p.evolution) * p.severity))
                for p, x, s in zip(parameters, torque, state)
            ]
        ), state

    def check(self) -> None:
        """A share above one would turn the torque round."""
        losses = self.loss if isinstance(self.loss, tuple) else (self.loss,)
        if max(losses) * self.severity > 1.0:
            raise ParameterError(
                f"severity: {self.severity:g} makes a loss of {max(losses) * self.severity:g}; "
                "expected at most 1"
            )


def onset(since: float, t: float, start: float, torque: float, overload: float) -> float:
    """When a drive broke: once it has, that stays.

    Args:
        since: when it broke, s; :data:`NEVER` if it has not.
        t: time, s.
        start: before this it cannot break, s.
        torque: torque of the drive, N·m.
        overload: torque that breaks it, N·m.
    """
    if since < NEVER or t <= start or abs(torque) < overload:
        return since
    return t
