# SPDX-License-Identifier: Apache-2.0
"""Takes the picture of a report for the pages: ``python tools/report_picture.py docs/images/report.png``.

Runs the paper's experiment and looks at its report in a Chromium without a window. Needs the package
playwright, and its Chromium or another one: ``--chromium PATH``.
"""

from __future__ import annotations

import argparse
import os
import subprocess
import sys
import tempfile
from pathlib import Path

COMMAND = (
    "compare",
    "paper",
    "--controllers",
    "smc",
    "nftsmc",
    "ftcm",
    "--set",
    "detector=cusum",
    "--no-figures",
)
SIZE = {"width": 1000, "height": 1210}


def main() -> None:
    """Run, look, write."""
    parser = argparse.ArgumentParser(description="Takes the picture of a report for the pages.")
    parser.add_argument("picture", type=Path, help="PNG file to write")
    parser.add_argument("--chromium", help="program to use; default: that of playwright")
    options = parser.parse_args()
    try:
        from playwright.sync_api import sync_playwright
    except ImportError:
        sys.exit("report_picture: the package playwright is not installed: pip install playwright")
    with tempfile.TemporaryDirectory() as folder:
        out = Path(folder) / "out"
        subprocess.run([sys.executable, "-m", "ftcm_core.cli", *COMMAND, "--output", str(out)], check=True)
        with sync_playwright() as driver:
            browser = driver.chromium.launch(
                executable_path=options.chromium, args=[] if os.geteuid() else ["--no-sandbox"]
            )
            page = browser.new_page(viewport=SIZE)
            page.goto((out / "report.html").as_uri())
            page.wait_for_selector("html[data-drawn]")
            page.screenshot(path=options.picture)
            browser.close()
    print(f"{options.picture}: {options.picture.stat().st_size / 1000:.0f} kB")


if __name__ == "__main__":
    main()
