# SPDX-License-Identifier: Apache-2.0
"""Real ROS processes, each test in a ROS domain of its own; nothing is left behind."""

from __future__ import annotations

import os
import signal
import subprocess
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

try:
    import rclpy
    from diagnostic_msgs.msg import DiagnosticArray
    from rcl_interfaces.msg import Parameter as ParameterMessage
    from rcl_interfaces.srv import DescribeParameters, GetParameters, ListParameters, SetParameters
    from rclpy.context import Context
    from rclpy.executors import SingleThreadedExecutor
    from rclpy.node import Node
    from rclpy.parameter import Parameter

    from ftcm_ros.transport.plane import qos
    from ftcm_ros.transport.topics import CHANGES
except ImportError:  # the test modules skip themselves, with the reason
    rclpy = None

from domains import OWN_DOMAINS, WORKERS, free_domain
from ftcm_core.errors import FtcmError
from ftcm_ros.transport.domain import Domain, ports_of
from ftcm_ros.transport.network import PROFILES
from programs import program

HANG_SECONDS = 120.0
"""Generous ceiling that catches hangs."""


@pytest.fixture
def domain(monkeypatch: pytest.MonkeyPatch) -> int:
    """A ROS domain that nobody else on this machine uses, set in the environment."""
    number = free_domain()
    monkeypatch.setenv("ROS_DOMAIN_ID", str(number))
    monkeypatch.setenv("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    monkeypatch.setenv("FASTRTPS_DEFAULT_PROFILES_FILE", str(PROFILES))  # else it is found after up to 3 s
    return number


@pytest.fixture
def shared_memory(domain: int) -> Callable[[], list[str]]:
    """Returns the shared-memory files of the domain's ports."""
    ports = ports_of(domain)

    def find() -> list[str]:
        return [f.name for f in Path("/dev/shm").iterdir() if any(f"port{p}" in f.name for p in ports)]

    return find


@pytest.fixture(scope="session", autouse=True)
def _nothing_left_in_shared_memory() -> Iterator[None]:
    """Killed nodes leave shared-memory files: remove those of every domain that is free."""
    yield
    for number in OWN_DOMAINS:
        try:
            Domain(number).release()
        except FtcmError:
            continue


class Watcher:
    """A node of the test's own in the same domain."""

    def __init__(self, domain: int) -> None:
        self.context = Context()
        rclpy.init(context=self.context, domain_id=domain)
        self.node = Node("watcher", context=self.context)
        self.executor = SingleThreadedExecutor(context=self.context)
        self.executor.add_node(self.node)

    def spin_until(self, condition: Callable[[], Any], what: str, seconds: float = HANG_SECONDS) -> Any:
        """Spin until a condition holds; fail the test if it does not in time."""
        end = time.monotonic() + seconds
        while time.monotonic() < end:
            if found := condition():
                return found
            self.executor.spin_once(timeout_sec=0.05)
        pytest.fail(f"{what}: not within {seconds:g} s")

    def call(self, service_type: Any, name: str, request: Any) -> Any:
        """Call a service and return its answer; asked again if the middleware drops an answer."""
        client = self.node.create_client(service_type, name)
        try:
            self.spin_until(client.service_is_ready, f"service {name}")
            for _ in range(5):
                future = client.call_async(request)
                end = time.monotonic() + 3.0
                while not future.done() and time.monotonic() < end:
                    self.executor.spin_once(timeout_sec=0.05)
                if future.done():
                    return future.result()
            pytest.fail(f"service {name} did not answer")
        finally:
            self.node.destroy_client(client)

    def set(self, node: str, **values: Any) -> list[tuple[bool, str]]:
        """Set parameters (``__`` stands for a dot), as ``ros2 param set`` does; return results."""
        parameters: list[ParameterMessage] = [
            Parameter(name.replace("__", "."), value=value).to_parameter_msg()
            for name, value in values.items()
        ]
        answer = self.call(
            SetParameters, f"/{node}/set_parameters", SetParameters.Request(parameters=parameters)
        )
        return [(r.successful, r.reason) for r in answer.results]

    def get(self, node: str, name: str) -> Any:
        """Get one parameter's value."""
        answer = self.call(GetParameters, f"/{node}/get_parameters", GetParameters.Request(names=[name]))
        return rclpy.parameter.parameter_value_to_python(answer.values[0])

    def describe(self, node: str, names: list[str]) -> list[Any]:
        """Return parameter descriptors."""
        request = DescribeParameters.Request(names=names)
        return list(self.call(DescribeParameters, f"/{node}/describe_parameters", request).descriptors)

    def list(self, node: str) -> list[str]:
        """Return parameter names."""
        return list(
            self.call(ListParameters, f"/{node}/list_parameters", ListParameters.Request()).result.names
        )

    def close(self) -> None:
        """Leave the domain."""
        self.executor.shutdown()
        self.node.destroy_node()
        rclpy.shutdown(context=self.context)


@pytest.fixture
def watcher(domain: int) -> Iterator[Watcher]:
    """A node of the test's own."""
    made = Watcher(domain)
    yield made
    made.close()


class Live:
    """An experiment under way: what its nodes report, and which components come into force."""

    def __init__(self, watcher: Watcher, process: subprocess.Popen[str]) -> None:
        self.watcher, self.process = watcher, process
        self.health: dict[str, dict[str, str]] = {}
        self.announced: list[tuple[str, str]] = []
        watcher.node.create_subscription(DiagnosticArray, "/diagnostics", self._on_diagnostics, 100)
        watcher.node.create_subscription(DiagnosticArray, CHANGES.name, self._on_change, qos(CHANGES))

    def _on_diagnostics(self, message: Any) -> None:
        for status in message.status:
            values = {v.key: v.value for v in status.values}
            self.health[status.name.partition(":")[0]] = {"message": status.message, **values}

    def _on_change(self, message: Any) -> None:
        self.announced.extend((s.name, s.message) for s in message.status)

    def until(self, condition: Callable[[], Any], what: str) -> Any:
        """Spin until a condition holds; fail the test if the experiment ends before."""

        def found() -> Any:
            return condition() or self.process.poll() is not None

        self.watcher.spin_until(found, what)
        if not (answer := condition()):
            pytest.fail(f"{what}: the experiment has ended; {self.process.communicate()}")
        return answer

    def first_tick(self, *components: tuple[str, str]) -> None:
        """Wait for ticks, and for the components that give them: kind and name."""
        self.until(
            lambda: (
                int(self.health.get("plant", {}).get("tick", 0)) and len(self.announced) >= len(components)
            ),
            "the first tick",
        )
        assert sorted(self.announced) == sorted(components)
        self.announced.clear()

    def change(self, kind: str, **values: Any) -> None:
        """Set parameters of a node, and wait until the change is in force.

        One that another follows before the next tick never is.
        """
        for name, value in values.items():
            assert self.watcher.set(kind, **{name: value}) == [(True, "")]
            self.until(lambda: self.announced, f"{name} of the {kind} in force")
            assert {k for k, _ in self.announced} == {kind}
            self.announced.clear()

    def interrupt(self) -> None:
        """Stop it as a user does."""
        self.process.send_signal(signal.SIGINT)
        _, err = self.process.communicate(timeout=HANG_SECONDS)
        assert self.process.returncode == 130, err

    def end(self) -> str:
        """Wait until it has ended well; return what it has told the user."""
        _, err = self.process.communicate(timeout=HANG_SECONDS)
        assert self.process.returncode == 0, err
        return err


@pytest.fixture
def live(domain: int, watcher: Watcher, start: Callable[..., subprocess.Popen[str]]) -> Callable[..., Live]:
    """Begin experiments in the watcher's domain."""

    def begin(*arguments: str) -> Live:
        return Live(
            watcher,
            start(
                "experiment", *arguments, "--name", "test", "--no-figures", "--domain-id", str(domain)
            ),
        )  # fmt: skip

    return begin


@pytest.fixture
def start(tmp_path: Path) -> Iterator[Callable[..., subprocess.Popen[str]]]:
    """Start commands of the suite; what still runs at the end of the test is stopped."""
    started: list[subprocess.Popen[str]] = []

    def run(name: str, *arguments: str) -> subprocess.Popen[str]:
        if WORKERS > 1 and name == "experiment" and not {"--domain-id", "--external-nodes"} & {*arguments}:
            arguments += ("--domain-id", str(free_domain()))
        # What this process has set for its own nodes is no setting of the user's.
        environment = {k: v for k, v in os.environ.items() if k != "FASTRTPS_DEFAULT_PROFILES_FILE"}
        process = subprocess.Popen(
            [*program(name), *arguments],
            cwd=tmp_path, env=environment, text=True, stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE, stderr=subprocess.PIPE,
        )  # fmt: skip
        started.append(process)
        return process

    yield run
    for process in started:
        if process.poll() is None:
            process.terminate()
            try:
                process.communicate(timeout=15)
            except subprocess.TimeoutExpired:
                process.kill()
                process.communicate()


@pytest.fixture
def experiment(
    tmp_path: Path, start: Callable[..., subprocess.Popen[str]]
) -> Callable[..., subprocess.CompletedProcess[str]]:
    """Run ``experiment`` to its end in the test's folder."""

    def run(*arguments: str) -> subprocess.CompletedProcess[str]:
        process = start("experiment", *arguments, "--name", "test", "--no-figures")
        out, err = process.communicate(timeout=HANG_SECONDS)
        return subprocess.CompletedProcess(process.args, process.returncode, out, err)

    return run
