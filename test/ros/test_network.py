# SPDX-License-Identifier: Apache-2.0
"""Who may talk to it: two machines on one network, each a set of Linux namespaces of its own."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest

pytest.importorskip("rclpy", reason="ROS 2 (rclpy) is not installed")

from ftcm_core.scenario import load
from ftcm_core.simulation import simulate
from ftcm_ros.bags.reader import read_bag
from ftcm_ros.nodes.parent import PARENT_VARIABLE
from ftcm_ros.transport.network import PROFILES, SHOWN, VIEWER_PROFILES, set_defaults
from programs import program
from traces import same

pytestmark = pytest.mark.ros

WAIT_SECONDS = 60.0
"""Generous ceiling for what is to happen."""
ABSENT_SECONDS = 3.0
"""How long to look for what is not to be seen: ten announcements of the profile that experiments use."""
SEES = """
import sys, time
import rclpy
rclpy.init()
node = rclpy.create_node("looker")
end = time.monotonic() + float(sys.argv[1])
seen = False
while not seen and time.monotonic() < end:
    seen = "plant" in node.get_node_names()
    time.sleep(0.05)
print("seen" if seen else "not seen")
"""
"""Tells whether there is a plant; an ordinary ROS process, as a stranger's or a tool's."""
DRIVE = """
import rclpy
from ftcm_ros.transport.joining import join_as
from ftcm_ros.run.lifecycle import Managed, drive
from ftcm_ros.parameters.node_parameters import NODES
node = join_as("starter")
nodes = {name: Managed(node, name) for name in NODES}
plant = [nodes.pop("plant")]
others = list(nodes.values())
for transition, which in (("configure", plant + others), ("activate", others), ("activate", plant)):
    failed = drive(which, transition, lambda: rclpy.spin_once(node, timeout_sec=0.05), 60.0)
    assert not failed, (transition, failed)
"""
"""Starts a run of nodes that are waiting, so that no tick is published before all are matched."""


def parameters(**values: str) -> list[str]:
    """Command line of node parameters."""
    return [word for name, value in values.items() for word in ("-p", f"{name}:={value}")]


class Machine:
    """Namespaces that a waiting process holds: they, and the cable, are gone when it is.

    It ends when its standard input is closed, so also when the tests are killed.
    """

    def __init__(self, address: str) -> None:
        self.address = address
        self.started: list[subprocess.Popen[str]] = []
        script = "mount -t tmpfs tmpfs /dev/shm && ip link set lo up && echo ready && exec cat"
        self.holder = subprocess.Popen(
            ["unshare", "--net", "--mount", "--ipc", "sh", "-c", script],
            stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
        )  # fmt: skip
        assert self.holder.stdout is not None
        self.ready = self.holder.stdout.readline() == "ready\n"

    @property
    def enter(self) -> list[str]:
        """Command prefix that runs something on this machine."""
        return ["nsenter", "--target", str(self.holder.pid), "--net", "--mount", "--ipc"]

    def do(self, *command: str, **variables: str) -> str:
        """Run a command to its end and return what it wrote."""
        return subprocess.run(
            [*self.enter, *command], env=environment(**variables), stdout=subprocess.PIPE, text=True,
            check=True, timeout=2 * WAIT_SECONDS,
        ).stdout  # fmt: skip

    def start(self, folder: Path, name: str, *arguments: str, **variables: str) -> subprocess.Popen[str]:
        """Start a program of the suite; its environment says no more about the network than is given."""
        process = subprocess.Popen(
            [*self.enter, f"--wd={folder}", *program(name), *arguments],
            env=environment(**variables), stdin=subprocess.DEVNULL, text=True,
            stdout=subprocess.PIPE, stderr=subprocess.STDOUT,
        )  # fmt: skip
        self.started.append(process)
        return process

    def sees_a_plant(self, seconds: float, **variables: str) -> bool:
        """Whether another process on this machine discovers the plant."""
        return self.do(sys.executable, "-c", SEES, str(seconds), **variables).strip() == "seen"

    def close(self) -> None:
        """End all that runs on it, then the machine."""
        for process in self.started:
            process.terminate()
        for process in self.started:
            try:
                process.communicate(timeout=15)
            except subprocess.TimeoutExpired:
                process.kill()
                process.communicate()
        self.holder.communicate()


def environment(**variables: str) -> dict[str, str]:
    """This process's environment without what restricts ROS, and with the given variables."""
    kept = {k: v for k, v in os.environ.items() if k not in SHOWN}
    ends_with_the_tests = {PARENT_VARIABLE: str(os.getpid())}
    return {**kept, **ends_with_the_tests, "ROS_DOMAIN_ID": "7", "PYTHONUNBUFFERED": "1", **variables}


@pytest.fixture
def machines() -> Iterator[tuple[Machine, Machine]]:
    """Two machines and a cable between them."""
    if os.getuid() != 0:
        pytest.skip("network namespaces need root")
    here, there = Machine("10.77.0.1"), Machine("10.77.0.2")
    try:
        for machine in (here, there):
            if not machine.ready:
                _, error = machine.holder.communicate()
                pytest.skip(f"no network namespaces here: {error.strip()}")
        peer = ("peer", "name", "cable", "netns", str(there.holder.pid))
        here.do("ip", "link", "add", "cable", "type", "veth", *peer)
        for machine in (here, there):
            machine.do("ip", "address", "add", f"{machine.address}/24", "dev", "cable")
            machine.do("ip", "link", "set", "cable", "up")
        for machine in (
            here,
            there,
        ):  # what starts before the kernel says so overlooks it
            machine.do("sh", "-c", "until ip link show cable | grep -q 'state UP'; do sleep 0.05; done")
        yield here, there
    finally:
        here.close()
        there.close()


SUBNET = {"ROS_AUTOMATIC_DISCOVERY_RANGE": "SUBNET"}
LOCALHOST = {"ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST"}
STRANGERS = {
    "subnet": SUBNET,
    "localhost": LOCALHOST,
    "subnet, other domain": {**SUBNET, "ROS_DOMAIN_ID": "8"},
    "peer": {**LOCALHOST, "ROS_STATIC_PEERS": "10.77.0.1"},
}
"""Processes on the other machine."""


@pytest.mark.slow
@pytest.mark.parametrize(
    ("settings", "seen_by"),
    [
        pytest.param({}, {"peer"}, id="default"),
        pytest.param({"FASTRTPS_DEFAULT_PROFILES_FILE": str(PROFILES)}, {"peer"}, id="experiment"),
        pytest.param(SUBNET, {"subnet", "peer"}, id="subnet"),
        pytest.param({**SUBNET, "ROS_LOCALHOST_ONLY": "1"}, {"peer"}, id="older variable"),
        pytest.param({"ROS_STATIC_PEERS": "10.77.0.2"}, {"subnet", "localhost", "peer"}, id="static peer"),
    ],
)
def test_who_sees_a_node_from_another_machine(
    machines: tuple[Machine, Machine], tmp_path: Path, settings: dict[str, str], seen_by: set[str]
) -> None:
    here, there = machines
    here.start(tmp_path, "nodes.plant", **settings)
    assert here.sees_a_plant(WAIT_SECONDS, **SUBNET)  # as a tool with ROS's own defaults
    with ThreadPoolExecutor() as pool:
        looks = {
            name: pool.submit(
                there.sees_a_plant, WAIT_SECONDS if name in seen_by else ABSENT_SECONDS, **variables
            )
            for name, variables in STRANGERS.items()
        }
        assert {name for name, look in looks.items() if look.result()} == seen_by


@pytest.mark.slow
@pytest.mark.parametrize(
    ("settings_here", "settings_there"),
    [
        pytest.param(SUBNET, SUBNET, id="subnet"),
        pytest.param({"ROS_STATIC_PEERS": "10.77.0.2"}, {}, id="static peer"),
    ],
)
def test_a_run_over_two_machines_equals_the_in_process_run(
    machines: tuple[Machine, Machine],
    tmp_path: Path,
    settings_here: dict[str, str],
    settings_there: dict[str, str],
) -> None:
    here, there = machines
    scenario = load("paper", ["duration=0.5", "injection.faults.0.start=0.2"], controller="ftcm")
    (tmp_path / "short.yaml").write_text(scenario.to_yaml(), encoding="utf-8")
    common = ("--ros-args", *parameters(scenario="short.yaml", autostart="false", await_graph="true"))
    recorder = here.start(tmp_path, "nodes.recorder", *common, *parameters(bag="bag"), **settings_here)
    lockstep = parameters(mode="lockstep", recorder_window="1000")
    plant = here.start(tmp_path, "nodes.plant", *common, *lockstep, **settings_here)
    for name in ("observer", "controller", "injector"):
        there.start(tmp_path, f"nodes.{name}", *common, **settings_there)
    here.do(sys.executable, "-c", DRIVE, **settings_here)
    assert plant.stdout is not None
    said = next((line for line in plant.stdout if "completed" in line or "error" in line), "it ended")
    assert "completed" in said
    recorder.send_signal(signal.SIGINT)
    recorder.communicate(timeout=WAIT_SECONDS)
    bag = read_bag(tmp_path / "bag")
    assert bag.missing == {}
    again = simulate(scenario)
    assert bag.trace.ticks == again.ticks == 501
    assert same(bag.trace, again)


@pytest.mark.slow
def test_a_run_is_watched_from_another_machine(machines: tuple[Machine, Machine], tmp_path: Path) -> None:
    here, there = machines
    run = here.start(
        tmp_path, "experiment", "paper", "--controllers", "smc", "--no-figures", "--domain-id", "7", **SUBNET
    )
    assert run.stdout is not None
    assert any("ticks/s" in line for line in run.stdout)
    said = there.do(*program("run.watch"), "--once", **SUBNET)
    assert "joint1" in said


def test_what_the_user_has_set_stays(monkeypatch: pytest.MonkeyPatch) -> None:
    for name in SHOWN:
        monkeypatch.setenv(name, "")  # so that it is put back
        monkeypatch.delenv(name)
    assert set_defaults() == "ROS_AUTOMATIC_DISCOVERY_RANGE=LOCALHOST"
    monkeypatch.setenv("ROS_AUTOMATIC_DISCOVERY_RANGE", "SUBNET")
    monkeypatch.setenv("ROS_STATIC_PEERS", "10.0.0.2;10.0.0.3")
    assert set_defaults() == "ROS_AUTOMATIC_DISCOVERY_RANGE=SUBNET ROS_STATIC_PEERS=10.0.0.2;10.0.0.3"
    monkeypatch.setenv("ROS_SECURITY_ENABLE", "true")
    assert set_defaults().endswith("ROS_SECURITY_ENABLE=true ROS_SECURITY_STRATEGY=Enforce")
    monkeypatch.setenv("ROS_SECURITY_STRATEGY", "Permissive")
    assert set_defaults().endswith("ROS_SECURITY_STRATEGY=Permissive")


def test_each_kind_of_process_has_its_settings_of_the_middleware(monkeypatch: pytest.MonkeyPatch) -> None:
    variable = "FASTRTPS_DEFAULT_PROFILES_FILE"
    monkeypatch.setenv("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    for profiles in (PROFILES, VIEWER_PROFILES):
        monkeypatch.setenv(variable, "")  # so that it is put back
        monkeypatch.delenv(variable)
        set_defaults(profiles)
        assert os.environ[variable] == str(profiles)
    monkeypatch.setenv(variable, "mine.xml")
    set_defaults(VIEWER_PROFILES)
    assert os.environ[variable] == "mine.xml"
