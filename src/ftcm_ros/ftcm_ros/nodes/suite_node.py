# SPDX-License-Identifier: Apache-2.0
"""What all nodes share: parameters, lifecycle, diagnostics and the main loop."""

from __future__ import annotations

import gc
import os
import secrets
import threading
import time
from abc import abstractmethod
from collections.abc import Callable
from pathlib import Path
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from rcl_interfaces.msg import ParameterDescriptor
from rclpy.lifecycle import LifecycleNode, LifecycleState, TransitionCallbackReturn

from ftcm_core.compiled import NotCompilable
from ftcm_core.compiled.stage import StageProgram, compiled_stage, stage_program
from ftcm_core.errors import FtcmError
from ftcm_core.registry import Component, load_plugins
from ftcm_core.scenario import Scenario, load
from ftcm_core.signals import NANOSECONDS, seconds
from ftcm_ros.parameters.node_parameters import setting
from ftcm_ros.timing import scheduling
from ftcm_ros.timing.durations import Durations
from ftcm_ros.transport.codec import CodecError, JointSample, JointStateCodec
from ftcm_ros.transport.composed import ComposedPlane, Composition
from ftcm_ros.transport.plane import make_plane
from ftcm_ros.transport.topics import DIAGNOSTICS, Topic

POLL_NS = NANOSECONDS // 50
"""How often a waiting node looks at other things, ns."""
REPORT_SECONDS = 1.0
PROCESS = f"{os.getpid()}-{secrets.token_hex(4)}"
"""Tells this process from every other, also of another container or machine."""
HEARTBEAT = os.environ.get("FTCM_HEARTBEAT")
"""File to touch with every report, for a health check from outside; none by default."""
MATCH_TIMEOUT = 20.0
"""How long a node waits at activation for the suite's other nodes, s."""


class SuiteNode(LifecycleNode):
    """A managed node; what touches its data is done one thing at a time."""

    gathers: Topic | None = None
    """The topic after which messages are collected, many at a time, instead of answered each at once."""

    def __init__(self, name: str, composition: Composition | None = None) -> None:
        """Declare the common parameters and read the scenario.

        Args:
            name: which node of the suite this is.
            composition: what it shares with the other nodes of this process, if there are any.

        Raises:
            FtcmError: a parameter, a plug-in or the scenario is not valid.
        """
        super().__init__(name)
        self.name_in_suite = name
        self.composition = composition
        load_plugins(name.strip() for name in self.setting("plugins").split(",") if name.strip())
        self.scenario: Scenario = load(self.setting("scenario"))
        self.autostart: bool = self.setting("autostart")
        self._await_graph: bool = self.setting("await_graph")
        self._not_permitted = scheduling.apply(
            *(self.setting(n) for n in ("priority", "lock_memory", "processors"))
        )
        for line in self._not_permitted:
            self.get_logger().warning(line)
        self.codec = JointStateCodec(self.scenario.robot.joint_names)
        path = self.setting("data_path")
        self.plane = (
            ComposedPlane(self, name, self.scenario, composition)
            if composition
            else make_plane(self, path, self.gathers)
        )
        self.stages: str = self.setting("stages") if name != "recorder" else ""
        """``plain`` or ``compiled``."""
        self.active = False
        self.stopping = False
        self._failure = ""
        self.ticks = 0
        """Ticks done since activation."""
        self.refused: dict[str, int] = {}
        """Messages refused, per kind, and the last reason."""
        self.refusal = ""
        self._dt_ns, self._end_ns = self.scenario.dt_ns, self.scenario.last_tick * self.scenario.dt_ns
        self._report = self.plane.publisher(DIAGNOSTICS)
        self._report_marks = (time.monotonic(), 0)
        self._time_marks = (0.0, 0.0)
        """Processor time and time without a processor when the run began, s."""
        self._main = threading.current_thread()
        self._work: list[tuple[Callable[[], Any], threading.Event, list[Any]]] = []

    def setting(self, name: str) -> Any:
        """Declare one of this node's read-only parameters and return its value."""
        declared = setting(self.name_in_suite, name)
        text = declared.description + (f"; one of {', '.join(declared.choices)}" if declared.choices else "")
        descriptor = ParameterDescriptor(
            description=text, read_only=True, dynamic_typing=isinstance(declared.default, float)
        )
        return declared.check(self.declare_parameter(name, declared.default, descriptor).value)

    def staged(self, stage: Any, component: Component | None = None) -> Any:
        """Return this node's stage, or what stands in its place compiled.

        Args:
            stage: the stage.
            component: that it uses, where that may be another than the scenario's.

        Raises:
            FtcmError: it cannot be compiled.
        """
        if self.stages == "plain":
            return stage
        return compiled_stage(stage, self.program(component))

    def program(self, component: Component | None = None) -> StageProgram:
        """Compile this node's stage with a component, or find it compiled.

        Raises:
            FtcmError: it cannot be compiled.
        """
        try:
            return stage_program(self.name_in_suite, self.scenario, component)
        except NotCompilable as error:
            raise FtcmError(f"stages: compiled is not possible: {error}; use stages: plain") from None

    # Lifecycle. Transitions run on the services thread; what touches the data runs on the main one.

    def on_configure(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Make the stage ready to begin a run."""
        return self._transition(self._configure)

    def on_activate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Begin a run."""
        if self._await_graph and not self._wait_for_graph():
            return TransitionCallbackReturn.FAILURE
        return self._transition(self._activate)

    def on_deactivate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """End the run."""
        return self._transition(self._deactivate)

    def on_shutdown(self, state: LifecycleState) -> TransitionCallbackReturn:
        """End the run and the process."""
        result = self._transition(self._deactivate)
        self.stopping = True
        return result

    def _configure(self) -> None:
        self.plane.open()
        self.configure()

    def _activate(self) -> None:
        self.ticks = 0
        gc.collect()
        gc.freeze()
        self._time_marks = (time.process_time(), scheduling.waited_seconds())
        self.active = True  # now: the first tick may be answered before it has been begun
        try:
            self.activate()
        except Exception:
            self.active = False
            raise

    def _deactivate(self) -> None:
        if self.active:
            self.conclude()
            self.active = False
            self.deactivate()
            self.report()

    def _transition(self, work: Callable[[], None]) -> TransitionCallbackReturn:
        try:
            self.on_main_thread(work)
        except (FtcmError, OSError) as error:
            self._failed(str(error))
            return TransitionCallbackReturn.FAILURE
        return TransitionCallbackReturn.SUCCESS

    def _failed(self, reason: str) -> None:
        self._failure = reason
        if not self.autostart:  # else the process ends with this line
            self.get_logger().error(reason)

    def _wait_for_graph(self) -> bool:
        end = time.monotonic() + MATCH_TIMEOUT
        while missing := self.plane.unmatched(self.scenario):
            if time.monotonic() > end or self.stopping:
                self._failed(f"not activated: {missing} after {MATCH_TIMEOUT:g} s")
                return False
            time.sleep(0.01)  # the graph has no wait of its own that covers both directions
        return True

    def configure(self) -> None:
        """Make the stage; main thread."""

    def activate(self) -> None:
        """Begin a run; main thread."""

    def conclude(self) -> None:
        """Do what belongs to the run's last moments: the node is still active; main thread."""

    def deactivate(self) -> None:
        """End the run; main thread."""

    def abandon(self) -> None:
        """Save what can be saved; an error is about to end the process."""

    def on_main_thread(self, work: Callable[[], Any]) -> Any:
        """Run something between two polls of the main loop and return its result."""
        if threading.current_thread() is self._main:
            return work()
        done, outcome = threading.Event(), [None, None]
        self._work.append((work, done, outcome))
        self.plane.wake()
        done.wait()
        if outcome[1] is not None:
            raise outcome[1]
        return outcome[0]

    def do_main_thread_work(self) -> None:
        """Run what other threads have asked for."""
        while self._work:
            work, done, outcome = self._work.pop(0)
            try:
                outcome[0] = work()
            except Exception as error:  # handed to the thread that asked
                outcome[1] = error
            done.set()

    def serve(self) -> None:
        """Begin to answer services, and to report."""
        self.plane.start()
        self.plane.serve_every(REPORT_SECONDS, self.report)

    def begin(self) -> None:
        """Become active; main thread.

        Raises:
            FtcmError: that is not possible.
        """
        self.trigger_activate()
        if not self.active:
            raise FtcmError(self._failure)

    def end(self) -> None:
        """End the run, if there is one; main thread."""
        self.do_main_thread_work()
        self._deactivate()

    def step(self) -> None:
        """One round of the main loop: by default, wait for messages."""
        self.plane.poll(POLL_NS)

    # Messages.

    def subscribe(self, topic: Topic, arrays: tuple[str, ...], take: Callable[[JointSample], None]) -> None:
        """Have messages of a data topic taken while a run is on, if they can be used.

        Args:
            topic: which.
            arrays: which arrays must be filled.
            take: takes what a message says.
        """

        def handle(data: bytes, published_ns: int) -> None:
            if self.active and (sample := self.decode(topic, data, arrays)) is not None:
                take(sample)

        def hand(sample: JointSample) -> None:
            if self.active:
                take(sample)

        self.plane.subscribe(topic, handle, hand)

    def decode(self, topic: Topic, data: bytes, arrays: tuple[str, ...] = ()) -> JointSample | None:
        """Decode a JointState; None and a count if it is refused.

        Args:
            topic: where it came from.
            data: the serialized message.
            arrays: which arrays must be filled.
        """
        try:
            sample = self.codec.decode(data)
        except CodecError as error:
            self.refuse(topic, "malformed", str(error))
            return None
        time_ns = sample.time_ns
        if time_ns % self._dt_ns or not 0 <= time_ns <= self._end_ns:
            self.refuse(topic, "stamp", f"t = {seconds(time_ns):.9f} s is not a tick of this run")
            return None
        for array in arrays:
            if not getattr(sample, array):
                self.refuse(topic, "malformed", f"{array} is empty; expected one value per joint")
                return None
        return sample

    def refuse(self, topic: Topic, kind: str, reason: str) -> None:
        """Count a message that cannot be used."""
        if not self.refused:
            self.get_logger().warning(f"message refused: {topic.name}: {reason}")
        self.refused[kind] = self.refused.get(kind, 0) + 1
        self.refusal = f"{topic.name}: {reason}"

    # Diagnostics.

    @abstractmethod
    def health(self) -> tuple[str, str, dict[str, Any]]:
        """Return level (``ok``, ``warn``, ``error``), a message and values; services thread."""

    def statistics(self, name: str, durations: Durations) -> dict[str, float]:
        """Mean and percentiles: while running, of the last second; then of the whole run."""
        return durations.recent(name) if self.active else durations.whole(name)

    def report(self) -> None:
        """Publish this node's diagnostics."""
        now, (then, ticks) = time.monotonic(), self._report_marks
        self._report_marks = (now, self.ticks)
        level, message, values = self.health()
        rate = max(0, self.ticks - ticks) / max(now - then, 1e-9)
        kinds = dict(self.refused)
        for name, identity in list(self.plane.identities.items()):
            if identity.refused:
                kinds["other_publisher"] = kinds.get("other_publisher", 0) + identity.refused
                self.refusal = self.refusal or f"{name}: from another publisher"
        refused = sum(kinds.values())
        if refused:
            level, message = "error", f"{message}; {refused} messages refused, last: {self.refusal}"
        if rivals := self.plane.rivals():
            level, message = "error", f"{message}; {rivals}"
        common: dict[str, Any] = {
            "ticks": self.ticks,
            "rate_hz": round(rate, 1),
            "refused": refused,
            **{f"refused_{kind}": count for kind, count in kinds.items()},
            "process": PROCESS,
            "cpu_seconds": round(time.process_time() - self._time_marks[0], 3),
        }
        if self.stages:
            common["stages"] = self.stages
        if not self.active:  # it takes too long to be looked at while the ticks go on
            common["waited_seconds"] = round(scheduling.waited_seconds() - self._time_marks[1], 3)
        if self._not_permitted:
            common["not_permitted"] = "; ".join(self._not_permitted)
        status = DiagnosticStatus(
            level={"ok": DiagnosticStatus.OK, "warn": DiagnosticStatus.WARN, "error": DiagnosticStatus.ERROR}[
                level
            ],
            name=f"{self.get_name()}: tick",
            message=message,
            hardware_id=self.scenario.robot.type_name,
            values=[KeyValue(key=k, value=str(v)) for k, v in {**common, **values}.items()],
        )
        array = DiagnosticArray(status=[status])
        array.header.stamp = self.get_clock().now().to_msg()
        self._report(array)
        if HEARTBEAT:
            Path(HEARTBEAT).touch()
