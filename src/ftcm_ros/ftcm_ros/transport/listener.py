# SPDX-License-Identifier: Apache-2.0
"""The transport ``listener``: a message is handled by the very thread of the middleware that received it.

So no other thread has to be woken. rclpy does not offer this; its C library does, and is called here.
Where the middleware cannot do it, the wait set is used.
"""

from __future__ import annotations

import ctypes
import threading
import time
from collections import deque
from collections.abc import Callable
from typing import Any

from rclpy.node import Node

from ftcm_ros.transport.plane import Taken
from ftcm_ros.transport.topics import Topic
from ftcm_ros.transport.wait_set import WaitSetPlane

GATHER_TICKS = 4
"""How many ticks are taken at a time where messages gather."""
GATHER_SECONDS = 0.003
"""How long the receiving thread sleeps once it has the newest tick, where messages gather."""
FRESH_NS = 500_000
"""A message younger than this is taken for the newest there is."""

_Callback = ctypes.CFUNCTYPE(None, ctypes.c_void_p, ctypes.c_size_t)
"""rcl_event_callback_t: user data, number of messages."""


def _call_on_message(handle: Any, callback: Any) -> bool:
    """Have the middleware's receiving thread call a function for new messages (None: no longer).

    ctypes releases the interpreter meanwhile, so that a callback that is under way can end.

    Returns:
        Whether the middleware can do that.
    """
    try:
        set_callback = ctypes.CDLL("librcl.so").rcl_subscription_set_on_new_message_callback
    except (OSError, AttributeError):
        return False
    set_callback.argtypes = [ctypes.c_void_p, ctypes.c_void_p, ctypes.c_void_p]
    return bool(set_callback(handle.pointer, ctypes.cast(callback, ctypes.c_void_p), None) == 0)


class ListenerPlane(WaitSetPlane):
    """Has messages handled by the thread that receives them, or gathers them there for the main thread.

    It is a :class:`~ftcm_ros.transport.wait_set.WaitSetPlane` that does without its wait set as long as the
    middleware calls back.
    """

    def __init__(self, node: Node, gather: Topic | None = None) -> None:
        """Begin without any topic; see :func:`~ftcm_ros.transport.plane.make_plane`."""
        super().__init__(node, gather)
        self._listening = True
        self._callbacks: list[Any] = []
        self._loose: list[Taken] = []
        """What gathers with the middleware."""
        self._gathered: deque[tuple[Callable[[bytes, Any], None], Any]] = deque(
            maxlen=None if gather is None else gather.depth
        )
        """What gathers here: callback and its arguments."""
        self._thread_state = threading.local()

    def _opened(self) -> None:
        if self._listening and not self._listen():
            self._node.get_logger().warning("data_path listener is not possible here; waitset is used")
            self._listening = False
        if not self._listening:
            super()._opened()

    def stop(self) -> None:
        """Listen no longer, and stop serving."""
        self._ignore()
        super().stop()

    def _listen(self) -> bool:
        """Have the receiving thread handle or gather messages; return whether the middleware can do that.

        Where messages gather, only one topic is listened to. The main thread takes the other topics'
        messages. It does not take those of a topic for which the middleware calls back: during the call the
        middleware holds a lock. The main thread would wait for this lock, and meanwhile keep the interpreter
        from the callback.
        """
        for entry in self._taken:
            if self._gather not in (None, entry.topic):
                self._loose.append(entry)
                continue
            receive = self._answering(entry) if self._gather is None else self._gathering(entry)
            self._callbacks.append(_Callback(receive))
            if not _call_on_message(entry.handle, self._callbacks[-1]):
                self._ignore()
                return False
        return True

    def _ignore(self) -> None:
        """Listen no longer."""
        if self._callbacks:
            for entry in self._taken:
                _call_on_message(entry.handle, None)
        self._callbacks, self._loose = [], []

    def _keep_thread(self) -> None:
        """Have Python remember this thread of the middleware, instead of making and dropping it each time."""
        if not hasattr(self._thread_state, "kept"):
            ctypes.pythonapi.PyGILState_Ensure()
            self._thread_state.kept = True

    def _answering(self, entry: Taken) -> Callable[[Any, int], None]:
        def receive(_: Any, count: int) -> None:
            self._keep_thread()
            with self.turn:
                if self.failure() is not None:  # the main thread is about to end the node
                    return
                try:
                    entry.handle_all()
                except Exception as error:
                    self._fail(error)
                    self.turn.notify()

        return receive

    def _gathering(self, entry: Taken) -> Callable[[Any, int], None]:
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

    def poll(self, timeout_ns: int, trigger: Topic | None = None) -> None:
        """Leave the node's data to the receiving thread for so long, or until :meth:`wake`.

        Raises:
            Exception: what a handler has raised.
        """
        if not self._listening:
            super().poll(timeout_ns, trigger)
            return
        self._raise_failure()
        self.turn.wait(timeout_ns / 1e9)
        self._raise_failure()

    def collect(self, seconds: float) -> None:
        """Wait until a few ticks have gathered, or the newest; then handle all messages.

        Raises:
            Exception: what a handler has raised.
        """
        self._raise_failure()
        self._enough.wait(seconds)
        self._enough.clear()
        while self._gathered:
            callback, taken = self._gathered.popleft()
            callback(*taken)
        self._handle_all(self._loose or self._taken)

    def wake(self) -> None:
        """End the wait of :meth:`collect` or :meth:`poll`."""
        if self._gather is not None or not self._listening:
            super().wake()
        else:
            with self.turn:
                self.turn.notify()
