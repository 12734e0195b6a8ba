"""A fault of an actuator: small torques do not reach the joint."""

from ftcm_core.faults import ActuatorFault, scaled
from ftcm_core.params import joint_parameters, param
from ftcm_core.registry import register


@register("fault", "my_dead_zone")
class DeadZone(ActuatorFault):
    """Dead zone: what the joint gets is short of the torque u by up to ψ width, torque = u - clip(u)."""

    width: float = param(
        1.0, unit="N·m", at_least=0.0, per_joint=True, doc="torque that gets lost", source="chosen"
    )

    def step(self, t, dt, torque, q, v, state):
        """Take from each joint's torque what the dead zone swallows."""
        psi = self.size(t)
        parameters = joint_parameters(self, len(torque))
        return tuple([x - swallowed(x, scaled(psi, p.width)) for p, x in zip(parameters, torque)]), state


def swallowed(torque: float, width: float) -> float:
    """The part of a torque (N·m) within ±width."""
    return max(-width, min(width, torque))
