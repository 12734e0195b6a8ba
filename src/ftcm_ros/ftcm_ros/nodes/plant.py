# SPDX-License-Identifier: Apache-2.0
"""The plant node: publishes ``joint_states``, integrates the robot, and is the only one with a clock."""

from __future__ import annotations

import sys
import time
from dataclasses import asdict
from typing import Any

from builtin_interfaces.msg import Time
from rclpy.serialization import deserialize_message
from std_msgs.msg import String

from ftcm_core.errors import FtcmError
from ftcm_core.signals import NANOSECONDS, TrueDisturbance, seconds
from ftcm_core.trace import ENDED_EARLY
from ftcm_ros.nodes.main import run
from ftcm_ros.nodes.suite_node import POLL_NS, SuiteNode
from ftcm_ros.timing.clocks import ClockWatch
from ftcm_ros.timing.durations import Durations
from ftcm_ros.timing.pacing import PACERS, Misses, RealTime
from ftcm_ros.transport.topics import (
    CLOCK,
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


class PlantNode(SuiteNode):
    """Simulates the robot, one tick after the other, in lockstep or in real time."""

    def __init__(self) -> None:
        """Subscribe torque and disturbance, publish the measurement."""
        super().__init__("plant")
        self.mode: str = self.setting("mode")
        self.recorder_window: int = self.setting("recorder_window")
        timeout: int = self.setting("torque_timeout")
        if timeout < 0:
            raise FtcmError(f"torque_timeout: {timeout} is out of range; expected ticks, or 0: never")
        self._torque_timeout_ns = timeout * self.scenario.dt_ns or sys.maxsize
        self._publish = self.plane.publisher(JOINT_STATES)
        exact = self.scenario.sensor.exact
        self._publish_truth = None if exact else self.plane.publisher(TRUE_STATE)
        self._publish_clock = self.plane.publisher(CLOCK)
        self._publish_scenario = self.plane.publisher(SCENARIO)
        self._inputs: dict[Topic, dict[str, Any]] = {}
        for topic in (TORQUES, DISTURBANCE):
            self._inputs[topic] = {}
            self.plane.subscribe(topic, self._handler(topic))
        self.plane.subscribe(RECORDED, self._on_recorded)
        self._recorded_ns = -1
        self._clocks = ClockWatch()
        self.state = "waiting"
        self.detail = ""
        self._began = time.monotonic()
        self.elapsed = 0.0
        self.configure()

    def _handler(self, topic: Topic) -> Any:
        latest = self._inputs[topic]

        def handle(data: bytes, published_ns: int) -> None:
            if not self.active:
                return
            sample = self.decode(topic, data, ("effort",))
            if sample is None:
                return
            time_ns, value = sample.time_ns, sample.effort
            if latest["time_ns"] < time_ns <= self.time_ns:
                latest["time_ns"], latest["value"] = time_ns, value
                if time_ns == self.time_ns:
                    self._on_input()
            elif time_ns > self.time_ns:
                self.refuse(topic, "future", f"t = {seconds(time_ns):g} s has not come yet")
            elif time_ns == latest["time_ns"] and value == latest["value"]:
                self.repeated += 1
            elif time_ns == latest["time_ns"]:
                self.refuse(topic, "conflicting", f"another value for t = {seconds(time_ns):g} s")
            else:
                self.refuse(topic, "stale", f"t = {seconds(time_ns):g} s after a later tick")

        return handle

    def _on_recorded(self, data: bytes, published_ns: int) -> None:
        stamp = deserialize_message(data, Time)
        self._recorded_ns = stamp.sec * NANOSECONDS + stamp.nanosec
        if self.active:
            self._go_on()

    def configure(self) -> None:
        """The robot at its initial state."""
        self.stage = self.scenario.plant_stage()
        self.misses = Misses()
        self.pacer = PACERS[self.mode](self.scenario.dt_ns, misses=self.misses)
        self.tick = 0
        self.time_ns = 0
        self._recorded_ns = -1
        for latest in self._inputs.values():
            latest.update(time_ns=-1, value=(0.0,) * self.scenario.robot.joints)
        self.latencies = Durations()
        self.lateness = Durations()
        self.times = Durations()
        self._answered = False
        self._finished = False
        self._published_at = 0
        self.asked_again = 0
        self.repeated = 0
        """Inputs that came again for their tick, the same."""
        self.stopping_safely = False
        self.safe_stops = self.safe_stop_ticks = 0
        self._raised = ""
        """What the robot's equations raised: it was driven out of their domain."""

    def activate(self) -> None:
        """Begin at tick 0."""
        self.configure()
        self.state, self.detail = "running", ""
        self._publish_scenario(String(data=self.scenario.to_yaml()))
        self._began = time.monotonic()
        self.elapsed = 0.0
        self._prepare(0)
        self._publish_measurement()
        self.pacer.begin()

    def deactivate(self) -> None:
        """End the run where it is."""
        if self.state == "running":
            self.state, self.detail = "incomplete", f"stopped at t = {seconds(self.time_ns):g} s"

    def step(self) -> None:
        """One round: wait for the end of the tick, go on to the next."""
        if self._finished or not self.active:
            self.plane.poll(POLL_NS)
        elif self.pacer.wait(self._ready, self._poll):
            self._end_of_tick()
        elif time.monotonic_ns() - self._published_at > ASK_AGAIN_NS and not self._answered:
            self.asked_again += 1
            self._publish_measurement()

    def _poll(self, timeout_ns: int) -> None:
        """Wait for the disturbance, which comes last, and take the torque with it."""
        early = self._inputs[DISTURBANCE]["time_ns"] == self.time_ns and not self._answered
        self.plane.poll(timeout_ns, None if early or self._recorder_behind() else DISTURBANCE)

    def _ready(self) -> bool:
        return self._answered and not self._finished and not self._recorder_behind()

    def _recorder_behind(self) -> bool:
        if self.mode != "lockstep" or self.recorder_window == 0:
            return False
        window = 0 if self.tick == self.scenario.last_tick else self.recorder_window
        return self.time_ns - self._recorded_ns > window * self.scenario.dt_ns

    def _on_input(self) -> None:
        """An input of this tick has come: with both, integrate at once, ahead of the deadline."""
        torque, disturbance = (self._inputs[t]["time_ns"] == self.time_ns for t in (TORQUES, DISTURBANCE))
        if torque and disturbance and not self._answered:
            self._answered = True
            self.latencies.add(time.monotonic_ns() - self._published_at)
            self._integrate()
            self._go_on()

    def _go_on(self) -> None:
        """In lockstep nothing else has to be waited for: end the tick at once."""
        if self.mode == "lockstep" and self._ready():
            self._end_of_tick()

    def _integrate(self) -> None:
        if self.tick < self.scenario.last_tick:
            begin = time.monotonic_ns()
            torque, d = self._inputs[TORQUES], TrueDisturbance(self._inputs[DISTURBANCE]["value"])
            try:
                if self._stop_safely(self.time_ns - torque["time_ns"] > self._torque_timeout_ns):
                    self.stage.safe_stop(d)
                else:
                    self.stage.step(torque["value"], d)
            except (ArithmeticError, ValueError) as error:
                self._raised = str(error)
            self._prepare(self.time_ns + self.scenario.dt_ns)
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

    def _end_of_tick(self) -> None:
        if not self._answered:  # real time only: hold the newest torque and disturbance
            if self._missed(TORQUES):  # the disturbance follows from the torque: one cause, not two
                self.misses.late_torque += 1
            elif self._missed(DISTURBANCE):
                self.misses.late_disturbance += 1
            self._integrate()
        self.ticks += 1
        if self._raised:
            self._finish("diverged", f"at t = {seconds(self.time_ns):g} s: {self._raised}")
        elif self.stage.reason:
            after = seconds(self.time_ns + self.scenario.dt_ns)
            self._finish(self.stage.status, f"at t = {after:g} s: {self.stage.reason}")
        elif self.tick == self.scenario.last_tick:
            self._finish("completed", f"{seconds(self.time_ns):g} s")
        else:
            self.tick += 1
            self.time_ns = self.tick * self.scenario.dt_ns
            self._answered = False
            self._publish_measurement()

    def _missed(self, topic: Topic) -> bool:
        """Whether an input has not come; none is expected of a topic without a publisher in this run."""
        newest = self._inputs[topic]["time_ns"]
        return newest < self.time_ns and (newest >= 0 or self.plane.has_publisher(topic))

    def _prepare(self, time_ns: int) -> None:
        """Encode what is published at the beginning of a tick, ahead of it."""
        stage = self.stage
        self._measurement = self.codec.state.encode(time_ns, *stage.measure())
        if self._publish_truth is not None:
            self._truth = self.codec.motion.encode(time_ns, stage.position, stage.velocity)

    def _publish_measurement(self) -> None:
        self._published_at = time.monotonic_ns()
        if isinstance(self.pacer, RealTime) and self.tick:
            self.lateness.add(self._published_at - self.pacer.deadline + self.scenario.dt_ns)
        self._publish(self._measurement)
        if self._publish_truth is not None:
            self._publish_truth(self._truth)
        if self.time_ns % CLOCK_PERIOD_NS == 0:
            sec, nanosec = divmod(self.time_ns, NANOSECONDS)
            self._publish_clock(
                b"\x00\x01\x00\x00" + sec.to_bytes(4, "little") + nanosec.to_bytes(4, "little")
            )

    def _finish(self, state: str, detail: str) -> None:
        self.state, self.detail = state, detail
        self.elapsed = time.monotonic() - self._began
        self.get_logger().info(f"{state}: {detail}")
        self._finished = True
        self.plane.serve(self.trigger_deactivate)

    def health(self) -> tuple[str, str, dict[str, Any]]:
        """State of the run, misses per cause, latency and jitter."""
        misses = self.misses
        level = "ok"
        if misses.total and self.ticks:
            level = "error" if misses.total > 0.01 * self.ticks else "warn"
        if self.state in ENDED_EARLY:
            level = "error"
        message = f"{self.state}: {self.detail}" if self.detail else self.state
        if misses.total:
            message += f", {misses.total} deadlines missed"
        safety = "safe_stop" if self.active and self.stopping_safely else "normal"
        if safety != "normal":
            level, message = "error", f"{message}, safe stop: no fresh torque"
        return level, message, {
            "state": self.state,
            "detail": self.detail,
            "mode": self.mode,
            "tick": self.tick,
            "last_tick": self.scenario.last_tick,
            "elapsed_seconds": round(self.elapsed or time.monotonic() - self._began, 3),
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
