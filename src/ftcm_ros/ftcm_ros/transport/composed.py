# SPDX-License-Identifier: Apache-2.0
"""The transport of composed nodes: those of one process hand their messages over to each other.

ROS 2 calls this composition with intra-process communication; rclpy has none. A node sends a message: its
readers in this process take what it says, in the order of the tick, before :attr:`Sender.send` returns. Then
it is serialized and published as ever, for the recorder and whoever else listens. What nodes of other
processes publish comes in as with :mod:`~ftcm_ros.transport.listener`.

The nodes of a process share one turn, so that one of them at a time does something with its data.
"""

from __future__ import annotations

import threading
from collections import deque
from collections.abc import Callable
from typing import Any, NamedTuple

from rclpy.node import Node

from ftcm_core.errors import FtcmError
from ftcm_core.scenario import Scenario
from ftcm_ros.transport.codec import JointSample, Layout
from ftcm_ros.transport.listener import ListenerPlane
from ftcm_ros.transport.plane import Sender, Take, Taken
from ftcm_ros.transport.topics import Topic, subscribers

BUSY_SECONDS = 0.02
"""How long the middleware's receiving thread waits for its turn; then it leaves a message to the main thread.

It also serves readers that have missed something, whatever the nodes are doing.
"""


class _Outlet(NamedTuple):
    """Where the messages of one topic go out."""

    node: str
    topic: Topic
    readers: tuple[str, ...]
    """Nodes of the run that answer it."""
    layout: Layout
    publish: Callable[[bytes], None]

    def out(self, sample: JointSample) -> None:
        """Publish a message."""
        self.publish(self.layout.encode(sample.time_ns, *[values for values in sample[1:] if values]))


class Composition:
    """What the nodes of one process share."""

    def __init__(self) -> None:
        """No nodes yet."""
        self.names: list[str] = []
        """The nodes."""
        self.turn = threading.Condition(threading.RLock())
        """As of :class:`~ftcm_ros.transport.plane.DataPlane`."""
        self.working = ""
        """The node that does something with its data, or did last."""
        self.failed = ""
        """The node that has raised the error that ends the process."""
        self.failure: Exception | None = None
        self._readers: dict[str, list[tuple[str, Take]]] = {}
        self._handing = False
        self._handed: deque[tuple[str, Take, JointSample]] = deque()
        self._unpublished: deque[tuple[_Outlet, JointSample]] = deque()
        self.received: deque[tuple[str, Callable[[bytes, Any], None], Any]] = deque()
        """Messages of other processes: for which node, its handler, and the arguments of that."""

    def has(self, topic: Topic) -> bool:
        """Whether all that publish a topic are here."""
        return all(name in self.names for name in topic.publishers)

    def read(self, node: str, topic: Topic, take: Take) -> None:
        """Hand a topic's messages to a node, after the readers there are."""
        self._readers.setdefault(topic.name, []).append((node, take))

    def receive(self) -> None:
        """Handle the messages of other processes; by whoever has the turn.

        Raises:
            Exception: what a handler has raised.
        """
        while self.received and self.failure is None:
            self.working, callback, arguments = self.received.popleft()
            callback(*arguments)

    def send(self, outlet: _Outlet, sample: JointSample) -> None:
        """Hand a message over, and then what its readers send; publish all of them after that.

        A message that a node of another process answers is published first.

        Raises:
            Exception: what a reader has raised. What was sent before has been published.
        """
        if all(name in self.names for name in outlet.readers):
            self._unpublished.append((outlet, sample))
        else:
            outlet.out(sample)
        for node, take in self._readers.get(outlet.topic.name, ()):
            self._handed.append((node, take, sample))
        if self._handing:
            return
        self._handing = True
        before = self.working
        try:
            while self._handed:
                self.working, take, sample = self._handed.popleft()
                take(sample)
            self.working = before
        finally:
            self._handing = False
            while self._unpublished:
                outlet, sample = self._unpublished.popleft()
                outlet.out(sample)


class ComposedPlane(ListenerPlane):
    """Takes messages of nodes in this process from them, those of others as they come."""

    hands_over = True

    def __init__(self, node: Node, name: str, scenario: Scenario, composition: Composition) -> None:
        """Begin without any topic.

        Args:
            node: whose topics these are.
            name: its name in the suite.
            scenario: the run.
            composition: what it shares with the other nodes of this process.
        """
        super().__init__(node)
        self.turn = composition.turn
        self._name = name
        self._scenario = scenario
        self._composition = composition
        self._local: list[Topic] = []
        composition.names.append(name)

    def _locally(self, topic: Topic, take: Take) -> bool:
        if not self._composition.has(topic):
            return False
        self._local.append(topic)
        self._composition.read(self._name, topic, take)
        return True

    def sender(self, topic: Topic, layout: Layout) -> Sender:
        """Return how messages of a data topic are handed over and published."""
        readers = tuple(name for name in subscribers(topic, self._scenario) if name != "recorder")
        outlet = _Outlet(self._name, topic, readers, layout, self.publisher(topic))
        send = self._composition.send
        return Sender(layout.sample, lambda sample: send(outlet, sample))

    def _opened(self) -> None:
        if not self._listen():
            raise FtcmError("composed nodes need a middleware that calls back; start each node by itself")

    def _answering(self, entry: Taken) -> Callable[[Any, int], None]:
        composition = self._composition

        def receive(_: Any, count: int) -> None:
            self._keep_thread()
            while (taken := entry.take()) is not None:
                composition.received.append((self._name, entry.callback, taken))
            if not self.turn.acquire(timeout=BUSY_SECONDS):
                return
            try:
                composition.receive()
            except Exception as error:
                self._fail(error)
                self.turn.notify()
            finally:
                self.turn.release()

        return receive

    def poll(self, timeout_ns: int, trigger: Topic | None = None) -> None:
        """Leave the nodes' data to the receiving thread for so long, or until :meth:`wake`.

        Raises:
            Exception: what a handler of any of the nodes has raised.
        """
        if self._composition.received:
            self._composition.receive()
        else:
            super().poll(timeout_ns, trigger)

    def wake(self) -> None:
        """End the wait of :meth:`poll`; a main thread that is at work looks by itself what there is to do."""
        if self.turn.acquire(timeout=BUSY_SECONDS):
            self.turn.notify()
            self.turn.release()

    def _fail(self, error: Exception) -> None:
        composition = self._composition
        if composition.failure is None:
            serving = threading.current_thread() is self._thread
            composition.failed = self._name if serving else composition.working
            composition.failure = error

    def failure(self) -> Exception | None:
        """What a handler or a services thread of any of the nodes has raised."""
        return self._composition.failure

    # Who else is there.

    def _elsewhere(self, names: tuple[str, ...]) -> tuple[str, ...]:
        return tuple(name for name in names if name not in self._composition.names)

    def _single(self) -> list[str]:
        return [*super()._single(), *(topic.name for topic in self._local)]

    def has_publisher(self, topic: Topic) -> bool:
        """Whether anybody publishes a topic that this node takes."""
        return topic in self._local or super().has_publisher(topic)
