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

from browser import DESKTOP, PHONE, missing, opened

RUN = (
    "paper", "--controllers", "ftcm", "--no-figures", "--name", "pictures",
    "--set", "duration=600", "--set", "detector=residual_threshold", "--set",
    "injection.faults=[{type: external_torque, trigger: hand, joint: 3}, "
    "{type: loss_of_effectiveness, joint: 2, loss: 0.5, start: 12, lifetime: until_cleared}]",
)  # fmt: skip
UNTIL = 16.0
"""Time of the run at which the pictures are taken: there is a fault, s."""
LOOKS = {"viewer": DESKTOP, "viewer_phone": PHONE}
"""Of the pictures."""
START_SECONDS = 5.0
"""After so long the page is served, s."""
TIME = "parseFloat((document.body.innerText.match(/t = ([0-9.]+) s/) || [0, 0])[1])"
"""What the page says of the time."""


def take(folder: Path, names: Sequence[str], port: int) -> None:
    """Open the page once for each picture, wait, and write it.

    Args:
        folder: where to.
        names: of :data:`LOOKS`.
        port: of the page.
    """
    for name in names:
        with opened(f"http://127.0.0.1:{port}", LOOKS[name]) as page:
            page.wait_for_function(f"{TIME} > {UNTIL}")
            page.evaluate(
                "document.querySelectorAll('.mantine-Notification-closeButton').forEach(x => x.click())"
            )
            time.sleep(6.0)  # the arm is drawn, and that it is without a graphics card is no longer told
            page.screenshot(path=folder / f"{name}.png")


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
    if missing():
        print(f"web_pictures: error: {missing()}", file=sys.stderr)
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
            time.sleep(START_SECONDS)
            take(options.folder, list(LOOKS)[: 1 + options.phone], options.port)
        finally:
            for process in reversed(processes):
                process.send_signal(signal.SIGINT)
                process.wait(60)
    return 0


if __name__ == "__main__":
    sys.exit(main())
