# SPDX-License-Identifier: Apache-2.0
"""What is done about faults: the scenario's policies, beside the stages that they change.

What the detector says in tick k acts from tick k + 1 on. In process one of these serves a run. Over the graph
the observer's and the controller's node have one each: the same detections give the same decisions.
"""

from __future__ import annotations

from typing import Any, NamedTuple

from ftcm_core.detectors import VERDICTS
from ftcm_core.policies import Policy
from ftcm_core.recording.trace import Decision
from ftcm_core.references import Reference
from ftcm_core.scenario import Scenario
from ftcm_core.signals import Detection, Measurement, ReferencePoint, Vector


class Pace(NamedTuple):
    """How the reference's own time s goes on with the time t; from ``begin`` on, slower by and by."""

    begin: float
    """s"""
    before: float
    """ds/dt until then."""
    reached: float
    """s(begin), s."""
    factor: float
    """ds/dt in the end."""
    ramp: float
    """How long coming to it takes, s."""

    def at(self, t: float) -> tuple[float, float, float]:
        """Return s (s), ds/dt and d²s/dt² (1/s) at a time t (s); ds/dt is a cubic between both speeds."""
        since, change = t - self.begin, self.factor - self.before
        x = min(1.0, since / self.ramp)
        s = self.reached + self.before * since + change * self.ramp * x**3 * (1.0 - 0.5 * x)
        s += change * max(0.0, since - self.ramp)
        return s, self.before + change * x * x * (3.0 - 2.0 * x), change * 6.0 * x * (1.0 - x) / self.ramp


def paced(reference: Reference, pace: Pace | None, t: float, joints: int) -> ReferencePoint:
    """Return the reference at a time t (s), its path gone along at a pace."""
    if pace is None:
        return reference.at(t, joints)
    s, speed, change = pace.at(t)
    point = reference.at(s, joints)
    return ReferencePoint(
        point.position,
        tuple([speed * v for v in point.velocity]),
        tuple([speed * speed * a + change * v for v, a in zip(point.velocity, point.acceleration)]),
    )


class PolicyState(NamedTuple):
    """What is remembered of a policy."""

    said: tuple[int, ...]
    """For how many ticks without a break the detector has said of each joint what it waits for."""
    broken: Vector
    """Per joint, 1 from the decision about it on."""
    memory: Any
    """What the policy itself remembers of measurements."""


class Accommodation:
    """The policies of a run: ``hear`` and then ``measured``, once per tick."""

    def __init__(self, scenario: Scenario) -> None:
        """Nothing decided yet."""
        self.policies: tuple[Policy, ...] = scenario.policies
        self.dt = scenario.dt
        n = scenario.model.joints
        self.state = tuple([PolicyState((0,) * n, (0.0,) * n, policy.memory(n)) for policy in self.policies])
        self.pace: Pace | None = None
        """How the reference goes on; None: as planned."""

    def hear(self, tick: int, found: Detection, ticks: int = 1) -> list[Decision]:
        """Take in what the detector has said; return what is decided, in force from a tick on.

        Args:
            tick: the tick that comes now.
            found: what was said in the one before.
            ticks: how many ticks after the last one heard that was.
        """
        decisions, following = [], []
        for number, (policy, state) in enumerate(zip(self.policies, self.state)):
            said = [(n + ticks) * now for n, now in zip(state.said, policy.says(found))]
            broken = list(state.broken)
            for joint, n in enumerate(said):
                if broken[joint] or not n or (n - 1) * self.dt < policy.hold * (1.0 - 1e-9):
                    continue
                if policy.each_joint or not any(broken):
                    decisions.append(Decision(tick, number, joint + 1, _word(found.verdict[joint])))
                    broken[joint] = 1.0
            following.append(PolicyState(tuple(said), tuple(broken), state.memory))
        self.state = tuple(following)
        for decision in decisions:
            self._slow_down(tick * self.dt, self.policies[decision.number].pace)
        return decisions

    def measured(self, y: Measurement, ticks: int = 1) -> Measurement:
        """Return what observer and law are given in place of a measurement.

        Args:
            y: the measurement.
            ticks: how many ticks after the last one it is.
        """
        following = []
        for policy, state in zip(self.policies, self.state):
            y, memory = policy.measured(ticks * self.dt, y, state.broken, state.memory)
            following.append(state._replace(memory=memory))
        self.state = tuple(following)
        return y

    def _slow_down(self, t: float, wanted: tuple[float, float] | None) -> None:
        if wanted is None or (self.pace and self.pace.factor <= wanted[0]):
            return
        reached, before, _ = self.pace.at(t) if self.pace else (t, 1.0, 0.0)
        self.pace = Pace(t, before, reached, *wanted)


def _word(verdict: float) -> str:
    """What a verdict says; a number that means nothing, as of somebody else's detector, is ``unknown``."""
    return VERDICTS[int(verdict)] if verdict in range(len(VERDICTS)) else "unknown"
