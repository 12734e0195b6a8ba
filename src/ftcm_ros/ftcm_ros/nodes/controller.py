# SPDX-License-Identifier: Apache-2.0
"""The controller node: ``joint_states`` and ``disturbance_estimate`` in, ``joint_torques`` out."""

from __future__ import annotations

import contextlib
import math
import sys
from typing import Any, cast

from ftcm_core.controllers import Controller
from ftcm_core.errors import FtcmError
from ftcm_core.limits import command_beyond
from ftcm_core.references.start_blend import StartBlend
from ftcm_core.registry import Component
from ftcm_core.signals import Measurement, seconds
from ftcm_core.simulation.accommodation import Pace
from ftcm_core.simulation.stages import ControllerStage
from ftcm_ros.nodes.accommodating_node import AccommodatingNode
from ftcm_ros.nodes.command_output import SETTINGS, CommandOutput
from ftcm_ros.nodes.fault_desk import FaultDesk
from ftcm_ros.nodes.main import run
from ftcm_ros.nodes.reactive_node import Answer
from ftcm_ros.nodes.reference_topic import ReferenceTopic
from ftcm_ros.transport.codec import JointSample
from ftcm_ros.transport.composed import Composition
from ftcm_ros.transport.topics import ESTIMATE, JOINT_STATES, REFERENCE, TORQUES


class ControllerNode(AccommodatingNode):
    """Runs the control law; a law that uses no observer does not wait for the estimate."""

    tells = True

    def __init__(self, composition: Composition | None = None) -> None:
        """Subscribe measurements and estimates, publish torques and the reference.

        Raises:
            FtcmError: a parameter is not valid.
        """
        super().__init__("controller", composition)
        self.listen({JOINT_STATES: ("position", "velocity", "effort"), ESTIMATE: ("effort",)})
        self._torques = self.plane.sender(TORQUES, self.codec.torque)
        self._reference = self.plane.sender(REFERENCE, self.codec.motion)
        self.faults = FaultDesk(self, self.next_tick)
        self._zeros = (0.0,) * self.scenario.robot.joints
        self._limits = self.scenario.limits
        self.beyond_limits = 0
        """Commands that the drives cannot follow, and what was wrong with the last."""
        self.last_beyond = ""
        self.output: CommandOutput | None = None
        """The way to a robot's drives, where that is one."""
        settings = {name: self.setting(name) for name in SETTINGS}
        ramp: float = self.setting("start_ramp")
        self._start_ramp = 0.0
        if self.setting("command_interface") == "float64_multi_array":
            self.output = CommandOutput(self, settings, self._missing)
            self._start_ramp = ramp
            if ramp and self.stages == "compiled":
                raise FtcmError("stages: compiled is not possible with start_ramp; expected start_ramp: 0")
        elif settings["dry_run"]:
            raise FtcmError("dry_run: needs command_interface: float64_multi_array, whose topic stays silent")
        topic: str = self.setting("reference_topic")
        self.trajectories = ReferenceTopic(self, topic) if topic else None
        """What is followed in place of the scenario's reference."""
        if topic and (self.stages == "compiled" or self.scenario.policies):
            raise FtcmError("reference_topic: is not possible with stages: compiled, nor with policies")
        self._begun = True
        """Whether the reference is what is followed: else it waits for the first measurement."""
        self.configure()

    def configure(self) -> None:
        """A fresh control law."""
        super().configure()
        law = cast(Controller, self.parameters.component)
        self.stage = self.staged(ControllerStage(self.scenario, law), law)
        if self.active:  # the plant has begun another run
            self.faults.begin()
        self._require(law)
        self._begun = not self._start_ramp and self.trajectories is None

    def activate(self) -> None:
        """Tell when faults will act."""
        if self.output is None:
            self.faults.begin()
        else:
            self.output.begin()
            self.configure()

    def _begin_motion(self, time_ns: int, y: Measurement) -> None:
        """Let the reference begin with the motion that is measured first."""
        trajectories, ramp = self.trajectories, self._start_ramp
        reference: Any = trajectories.begin(y.position) if trajectories else self.scenario.reference
        self.stage.reference = (
            StartBlend(reference, seconds(time_ns), ramp, y.position, y.velocity) if ramp else reference
        )
        self._begun = True

    def _missing(self) -> str:
        """Say what does not come."""
        if not self.aligner.pending:
            return f"no {JOINT_STATES.name} that can be used"
        return f"{JOINT_STATES.name} without {ESTIMATE.name}"

    def do_main_thread_work(self) -> None:
        """Besides, watch over what goes to a robot."""
        super().do_main_thread_work()
        if self.output is not None and self.active:
            self.output.watch()

    def conclude(self) -> None:
        """Go to the last torque gently."""
        output = self.output
        if output is None:
            return
        try:
            output.begin_end()
            while not output.at_end():
                ticks = self.ticks
                self.plane.poll(self.scenario.dt_ns)
                if self.ticks == ticks:
                    output.coast()
        finally:
            output.end()

    def abandon(self) -> None:
        """Tell the drives that nothing more will come."""
        if self.output is not None and self.active:
            self.output.stop("the controller ends with an error")

    def _require(self, law: Controller) -> None:
        self.require(JOINT_STATES, *[ESTIMATE] * law.needs_observer)

    def use(self, component: Component) -> None:
        """Wait for the estimate, or not, as the law needs it."""
        self._require(cast(Controller, component))

    def slow(self, pace: Pace | None) -> None:
        """The reference is here."""
        self.stage.slow(pace)

    def prepare(self, time_ns: int, sample: JointSample) -> None:
        """All of the torque but the estimate, while the observer works."""
        if self.accommodation or not self._begun:
            return  # what the tick is made of is decided when all of it is there
        if self.free is not None:
            time_ns = self.free.next(time_ns) * self.scenario.dt_ns
        with contextlib.suppress(ArithmeticError, ValueError):  # the answer meets it again, and says so
            self.stage.prepare(time_ns, Measurement(*sample[1:]))

    def answer(self, time_ns: int, values: dict[str, JointSample]) -> Answer:
        """One torque and the reference it followed."""
        if self.output is not None and self.output.stopped:
            return []
        run_ns = self.run_ns
        y, estimate = self.accommodated(time_ns, values), values.get(ESTIMATE.name)
        if not self._begun:
            self._begin_motion(run_ns, y)
        try:
            u, reference = self.stage.step(run_ns, y, estimate.effort if estimate else self._zeros)
        except (ArithmeticError, ValueError) as error:  # a law driven out of its domain: the run has diverged
            self.get_logger().error(f"tick {run_ns // self.scenario.dt_ns}: {error}")
            u = (math.nan,) * self.scenario.robot.joints
            reference = self.stage.reference_at(run_ns)
        if self.output is None and (
            beyond := command_beyond(self._limits, self.codec.joint_names, self._output, u)
        ):
            self.beyond_limits += 1
            self.last_beyond = f"t = {run_ns / 1e9:g} s: {beyond}"
        self.announce(time_ns, self.stage.controller, u)
        answer: Answer = []
        if self.output is not None:
            torque = self.output.torque(y, u)
            if torque is None:
                return answer
            answer, u = [(self.output.send, torque)], torque
        return [
            *answer,
            (self._torques.send, self._torques.ready(time_ns, u)),
            (self._reference.send, self._reference.ready(time_ns, reference.position, reference.velocity)),
        ]

    def health(self) -> tuple[str, str, dict[str, Any]]:
        """Besides, commands beyond the robot's limits; the plant enforces them."""
        level, message, values = super().health()
        values["beyond_limits"] = self.beyond_limits
        if self.beyond_limits:
            level = "warn" if level == "ok" else level
            message += f"; {self.beyond_limits} commands beyond the limits, last: {self.last_beyond}"
        for part in (self.output, self.trajectories):
            if part is not None:
                level, message, more = part.health(level, message)
                values |= more
        return level, message, values


def main() -> None:
    """Entry point of ``ros2 run ftcm_ros controller``."""
    sys.exit(run(ControllerNode))


if __name__ == "__main__":
    main()
