# SPDX-License-Identifier: Apache-2.0
"""The plant, replayed: which torque and disturbance moved it, and whether they give the recorded motion.

In real time the plant moves at its deadline with the newest command and disturbance it has, or brakes when
the command is too old. Which those were is not recorded, but they were sent before, and that is. So the plant
is run with what may have acted, the inputs of the tick first, until it measures what is recorded:

1. command and disturbance of the tick;
2. one of them, or both, as in one of the last ticks; a safe stop;
3. a safe stop, or any command of the last ticks, that gives the recorded effort, with any disturbance.

With ``torque_delay`` a held command shows in the effort that many ticks later. Then it is put in the place of
the one that comes out of the delay.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import chain, islice, product
from typing import Any, NamedTuple

from ftcm_core.recording.trace import ENDED_EARLY
from ftcm_core.replay.answers import MOST, Computed, as_it_ran, distinct, heard_at, ordered
from ftcm_core.replay.record import (
    PATIENCE,
    ROUNDING,
    Message,
    Record,
    distance,
    plain_state,
    recall,
    remember,
)
from ftcm_core.signals import TrueDisturbance, Vector
from ftcm_core.simulation.stages import PlantStage

WINDOW = 1000
"""How many ticks back a held input is looked for (chosen: ten times the longest before a safe stop)."""
TRIES = 2000
"""How many acts a search tries (chosen: twice the disturbances of the window)."""
LAST = 4
"""How many inputs that acted last are remembered (chosen: where messages are dropped, several fit a tick)."""

INFINITELY = float("inf")


class Act(NamedTuple):
    """What may have moved the robot over a tick."""

    command: Vector | None
    """What the drives get, N·m; None: a safe stop."""
    disturbance: Vector
    late_command: bool = False
    """Whether it is not the one whose turn it was."""
    late_disturbance: bool = False

    @property
    def late(self) -> bool:
        """Whether anything is not what it should be."""
        return self.late_command or self.late_disturbance or self.command is None


class Outcome(NamedTuple):
    """Where an act leads, or may have led."""

    apart: float
    """Distance from what is recorded; infinite where the run ends."""
    act: Act | None
    """None: the motion is the recorded one, however that came about."""
    sent: tuple[Message, Message] | None
    """Measured and true motion after it."""
    memory: Any
    status: str = "running"
    reason: str = ""
    """Why the run ends."""


@dataclass
class Held:
    """In how many ticks the plant moved with inputs that were not those of the tick."""

    command: int = 0
    disturbance: int = 0
    safe_stop: int = 0
    ticks: int = 0
    """Any of them."""

    def count(self, act: Act) -> None:
        """Count one tick."""
        self.command += act.late_command
        self.disturbance += act.late_disturbance
        self.safe_stop += act.command is None
        self.ticks += act.late


class ReplayedPlant:
    """The plant, run again with what may have moved it."""

    name = "plant"
    outputs = ("joint_states", "true_state")

    def __init__(self, record: Record, computed: Computed) -> None:
        """Begin at the scenario's initial state.

        Args:
            record: the run.
            computed: what the replay gives; its outputs are added.
        """
        scenario = record.scenario
        self._record, self._computed = record, computed
        self._stage = as_it_ran(record, "plant", PlantStage(scenario))
        self._plain: PlantStage = getattr(self._stage, "stage", self._stage)
        self._dt_ns, self._delay = scenario.dt_ns, scenario.torque_delay
        self._effort_shows = not self._plain.links[0].faults
        self._zeros = (0.0,) * scenario.robot.joints
        self._commands: deque[Vector] = deque([self._zeros], LAST)
        """What moved it last, the newest first."""
        self._disturbances: deque[Vector] = deque([self._zeros], LAST)
        self._possible = [Outcome(0.0, None, self._sent(), remember(self._stage))]
        """Where it may be."""
        self._robot = self._plain.robot, self._plain.changes
        """The robot in this tick, and what becomes of it."""
        self._motion = self._plain.motion
        self._spent = False
        """Whether the engine has moved on from there, and changes its state in place."""
        self._sure = True
        """Whether it is known what the plant remembers."""
        limited = scenario.limits.torque is not None or scenario.limits.torque_step is not None
        self._doubtful = not record.lockstep and limited and bool(self._plain.links[1].faults)
        """Whether that may never be known: a drive at its limit does the same whatever it gets, but what acts
        when the next message is dropped is the last one that it got."""
        self._patience = PATIENCE
        self._open = 0
        """For how many ticks more it may show which of several possibilities it was."""
        self.held = Held()
        self.undecided: list[int] = []
        """Ticks of which the record does not tell enough."""
        self.end = ("completed", "")
        """How the run ends after its last tick: status and reason."""
        self._send(0)

    def _sent(self) -> tuple[Message, Message]:
        return tuple(self._stage.measure()), (*self._stage.motion, self._stage.joint_torque)

    def _send(self, k: int) -> None:
        """Say what is measured at a tick, or may be."""
        sent = [outcome.sent for outcome in self._possible if outcome.sent]
        for i, topic in enumerate(self.outputs):
            self._computed[topic][k] = distinct(messages[i] for messages in sent)

    def order(self, number: int, action: str, t: float) -> None:
        """Arm or clear a fault by hand at t, s."""
        self._possible = [
            outcome._replace(memory=ordered(self._stage, outcome.memory, number, action, t))
            for outcome in self._possible
        ]

    def move(self, k: int) -> None:
        """Move over the tick k; what is measured at k + 1 is computed."""
        record = self._record
        said = [record.at(topic, k + 1) for topic in self.outputs]
        recall(self._stage, self._possible[0].memory)
        self._robot, self._spent = (self._plain.robot, self._plain.changes), False
        if self._stage is self._plain:
            self._motion = self._plain.motion
        known = record.lockstep or said != [None, None]
        found = self._follow(k, said, known)
        exact = known and found[0].apart == 0.0
        if known and not exact:
            self._patience = max(0, self._patience - 1)
            found += self._as_recorded(found[0].memory, *said)
        self._possible = found
        self._send(k + 1)
        self._note(found[0].act)
        if record.lockstep:
            return
        if exact:
            self._sure = True
        elif not known:
            self._sure = False
        elif self._doubtful or not self._sure:
            self.undecided.append(k + 1)

    def _follow(self, k: int, said: list[Message | None], known: bool) -> list[Outcome]:
        """Find what leads to what is recorded; else return all that may have acted, the likeliest first."""
        tried: list[Outcome] = []
        fitting: list[tuple[Outcome, Outcome]] = []
        for before in self._possible if known else self._possible[:1]:
            fits = False
            for act in self._usual(k):
                if fits and act.late:
                    break
                outcome = self._try(k, before.memory, act, said)
                tried.append(outcome)
                if known and outcome.apart == 0.0:
                    fitting.append((before, outcome))
                    fits = True
            if fits and not self._open:
                break
        if fitting:
            self._open = self._delay + 1 if len(fitting) > len(self._possible) else max(0, self._open - 1)
            self._settle(k, fitting[0][0])
            return [outcome for _, outcome in fitting[: MOST if self._open else 1]]
        self._open = self._delay + 1
        if known and self._patience and not self._record.lockstep:
            for act in islice(self._unusual(k, said), TRIES):
                outcome = self._try(k, self._possible[0].memory, act, said)
                if outcome.apart == 0.0:
                    self._settle(k, self._possible[0])
                    return [outcome]
        self._settle(k, self._possible[0])
        if not tried:  # the run has ended before, as far as the replay knows
            return [Outcome(INFINITELY, None, None, self._possible[0].memory)]
        nearest = min(tried, key=lambda outcome: outcome.apart)
        first = nearest if not self._patience or nearest.apart <= ROUNDING < tried[0].apart else tried[0]
        if known and not self._patience:
            return [first]
        others = {outcome.sent: outcome for outcome in reversed(tried) if outcome.sent != first.sent}
        return [first, *reversed(others.values())][: MOST - 1]

    def _settle(self, k: int, before: Outcome) -> None:
        """Note from where the plant moved on in the tick k: that tells what acted in the tick before."""
        if before.act is not None:
            self.held.count(before.act)
        if len(self._possible) > 1 and before.sent:
            for topic, message in zip(self.outputs, before.sent):
                self._computed[topic][k] = [message]

    def _note(self, act: Act | None) -> None:
        if act is None:
            return
        for value, last in ((act.command, self._commands), (act.disturbance, self._disturbances)):
            if value is not None and value != last[0]:
                last.appendleft(value)

    def _as_recorded(self, memory: Any, measured: Message | None, true: Message | None) -> list[Outcome]:
        """The same memory with the motion that is recorded, if it is."""
        motion = measured if true is None and not self._record.scenario.hidden else true
        if motion is None:
            return []
        recall(self._stage, memory)
        state = plain_state(self._stage)
        drive = state.drive
        if self._effort_shows and measured is not None:
            drive = drive._replace(effort=measured[2])
        q, v, *_ = motion
        engine = self._plain.plant.init(self._plain.robot, q, v)
        return [Outcome(0.0, None, None, state._replace(motion=engine, drive=drive))]

    def finish(self, k: int) -> None:
        """Move over the last tick of the record: see how a run ended that could not go on."""
        self._settle(k, self._possible[0])
        if self._record.status not in ENDED_EARLY:
            return
        ends = [self._try(k, p.memory, act, []) for p in self._possible for act in self._usual(k)]
        alike = [outcome for outcome in ends if outcome.status == self._record.status]
        if ends:
            self.end = (alike or ends)[0][-2:]

    def _usual(self, k: int) -> Iterator[Act]:
        """What may have moved it over the tick k, the likeliest first."""
        commands: list[tuple[Vector | None, bool]]
        commands = [(u, False) for (u,) in heard_at(self._record, self._computed, "joint_torques", k)]
        disturbances = [(d, False) for (d,) in heard_at(self._record, self._computed, "disturbance", k)]
        if not self._record.lockstep:
            last = LAST if self._patience else 1
            commands += [*((u, True) for u in islice(self._commands, last)), (None, False)]
            disturbances += [(d, True) for d in islice(self._disturbances, last)]
        for (u, late), (d, late_disturbance) in product(commands, disturbances):
            yield Act(u, d, late, late_disturbance)

    def _unusual(self, k: int, said: list[Message | None]) -> Iterator[Act]:
        """A safe stop, or commands of the last ticks, that give the recorded effort; with any disturbance."""
        wanted = said[0][2] if said[0] else None
        sent = self._sent_command(k)
        acts = (
            Act(u if late else sent, self._disturbances[0], late, True)
            for late, u in self._recent("joint_torques", k - self._delay)
        )
        for act in chain([Act(None, self._disturbances[0])], acts):
            sent_then = self._try(k, self._possible[0].memory, act, said).sent
            if wanted is None or (sent_then is not None and sent_then[0][2] == wanted):
                for late, d in self._recent("disturbance", k):
                    yield act._replace(disturbance=d, late_disturbance=late)

    def _sent_command(self, k: int) -> Vector:
        return next((u for (u,) in heard_at(self._record, self._computed, "joint_torques", k)), self._zeros)

    def _recent(self, topic: str, k: int) -> Iterator[tuple[bool, Vector]]:
        """What was said on a topic up to the tick k, the newest first, and whether it is of an earlier."""
        for j in range(k, max(-1, k - WINDOW), -1):
            for message in heard_at(self._record, self._computed, topic, j):
                yield j < k, message[0]
        if k < WINDOW:
            yield True, self._zeros  # nothing had come yet

    def _try(self, k: int, memory: Any, act: Act, said: list[Message | None]) -> Outcome:
        """Move over the tick k with what may have acted."""
        stage, plain, command = self._stage, self._plain, act.command
        plain.status, plain.reason = "running", ""
        plain.robot, plain.changes = self._robot
        if self._spent and memory is self._possible[0].memory:
            memory = memory._replace(motion=plain.plant.init(plain.robot, *self._motion))
        recall(stage, memory)
        if self._delay and command is not None and not self._record.lockstep:
            drive = plain_state(stage).drive
            if act.late_command:  # it comes out of the delay; what goes in shows later
                drive = drive._replace(waiting=(command, *drive.waiting[1:]))
                recall(stage, plain_state(stage)._replace(drive=drive))
                command = self._sent_command(k)
            act = act._replace(command=drive.waiting[0])
        d = TrueDisturbance(act.disturbance)
        try:
            if command is None:
                stage.safe_stop(k * self._dt_ns, d)
            else:
                stage.step(k * self._dt_ns, command, d)
        except (ArithmeticError, ValueError) as error:
            reason = str(error) or type(error).__name__
            return Outcome(INFINITELY, act, None, memory, "diverged", reason)
        if stage.reason:
            return Outcome(INFINITELY, act, None, memory, stage.status, stage.reason)
        after, sent = remember(stage), self._sent()
        self._spent |= stage is plain and after.motion is memory.motion
        return Outcome(distance(said, sent), act, sent, after)
