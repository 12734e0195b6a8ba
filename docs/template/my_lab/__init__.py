"""Importing the package registers its components."""

from my_lab import dead_zone, pd_plus, pendulum, residual_observer, tachometer, torque_mismatch

__all__ = ["dead_zone", "pd_plus", "pendulum", "residual_observer", "tachometer", "torque_mismatch"]
