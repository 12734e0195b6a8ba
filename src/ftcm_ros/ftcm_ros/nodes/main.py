# SPDX-License-Identifier: Apache-2.0
"""The main function of every node: join the graph, run until a signal, leave, say in one line what failed."""

from __future__ import annotations

import signal
import sys
import traceback
from collections.abc import Callable, Sequence
from typing import Any

import rclpy
from rclpy.exceptions import InvalidParameterTypeException, InvalidParameterValueException

from ftcm_core.errors import FtcmError
from ftcm_ros.nodes.parent import end_with_parent, take_signals
from ftcm_ros.nodes.suite_node import SuiteNode
from ftcm_ros.timing import scheduling
from ftcm_ros.transport.joining import join, made

STOP_LIMIT = 30
"""How long a node that was asked to stop may take; a signal ends it then, s."""


def run(make: Callable[[], SuiteNode | Sequence[SuiteNode]], name: str = "ftcm_ros") -> int:
    """Run a node, or the nodes of one process, until SIGINT or SIGTERM.

    Args:
        make: makes the node; or all nodes of a composition, of which the first leads.
        name: who speaks while there is no node yet.

    Returns:
        The exit status: a user's mistake is one line and 2; a programming error is a traceback, then a
        line with the node, its tick and the error, and 1.
    """
    nodes: list[SuiteNode] = []

    def stop(signum: int, frame: Any) -> None:
        if not nodes:
            raise KeyboardInterrupt
        for node in nodes:
            node.stopping = True
        signal.alarm(STOP_LIMIT)

    signal.signal(signal.SIGINT, stop)
    signal.signal(signal.SIGTERM, stop)
    end_with_parent()
    try:
        take_signals()
        join()
        found = made(make)
        nodes = [found] if isinstance(found, SuiteNode) else [*found]
        spin(nodes)
    except KeyboardInterrupt:
        return 130
    except (FtcmError, OSError, InvalidParameterTypeException, InvalidParameterValueException) as error:
        text = " ".join(str(error).split())
        print(f"{at_work(nodes).get_name() if nodes else name}: error: {text}", file=sys.stderr)
        return 2
    except Exception as error:  # a programming error, or one in a component
        traceback.print_exc()
        where = f"{name}: at start"
        if nodes:
            where = f"{at_work(nodes).get_name()}: at tick {at_work(nodes).ticks}"
        text = " ".join(f"{type(error).__name__}: {error}".split())
        print(f"{where}: {text}", file=sys.stderr)
        return 1
    finally:
        scheduling.release()  # leaving the graph, the middleware spins
        for node in nodes:
            node.plane.stop()
            node.destroy_node()
        rclpy.try_shutdown()
    return 0


def at_work(nodes: Sequence[SuiteNode]) -> SuiteNode:
    """Return the node that has raised an error."""
    composition = nodes[0].composition
    name = composition.failed if composition else ""
    return next((node for node in nodes if node.name_in_suite == name), nodes[0])


def spin(nodes: Sequence[SuiteNode]) -> None:
    """Run the main loop of the nodes of this process until all have been asked to stop.

    The first one leads: it waits for messages, or for its clock. The others work when a message is handed to
    them, and do here what their services ask for.
    """
    leader, *others = nodes
    for node in nodes:
        node.serve()
    with leader.plane.turn:
        starting = [node for node in (*others, leader) if node.autostart]
        for node in starting:
            node.trigger_configure()
        try:
            for node in starting:
                _works(node)
                node.begin()
            while not all(node.stopping for node in nodes):
                for node in nodes:
                    node.do_main_thread_work()
                _works(leader)
                leader.step()
        except Exception:
            if leader.composition:
                leader.composition.failed = leader.composition.failed or leader.composition.working
            for node in nodes:
                node.abandon()
            raise
        for node in nodes:
            node.end()


def _works(node: SuiteNode) -> None:
    if node.composition:
        node.composition.working = node.name_in_suite
