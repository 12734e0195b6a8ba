# SPDX-License-Identifier: Apache-2.0
"""Takes the pictures of the viewer: a run with a fault, ``watch --web`` and a headless Chromium.

``python tools/web_pictures.py docs/images/`` writes ``viewer.png``; with ``--phone`` also that of a phone.
"""

from __future__ import annotations

import argparse
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path

from browser import TEXT, VARIABLE, Browser, found

RUN = (
    "paper", "--controllers", "ftcm", "--no-figures", "--name", "pictures",
    "--set", "duration=600", "--set", "detector=residual_threshold", "--set",
    "injection.faults=[{type: external_torque, trigger: hand, joint: 3}, "
    "{type: loss_of_effectiveness, joint: 2, loss: 0.5, start: 12, lifetime: until_cleared}]",
)  # fmt: skip
UNTIL = 16.0
"""Time of the run at which the pictures are taken: there is a fault, s."""
SIZES = {"viewer": (1280, 800, False), "viewer_phone": (390, 844, True)}
"""Of the pictures, px; and whether of a phone."""
WAIT_SECONDS = 120.0
"""Generous ceiling for that."""
TIME = f"parseFloat(({TEXT}.match(/t = ([0-9.]+) s/) || [0, 0])[1])"
"""What the page says of the time."""


def take(folder: Path, names: Sequence[str], port: int) -> None:
    """Open the page once for each picture, wait, and write it.

    Args:
        folder: where to.
        names: of :data:`SIZES`.
        port: of the page.
    """
    for name in names:
        width, height, phone = SIZES[name]
        with tempfile.TemporaryDirectory() as own, Browser(Path(own), width, height, phone=phone) as browser:
            browser.open(f"http://127.0.0.1:{port}")
            browser.until(f"{TIME} > {UNTIL}", WAIT_SECONDS)
            browser.value(
                "document.querySelectorAll('.mantine-Notification-closeButton').forEach(x => x.click())"
            )
            time.sleep(6.0)  # the arm is drawn, and that it is without a graphics card is no longer told
            browser.picture(folder / f"{name}.png")


def main() -> int:
    """Take the pictures."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("folder", type=Path, help="where to write them")
    parser.add_argument("--phone", action="store_true", help="also that of a phone")
    parser.add_argument("--port", type=int, default=8087, help="of the page (default: 8087)")
    parser.add_argument("--domain-id", type=int, default=87, help="ROS domain of the run (default: 87)")
    options = parser.parse_args()
    if not found():
        print(f"web_pictures: error: no Chromium on the path; name one in {VARIABLE}", file=sys.stderr)
        return 2
    options.folder.mkdir(parents=True, exist_ok=True)
    domain, port = ["--domain-id", str(options.domain_id)], ["--port", str(options.port)]
    python = [sys.executable, "-m"]
    commands = (
        [*python, "ftcm_ros.run.watch", "--web", "--control", *domain, *port],
        [*python, "ftcm_ros.run.experiment", *RUN, *domain],
    )
    with tempfile.TemporaryDirectory() as runs:
        processes = [subprocess.Popen(c, cwd=runs, stdout=subprocess.DEVNULL) for c in commands]
        try:
            take(options.folder, list(SIZES)[: 1 + options.phone], options.port)
        finally:
            for process in reversed(processes):
                process.send_signal(signal.SIGINT)
                process.wait(60)
    return 0


if __name__ == "__main__":
    sys.exit(main())
