# SPDX-License-Identifier: Apache-2.0
"""The observer's estimate as a residual: r = tau_hat (N·m), which estimates minus the added torque."""

from __future__ import annotations

from ftcm_core.signals import Vector


def estimate_residual(disturbance_estimate: Vector) -> Vector:
    """Return tau_hat as it is, N·m."""
    return disturbance_estimate
