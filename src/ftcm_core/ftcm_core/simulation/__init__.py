# SPDX-License-Identifier: Apache-2.0
"""The in-process simulation: stages, the tick that composes them, and whole runs."""

from ftcm_core.simulation.loop import Loop, simulate, to_trace

__all__ = ["Loop", "simulate", "to_trace"]
