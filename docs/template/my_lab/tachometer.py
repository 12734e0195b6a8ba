"""A sensor: exact positions, noisy velocities."""

from ftcm_core.params import joint_parameters, param
from ftcm_core.random_streams import gaussian, stream_key
from ftcm_core.registry import register
from ftcm_core.sensors import Sensor


@register("sensor", "my_tachometer")
class Tachometer(Sensor):
    """Tachometer: y = q, measured velocity = v + noise n, n of mean 0 and deviation 1."""

    noise: float = param(
        1e-3, unit="rad/s", at_least=0.0, per_joint=True, doc="standard deviation", source="chosen"
    )

    def init(self, joints, seed):
        """Its own stream of random numbers, and how many ticks have drawn from it."""
        return stream_key(seed, "sensor.my_tachometer"), 0.0

    def step(self, dt, position, velocity, state):
        """Add noise to each velocity."""
        key, ticks = state
        joints = len(position)
        first = joints * ticks
        noisy = tuple(
            [
                v + p.noise * gaussian(key, first + j)
                for j, (p, v) in enumerate(zip(joint_parameters(self, joints), velocity))
            ]
        )
        return position, noisy, (key, ticks + 1.0)
