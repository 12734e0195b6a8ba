"""A fault of an actuator: small torques do not reach the joint."""

from ftcm_core.faults import ActuatorFault, scaled
from ftcm_core.params import param
from ftcm_core.registry import register


@register("fault", "my_dead_zone")
class DeadZone(ActuatorFault):
    """Dead zone: what the joint gets is short of the torque u by up to ψ width, torque = u - clip(u)."""

    width: float = param(
        1.0, unit="N·m", at_least=0.0, per_joint=True, doc="torque that gets lost", source="chosen"
    )

    @staticmethod
    def act(p, size, now, torque, q, v, s):
        """Take from the torque what the dead zone swallows."""
        return torque - swallowed(torque, scaled(size, p.width)), s


def swallowed(torque: float, width: float) -> float:
    """The part of a torque (N·m) within ±width."""
    return max(-width, min(width, torque))
