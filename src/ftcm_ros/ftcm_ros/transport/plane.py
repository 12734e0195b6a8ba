# SPDX-License-Identifier: Apache-2.0
"""The data plane of a node: how its data messages come in and go out.

This is the interface that the nodes use. A node does not know how its messages are taken: the parameter
``data_path`` chooses one of the transports, of which each has a file of its own. Their results are equal.

* ``listener`` (:mod:`~ftcm_ros.transport.listener`): the thread that receives a message handles it too.
* ``waitset`` (:mod:`~ftcm_ros.transport.wait_set`): the main thread waits for data messages.
* ``executor`` (:mod:`~ftcm_ros.transport.executor`): everything goes through one ordinary executor.
* composed (:mod:`~ftcm_ros.transport.composed`): for the nodes of one process, which hand their messages over
  to each other; it is chosen by starting them so, and takes the messages of other processes as ``listener``.

The first two exist because an executor costs about 130 µs a message and the waking of a thread about
30 µs. With them, services, parameters, lifecycle and diagnostics are on an ordinary executor in a
background thread. With each of them, data messages are published as serialized bytes, and a handler runs
only while the main thread is in :meth:`DataPlane.poll` or :meth:`DataPlane.collect`, or sends: never beside
anything else that the main thread does.

A new transport is a subclass of :class:`DataPlane` in a file of its own, with the four abstract methods;
it may replace others. It is named in :func:`make_plane`, and in the choices of the parameter.
"""

from __future__ import annotations

import importlib
import sys
import threading
import time
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable
from typing import Any, NamedTuple

from rclpy.callback_groups import CallbackGroup
from rclpy.duration import Duration
from rclpy.executors import ExternalShutdownException, ShutdownException, SingleThreadedExecutor
from rclpy.impl.implementation_singleton import rclpy_implementation as _rclpy
from rclpy.node import Node
from rclpy.publisher import Publisher
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from rclpy.subscription import Subscription
from rclpy.task import Task

from ftcm_core.scenario import Scenario
from ftcm_ros.transport.codec import JointSample, Layout
from ftcm_ros.transport.publisher_identity import PublisherIdentity
from ftcm_ros.transport.topics import Topic, subscribers

Handler = Callable[[bytes, int], None]
"""Takes one serialized message and the time it was published (system clock, ns)."""
Take = Callable[[JointSample], None]
"""Takes what a message says."""

SWITCH_INTERVAL = 1e-4
"""How long a background thread may keep the interpreter from the tick, s."""
ACKNOWLEDGE_SECONDS = 0.5
"""How long a node that ends waits for readers that have not received all of its messages."""
STOP_SECONDS = 8.0
"""How long the services thread may take to end. What it uses is destroyed then."""


class Sender(NamedTuple):
    """How a node sends its messages of one data topic."""

    ready: Callable[..., Any]
    """Makes a message of a stamp (ns) and the filled arrays, in order."""
    send: Callable[[Any], None]
    """Sends such a message, to whoever wants it; again, if called again."""


class Taken(NamedTuple):
    """A subscription from which a transport takes messages."""

    topic: Topic
    handle: Any
    """rclpy's handle: what the middleware knows."""
    message_class: Any
    callback: Callable[[bytes, Any], None]
    """Takes one serialized message and what the middleware says about it."""

    def take(self) -> Any:
        """Take the next message that waits: the arguments of the callback, or None if none waits."""
        return self.handle.take_message(self.message_class, True)

    def handle_all(self) -> None:
        """Take all messages that wait, and handle them.

        Raises:
            Exception: what the handler has raised.
        """
        _, handle, cls, callback = self
        while (taken := handle.take_message(cls, True)) is not None:
            callback(*taken)


class _NoExecutor(CallbackGroup):
    """Keeps subscriptions out of the executor's wait set: the data plane takes their messages itself."""

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
    """Return the quality of service: reliable, of a stated depth; latched topics keep their messages."""
    return QoSProfile(
        depth=topic.depth,
        reliability=ReliabilityPolicy.RELIABLE,
        durability=DurabilityPolicy.TRANSIENT_LOCAL if topic.latched else DurabilityPolicy.VOLATILE,
    )


def make_plane(node: Node, path: str, gather: Topic | None = None) -> DataPlane:
    """Make the data plane of a node that has a process to itself.

    Args:
        node: whose topics these are.
        path: value of the parameter ``data_path``.
        gather: messages are only taken by :meth:`DataPlane.collect`, many at a time. A good moment for that
            is after a message of this topic, the last to come in a tick.
    """
    from ftcm_ros.transport.executor import ExecutorPlane
    from ftcm_ros.transport.listener import ListenerPlane
    from ftcm_ros.transport.wait_set import WaitSetPlane

    planes: dict[str, type[DataPlane]] = {
        "listener": ListenerPlane,
        "waitset": WaitSetPlane,
        "executor": ExecutorPlane,
    }
    return planes[path](node, gather)


class DataPlane(ABC):
    """The data subscriptions and publishers of one node, and the thread that serves its other callbacks.

    A transport says how messages are taken: the abstract methods. All transports share the rest.
    """

    hands_over = False
    """Whether a message is handled where it is sent, before :attr:`Sender.send` returns."""

    def __init__(self, node: Node, gather: Topic | None = None) -> None:
        """Begin without any topic; the arguments are those of :func:`make_plane`."""
        self._node = node
        self._gather = gather
        self._group = self._callback_group()
        self._wanted: list[tuple[Topic, Handler, Take | None]] = []
        self._subscriptions: list[Subscription] = []
        self._taken: list[Taken] = []
        """In order of declaration."""
        self.identities: dict[str, PublisherIdentity] = {}
        """Whose messages count, of each subscribed topic that has one publisher in the suite."""
        self._publishers: list[tuple[Topic, Publisher]] = []
        self._failure: Exception | None = None
        """What a handler or the services thread has raised. It is raised again on the main thread."""
        self.turn = threading.Condition(threading.RLock())
        """Held by whoever may touch the node's data: by the main thread, except while it polls."""
        self._executor = SingleThreadedExecutor(context=node.context)
        self._thread: threading.Thread | None = None
        self._timer: threading.Thread | None = None
        self._stopped = threading.Event()

    # What a transport says.

    @abstractmethod
    def poll(self, timeout_ns: int, trigger: Topic | None = None) -> None:
        """Wait at most so long for messages, and have those that come handled.

        Args:
            timeout_ns: longest wait, ns.
            trigger: the last topic to come in a tick. A transport may wake up only for this one, instead of
                for every message, and look at the others then and when the time is up.

        Raises:
            Exception: what a handler has raised.
        """

    @abstractmethod
    def collect(self, seconds: float) -> None:
        """Let messages gather for a while, then handle all of them: one wake-up for many.

        Raises:
            Exception: what a handler has raised.
        """

    @abstractmethod
    def wake(self) -> None:
        """End the wait of :meth:`poll` or :meth:`collect`, where it would not end by itself soon."""

    @abstractmethod
    def _opened(self) -> None:
        """Get ready to take messages: the subscriptions have been made."""

    def _callback_group(self) -> CallbackGroup:
        """Return the callback group of the data subscriptions."""
        return _NoExecutor()

    def _serve_others(self) -> None:
        """Begin to serve the node's other callbacks: in a background thread."""
        sys.setswitchinterval(SWITCH_INTERVAL)
        self._thread = threading.Thread(target=self._serve, name="services", daemon=True)
        self._thread.start()

    # Topics.

    def subscribe(self, topic: Topic, handler: Handler, take: Take | None = None) -> None:
        """Hand every message of a topic to a handler, serialized, once the plane is open.

        Of a topic that has one publisher in the suite, messages of others are dropped and counted.

        Args:
            topic: which.
            handler: takes a serialized message.
            take: takes what a message says: for a transport that does not serialize it.
        """
        self._wanted.append((topic, handler, take))

    def open(self) -> None:
        """Make the subscriptions, if that has not been done.

        A writer serves its readers in the order in which they were matched, at some 25 µs each. So
        whoever configures the nodes in the order of the tick gets the shortest chain.
        """
        wanted, self._wanted = self._wanted, []
        for topic, handler, take in wanted:
            if take is not None and self._locally(topic, take):
                continue
            cls = message_class(topic.type)
            callback = self._callback(topic, handler)
            made = self._node.create_subscription(
                cls, topic.name, callback, qos(topic), callback_group=self._group, raw=True
            )
            self._subscriptions.append(made)
            self._taken.append(Taken(topic, made.handle, cls, callback))
        if wanted:
            self._opened()

    def _locally(self, topic: Topic, take: Take) -> bool:
        """Whether a topic's messages come without the middleware: then they are handed to ``take``."""
        return False

    def _callback(self, topic: Topic, handler: Handler) -> Callable[[bytes, Any], None]:
        if len(topic.publishers) > 1:
            return lambda data, info: handler(data, info["source_timestamp"])
        identity = self.identities[topic.name] = PublisherIdentity(
            lambda: self._node.count_publishers(topic.name),
            lambda: any(name not in topic.publishers for name in self._publishing(topic.name)),
        )

        def callback(data: bytes, info: Any) -> None:
            if identity.admits(info["publication_sequence_number"]):
                handler(data, info["source_timestamp"])

        return callback

    @staticmethod
    def _handle_all(entries: Iterable[Taken]) -> None:
        for entry in entries:
            entry.handle_all()

    def publisher(self, topic: Topic) -> Callable[[Any], None]:
        """Return a function that publishes a message object or its serialized bytes."""
        made = self._node.create_publisher(message_class(topic.type), topic.name, qos(topic))
        self._publishers.append((topic, made))
        return made.publish

    def sender(self, topic: Topic, layout: Layout) -> Sender:
        """Return how messages of a data topic are sent, all of one layout."""
        return Sender(layout.encode, self.publisher(topic))

    # The node's other callbacks.

    def start(self) -> None:
        """Begin to serve the node's other callbacks."""
        self._executor.add_node(self._node)
        self._serve_others()

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
            self._fail(error)

    def _fail(self, error: Exception) -> None:
        """Have an error raised on the main thread that another thread has met."""
        self._failure = error

    def _spin(self, seconds: float | None) -> None:
        """Serve one callback. A lifecycle transition that is not possible now does not end the node."""
        try:
            self._executor.spin_once(timeout_sec=seconds)
        except _rclpy.RCLError as error:
            self._node.get_logger().warning(f"request not possible now: {error}")

    def failure(self) -> Exception | None:
        """What a handler or the services thread has raised."""
        return self._failure

    def _raise_failure(self) -> None:
        if (failure := self.failure()) is not None:
            raise failure

    def stop(self) -> None:
        """Stop serving. The data plane is not used after this.

        When a reader hears that a writer has gone, it loses what it has not received of it. So the writers
        go when everything has been received.
        """
        end = time.monotonic() + ACKNOWLEDGE_SECONDS
        for _, made in self._publishers:
            made.wait_for_all_acked(Duration(seconds=max(0.0, end - time.monotonic())))
        self._stopped.set()
        if self._timer is not None:
            self._timer.join()
        self._executor.shutdown(timeout_sec=STOP_SECONDS)
        if self._thread is not None:
            self._thread.join(timeout=STOP_SECONDS)

    # Who else is there.

    def unmatched(self, scenario: Scenario) -> str:
        """Say which topic still waits for the suite's other nodes; empty when all are matched."""
        for topic, made in self._publishers:
            wanted = self._elsewhere(subscribers(topic, scenario))
            if (count := made.get_subscription_count()) < len(wanted):
                return f"{topic.name} has {count} of {len(wanted)} subscribers ({', '.join(wanted)})"
        for subscription in self._subscriptions:
            if subscription.get_publisher_count() == 0:
                return f"{subscription.topic_name} has no publisher"
        return self.rivals()

    def _elsewhere(self, names: tuple[str, ...]) -> tuple[str, ...]:
        """Which of these nodes receive messages through the middleware."""
        return names

    def _single(self) -> list[str]:
        """Names of the subscribed topics that have one publisher in the suite."""
        return list(self.identities)

    def rivals(self) -> str:
        """Say which subscribed topic has more than one publisher, and whose; empty if none has."""
        for name in self._single():
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
