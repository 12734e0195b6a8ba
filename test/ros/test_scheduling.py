# SPDX-License-Identifier: Apache-2.0
"""Real-time scheduling is asked for, refused in one line, and given back."""

from __future__ import annotations

import json
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from ftcm_core.errors import FtcmError
from ftcm_ros.timing import scheduling
from programs import program

pytestmark = pytest.mark.alone

THREADS = """
import os, threading, time
import psutil
from ftcm_ros.timing import scheduling
start = lambda: threading.Thread(target=time.sleep, args=(60,), daemon=True).start()
threads = lambda: [t.id for t in psutil.Process().threads()]
policies = lambda: {os.sched_getscheduler(thread) for thread in threads()}
one = min(os.sched_getaffinity(0))
start()
lines = scheduling.apply(1, False, str(one))
start()
affinities = [os.sched_getaffinity(thread) == {one} for thread in threads()]
print(lines, policies() == {os.SCHED_FIFO}, all(affinities))
scheduling.release()
print(policies() == {os.SCHED_OTHER})
"""


WAITING = """
import os, time
from ftcm_ros.timing import scheduling
scheduling.apply(0, False, str(min(os.sched_getaffinity(0))))
print(open("/proc/self/timerslack_ns").read().strip(), flush=True)
other = os.fork()
began = scheduling.waited_seconds()
end = time.monotonic() + 0.5
while time.monotonic() < end:
    pass
if other:
    os.waitpid(other, 0)
    print(scheduling.waited_seconds() - began > 0.1)
"""


@pytest.mark.parametrize(
    ("arguments", "text"),
    [((100, False, ""), "priority: 100"), ((0, False, "x"), "'x'"), ((0, False, "4096"), "4096")],
)
def test_values_that_make_no_sense_are_one_line(arguments: tuple[int, bool, str], text: str) -> None:
    with pytest.raises(FtcmError, match=text):
        scheduling.apply(*arguments)


def test_every_thread_gets_real_time_scheduling_and_gives_it_back() -> None:
    """Those of before, as the middleware's are, and those that are started later."""
    run = subprocess.run(
        [sys.executable, "-c", THREADS], capture_output=True, text=True, timeout=60, check=True
    )
    asked, given_back = run.stdout.splitlines()
    if "not permitted" in asked:
        pytest.skip(asked)
    assert asked == "[] True True"
    assert given_back == "True"


@pytest.mark.ros
def test_what_is_not_permitted_is_said_once_and_kept(tmp_path: Path) -> None:
    """Run without the capabilities, as ordinary users do."""
    pytest.importorskip("rclpy", reason="ROS 2 (rclpy) is not installed")
    if shutil.which("setpriv") is None:
        pytest.skip("setpriv (util-linux) is not installed")
    without = ["setpriv", "--bounding-set", "-sys_nice,-ipc_lock", "--inh-caps", "-sys_nice,-ipc_lock"]
    process = subprocess.run(
        [*without, *program("experiment"), "paper", "--controllers", "ftcm",
         "--name", "test", "--set", "duration=0.1", "--no-figures", "--priority", "50", "--lock-memory"],
        cwd=tmp_path, capture_output=True, text=True, timeout=120, check=False,
    )  # fmt: skip
    assert process.returncode == 0, process.stderr
    said = "warning: ftcm: priority 50 is not permitted; ordinary scheduling is used. Allow it"
    (line,) = [w for w in process.stderr.splitlines() if w.startswith(said)]
    assert "memory cannot be locked" in line
    nodes = json.loads((tmp_path / "runs" / "test" / "summary.json").read_text())["timing"]["ftcm"]["nodes"]
    refused = {name: "warning: ftcm: " + node["not_permitted"] for name, node in nodes.items()}
    assert "priority" not in refused.pop("recorder")  # which is not in the tick
    assert set(refused.values()) == {line}


def test_waits_end_in_time_and_waiting_for_a_processor_is_counted() -> None:
    """Two busy processes on one processor."""
    run = subprocess.run(
        [sys.executable, "-c", WAITING], capture_output=True, text=True, timeout=60, check=True
    )
    assert run.stdout.split() == ["1", "True"]
