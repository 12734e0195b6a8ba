# SPDX-License-Identifier: Apache-2.0
"""How data messages get in and out of a node: the only place that knows.

rclpy's executor costs about 130 µs a message, the middleware almost nothing, the waking of a thread
some 30 µs. So data messages do not use the executor, and cross as serialized bytes. There are three
paths with equal results, chosen by the parameter ``data_path``:

* ``listener``: a message is handled in the very thread of the middleware that received it, so that
  no other thread has to be woken. Where the middleware cannot do that, ``waitset`` is used.
* ``waitset``: the main thread waits in a wait set of its own for the data topics.
* ``executor``: everything goes through one ordinary executor.

On the first two, services, parameters, lifecycle and diagnostics are on an ordinary executor in a
background thread. On every path a handler runs only while the main thread is in :meth:`DataPlane.poll`
or :meth:`DataPlane.collect`, never beside anything else that the main thread does.
"""

from __future__ import annotations

import ctypes
import importlib
import sys
import threading
import time
from collections import deque
from collections.abc import Callable, Iterable
from typing import Any

from rclpy.callback_groups import CallbackGroup, MutuallyExclusiveCallbackGroup
from rclpy.duration import Duration
from rclpy.executors import ExternalShutdownException, ShutdownException, SingleThreadedExecutor
from rclpy.impl.implementation_singleton import rclpy_implementation as _rclpy
from rclpy.node import Node
from rclpy.publisher import Publisher
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from rclpy.subscription import Subscription
from rclpy.task import Task

from ftcm_core.scenario import Scenario
from ftcm_ros.sources import Source
from ftcm_ros.topics import Topic, subscribers

Handler = Callable[[bytes, int], None]
"""Takes one serialized message and the time it was published (system clock, ns)."""

GATHER_TICKS = 4
"""How many ticks are taken at a time where messages gather."""
GATHER_SECONDS = 0.003
"""How long the receiving thread sleeps once it has the newest tick, where messages gather."""
FRESH_NS = 500_000
"""A message younger than this is taken for the newest there is."""

SWITCH_INTERVAL = 1e-4
"""How long a background thread may keep the interpreter from the tick, s."""

ACKNOWLEDGE_SECONDS = 0.5
"""How long a node that ends waits for readers that have not received all of its messages."""

STOP_SECONDS = 8.0
"""How long the services thread may take to end; what it uses is destroyed then."""


_Callback = ctypes.CFUNCTYPE(None, ctypes.c_void_p, ctypes.c_size_t)
"""rcl_event_callback_t: user data, number of messages."""


def _call_on_message(handle: Any, callback: Any) -> bool:
    """Let the middleware's receiving thread call a function for new messages (None: no longer).

    rclpy has no such call, rcl does. ctypes releases the interpreter meanwhile, so a callback that
    is under way can end.
    """
    try:
        set_callback = ctypes.CDLL("librcl.so").rcl_subscription_set_on_new_message_callback
    except (OSError, AttributeError):
        return False
    set_callback.argtypes = [ctypes.c_void_p, ctypes.c_void_p, ctypes.c_void_p]
    return bool(set_callback(handle.pointer, ctypes.cast(callback, ctypes.c_void_p), None) == 0)


_Taken = tuple[Topic, Any, Any, Callable[[bytes, Any], None]]
"""A subscription: topic, rclpy handle, message class and callback."""


class _NoExecutor(CallbackGroup):
    """Keeps subscriptions out of the executor's wait set: the data plane takes them itself."""

    def can_execute(self, entity: Any) -> bool:
        return False

    def beginning_execution(self, entity: Any) -> bool:
        return False

    def ending_execution(self, entity: Any) -> None:
        pass


def message_class(type_name: str) -> Any:
    """Return the Python class of ``package/msg/Name``."""
    package, _, name = type_name.partition("/msg/")
    return getattr(importlib.import_module(f"{package}.msg"), name)


def qos(topic: Topic) -> QoSProfile:
    """Reliable with explicit depth; latched topics keep their messages for late subscribers."""
    return QoSProfile(
        depth=topic.depth,
        reliability=ReliabilityPolicy.RELIABLE,
        durability=DurabilityPolicy.TRANSIENT_LOCAL if topic.latched else DurabilityPolicy.VOLATILE,
    )


class DataPlane:
    """The data subscriptions and publishers of one node."""

    def __init__(self, node: Node, path: str, gather: Topic | None = None) -> None:
        """Use the given path.

        Args:
            node: whose topics these are.
            path: ``listener``, ``waitset`` or ``executor``.
            gather: messages are only taken by :meth:`collect`, many at a time, and best after one of this
                topic, the last to come in a tick.
        """
        self._node = node
        self._path = path
        self._gather = gather
        self._group = MutuallyExclusiveCallbackGroup() if path == "executor" else _NoExecutor()
        self._wanted: list[tuple[Topic, Handler]] = []
        self._subscriptions: list[Subscription] = []
        self._taken: list[_Taken] = []
        """In order of declaration."""
        self._loose: list[_Taken] = []
        """What gathers with the middleware."""
        self._gathered: deque[tuple[Callable[[bytes, Any], None], Any]] = deque(
            maxlen=None if gather is None else gather.depth
        )
        """What gathers here: callback and its arguments."""
        self._enough = threading.Event()
        self.sources: dict[str, Source] = {}
        """Whose messages count, of each subscribed topic that has one publisher in the suite."""
        self._publishers: list[tuple[Topic, Publisher]] = []
        self._wait_set: Any = None
        self._callbacks: list[Any] = []
        self._thread_state = threading.local()
        self._failure: Exception | None = None
        """What a handler or the services thread has raised; raised again on the main thread."""
        self.turn = threading.Condition(threading.RLock())
        """Held by whoever may touch the node's data: by the main thread, except while it polls."""
        self._executor = SingleThreadedExecutor(context=node.context)
        self._thread: threading.Thread | None = None
        self._timer: threading.Thread | None = None
        self._stopped = threading.Event()

    def subscribe(self, topic: Topic, handler: Handler) -> None:
        """Hand every message of a topic to a handler, serialized, on the main thread, once opened.

        Of a topic that has one publisher in the suite, messages of others are dropped and counted.
        """
        self._wanted.append((topic, handler))

    def open(self) -> None:
        """Make the subscriptions, if that has not been done.

        A writer serves its readers in the order in which they were matched, at some 25 µs each. So
        whoever configures the nodes in the order of the tick gets the shortest chain.
        """
        for topic, handler in self._wanted:
            cls = message_class(topic.type)
            callback = self._callback(topic, handler)
            made = self._node.create_subscription(
                cls, topic.name, callback, qos(topic), callback_group=self._group, raw=True
            )
            self._subscriptions.append(made)
            self._taken.append((topic, made.handle, cls, callback))
        if self._wanted and self._path == "listener" and not self._listen():
            self._node.get_logger().warning("data_path listener is not possible here; waitset is used")
            self._path = "waitset"
        if self._wanted and self._path == "waitset":
            count = len(self._subscriptions)
            self._wait_set = _rclpy.WaitSet(count, 0, 0, 0, 0, 0, self._node.context.handle)
        self._wanted = []

    def _callback(self, topic: Topic, handler: Handler) -> Callable[[bytes, Any], None]:
        if len(topic.publishers) > 1:
            return lambda data, info: handler(data, info["source_timestamp"])
        source = self.sources[topic.name] = Source(
            lambda: self._node.count_publishers(topic.name),
            lambda: any(name not in topic.publishers for name in self._publishing(topic.name)),
        )

        def callback(data: bytes, info: Any) -> None:
            if source.admits(info["publication_sequence_number"]):
                handler(data, info["source_timestamp"])

        return callback

    def _listen(self) -> bool:
        """Have messages taken by the thread that receives them: handled at once, or gathered.

        Of what gathers only one topic is listened to. The others can be taken by the main thread: the
        middleware does not call back for them. Of a topic it calls back for, it holds a lock of its own
        meanwhile, which another thread that takes would wait for with the interpreter's in its hands.
        """
        for entry in self._taken:
            if self._gather not in (None, entry[0]):
                self._loose.append(entry)
                continue
            receive = self._answering(entry) if self._gather is None else self._gathering(entry)
            self._callbacks.append(_Callback(receive))
            if not _call_on_message(entry[1], self._callbacks[-1]):
                self._ignore()
                return False
        return True

    def _keep_thread(self) -> None:
        """Have Python remember this thread of the middleware, instead of making and dropping it each time."""
        if not hasattr(self._thread_state, "kept"):
            ctypes.pythonapi.PyGILState_Ensure()
            self._thread_state.kept = True

    def _answering(self, entry: _Taken) -> Callable[[Any, int], None]:
        def receive(_: Any, count: int) -> None:
            self._keep_thread()
            with self.turn:
                if self._failure is not None:  # the main thread is about to end the node
                    return
                try:
                    self._take_all((entry,))
                except Exception as error:
                    self._failure = error
                    self.turn.notify()

        return receive

    def _gathering(self, entry: _Taken) -> Callable[[Any, int], None]:
        _, handle, cls, callback = entry
        ticks = 0

        def receive(_: Any, count: int) -> None:
            nonlocal ticks
            self._keep_thread()
            fresh = False
            while (taken := handle.take_message(cls, True)) is not None:
                self._gathered.append((callback, taken))
                ticks += 1
                fresh = 0 <= time.time_ns() - taken[1]["source_timestamp"] < FRESH_NS
            if fresh or ticks >= GATHER_TICKS:
                ticks = 0
                self._enough.set()
            if fresh:  # what comes meanwhile waits with the middleware, and wakes nobody
                time.sleep(GATHER_SECONDS)

        return receive

    @staticmethod
    def _take_all(entries: Iterable[_Taken]) -> None:
        for _, handle, cls, callback in entries:
            while (taken := handle.take_message(cls, True)) is not None:
                callback(*taken)

    def _ignore(self) -> None:
        if self._callbacks:
            for _, handle, _, _ in self._taken:
                _call_on_message(handle, None)
        self._callbacks, self._loose = [], []

    def publisher(self, topic: Topic) -> Callable[[Any], None]:
        """Return a function that publishes a message object or its serialized bytes."""
        made = self._node.create_publisher(message_class(topic.type), topic.name, qos(topic))
        self._publishers.append((topic, made))
        return made.publish

    def start(self) -> None:
        """Begin to serve the node's other callbacks."""
        self._executor.add_node(self._node)
        if self._path != "executor":
            sys.setswitchinterval(SWITCH_INTERVAL)
            self._thread = threading.Thread(target=self._serve, name="services", daemon=True)
            self._thread.start()

    def serve(self, work: Callable[[], Any]) -> Task:
        """Have something done where the node's other callbacks are: after one of them, never beside it."""
        return self._executor.create_task(work)

    def serve_every(self, seconds: float, work: Callable[[], Any]) -> None:
        """Have something done now and then, by the steady clock.

        A timer of the executor stands still while the system time, set back, catches up.
        """

        def ask() -> None:
            task = None
            while not self._stopped.wait(seconds):
                if task is None or task.done():
                    task = self.serve(work)

        self._timer = threading.Thread(target=ask, name="timer", daemon=True)
        self._timer.start()

    def _serve(self) -> None:
        try:
            while not self._stopped.is_set() and self._node.context.ok():  # a shut-down executor says nothing
                self._spin(None)
        except (ExternalShutdownException, ShutdownException):
            return
        except Exception as error:
            self._failure = error

    def _spin(self, seconds: float | None) -> None:
        """Serve one callback; a lifecycle transition that is not possible now must not end the node."""
        try:
            self._executor.spin_once(timeout_sec=seconds)
        except _rclpy.RCLError as error:
            self._node.get_logger().warning(f"request not possible now: {error}")

    def stop(self) -> None:
        """Stop serving; the data plane is not used after this.

        What a writer has sent is lost to a reader that has not received it when it hears that the writer
        has gone; so it goes when all is received.
        """
        self._ignore()
        end = time.monotonic() + ACKNOWLEDGE_SECONDS
        for _, made in self._publishers:
            made.wait_for_all_acked(Duration(seconds=max(0.0, end - time.monotonic())))
        self._stopped.set()
        if self._timer is not None:
            self._timer.join()
        self._executor.shutdown(timeout_sec=STOP_SECONDS)
        if self._thread is not None:
            self._thread.join(timeout=STOP_SECONDS)

    def poll(self, timeout_ns: int, trigger: Topic | None = None) -> None:
        """Wait at most so long for messages, then hand what is here to the handlers, one of each topic.

        Args:
            timeout_ns: longest wait, ns.
            trigger: wake up only for this topic, the last to come in a tick, instead of for every
                message; the others are looked at then, and when the time is up.

        Raises:
            Exception: what a handler has raised.
        """
        self._raise_failure()
        if self._path == "listener":
            self.turn.wait(timeout_ns / 1e9)
            self._raise_failure()
            return
        if self._path == "executor":
            self._spin(timeout_ns / 1e9)
            return
        wait_set = self._wait_set
        if wait_set is None:  # not opened yet
            time.sleep(timeout_ns / 1e9)
            return
        wait_set.clear_entities()
        for topic, handle, _, _ in self._taken:
            if trigger is None or topic is trigger:
                wait_set.add_subscription(handle)
        wait_set.wait(timeout_ns)
        for _, handle, cls, callback in self._taken:
            taken = handle.take_message(cls, True)
            if taken is not None:
                callback(*taken)

    def _raise_failure(self) -> None:
        if self._failure is not None:
            raise self._failure

    def wake(self) -> None:
        """End the wait of :meth:`poll`, where it would not end by itself soon."""
        if self._gather is not None:
            self._enough.set()
        elif self._path == "listener":
            with self.turn:
                self.turn.notify()

    def collect(self, seconds: float) -> None:
        """Let messages gather for a while, then hand all of them to the handlers: one wake-up for many."""
        self._raise_failure()
        if self._path == "executor":
            self._spin(seconds)
            return
        self._enough.wait(seconds)
        self._enough.clear()
        while self._gathered:
            callback, taken = self._gathered.popleft()
            callback(*taken)
        self._take_all(self._loose or self._taken)

    def unmatched(self, scenario: Scenario) -> str:
        """Which endpoint still waits for the suite's other nodes; empty when all are matched."""
        for topic, made in self._publishers:
            wanted = subscribers(topic, scenario)
            if (count := made.get_subscription_count()) < len(wanted):
                return f"{topic.name} has {count} of {len(wanted)} subscribers ({', '.join(wanted)})"
        for subscription in self._subscriptions:
            if subscription.get_publisher_count() == 0:
                return f"{subscription.topic_name} has no publisher"
        return self.rivals()

    def rivals(self) -> str:
        """Which subscribed topic has more than the suite's one publisher, and whose; empty if none has."""
        for name in list(self.sources):
            if self._node.count_publishers(name) < 2:
                continue
            found = self._publishing(name)
            if len(found) > 1:
                return f"{name} has {len(found)} publishers: {', '.join(found)}"
        return ""

    def _publishing(self, name: str) -> list[str]:
        """Names of the nodes that publish a topic, in order."""
        found = self._node.get_publishers_info_by_topic(self._node.resolve_topic_name(name))
        return sorted(i.node_name for i in found)

    def has_publisher(self, topic: Topic) -> bool:
        """Whether anybody publishes a topic that this node subscribes."""
        return any(s.get_publisher_count() for s in self._subscriptions if s.topic_name.endswith(topic.name))
