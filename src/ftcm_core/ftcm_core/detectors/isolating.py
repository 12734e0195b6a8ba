# SPDX-License-Identifier: Apache-2.0
"""A detector that also says what is broken: the residuals of torque and of motion, side by side.

The motion residual of a joint depends on nothing but the sensor of that joint, so an alarm of it is the
sensor's. The torque residual r (of the momentum) depends on the drive and on what acts on the joint.
While its alarm lasts, two explanations are fitted by least squares that forget with a time constant, w
being the torque that the drive reports, low-passed as r is:

- loss of effectiveness: r = -λ w with 0 < λ ≤ 1.1 (a tenth for noise);
- added torque (a bias of the drive, an outer force): r = b.

One is named if it leaves at most the share `fit` of the squares of r, and the other at least four times as
much and a thousandth. All else is `unknown`. (Fault signatures of structured residuals: R. Isermann,
"Fault-Diagnosis Systems", 2006.)

What it cannot tell: a payload from a loss of effectiveness, where the weight of both makes the torque; a bias
of the drive from an outer force; anything from anything while the torque hardly changes.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from ftcm_core.detectors import Detector
from ftcm_core.detectors.residual_detector import lasting, time_above
from ftcm_core.detectors.residuals import Seen, nothing_seen
from ftcm_core.detectors.residuals.momentum import momentum_residual
from ftcm_core.detectors.residuals.motion import motion_residual
from ftcm_core.params import joint_parameters, param
from ftcm_core.registry import register
from ftcm_core.robots import Robot
from ftcm_core.signals import Detection, Measurement, Vector


class JointMemory(NamedTuple):
    """What is remembered of a joint."""

    above: float
    """For how long |r| has been above its threshold, s."""
    motion_alarm: float
    """For how long the alarm of the motion still lasts, s."""
    torque_alarm: float
    """For how long the alarm of the torque still lasts, s."""
    since: float
    """For how long the alarm of the torque has lasted, s."""
    load: float
    """w, N·m."""
    sums: Vector
    """Of r², r w, w², r and 1 since that alarm began, forgetting."""


class IsolatingState(NamedTuple):
    """What the detector remembers."""

    torque: Seen
    motion: Seen
    joints: tuple[JointMemory, ...]


@register("detector", "isolating")
class Isolating(Detector):
    """Isolation: sensor by the motion residual, drive by the fit r = -λ w or r = b of the momentum's."""

    gain: float = param(
        50.0, unit="1/s", above=0.0, per_joint=True, doc="pole of both residuals",
        source="De Luca and Mattone 2003; value chosen: 8 Hz",
    )  # fmt: skip
    threshold: float = param(
        10.0, unit="N·m", above=0.0, per_joint=True, doc="largest torque residual of a healthy robot",
        source="chosen: above the friction of eq 43, below the fault of eq 47",
    )  # fmt: skip
    hold: float = param(
        0.01, unit="s", at_least=0.0, per_joint=True, doc="how long the torque residual must stay above it",
        source="chosen: ten ticks",
    )  # fmt: skip
    motion_threshold: float = param(
        0.05, unit="rad/s", above=0.0, per_joint=True, doc="largest motion residual of a healthy sensor",
        source="chosen: a step of 1 mrad",
    )  # fmt: skip
    latch: float = param(
        0.5, unit="s", at_least=0.0, per_joint=True,
        doc="how long an alarm outlasts its residual",
        source="chosen: that a torque which passes through zero ends no alarm",
    )  # fmt: skip
    window: float = param(
        0.2, unit="s", above=0.0, per_joint=True, doc="time constant with which the fit forgets",
        source="chosen: ten times 1/K",
    )  # fmt: skip
    decide: float = param(
        0.4, unit="s", at_least=0.0, per_joint=True, doc="how long an alarm lasts before a drive is judged",
        source="chosen: twice the window",
    )  # fmt: skip
    fit: float = param(
        0.05, unit="-", above=0.0, below=1.0, per_joint=True, doc="share of the squares that may be left",
        source="chosen: residuals within 22 %",
    )  # fmt: skip

    def init(self, joints: int) -> IsolatingState:
        """Nothing seen yet."""
        fresh = JointMemory(0.0, 0.0, 0.0, 0.0, 0.0, (0.0,) * 5)
        return IsolatingState(nothing_seen(joints), nothing_seen(joints), (fresh,) * joints)

    def step(
        self,
        model: Robot,
        dt: float,
        y: Measurement,
        u: Vector,
        disturbance_estimate: Vector,
        state: IsolatingState,
    ) -> tuple[Detection, IsolatingState]:
        """Form both residuals, fit, judge each joint."""
        parameters = joint_parameters(self, model.joints)
        torque, torque_seen = momentum_residual(parameters, model, dt, y, state.torque)
        motion, motion_seen = motion_residual(parameters, dt, y, state.motion)
        motion_alarms = tuple(
            [
                lasts(lasting(abs(r), p.motion_threshold), m.motion_alarm, p.latch, dt)
                for p, r, m in zip(parameters, motion, state.joints)
            ]
        )
        sensor = max(motion_alarms)
        joints, alarms, verdicts = [], [], []
        for p, r, effort, own, m in zip(parameters, torque, y.effort, motion_alarms, state.joints):
            above = time_above(abs(r), p.threshold, m.above, dt)
            torque_alarm = lasts(lasting(above, p.hold), m.torque_alarm, p.latch, dt)
            alarm = lasting(torque_alarm, 0.0)
            load = m.load + (1.0 - math.exp(-p.gain * dt)) * (effort - m.load)
            kept = alarm * math.exp(-dt / p.window)
            more = (r * r, r * load, load * load, r, 1.0)
            sums = tuple([kept * s + alarm * x for s, x in zip(m.sums, more)])
            since = alarm * (m.since + dt)
            joints.append(JointMemory(above, own, torque_alarm, since, load, sums))
            alarms.append(max(alarm, lasting(own, 0.0)))
            verdicts.append(judged(alarm, own, sensor, since, p.decide, p.fit, *sums))
        found = Detection(torque, tuple(alarms), tuple(verdicts))
        return found, IsolatingState(torque_seen, motion_seen, tuple(joints))


def lasts(excess: float, before: float, latch: float, dt: float) -> float:
    """For how long an alarm still lasts, s: ``latch`` after an excess, one tick at least.

    Args:
        excess: 1 if there is one, else 0.
        before: what was returned in the tick before.
        latch: s.
        dt: tick length, s.
    """
    return max(latch, dt) if excess > 0.0 else max(0.0, before - dt)


def judged(
    alarm: float,
    own: float,
    sensor: float,
    since: float,
    decide: float,
    fit: float,
    rr: float,
    rw: float,
    ww: float,
    r: float,
    one: float,
) -> float:
    """What is broken at a joint, as of ``VERDICTS``.

    Args:
        alarm: 1 if there is an alarm of the torque.
        own: how long the alarm of the motion of this joint still lasts, s.
        sensor: the longest of all joints, s.
        since: for how long the alarm of the torque has lasted, s.
        decide: how long that has to be, s.
        fit: share of the squares that an explanation may leave.
        rr: sum of the squares of r.
        rw: of r w.
        ww: of w².
        r: of r.
        one: of 1.
    """
    if own > 0.0:
        return 2.0
    if alarm == 0.0:
        return 0.0
    if sensor > 0.0 or since < decide:  # the torque residual of a wrong motion means nothing
        return 1.0
    as_loss, as_torque = rr, max(0.0, rr - r * r / one)
    if rw < 0.0 and -rw <= 1.1 * ww:
        as_loss = max(0.0, rr - rw * rw / ww)
    if as_loss <= fit * rr and as_torque >= max(4.0 * as_loss, 0.001 * rr):
        return 3.0
    if as_torque <= fit * rr and as_loss >= max(4.0 * as_torque, 0.001 * rr):
        return 4.0
    return 1.0
