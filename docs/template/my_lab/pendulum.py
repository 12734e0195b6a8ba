"""A robot: a point mass on a rod, one joint."""

import math

from ftcm_core.params import param
from ftcm_core.registry import register
from ftcm_core.robots import Robot


@register("robot", "my_pendulum")
class Pendulum(Robot):
    """Pendulum: m l² q̈ + b q̇ + m g l sin q = u, hanging down at q = 0."""

    mass: float = param(1.0, unit="kg", above=0.0, doc="mass", source="chosen")
    length: float = param(0.5, unit="m", above=0.0, doc="length of the rod", source="chosen")
    damping: float = param(0.1, unit="N·m·s/rad", at_least=0.0, doc="viscous friction b", source="chosen")

    joint_names = ("swing",)

    def inverse_dynamics(self, q, v, a):
        """Torque that gives an acceleration; the forward dynamics follow from it."""
        inertia = self.mass * self.length * self.length
        gravity = 9.81 * self.mass * self.length * math.sin(q[0])
        return (inertia * a[0] + self.damping * v[0] + gravity,)
