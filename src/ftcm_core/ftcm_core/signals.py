# SPDX-License-Identifier: Apache-2.0
"""The signals of a tick, declared once: name, unit, meaning, topic, who writes and who reads.

The row of a run, the trace, the bag, the recorder and the topics all follow from :data:`COLUMNS` and
:data:`CHANNELS`. Everything is SI and in joint space; a vector has one entry per joint.

- tracking error ``e = q - q_ref`` (rad), velocity error ``de = v - v_ref`` (rad/s);
- torques are joint torques in N·m; ``disturbance`` is what is *added* to the torque of the drives
  (faults minus friction and disturbance), so that ``M a + h + G = effort + disturbance``;
- the lumped uncertainty of the paper, ``Delta = M^-1 (F_d - psi omega)`` (rad/s², eq 6), crosses
  as the torque ``tau_hat = M(q) Delta_hat`` (N·m): it estimates ``-disturbance``.
"""

from __future__ import annotations

from typing import NamedTuple

Vector = tuple[float, ...]
State = tuple[Vector, ...]
"""What a controller remembers: one small tuple of floats per joint."""

NANOSECONDS = 1_000_000_000


class Measurement(NamedTuple):
    """What the plant publishes at tick k (``joint_states``)."""

    position: Vector
    """Joint positions q_k, rad."""
    velocity: Vector
    """Joint velocities, rad/s."""
    effort: Vector
    """Torque of the drives over the tick that ended at t_k, after limits, N·m; zero at k = 0."""


class ReferencePoint(NamedTuple):
    """Desired motion at tick k (``reference``)."""

    position: Vector
    """rad"""
    velocity: Vector
    """rad/s"""
    acceleration: Vector
    """rad/s²"""


class TrueDisturbance(NamedTuple):
    """Ground truth: the torque the injector adds. No controller or observer accepts this type."""

    torque: Vector
    """Added joint torque, N·m."""


class _Detection(NamedTuple):
    residual: Vector
    alarm: Vector
    verdict: Vector


class Detection(_Detection):
    """What a detector says at tick k (``detection``)."""

    __slots__ = ()

    def __new__(cls, residual: Vector, alarm: Vector, verdict: Vector | None = None) -> Detection:
        """Say what is seen in a tick, one number per joint.

        Args:
            residual: difference between what is measured and what a healthy robot would do, N·m; of the
                motion, rad/s.
            alarm: 1 for a joint with an alarm, else 0.
            verdict: what is broken, an index of ``VERDICTS`` in :mod:`ftcm_core.detectors`; from a detector
                that cannot tell, ``unknown`` for each alarm.
        """
        return super().__new__(cls, residual, alarm, alarm if verdict is None else verdict)


class Column(NamedTuple):
    """One recorded signal: an array of shape (ticks, joints)."""

    unit: str
    meaning: str
    when: str = ""
    """Which runs have it: empty, all; else ``hidden`` or ``detector``, see :func:`recorded`."""


COLUMNS: dict[str, Column] = {
    "position": Column("rad", "true joint positions"),
    "velocity": Column("rad/s", "true joint velocities"),
    "effort": Column("N·m", "torque of the drives over the tick that ended at the stamp, after limits"),
    "disturbance_estimate": Column("N·m", "the observer's estimate tau_hat = M(q) Δ̂"),
    "command": Column("N·m", "the commanded torque u"),
    "disturbance": Column("N·m", "torque added to that of the drives: faults minus friction and disturbance"),
    "reference_position": Column("rad", "desired joint positions"),
    "reference_velocity": Column("rad/s", "desired joint velocities"),
    "measured_position": Column("rad", "joint positions that observer and controller are given", "hidden"),
    "measured_velocity": Column("rad/s", "joint velocities that they are given", "hidden"),
    "joint_torque": Column(
        "N·m", "torque on the joints over the tick that ended: drives, their faults, disturbance", "hidden"
    ),
    "residual": Column("N·m", "the detector's residual; rad/s where it is that of the motion", "detector"),
    "alarm": Column("-", "1 for a joint with an alarm, else 0", "detector"),
    "verdict": Column(
        "-",
        "what is broken: 0 nothing, 1 unknown, 2 sensor, 3 loss of effectiveness, 4 added torque",
        "detector",
    ),
}
"""Every recorded signal, in the order of a run's row."""


def recorded(hidden: bool, detector: bool) -> tuple[str, ...]:
    """Return the columns of a run, in the order of its row.

    Args:
        hidden: whether the true motion or torque is not what the drives report (a sensor that is not
            exact, a fault of a sensor, an actuator or the communication).
        detector: whether the run has a detector.
    """
    there = {"": True, "hidden": hidden, "detector": detector}
    return tuple(name for name, column in COLUMNS.items() if there[column.when])


class Channel(NamedTuple):
    """One data topic: a ``sensor_msgs/JointState`` per tick, its arrays filled from columns."""

    topic: str
    writer: str
    readers: tuple[str, ...]
    position: str = ""
    """Column in the array ``position``; empty: the array is not filled."""
    velocity: str = ""
    effort: str = ""
    when: str = ""
    """As of :class:`Column`."""

    @property
    def columns(self) -> tuple[str, str, str]:
        """Columns in the arrays position, velocity and effort."""
        return self.position, self.velocity, self.effort


CHANNELS = (
    Channel("joint_states", "plant", ("observer", "controller", "injector", "detector"),
            "measured_position", "measured_velocity", "effort"),
    Channel("disturbance_estimate", "observer", ("controller", "detector"), effort="disturbance_estimate"),
    Channel("joint_torques", "controller", ("plant", "injector", "detector"), effort="command"),
    Channel("disturbance", "injector", ("plant",), effort="disturbance"),
    Channel("reference", "controller", (), "reference_position", "reference_velocity"),
    Channel("true_state", "plant", ("injector",), "position", "velocity", "joint_torque", when="hidden"),
    Channel("detection", "detector", ("observer", "controller"), "alarm", "verdict", "residual",
            when="detector"),
)  # fmt: skip
"""Every data topic. The recorder reads all of them besides."""


def channels(hidden: bool, detector: bool, policies: bool = False) -> tuple[Channel, ...]:
    """Return the data topics of a run, with its readers.

    Args:
        hidden: as of :func:`recorded`. If not, ``joint_states`` has the true motion, also for the injector.
        detector: whether the run has a detector.
        policies: whether anything is done about what the detector says.
    """
    found = []
    for channel in CHANNELS:
        readers = [r for r in channel.readers if r != "detector" or detector]
        if channel.topic == "detection" and not policies:
            readers = []
        if channel.topic == "joint_states":
            if hidden:
                readers.remove("injector")
            else:
                channel = channel._replace(position="position", velocity="velocity")
        if (
            channel.when == ""
            or (channel.when == "hidden" and hidden)
            or (channel.when == "detector" and detector)
        ):
            found.append(channel._replace(readers=tuple(readers)))
    return tuple(found)


def seconds(nanoseconds: int) -> float:
    """Time of an integer stamp, s: correctly rounded, the same in process and in a node."""
    return nanoseconds / NANOSECONDS


def saturate(torque: Vector, limits: Vector | None) -> Vector:
    """Clip a torque command to the drive's limits.

    Args:
        torque: commanded joint torques, N·m.
        limits: largest absolute torque per joint, N·m; None means no limit.

    Returns:
        The torque the drive applies, N·m.
    """
    if limits is None:
        return torque
    return tuple(max(-lim, min(lim, u)) for u, lim in zip(torque, limits))
