"""A controller: PD with the model, and with the disturbance estimate."""

from ftcm_core.controllers import AccelerationLaw
from ftcm_core.params import param
from ftcm_core.registry import register


@register("controller", "my_pd_plus")
class PDPlus(AccelerationLaw):
    """PD with model, a baseline: v = ẍ_r - kp e - kd ė, u = M v + h + G + tau_hat."""

    kp: float = param(
        50.0, unit="1/s²", above=0.0, per_joint=True, doc="position gain", source="chosen: 7 rad/s"
    )
    kd: float = param(14.0, unit="1/s", above=0.0, per_joint=True, doc="velocity gain", source="chosen")

    needs_observer = True

    @staticmethod
    def law(p, e, de, dt, s):
        """One joint: feedback acceleration (rad/s²) from its errors (rad, rad/s), and the next state."""
        return -p.kp * e - p.kd * de, s
