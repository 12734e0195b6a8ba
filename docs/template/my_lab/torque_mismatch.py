"""A detector: the drive does not do what it is told."""

from ftcm_core.detectors import Detector
from ftcm_core.params import joint_parameters, param
from ftcm_core.registry import register
from ftcm_core.signals import Detection


@register("detector", "my_torque_mismatch")
class TorqueMismatch(Detector):
    """Difference between the last command and the torque of the drive: r = u_{k-1} - effort_k."""

    threshold: float = param(
        1.0, unit="N·m", above=0.0, per_joint=True, doc="smallest |r| that gives an alarm", source="chosen"
    )

    def init(self, joints):
        """The command before the first is zero."""
        return (0.0,) * joints

    def step(self, model, dt, y, u, disturbance_estimate, state):
        """The effort of this tick is the torque that acted since the last one."""
        residual = tuple([before - effort for before, effort in zip(state, y.effort)])
        parameters = joint_parameters(self, model.joints)
        alarm = tuple([beyond(r, p.threshold) for p, r in zip(parameters, residual)])
        return Detection(residual, alarm), u


def beyond(residual: float, threshold: float) -> float:
    """1 for an alarm. A decision on numbers stands in such a function, so that it can be compiled."""
    return 1.0 if abs(residual) > threshold else 0.0
