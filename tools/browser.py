# SPDX-License-Identifier: Apache-2.0
"""A headless Chromium, told what to do over its DevTools protocol: for tests and pictures of the viewer."""

from __future__ import annotations

import base64
import itertools
import json
import os
import shutil
import subprocess
import time
import urllib.request
from pathlib import Path
from types import TracebackType
from typing import Any

VARIABLE = "FTCM_CHROMIUM"
"""Environment variable that names the program, where none is on the path."""
NAMES = ("chromium", "chromium-browser", "google-chrome", "chrome", "chrome-headless-shell")
TEXT = "(document.body ? document.body.innerText : '')"
"""Expression: all text of the page."""
START_SECONDS = 60.0
"""Generous ceiling for its start."""
FLAGS = (
    "--headless=new", "--no-sandbox", "--remote-debugging-port=0", "--no-first-run", "--mute-audio",
    "--disable-background-networking", "--disable-component-update", "--hide-scrollbars",
    "--use-angle=swiftshader", "--enable-unsafe-swiftshader", "--ignore-gpu-blocklist",
)  # fmt: skip
"""It draws in 3-D without a graphics card, and asks nobody for updates."""


def found() -> str:
    """Return the program; empty where there is none."""
    return os.environ.get(VARIABLE) or next(filter(None, map(shutil.which, NAMES)), "")


class Browser:
    """A page in a browser; to be used in a ``with`` statement."""

    def __init__(self, folder: Path, width: int, height: int, *, phone: bool = False) -> None:
        """Start it.

        Args:
            folder: for its files; made.
            width: of the page, px; likewise the height.
            height: px.
            phone: whether it is one: touched, and with two pixels for each.
        """
        from websockets.sync.client import connect

        folder.mkdir(parents=True, exist_ok=True)
        self.process = subprocess.Popen(
            [found(), *FLAGS, f"--user-data-dir={folder}", f"--window-size={width},{height}", "about:blank"],
            stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL,
        )  # fmt: skip
        self._numbers = itertools.count(1)
        self.asked: list[str] = []
        """Addresses that the page has asked for."""
        self.errors: list[str] = []
        """What went wrong in its scripts."""
        try:
            self._socket = connect(self._address(folder / "DevToolsActivePort"), max_size=None)
        except BaseException:
            self.close()
            raise
        for domain in ("Page", "Network", "Runtime"):
            self.call(f"{domain}.enable")
        metrics = {"width": width, "height": height, "deviceScaleFactor": 2 if phone else 1, "mobile": phone}
        self.call("Emulation.setDeviceMetricsOverride", **metrics)
        if phone:
            self.call("Emulation.setTouchEmulationEnabled", enabled=True)

    def _address(self, file: Path) -> str:
        """Where its page listens."""
        end = time.monotonic() + START_SECONDS
        while time.monotonic() < end and self.process.poll() is None:
            if file.is_file() and (lines := file.read_text().split()):
                with urllib.request.urlopen(f"http://127.0.0.1:{lines[0]}/json") as answer:
                    pages = [one for one in json.load(answer) if one["type"] == "page"]
                if pages:
                    return str(pages[0]["webSocketDebuggerUrl"])
            time.sleep(0.1)
        raise RuntimeError(f"{found()} has not started: status {self.process.poll()}")

    def call(self, method: str, **parameters: Any) -> Any:
        """Call a method of the protocol and return its result."""
        number = next(self._numbers)
        self._socket.send(json.dumps({"id": number, "method": method, "params": parameters}))
        while True:
            message = json.loads(self._socket.recv(timeout=START_SECONDS))
            if message.get("id") == number:
                if "error" in message:
                    raise RuntimeError(f"{method}: {message['error']['message']}")
                return message["result"]
            self._hear(message)

    def _hear(self, event: dict[str, Any]) -> None:
        if event["method"] == "Network.requestWillBeSent":
            self.asked.append(event["params"]["request"]["url"][:200])
        elif event["method"] == "Network.webSocketCreated":
            self.asked.append(event["params"]["url"])
        elif event["method"] == "Runtime.exceptionThrown":
            details = event["params"]["exceptionDetails"]
            self.errors.append(str(details.get("exception", {}).get("description", details["text"])))

    def open(self, address: str) -> None:
        """Open a page, as soon as somebody serves it.

        Raises:
            TimeoutError: nobody does.
        """
        end = time.monotonic() + START_SECONDS
        while "errorText" in self.call("Page.navigate", url=address):
            if time.monotonic() > end:
                raise TimeoutError(f"{address}: nobody serves it")
            time.sleep(0.2)

    def value(self, script: str) -> Any:
        """Return the value of an expression in the page."""
        answer = self.call("Runtime.evaluate", expression=script, returnByValue=True, awaitPromise=True)
        if "exceptionDetails" in answer:
            raise RuntimeError(f"{script}: {answer['exceptionDetails']['text']}")
        return answer["result"].get("value")

    def text(self) -> str:
        """Return all text of the page."""
        return str(self.value(TEXT))

    def until(self, script: str, seconds: float = START_SECONDS) -> Any:
        """Wait until an expression is true, and return its value.

        Raises:
            TimeoutError: it has not become so.
        """
        end = time.monotonic() + seconds
        while time.monotonic() < end:
            if found_value := self.value(script):
                return found_value
            time.sleep(0.1)
        raise TimeoutError(
            f"{script}: not within {seconds:g} s; the page says {self.text()!r}; {self.errors}"
        )

    def press(self, label: str) -> None:
        """Press the button with this text."""
        script = "[...document.querySelectorAll('button, label')].find(b => b.innerText.trim() === %s)"
        button = script % json.dumps(label)
        self.until(f"!!{button}")
        self.value(f"{button}.click()")

    def picture(self, file: Path) -> None:
        """Write what is seen to a PNG file."""
        file.write_bytes(base64.b64decode(self.call("Page.captureScreenshot", format="png")["data"]))

    def close(self) -> None:
        """End it."""
        self.process.terminate()
        try:
            self.process.wait(10)
        except subprocess.TimeoutExpired:
            self.process.kill()
            self.process.wait()

    def __enter__(self) -> Browser:
        """Return it."""
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """End it."""
        self.close()
