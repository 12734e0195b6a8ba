# SPDX-License-Identifier: Apache-2.0
"""Samples of the joint sensors that get lost at random."""

from __future__ import annotations

from typing import Any, ClassVar

from ftcm_core.faults import Moment, SensorFault
from ftcm_core.faults.past import either
from ftcm_core.params import param
from ftcm_core.random_streams import happens
from ftcm_core.registry import register
from ftcm_core.signals import Vector


@register("fault", "sensor_dropout")
class SensorDropout(SensorFault):
    """Dropout: reported = the sample reported last, or zero, with P = ψ probability, else the one measured.

    Each joint's samples get lost by themselves, position and velocity together.

    Source: Sinopoli et al. (2004), Kalman filtering with intermittent observations, IEEE TAC 49(9); Schenato
    (2009), To zero or to hold control inputs with lossy links?, IEEE TAC 54(5).
    """

    rank: ClassVar[int] = 70
    remembers: ClassVar[bool] = True

    probability: float = param(
        0.1, unit="-", at_least=0.0, at_most=1.0, per_joint=True, doc="share of the samples that get lost",
        source="chosen: as of dropped_messages",
    )  # fmt: skip
    instead: str = param(
        "last", unit="-", choices=("last", "zero"), doc="what is reported in the place of a lost sample",
        source="Schenato 2009",
    )  # fmt: skip

    @staticmethod
    def sense(
        p: Any, size: float, now: Moment, position: float, velocity: float, s: Vector
    ) -> tuple[float, float, Vector]:
        """The sample, or what is reported in its place."""
        sample = (position, velocity)
        instead = (0.0, 0.0) if p.instead == "zero" else s or sample
        reported = either(happens(size * p.probability, now.key, now.number), instead, sample)
        return reported[0], reported[1], reported
