# SPDX-License-Identifier: Apache-2.0
"""Real-time scheduling is asked for, refused in one line, and given back."""

from __future__ import annotations

import subprocess
import sys

import pytest

from ftcm_core.errors import FtcmError
from ftcm_ros import scheduling

THREADS = """
import os, threading, time
from ftcm_ros import scheduling
lines = scheduling.apply(1, False, "")
threading.Thread(target=time.sleep, args=(60,), daemon=True).start()
policies = lambda: {os.sched_getscheduler(int(t)) for t in os.listdir("/proc/self/task")}
print(lines, policies() == {os.SCHED_FIFO})
scheduling.release()
print(policies() == {os.SCHED_OTHER})
"""


@pytest.mark.parametrize(
    ("arguments", "text"),
    [((100, False, ""), "priority: 100"), ((0, False, "x"), "'x'"), ((0, False, "4096"), "4096")],
)
def test_values_that_make_no_sense_are_one_line(arguments: tuple[int, bool, str], text: str) -> None:
    with pytest.raises(FtcmError, match=text):
        scheduling.apply(*arguments)


def test_every_thread_gives_real_time_scheduling_back() -> None:
    run = subprocess.run(
        [sys.executable, "-c", THREADS], capture_output=True, text=True, timeout=60, check=True
    )
    asked, given_back = run.stdout.splitlines()
    if "not permitted" in asked:
        pytest.skip(asked)
    assert asked == "[] True"
    assert given_back == "True"
