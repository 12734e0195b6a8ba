# SPDX-License-Identifier: Apache-2.0
"""What the viewer's buttons do: services of the nodes, called one after the other, in a thread of their own.

So who draws never waits for a node. Nothing of this is there unless the user has asked for controls.
"""

from __future__ import annotations

import queue
import threading
import time
from collections import deque
from typing import Any, NamedTuple

from rcl_interfaces.srv import SetParameters
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.parameter import Parameter
from std_srvs.srv import SetBool, Trigger

ASK_AGAIN_SECONDS = 1.5
"""After so long without an answer, ask again: the middleware drops one that is ready too early."""
WAIT_SECONDS = 6.0
"""So long an answer is waited for."""
ANSWERS = 4
"""So many answers are kept."""
PAUSE = "/plant/pause"
"""Of a plant that can wait."""


class Order(NamedTuple):
    """What a button asks a node to do."""

    text: str
    """In words."""
    type: Any
    """Of the service."""
    service: str
    request: Any


def fault_order(action: str, label: str) -> Order:
    """Return the order to ``arm`` or ``clear`` a fault."""
    return Order(f"{action} {label}", Trigger, f"/injector/faults/{label}/{action}", Trigger.Request())


def swap_order(kind: str, name: str) -> Order:
    """Return the order to use another controller, observer or detector: its node's parameter."""
    parameter = Parameter(kind, value=name).to_parameter_msg()
    request = SetParameters.Request(parameters=[parameter])
    return Order(f"{kind} {name}", SetParameters, f"/{kind}/set_parameters", request)


def pause_order(wait: bool) -> Order:
    """Return the order to wait, or to go on."""
    return Order("pause" if wait else "go on", SetBool, PAUSE, SetBool.Request(data=wait))


def outcome(answer: Any) -> tuple[bool, str]:
    """Return whether an order was taken, and what the node says."""
    if hasattr(answer, "results"):
        (result,) = answer.results
        return bool(result.successful), str(result.reason)
    return bool(answer.success), str(answer.message)


class Operator:
    """Carries out orders."""

    def __init__(self, node: Node) -> None:
        """Begin to wait for orders.

        Args:
            node: nobody else's.
        """
        self.answers: deque[tuple[str, bool]] = deque(maxlen=ANSWERS)
        """What has come of the newest orders, and whether they were taken."""
        self._node = node
        self._executor = SingleThreadedExecutor(context=node.context)
        self._executor.add_node(node)
        self._orders: queue.SimpleQueue[Order | None] = queue.SimpleQueue()
        self._thread = threading.Thread(target=self._work, name="operator", daemon=True)
        self._thread.start()

    def ask(self, order: Order) -> None:
        """Have an order carried out; return at once."""
        self._orders.put(order)

    def offered(self, service: str) -> bool:
        """Whether a node offers a service."""
        return any(name == service for name, _ in self._node.get_service_names_and_types())

    def close(self) -> None:
        """End the thread, after the order that it is at."""
        self._orders.put(None)
        self._thread.join()
        self._executor.shutdown()

    def _work(self) -> None:
        while (order := self._orders.get()) is not None:
            answer = self._call(order)
            if answer is None:
                self.answers.append((f"{order.text}: no answer of {order.service}; is the run on?", False))
                continue
            taken, says = outcome(answer)
            self.answers.append((says or f"{order.text}: {'done' if taken else 'refused'}", taken))

    def _call(self, order: Order) -> Any:
        client = self._node.create_client(order.type, order.service)
        end = time.monotonic() + WAIT_SECONDS
        try:
            if not client.wait_for_service(timeout_sec=WAIT_SECONDS):
                return None
            while time.monotonic() < end:
                future = client.call_async(order.request)
                self._executor.spin_until_future_complete(future, timeout_sec=ASK_AGAIN_SECONDS)
                if future.done():
                    return future.result()
            return None
        finally:
            self._node.destroy_client(client)
