# SPDX-License-Identifier: Apache-2.0
"""The paths a data message can take into a node: equal order, one thing at a time, errors not lost."""

from __future__ import annotations

import threading
import time
from collections.abc import Iterator
from typing import Any

import pytest

pytest.importorskip("rclpy", reason="ROS 2 (rclpy) is not installed")

import rclpy
from rclpy.context import Context
from rclpy.node import Node
from sensor_msgs.msg import JointState

from ftcm_ros.transport import listener
from ftcm_ros.transport.codec import JointStateCodec
from ftcm_ros.transport.plane import DataPlane, make_plane, qos
from ftcm_ros.transport.topics import DISTURBANCE, TORQUES, Topic

pytestmark = pytest.mark.ros

CODEC = JointStateCodec(("joint1", "joint2", "joint3"))
PATHS = ("listener", "waitset", "executor")


@pytest.fixture
def node(domain: int) -> Iterator[Node]:
    context = Context()
    rclpy.init(context=context, domain_id=domain)
    made = Node("reader", context=context)
    yield made
    made.destroy_node()
    rclpy.shutdown(context=context)


def opened(node: Node, watcher: Any, path: str, handler: Any) -> tuple[DataPlane, Any]:
    """A data plane that takes joint_torques, and a publisher that is matched with it."""
    plane = make_plane(node, path)
    plane.subscribe(TORQUES, handler)
    plane.open()
    plane.start()
    publisher = watcher.node.create_publisher(JointState, TORQUES.name, qos(TORQUES))
    watcher.spin_until(
        lambda: publisher.get_subscription_count() and plane.has_publisher(TORQUES), "a matched publisher"
    )
    return plane, publisher


def publish(publisher: Any, ticks: range) -> threading.Thread:
    """Publish from a thread of its own, as within one process that thread is the one that delivers."""

    def work() -> None:
        for tick in ticks:
            publisher.publish(CODEC.torque.encode(tick, (1.0, 2.0, 3.0)))

    thread = threading.Thread(target=work)
    thread.start()
    return thread


def poll_until(plane: DataPlane, condition: Any) -> None:
    """Poll as a node's main loop does."""
    end = time.monotonic() + 30.0
    while not condition() and time.monotonic() < end:
        plane.poll(10**7)


@pytest.mark.parametrize("path", PATHS)
def test_messages_come_whole_and_in_order_and_only_while_the_main_thread_polls(
    node: Node, watcher: Any, path: str
) -> None:
    got: list[tuple[int, int]] = []
    plane, publisher = opened(
        node, watcher, path, lambda data, _: got.append((CODEC.decode(data).time_ns, threading.get_ident()))
    )
    with plane.turn:
        thread = publish(publisher, range(100))
        thread.join(0.2)  # in vain on the listener path: this very thread is kept waiting
        assert thread.is_alive() == (path == "listener")
        assert got == []
        poll_until(plane, lambda: len(got) == 100)
    thread.join()
    plane.stop()
    assert [tick for tick, _ in got] == list(range(100))
    assert {thread == threading.get_ident() for _, thread in got} == {path != "listener"}
    publish(publisher, range(100, 101)).join()
    assert len(got) == 100  # stopped is stopped


@pytest.mark.parametrize("fresh_ns", [listener.FRESH_NS, 0])
def test_what_gathers_is_handled_on_the_main_thread_and_nothing_is_left_behind(
    node: Node, watcher: Any, monkeypatch: pytest.MonkeyPatch, fresh_ns: int
) -> None:
    """The newest disturbance ends the wait, or four that are old; the rest is there when the time is up."""
    monkeypatch.setattr(listener, "FRESH_NS", fresh_ns)
    got: list[tuple[str, int, bool]] = []
    plane = make_plane(node, "listener", DISTURBANCE)

    def handler(topic: Topic) -> Any:
        return lambda data, _: got.append(
            (topic.name, CODEC.decode(data).time_ns, threading.get_ident() == main)
        )

    main = threading.get_ident()
    for topic in (TORQUES, DISTURBANCE):
        plane.subscribe(topic, handler(topic))
    plane.open()
    plane.start()
    torques, disturbances = (
        watcher.node.create_publisher(JointState, t.name, qos(t)) for t in (TORQUES, DISTURBANCE)
    )
    watcher.spin_until(
        lambda: (
            torques.get_subscription_count() == disturbances.get_subscription_count() == 1
            and plane.has_publisher(TORQUES)
            and plane.has_publisher(DISTURBANCE)
        ),
        "matched publishers",
    )
    with plane.turn:
        publish(torques, range(3)).join()
        publish(disturbances, range(3)).join()
        plane.collect(0.01)
        assert got == [(t.name, k, True) for t in (DISTURBANCE, TORQUES) for k in range(3)]
        got.clear()
        publish(torques, range(3, 6)).join()
        publish(disturbances, range(3, 4)).join()
        begin = time.monotonic()
        plane.collect(60.0)
        assert time.monotonic() - begin < 50.0
        assert got == [("disturbance", 3, True), *(("joint_torques", k, True) for k in range(3, 6))]
    plane.stop()


@pytest.mark.parametrize("path", PATHS)
def test_an_error_in_a_handler_is_raised_where_the_node_polls(node: Node, watcher: Any, path: str) -> None:
    calls = []

    def handler(data: bytes, published_ns: int) -> None:
        calls.append(data)
        raise ZeroDivisionError("a mistake in a stage")

    plane, publisher = opened(node, watcher, path, handler)
    publish(publisher, range(3)).join()
    with plane.turn, pytest.raises(ZeroDivisionError, match="a mistake in a stage"):
        poll_until(plane, lambda: False)
    plane.stop()
    assert len(calls) == 1


def test_where_the_middleware_has_no_such_thread_a_wait_set_is_used(
    node: Node, watcher: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(listener, "_call_on_message", lambda handle, callback: callback is None)
    threads: list[int] = []
    plane, publisher = opened(
        node, watcher, "listener", lambda data, _: threads.append(threading.get_ident())
    )
    publisher.publish(CODEC.torque.encode(0, (1.0, 2.0, 3.0)))
    with plane.turn:
        end = time.monotonic() + 30.0
        while not threads and time.monotonic() < end:
            plane.poll(10**7)
    plane.stop()
    assert threads == [threading.get_ident()]


@pytest.mark.parametrize("path", PATHS)
def test_nothing_is_served_after_the_stop(node: Node, watcher: Any, path: str) -> None:
    plane, _ = opened(node, watcher, path, lambda *_: None)
    plane.stop()
    assert "services" not in [thread.name for thread in threading.enumerate()]
