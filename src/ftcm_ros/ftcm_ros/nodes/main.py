# SPDX-License-Identifier: Apache-2.0
"""The main function of every node: join the graph, run until a signal, leave, say in one line what failed."""

from __future__ import annotations

import signal
import sys
import traceback
from collections.abc import Callable
from typing import Any

import rclpy
from rclpy.exceptions import InvalidParameterTypeException, InvalidParameterValueException

from ftcm_core.errors import FtcmError
from ftcm_ros.nodes.parent import end_with_parent
from ftcm_ros.nodes.suite_node import SuiteNode
from ftcm_ros.timing import scheduling
from ftcm_ros.transport.joining import join, joining

STOP_LIMIT = 30
"""How long a node that was asked to stop may take; a signal ends it then, s."""


def run(factory: Callable[[], SuiteNode]) -> int:
    """Run a node until SIGINT or SIGTERM.

    Returns:
        The exit status: a user's mistake is one line and 2; a programming error is a traceback, then a
        line with the node, its tick and the error, and 1.
    """
    node: SuiteNode | None = None

    def stop(signum: int, frame: Any) -> None:
        if node is None:
            raise KeyboardInterrupt
        node.stopping = True
        signal.alarm(STOP_LIMIT)

    signal.signal(signal.SIGINT, stop)
    signal.signal(signal.SIGTERM, stop)
    end_with_parent()
    try:
        join()
        with joining():
            node = factory()
        node.spin()
    except KeyboardInterrupt:
        return 130
    except (FtcmError, OSError, InvalidParameterTypeException, InvalidParameterValueException) as error:
        text = " ".join(str(error).split())
        print(f"{node.get_name() if node else 'ftcm_ros'}: error: {text}", file=sys.stderr)
        return 2
    except Exception as error:  # a programming error, or one in a component
        traceback.print_exc()
        where = f"{node.get_name()}: at tick {node.ticks}" if node else "ftcm_ros: at start"
        text = " ".join(f"{type(error).__name__}: {error}".split())
        print(f"{where}: {text}", file=sys.stderr)
        return 1
    finally:
        scheduling.release()  # leaving the graph, the middleware spins
        if node is not None:
            node.plane.stop()
            node.destroy_node()
        rclpy.try_shutdown()
    return 0
