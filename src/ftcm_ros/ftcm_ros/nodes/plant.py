# SPDX-License-Identifier: Apache-2.0
"""The plant node: publishes ``joint_states``, moves the robot, and is the only one with a clock.

A tick, in lockstep and in real time, in the order of the methods below:

1. ``_begin_tick`` publishes the measurement.
2. ``_on_input`` takes torque and disturbance in. When both are here the robot moves at once: in real time
   that is ahead of the deadline.
3. ``_end_tick``, when the pacer says so: if they have not come, the robot moves with the newest there are,
   and the miss is counted. Then the next tick begins.

Where it stands in for a robot (``command_interface``), the newest command acts at the end of each tick.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Callable
from dataclasses import asdict
from math import isfinite
from typing import Any

from builtin_interfaces.msg import Time
from rclpy.serialization import deserialize_message
from std_msgs.msg import String

from ftcm_core.errors import FtcmError
from ftcm_core.recording.trace import ENDED_EARLY
from ftcm_core.signals import NANOSECONDS, TrueDisturbance, Vector, seconds
from ftcm_core.simulation.stages import PlantStage
from ftcm_ros.nodes.fault_desk import FaultDesk, FaultServices
from ftcm_ros.nodes.main import run
from ftcm_ros.nodes.pause import Pause
from ftcm_ros.nodes.stand_in import StandIn
from ftcm_ros.nodes.suite_node import POLL_NS, SuiteNode
from ftcm_ros.timing.clocks import ClockWatch
from ftcm_ros.timing.durations import Durations
from ftcm_ros.timing.pacing import PACERS, Misses, check_speed
from ftcm_ros.transport.codec import CodecError, JointSample
from ftcm_ros.transport.composed import Composition
from ftcm_ros.transport.float_array import FloatArray, joints_of
from ftcm_ros.transport.topics import (
    CLOCK,
    COMMAND,
    DISTURBANCE,
    JOINT_STATES,
    RECORDED,
    SCENARIO,
    TORQUES,
    TRUE_STATE,
    Topic,
)

CLOCK_PERIOD_NS = NANOSECONDS // 100
ASK_AGAIN_NS = NANOSECONDS
"""In lockstep, how long an answer may take before the measurement is published again."""


class Input:
    """The newest value of one topic that the plant acts on."""

    def __init__(self, joints: int) -> None:
        """None yet: zeros."""
        self.time_ns = -1
        self.value: Vector = (0.0,) * joints


class PlantNode(SuiteNode):
    """Simulates the robot, one tick after the other, in lockstep or in real time."""

    def __init__(self, composition: Composition | None = None) -> None:
        """Subscribe torque and disturbance, publish the measurement.

        Raises:
            FtcmError: a parameter is not valid.
        """
        super().__init__("plant", composition)
        if self.scenario.plant.foreign:
            self.stages = "plain"  # what moves the robot is machine code already
        self.mode: str = self.setting("mode")
        self.recorder_window: int = self.setting("recorder_window")
        timeout: int = self.setting("torque_timeout")
        if timeout < 0:
            raise FtcmError(f"torque_timeout: {timeout} is out of range; expected ticks, or 0: never")
        self.speed: float = self.setting("speed")
        check_speed(self.speed, self.mode)
        self._torque_timeout_ns = timeout * self.scenario.dt_ns or sys.maxsize
        self._measurements = self.plane.sender(JOINT_STATES, self.codec.state)
        self._truths = self.plane.sender(TRUE_STATE, self.codec.state)
        self._publish_clock = self.plane.publisher(CLOCK)
        self._publish_scenario = self.plane.publisher(SCENARIO)
        command_topic: str = self.setting("command_topic")
        joints: str = self.setting("command_joints")
        self._free: bool = self.setting("stamps") == "free"
        self.stands_in: bool = self.setting("command_interface") == "float64_multi_array"
        """Whether it takes the newest command of whoever there is, and adds the disturbance itself."""
        self._torque_topic = COMMAND._replace(name=command_topic) if self.stands_in else TORQUES
        if self.stands_in:
            self._require_real_time()
            self._array = FloatArray(self.codec.joint_names, joints_of(joints))
            self.plane.subscribe(self._torque_topic, self._on_command)
        elif self._free:
            raise FtcmError(
                "stamps: free needs command_interface: float64_multi_array; nobody answers by stamp then"
            )
        else:
            for topic in (TORQUES, DISTURBANCE):
                self.subscribe(topic, ("effort",), self._taker(topic))
        self.plane.subscribe(RECORDED, self._on_recorded)
        self.faults = FaultDesk(
            self, lambda: self.tick + self._moved, ("plant", "injector") if self.stands_in else ()
        )
        if self.stands_in:
            self.fault_services = FaultServices(self, self.faults)
        self.pause = Pause(self, self._resume)
        self._clocks = ClockWatch()
        self.state = "waiting"
        self.detail = ""
        self._began = time.monotonic()
        self.elapsed = 0.0
        self._stamped_from = 0
        """Stamp of tick 0, ns."""
        self.configure()

    def _require_real_time(self) -> None:
        if self.mode != "real_time":
            raise FtcmError(
                f"command_interface: float64_multi_array is not possible with mode: {self.mode}: such a "
                "command does not say for which tick it is; expected mode: real_time"
            )
        if self.stages == "compiled":
            raise FtcmError("stages: compiled is not possible with command_interface: float64_multi_array")

    # A run.

    def configure(self) -> None:
        """The robot at its initial state."""
        joints = self.scenario.robot.joints
        self.stage = StandIn(self.scenario) if self.stands_in else self.staged(PlantStage(self.scenario))
        self.misses = Misses()
        self.pacer = PACERS[self.mode](round(self.scenario.dt_ns / self.speed), misses=self.misses)
        self.pause.clear()
        self.tick = 0
        self.time_ns = 0
        self.torque, self.disturbance = Input(joints), Input(joints)
        self._recorded_ns = -1
        self.latencies, self.lateness, self.times = Durations(), Durations(), Durations()
        self._moved = False
        """Whether the robot has moved over the present tick, with its torque and disturbance."""
        self._finished = False
        self._published_at = 0
        self.asked_again = 0
        self.repeated = 0
        """Inputs that came again for their tick, the same."""
        self.stopping_safely = False
        self.safe_stops = self.safe_stop_ticks = 0
        self._raised = ""
        """What the robot's equations raised: it was driven out of their domain."""
        self.ended_at: float | None = None

    def activate(self) -> None:
        """Begin at tick 0."""
        self.configure()
        self.state, self.detail = "running", ""
        self._publish_scenario(String(data=self.scenario.to_yaml()))
        self._began = time.monotonic()
        self.elapsed = 0.0
        self.faults.begin()
        if self._free:
            self._stamped_from = self.get_clock().now().nanoseconds
        self._prepare(0, reveal=self.scenario.hidden)
        self._begin_tick()
        self.pacer.begin()

    def step(self) -> None:
        """One round of the main loop: wait for the end of the tick, go on to the next."""
        if self._finished or not self.active or (self.pause.on and not self.pacer.waits):
            self.plane.poll(POLL_NS)
        elif self.pacer.wait(self._ready, self._poll):
            self._end_tick()
        elif time.monotonic_ns() - self._published_at > ASK_AGAIN_NS and not self._moved:
            self.asked_again += 1
            self._begin_tick()

    def deactivate(self) -> None:
        """End the run where it is."""
        if self.state == "running":
            self.state, self.detail = "incomplete", f"stopped at t = {seconds(self.time_ns):g} s"

    # A tick.

    def _begin_tick(self) -> None:
        """Publish the measurement, which has been made ready ahead of time."""
        self._published_at = time.monotonic_ns()
        late = self.pacer.late_by(self._published_at)
        if late is not None and self.tick:
            self.lateness.add(late)
        measurement, truth = self._measurement, self._truth
        self._measurements.send(measurement)
        if truth:
            self._truths.send(truth)
        if self.time_ns % CLOCK_PERIOD_NS == 0 and not self._free:
            sec, nanosec = divmod(self.time_ns, NANOSECONDS)
            self._publish_clock(
                b"\x00\x01\x00\x00" + sec.to_bytes(4, "little") + nanosec.to_bytes(4, "little")
            )

    def _on_input(self) -> None:
        """An input of this tick has come: with both, move at once."""
        if self.torque.time_ns == self.disturbance.time_ns == self.time_ns and not self._moved:
            self._moved = True
            self.latencies.add(time.monotonic_ns() - self._published_at)
            self._move()
            self._go_on()

    def _go_on(self) -> None:
        """Where no clock has to be kept, end the tick as soon as it is done."""
        if self.pacer.waits and self._ready():
            if self.plane.hands_over:  # to begin the next tick from within this one would never end
                self.plane.wake()
            else:
                self._end_tick()

    def _ready(self) -> bool:
        return self._moved and not self._finished and not self.pause.on and not self._recorder_behind()

    def _resume(self) -> None:
        """Begin ticks again after a pause: the present one ends one tick from now."""
        self.pacer.begin()
        self._go_on()

    def _recorder_behind(self) -> bool:
        if not self.pacer.waits or self.recorder_window == 0:
            return False
        window = 0 if self.tick == self.scenario.last_tick else self.recorder_window
        return self.time_ns - self._recorded_ns > window * self.scenario.dt_ns

    def _poll(self, timeout_ns: int) -> None:
        """Wait for the disturbance, which comes last, and take the torque with it."""
        early = self.disturbance.time_ns == self.time_ns and not self._moved
        self.plane.poll(timeout_ns, None if early or self._recorder_behind() else DISTURBANCE)

    def _end_tick(self) -> None:
        """Move with what there is if that has not been done; then begin the next tick."""
        if not self._moved:
            # The disturbance follows from the torque: one cause.
            if self._missed(self._torque_topic, self.torque):
                self.misses.late_torque += 1
            elif self._missed(DISTURBANCE, self.disturbance):
                self.misses.late_disturbance += 1
            self._move()
        self.ticks += 1
        self.pause.ticked()
        self.faults.look(self.time_ns)
        if self._raised:
            self._finish("diverged", self.time_ns, self._raised)
        elif self.stage.reason:
            self._finish(self.stage.status, self.time_ns + self.scenario.dt_ns, self.stage.reason)
        elif self.tick == self.scenario.last_tick:
            self._finish("completed", self.time_ns, "")
        else:
            self.tick += 1
            self.time_ns = self.tick * self.scenario.dt_ns
            self._moved = False
            self._begin_tick()

    def _missed(self, topic: Topic, newest: Input) -> bool:
        """Whether an input has not come; none is expected of a topic without a publisher in this run."""
        return newest.time_ns < self.time_ns and (newest.time_ns >= 0 or self.plane.has_publisher(topic))

    def _move(self) -> None:
        """Let the newest torque and disturbance act over the tick, and make ready what is published next."""
        if self.tick == self.scenario.last_tick:
            return
        begin = time.monotonic_ns()
        d = TrueDisturbance(self.disturbance.value)
        try:
            if self._stop_safely(self.time_ns - self.torque.time_ns > self._torque_timeout_ns):
                self.stage.safe_stop(self.time_ns, d)
            else:
                self.stage.step(self.time_ns, self.torque.value, d)
        except (ArithmeticError, ValueError) as error:
            self._raised = str(error) or type(error).__name__
        # With a held disturbance, its topic does not tell what has acted.
        held = not self.stands_in and self.disturbance.time_ns != self.time_ns
        self._prepare(self.time_ns + self.scenario.dt_ns, reveal=held or self.scenario.hidden)
        self.times.add(time.monotonic_ns() - begin)

    def _stop_safely(self, overdue: bool) -> bool:
        """Count and tell when the torque is overdue (real time only), and when it is fresh again."""
        if overdue != self.stopping_safely:
            self.stopping_safely = overdue
            self.safe_stops += overdue
            what = "safe stop: no fresh torque" if overdue else "safe stop ends: fresh torque"
            self.get_logger().warning(f"tick {self.tick}: {what}")
        self.safe_stop_ticks += overdue
        return overdue

    def _prepare(self, time_ns: int, *, reveal: bool) -> None:
        """Make ready the measurement of a tick and, if wanted, the true motion and joint torque."""
        time_ns += self._stamped_from
        self._measurement = self._measurements.ready(time_ns, *self.stage.measure())
        self._truth = None
        if reveal:
            q, v = self.stage.motion
            self._truth = self._truths.ready(time_ns, q, v, self.stage.joint_torque)

    def _finish(self, state: str, time_ns: int, reason: str) -> None:
        self.faults.tell(self.tick)
        t = seconds(time_ns)
        self.state = state
        self.detail = f"at t = {t:g} s: {reason}" if reason else f"{t:g} s"
        self.ended_at = t if state in ENDED_EARLY else None
        self.elapsed = time.monotonic() - self._began
        self.get_logger().info(f"{self.state}: {self.detail}")
        self._finished = True
        self.plane.serve(self.trigger_deactivate)

    # Messages.

    def _taker(self, topic: Topic) -> Callable[[JointSample], None]:
        def take(sample: JointSample) -> None:
            newest = self.torque if topic is TORQUES else self.disturbance
            time_ns, value = sample.time_ns, sample.effort
            if newest.time_ns < time_ns <= self.time_ns:
                newest.time_ns, newest.value = time_ns, value
                if time_ns == self.time_ns:
                    self._on_input()
            elif time_ns > self.time_ns:
                self.refuse(topic, "future", f"t = {seconds(time_ns):g} s has not come yet")
            elif time_ns == newest.time_ns and value == newest.value:
                self.repeated += 1
            elif time_ns == newest.time_ns:
                self.refuse(topic, "conflicting", f"another value for t = {seconds(time_ns):g} s")
            else:
                self.refuse(topic, "stale", f"t = {seconds(time_ns):g} s after a later tick")

        return take

    def _on_command(self, data: bytes, published_ns: int) -> None:
        """Take the newest command: at the end of the tick it acts over the tick."""
        if not self.active:
            return
        try:
            torque = self._array.decode(data)
        except CodecError as error:
            self.refuse(self._torque_topic, "malformed", str(error))
            return
        if not all(map(isfinite, torque)):
            self.refuse(self._torque_topic, "not_finite", f"{list(torque)} is not finite")
            return
        self.torque.time_ns, self.torque.value = self.time_ns, torque

    def _on_recorded(self, data: bytes, published_ns: int) -> None:
        stamp = deserialize_message(data, Time)
        self._recorded_ns = stamp.sec * NANOSECONDS + stamp.nanosec
        if self.active:
            self._go_on()

    # Diagnostics.

    def health(self) -> tuple[str, str, dict[str, Any]]:
        """State of the run, misses per cause, latency and jitter."""
        misses = self.misses
        level = "ok"
        if misses.total and self.ticks:
            level = "error" if misses.total > 0.01 * self.ticks else "warn"
        if self.state in ENDED_EARLY:
            level = "error"
        message = f"{self.state}: {self.detail}" if self.detail else self.state
        if self.pause.paused:
            message = f"paused in tick {self.tick}"
        if misses.total:
            message += f", {misses.total} deadlines missed"
        safety = "safe_stop" if self.active and self.stopping_safely else "normal"
        if safety != "normal":
            level, message = "error", f"{message}, safe stop: no fresh torque"
        ended = {} if self.ended_at is None else {"ended_at": repr(self.ended_at)}
        return level, message, {
            "state": self.state,
            "detail": self.detail,
            **ended,
            "mode": self.mode,
            "tick": self.tick,
            "last_tick": self.scenario.last_tick,
            "elapsed_seconds": round(self.elapsed or time.monotonic() - self._began, 3),
            "paused": self.pause.paused,
            "pauses": self.pause.count,
            "paused_seconds": round(self.pause.seconds, 3),
            "missed_deadlines": misses.total,
            **asdict(misses),
            "asked_again": self.asked_again,
            "repeated": self.repeated,
            "safety": safety,
            "safe_stops": self.safe_stops,
            "safe_stop_ticks": self.safe_stop_ticks,
            **self._clocks.look(),
            **self.statistics("latency", self.latencies),
            **self.statistics("jitter", self.lateness),
            **self.statistics("execution", self.times),
        }  # fmt: skip


def main() -> None:
    """Entry point of ``ros2 run ftcm_ros plant``."""
    sys.exit(run(PlantNode))


if __name__ == "__main__":
    main()
