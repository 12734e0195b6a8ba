# SPDX-License-Identifier: Apache-2.0
"""Drives other nodes through lifecycle transitions, and does not depend on every answer arriving."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

from lifecycle_msgs.msg import State, Transition
from lifecycle_msgs.srv import ChangeState, GetState
from rclpy.node import Node

TRANSITIONS = {
    "configure": (Transition.TRANSITION_CONFIGURE, State.PRIMARY_STATE_INACTIVE),
    "activate": (Transition.TRANSITION_ACTIVATE, State.PRIMARY_STATE_ACTIVE),
    "deactivate": (Transition.TRANSITION_DEACTIVATE, State.PRIMARY_STATE_INACTIVE),
}
ASK_AGAIN_SECONDS = 1.5
"""After so long without an answer, ask for the state instead.

The middleware drops an answer that is ready before the server has discovered the client.
"""


class Managed:
    """One managed node as seen from outside."""

    def __init__(self, node: Node, name: str) -> None:
        """Make the clients; the node need not be up yet."""
        self.name = name
        self._change = node.create_client(ChangeState, f"/{name}/change_state")
        self._get = node.create_client(GetState, f"/{name}/get_state")
        self._pending: Any = None
        self._asked: Any = None
        self._ask_first = False
        self._since = 0.0
        self.transition = ""
        self.done = True
        self.refused = False

    def begin(self, transition: str) -> None:
        """Begin a transition, one of :data:`TRANSITIONS`."""
        self.transition = transition
        self.done = self.refused = False
        self._pending = self._asked = None
        # The plant may have ended its run by itself; asked for that again, it would not answer.
        self._ask_first = transition == "deactivate"

    def poll(self) -> None:
        """Look at what has come and ask on; sets ``done``, and ``refused`` if the node would not."""
        if self.done:
            return
        number, target = TRANSITIONS[self.transition]
        now = time.monotonic()
        if self._ask_first:
            if self._get.service_is_ready():
                self._ask(now)
                self._ask_first = False
        elif self._pending is None and self._asked is None:
            if self._change.service_is_ready():
                self._pending = self._change.call_async(ChangeState.Request(transition=Transition(id=number)))
                self._since = now
        elif self._pending is not None and self._pending.done():
            self.done, self.refused = True, not self._pending.result().success
        elif self._asked is not None and self._asked.done():
            state = self._asked.result().current_state.id
            self._asked, self._since = None, now
            if state == target:
                self.done = True
            elif state < State.TRANSITION_STATE_CONFIGURING:  # not under way: ask for it
                self._pending = None
            elif self._pending is None:  # under way by itself
                self._ask_first = True
        elif now - self._since > ASK_AGAIN_SECONDS and self._get.service_is_ready():
            self._ask(now)

    def _ask(self, now: float) -> None:
        self._asked, self._since = self._get.call_async(GetState.Request()), now


def drive(nodes: list[Managed], transition: str, spin: Callable[[], None], timeout: float) -> str:
    """Drive nodes through a transition at once.

    Args:
        nodes: the nodes.
        transition: one of :data:`TRANSITIONS`.
        spin: takes answers in for a moment.
        timeout: how long it may take, s.

    Returns:
        Empty, or the name of a node that did not make it.
    """
    for managed in nodes:
        managed.begin(transition)
    end = time.monotonic() + timeout
    while not all(m.done for m in nodes):
        spin()
        for managed in nodes:
            managed.poll()
        if time.monotonic() > end:
            return next(m.name for m in nodes if not m.done)
    return next((m.name for m in nodes if m.refused), "")
