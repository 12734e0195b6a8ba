# SPDX-License-Identifier: Apache-2.0
"""Loss of effectiveness of the drives: only a share of their torque reaches the joints."""

from __future__ import annotations

from typing import Any, ClassVar

from ftcm_core.errors import ParameterError
from ftcm_core.faults import ActuatorFault, Moment
from ftcm_core.params import param
from ftcm_core.registry import register
from ftcm_core.signals import Vector


@register("fault", "loss_of_effectiveness")
class LossOfEffectiveness(ActuatorFault):
    """Loss of effectiveness: torque on the joint = (1 - ψ loss) torque of the drive.

    The drive does not notice: it reports the torque that it believes to apply.
    """

    rank: ClassVar[int] = 40

    loss: float = param(
        0.3, unit="-", at_least=0.0, at_most=1.0, per_joint=True, doc="share of the torque that is lost",
        source="chosen: the amplitude of eq 47's loss",
    )  # fmt: skip

    @staticmethod
    def act(
        p: Any, size: float, now: Moment, torque: float, q: float, v: float, s: Vector
    ) -> tuple[float, Vector]:
        """(1 - ψ loss) of the torque."""
        return torque * (1.0 - p.loss * size), s

    def check(self) -> None:
        """A share above one would turn the torque round."""
        ActuatorFault.check(self)
        losses = self.loss if isinstance(self.loss, tuple) else (self.loss,)
        if max(losses) * self.severity > 1.0:
            raise ParameterError(
                f"severity: {self.severity:g} makes a loss of {max(losses) * self.severity:g}; "
                "expected at most 1"
            )
