# SPDX-License-Identifier: Apache-2.0
"""``watch --web``: the page is served until the user ends it.

Everything is in this process: a run hears as little of it as of ``watch`` in the terminal. It gives way to
the nodes of a run on the same processors. Nothing in it waits for a browser.
"""

from __future__ import annotations

import argparse
import contextlib
import functools
import importlib.util
import io
import os
import re
import socket
import sys
import time
from collections.abc import Iterator
from typing import Any

import rclpy

from ftcm_core.errors import FtcmError
from ftcm_ros.run.view import DRAWN, SHOWN
from ftcm_ros.run.watch import Watch
from ftcm_ros.transport.joining import join_as
from ftcm_ros.transport.network import VIEWER_PROFILES

LOOK_SECONDS = 0.05
"""How often messages are taken and the arm is drawn anew, s."""
NICE = 10
"""How much it gives way to other processes."""
OWN_PAGES = r"https?://(127\.0\.0\.1|localhost|\[::1\])(:\d+)?"
"""Where a page is from that this machine serves, by a tunnel too."""
THIS_MACHINE = ("127.0.0.1", "localhost", "::1")


def serve(options: argparse.Namespace, where: str) -> None:
    """Serve the page until the user ends it.

    Args:
        options: those of ``watch``.
        where: the domain, in words.

    Raises:
        FtcmError: viser is not installed, the port is in use, or ROS cannot start.
    """
    server = open_server(options.host, options.port)
    from ftcm_ros.viewer.operating import Operator
    from ftcm_ros.viewer.page import Page

    os.nice(NICE)
    node = join_as("watch", VIEWER_PROFILES)
    watched = Watch(node, topics=(*SHOWN, *DRAWN))
    operator = Operator(rclpy.create_node("watch_control")) if options.control else None
    try:
        page = Page(server, watched.view, where, operator)
        print(f"watch: http://{options.host}:{options.port} shows {where}; Ctrl-C ends it", flush=True)
        if options.control and options.host not in THIS_MACHINE:
            print(
                f"watch: whoever reaches port {options.port} may use the controls",
                file=sys.stderr,
                flush=True,
            )
        while True:
            began = time.monotonic()
            watched.look(began)
            page.show(began)
            time.sleep(max(0.0, LOOK_SECONDS - (time.monotonic() - began)))
    finally:
        if operator is not None:
            operator.close()
        with contextlib.redirect_stdout(io.StringIO()):
            server.stop()


def open_server(host: str, port: int) -> Any:
    """Return a server of viser's at an address.

    Raises:
        FtcmError: viser is not installed, or the address is not to be had.
    """
    if importlib.util.find_spec("viser") is None:
        raise FtcmError('--web needs viser; pip install "ftcm_core[web]", or watch in the terminal')
    refused = _refused(host, port)
    if refused:
        raise FtcmError(f"--web: cannot serve at {host}:{port}: {refused}; choose another --port or --host")
    import viser

    with contextlib.redirect_stdout(io.StringIO()), _for_pages_of(host):  # it says hello
        server = viser.ViserServer(host=host, port=port, verbose=False)
        if server.get_port() != port:  # somebody was quicker: viser takes the next one
            server.stop()
            raise FtcmError(f"--web: cannot serve at {host}:{port}: in use; choose another --port")
    server.request_share_url = _not_shared
    return server


@contextlib.contextmanager
def _for_pages_of(host: str) -> Iterator[None]:
    """Have a server that this machine alone reaches turn away pages that come from elsewhere.

    A browser lets any page open a socket here, and says where the page is from. viser does not ask: so
    that is told to the server which it starts.
    """
    import websockets.asyncio.server as module

    serve = module.serve
    if host in THIS_MACHINE:
        module.serve = functools.partial(serve, origins=[None, re.compile(OWN_PAGES)])
    try:
        yield
    finally:
        module.serve = serve


def _refused(host: str, port: int) -> str:
    """Why an address is not to be had; empty if it is."""
    try:
        family, kind, protocol, _, address = socket.getaddrinfo(host, port, type=socket.SOCK_STREAM)[0]
        with socket.socket(family, kind, protocol) as trial:
            trial.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)  # as the server does
            trial.bind(address)
    except OSError as error:
        return str(error.strerror or error)
    except OverflowError:
        return "no such port"
    return ""


def _not_shared(*_: Any) -> None:
    """Stand in for viser's tunnel to its own host: what is on this machine stays here."""
