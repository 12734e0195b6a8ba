# SPDX-License-Identifier: Apache-2.0
"""Reference of the paper's experiment (eq 44)."""

from __future__ import annotations

import math

from ftcm_core.references import Reference
from ftcm_core.registry import register
from ftcm_core.signals import ReferencePoint

RATE = 1.0 / (5.0 * math.pi)


@register("reference", "vo_kang_cosine")
class VoKangCosine(Reference):
    """x_r = cos(t/(5π)) - 0.5 on every joint: what all three lines of eq 44 amount to."""

    def at(self, t: float, joints: int) -> ReferencePoint:
        """cos(t/(5π)) - 0.5 and its derivatives."""
        c, s = math.cos(RATE * t), math.sin(RATE * t)
        return ReferencePoint((c - 0.5,) * joints, (-RATE * s,) * joints, (-RATE * RATE * c,) * joints)
