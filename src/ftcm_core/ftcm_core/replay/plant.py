# SPDX-License-Identifier: Apache-2.0
"""The plant, replayed: which torque and disturbance moved it, and whether they give the recorded motion.

In real time the plant moves at its deadline with the newest command and disturbance it has, or brakes when
the command is too old. Which those were is not recorded, but they were sent before, and that is. So the plant
is run with what may have acted, the inputs of the tick first, until it measures what is recorded:

1. command and disturbance of the tick;
2. one of them, or both, as in one of the last ticks; a safe stop;
3. any command of the last ticks that gives the recorded effort, with any disturbance.

With ``torque_delay`` a held command shows in the effort that many ticks later. Then it is put in the place of
the one that comes out of the delay.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from itertools import islice, product
from typing import Any, NamedTuple

from ftcm_core.recording.trace import ENDED_EARLY
from ftcm_core.replay.answers import Computed, as_it_ran, heard_at
from ftcm_core.replay.record import ROUNDING, Message, Record, distance, plain_state, recall, remember
from ftcm_core.signals import TrueDisturbance, Vector
from ftcm_core.simulation.stages import PlantStage

WINDOW = 1000
"""How many ticks back a held input is looked for (chosen: ten times the longest before a safe stop)."""
SEARCHES = 100
"""How many searches may be in vain before no more are made (chosen: one takes up to a tenth of a second)."""
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


class Outcome(NamedTuple):
    """Where an act leads."""

    apart: float
    """Distance from what is recorded; infinite where the run ends."""
    act: Act
    sent: tuple[Message | None, Message | None]
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
        self._braking = False
        """Whether that was a safe stop."""
        self._robot = self._plain.robot, self._plain.changes
        """The robot in this tick, and what becomes of it."""
        self._motion = self._plain.motion
        self._spent = False
        """Whether the engine has moved on from there, and changes its state in place."""
        self._memories = [remember(self._stage)]
        """What it may remember: as of the replay, and if that differs with the motion that is recorded."""
        self._sure = True
        self._searches = SEARCHES
        self.held = Held()
        self.undecided: list[int] = []
        """Ticks of which the record does not tell enough."""
        self.end = ("completed", "")
        """How the run ends after its last tick: status and reason."""
        computed["joint_states"][0], computed["true_state"][0] = self._sent()

    def _sent(self) -> tuple[Message, Message]:
        return tuple(self._stage.measure()), (*self._stage.motion, self._stage.joint_torque)

    def move(self, k: int) -> None:
        """Move over the tick k; what is measured at k + 1 is computed."""
        said = [self._record.at(topic, k + 1) for topic in self.outputs]
        recall(self._stage, self._memories[0])
        self._robot, self._spent = (self._plain.robot, self._plain.changes), False
        if self._stage is self._plain:
            self._motion = self._plain.motion
        best = self._best(k, said, product(self._memories, self._usual(k)))
        if best.apart > 0.0 and not self._record.lockstep and self._searches:
            acts = islice(self._unusual(k, said), TRIES)
            found = self._best(k, said, ((self._memories[0], act) for act in acts))
            self._searches -= found.apart > ROUNDING or found.apart >= best.apart
            best = min(best, found, key=lambda outcome: outcome.apart)
        act = best.act
        self._braking = act.command is None
        for value, last in ((act.command, self._commands), (act.disturbance, self._disturbances)):
            if value is not None and value != last[0]:
                last.appendleft(value)
        self.held.command += act.late_command
        self.held.disturbance += act.late_disturbance
        self.held.safe_stop += self._braking
        self.held.ticks += self._braking or act.late_command or act.late_disturbance
        self._computed["joint_states"][k + 1], self._computed["true_state"][k + 1] = best.sent
        self._memories = [best.memory]
        if said[0] is None and not self._record.lockstep:
            self._sure = False
        elif best.apart <= ROUNDING:
            self._sure = True
        elif not self._sure:
            self.undecided.append(k + 1)
        if best.apart > 0.0:
            self._memories += self._as_recorded(best.memory, *said)

    def _as_recorded(self, memory: Any, measured: Message | None, true: Message | None) -> list[Any]:
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
        return [state._replace(motion=self._plain.plant.init(self._plain.robot, q, v), drive=drive)]

    def finish(self, k: int) -> None:
        """Move over the last tick of the record: see how a run ended that could not go on."""
        if self._record.status not in ENDED_EARLY:
            return
        ends = [self._try(k, m, act, []) for m, act in product(self._memories, self._usual(k))]
        alike = [outcome for outcome in ends if outcome.status == self._record.status]
        self.end = (alike or ends)[0][-2:]

    def _best(self, k: int, said: list[Message | None], acts: Iterable[tuple[Any, Act]]) -> Outcome:
        """Try one after the other, until one leads to what is recorded."""
        best = None
        for memory, act in acts:
            outcome = self._try(k, memory, act, said)
            if best is None or outcome.apart < best.apart:
                best = outcome
            if outcome.apart == 0.0:
                break
        return best or Outcome(INFINITELY, Act(self._zeros, self._zeros), (None, None), self._memories[0])

    def _usual(self, k: int) -> Iterator[Act]:
        """What may have moved it over the tick k, the likeliest first."""
        commands: list[tuple[Vector | None, bool]]
        commands = [(u, False) for (u,) in heard_at(self._record, self._computed, "joint_torques", k)]
        disturbances = [(d, False) for (d,) in heard_at(self._record, self._computed, "disturbance", k)]
        if not self._record.lockstep:
            commands += [*((u, True) for u in self._commands), (None, False)]
            disturbances += [(d, True) for d in self._disturbances]
        for (u, late), (d, late_disturbance) in product(commands, disturbances):
            yield Act(u, d, late, late_disturbance)

    def _unusual(self, k: int, said: list[Message | None]) -> Iterator[Act]:
        """Commands of the last ticks that give the recorded effort, each with the disturbances of them.

        While it brakes, first that, with the disturbances.
        """
        if self._braking:
            for late, d in self._recent("disturbance", k):
                yield Act(None, d, False, late)
        wanted = said[0][2] if self._effort_shows and said[0] else None
        sent = self._sent_command(k)
        for late, u in self._recent("joint_torques", k - self._delay):
            act = Act(u if late else sent, self._disturbances[0], late, True)
            measured = self._try(k, self._memories[0], act, said).sent[0]
            if wanted is None or (measured is not None and measured[2] == wanted):
                for late_disturbance, d in self._recent("disturbance", k):
                    yield act._replace(disturbance=d, late_disturbance=late_disturbance)

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
        if self._spent and memory is self._memories[0]:
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
            return Outcome(INFINITELY, act, (None, None), memory, "diverged", reason)
        if stage.reason:
            return Outcome(INFINITELY, act, (None, None), memory, stage.status, stage.reason)
        after, sent = remember(stage), self._sent()
        self._spent |= stage is plain and after.motion is memory.motion
        return Outcome(distance(said, sent), act, sent, after)
