"""An observer: what the model says of the acceleration, less the measured one, low-passed."""

import math
from typing import NamedTuple

from ftcm_core.observers import Observer
from ftcm_core.params import joint_parameters, param
from ftcm_core.registry import register


class Memory(NamedTuple):
    """What the observer remembers: vectors with one entry per joint."""

    position: tuple  # rad, of the last tick
    velocity: tuple  # rad/s, of the last tick
    delta: tuple  # rad/s², the estimate


@register("observer", "my_residual_observer")
class ResidualObserver(Observer):
    """Residual of the acceleration: T dΔ̂/dt = (M⁻¹(u - h - G) - dv/dt) - Δ̂."""

    time_constant: float = param(
        0.02, unit="s", above=0.0, per_joint=True, doc="T of the low-pass", source="chosen: 8 Hz"
    )

    def init(self, model, y):
        """The estimate starts from zero."""
        return Memory(y.position, y.velocity, (0.0,) * model.joints)

    def step(self, model, dt, y, state):
        """Compare the change of the velocity with what the model makes of the torque that acted meanwhile."""
        believed = model.forward_dynamics(state.position, state.velocity, y.effort)
        delta = tuple(
            [
                d + (1.0 - math.exp(-dt / p.time_constant)) * (a - (v - before) / dt - d)
                for p, d, a, v, before in zip(
                    joint_parameters(self, model.joints), state.delta, believed, y.velocity, state.velocity
                )
            ]
        )
        return model.inertia_torque(y.position, delta), Memory(y.position, y.velocity, delta)
