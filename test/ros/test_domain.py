# SPDX-License-Identifier: Apache-2.0
"""A domain is held until the last process that shares it has ended, and dead shared memory is removed."""

from __future__ import annotations

import fcntl
import os
import subprocess
import sys
import time
from pathlib import Path

import pytest

from ftcm_core.errors import FtcmError
from ftcm_ros.transport.domain import (
    DOMAINS,
    PORT_BASE,
    PORT_GAIN,
    SETTLED_SECONDS,
    Domain,
    has_new_ports,
    remove_dead_shared_memory,
)

pytestmark = pytest.mark.alone

DOMAIN = 7
PORT = PORT_BASE + PORT_GAIN * DOMAIN + 11


def test_a_domain_is_taken_once_and_given_back() -> None:
    held = Domain()
    with pytest.raises(FtcmError, match="in use by other runs"):
        Domain(held.number)
    held.release()
    Domain(held.number).release()


def test_a_child_that_inherits_the_lock_holds_the_domain() -> None:
    held = Domain(DOMAINS[-1])
    child = subprocess.Popen(
        [sys.executable, "-c", "input()"], stdin=subprocess.PIPE, pass_fds=[held.fileno()]
    )
    held.release()
    with pytest.raises(FtcmError, match="in use"):
        Domain(held.number)
    child.communicate(b"\n", timeout=60)
    Domain(held.number).release()


def make(folder: Path, *names: str, age: float = 2 * SETTLED_SECONDS) -> None:
    for name in names:
        (folder / name).touch()
        os.utime(folder / name, (time.time() - age,) * 2)


def left(folder: Path) -> set[str]:
    return {f.name for f in folder.iterdir()}


@pytest.mark.parametrize("kind", ["el", "sl"])
def test_what_nobody_holds_is_removed_and_what_is_in_use_stays(tmp_path: Path, kind: str) -> None:
    dead = "fastrtps_00000000000000aa"
    alive = "fastrtps_00000000000000bb"
    ports = [f"fastrtps_port{PORT + i}" for i in range(3)]
    make(tmp_path, dead, f"{dead}_el", alive, f"{alive}_el")
    make(
        tmp_path,
        ports[0],
        f"{ports[0]}_el",
        f"sem.{ports[0]}_mutex",
        ports[1],
        f"{ports[1]}_{kind}",
        ports[2],
    )
    other = {"fastrtps_port99999", "fastrtps_port99999_el", "sem.other", "fastrtps_portx"}
    make(tmp_path, *other)
    with (tmp_path / f"{alive}_el").open() as segment, (tmp_path / f"{ports[1]}_{kind}").open() as port:
        fcntl.flock(segment, fcntl.LOCK_EX)
        fcntl.flock(port, fcntl.LOCK_SH if kind == "sl" else fcntl.LOCK_EX)
        removed = remove_dead_shared_memory(DOMAIN, tmp_path)
    assert set(removed) == {
        dead,
        f"{dead}_el",
        ports[0],
        f"{ports[0]}_el",
        f"sem.{ports[0]}_mutex",
        ports[2],
    }
    assert left(tmp_path) == {alive, f"{alive}_el", ports[1], f"{ports[1]}_{kind}", *other}


def test_a_lock_file_made_just_now_is_left_alone(tmp_path: Path) -> None:
    """Its owner has yet to lock it."""
    make(tmp_path, "fastrtps_00000000000000cc_el", age=0.0)
    make(tmp_path, "fastrtps_00000000000000cc")
    assert remove_dead_shared_memory(DOMAIN, tmp_path) == []
    assert len(left(tmp_path)) == 2


def test_a_new_port_of_the_domain_is_known_to_be_one(tmp_path: Path) -> None:
    """Whoever gives the domain back waits for it to become old."""
    make(tmp_path, f"fastrtps_port{PORT}_el")
    make(tmp_path, "fastrtps_port7012_el", f"fastrtps_port{PORT - 1000}_el", age=0.0)
    assert not has_new_ports(DOMAIN, tmp_path)
    make(tmp_path, f"fastrtps_port{PORT + 1}_el", age=0.0)
    assert has_new_ports(DOMAIN, tmp_path)


@pytest.mark.parametrize(("age", "stays"), [(0.0, True), (10.0, False)])
def test_a_dead_port_of_no_domain_is_removed_once_it_is_old(tmp_path: Path, age: float, stays: bool) -> None:
    files = {"fastrtps_port7012", "sem.fastrtps_port7012_mutex"}
    make(tmp_path, *files, age=age)
    remove_dead_shared_memory(DOMAIN, tmp_path)
    assert left(tmp_path) == (files if stays else set())


def test_a_port_of_no_domain_stays_while_any_process_is_there(tmp_path: Path) -> None:
    """It may be about to open it."""
    files = {"fastrtps_port7012", "sem.fastrtps_port7012_mutex", "fastrtps_00000000000000bb_el"}
    make(tmp_path, *files)
    with (tmp_path / "fastrtps_00000000000000bb_el").open() as segment:
        fcntl.flock(segment, fcntl.LOCK_EX)
        assert remove_dead_shared_memory(DOMAIN, tmp_path) == []
    assert set(remove_dead_shared_memory(DOMAIN, tmp_path)) == files


LOSES_A_PORT = """
import os
from pathlib import Path
import rclpy
from ftcm_ros.transport import joining
from ftcm_ros.transport.domain import lost_ports

create, made, lost = joining.Node, [], []

def create_and_lose(*given, **named):
    made.append(create(*given, **named))
    assert lost_ports() == []
    links = [os.readlink(f) for f in Path("/proc/self/fd").glob("*") if f.is_symlink()]
    locks = sorted(link for link in links if "fastrtps_port" in link)
    if len(made) <= int(os.environ["TIMES"]):
        # As another process does that takes it to be nobody's: its lock, or its segment.
        os.unlink(locks[-1] if len(made) % 2 else locks[0].removesuffix("_el"))
        lost.append(len(lost_ports()))
    return made[-1]

joining.Node = create_and_lose
try:
    node = joining.join_as("unheard")
    print(len(made), lost, lost_ports())
    node.destroy_node()
except joining.JoinError as error:
    print(len(made), lost, error)
rclpy.shutdown()
"""


@pytest.mark.parametrize(
    ("times", "said"),
    [
        (0, "1 [] []"),
        (2, "3 [1, 1] []"),
        (9, "5 [1, 1, 1, 1, 1] cannot join the ROS graph: other processes "),
    ],
)
def test_a_node_whose_port_was_removed_is_made_anew(domain: int, times: int, said: str) -> None:
    """No message would reach it, and nothing would say so."""
    done = subprocess.run(
        [sys.executable, "-c", LOSES_A_PORT],
        env={**os.environ, "TIMES": str(times)},
        capture_output=True,
        text=True,
        timeout=60,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    assert done.stdout.startswith(said)
