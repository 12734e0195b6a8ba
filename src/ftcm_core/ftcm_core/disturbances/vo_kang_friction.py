# SPDX-License-Identifier: Apache-2.0
"""Friction and disturbance of the paper's experiment (eq 43)."""

from __future__ import annotations

import math

from ftcm_core.disturbances import Disturbance
from ftcm_core.params import param, per_joint
from ftcm_core.registry import register
from ftcm_core.signals import Vector


@register("disturbance", "vo_kang_friction")
class VoKangFriction(Disturbance):
    """F_d,i = a_i sin((t - 2) v_i) + b_i q_i³ (eq 43), acting against the torque."""

    a: tuple[float, ...] = param(
        (1.5, 1.3, 2.5), unit="N·m", per_joint=True, doc="amplitude of the velocity term", source="eq 43"
    )
    b: tuple[float, ...] = param(
        (1.2, 1.1, 1.3), unit="N·m/rad³", per_joint=True, doc="gain of the position term", source="eq 43"
    )

    def torque(self, t: float, q: Vector, v: Vector, u: Vector) -> Vector:
        """-F_d, N·m."""
        a, b = per_joint(self.a, len(q)), per_joint(self.b, len(q))
        return tuple(
            [-(ai * math.sin((t - 2.0) * vi) + bi * qi * qi * qi) for ai, bi, qi, vi in zip(a, b, q, v)]
        )
