# SPDX-License-Identifier: Apache-2.0
"""The experiment with each node in a container of its own, as docker/compose.yaml has it."""

from __future__ import annotations

import contextlib
import itertools
import json
import os
import shutil
import subprocess
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

pytestmark = [pytest.mark.docker, pytest.mark.slow]

ROOT = Path(__file__).resolve().parents[2]
IMAGE = os.environ.get("FTCM_IMAGE", "ftcm")
NODES = ("plant", "injector", "observer", "controller", "recorder")
HANG_SECONDS = 200.0
"""Generous ceiling that catches hangs."""
SHORT = "paper --controllers ftcm --set duration=1 --set injection.faults.0.start=0.5"


def docker(*arguments: str, check: bool = True, **options: Any) -> str:
    """Run the Docker client and return what it printed."""
    run = subprocess.run(
        ["docker", *arguments], capture_output=True, text=True, timeout=HANG_SECONDS, check=False, **options
    )
    assert run.returncode == 0 or not check, f"docker {' '.join(arguments)}: {run.stderr}"
    return run.stdout.strip()


def why_not() -> str:
    """Why these tests cannot run here; empty if they can."""
    if shutil.which("docker") is None:
        return "no docker command"
    run = subprocess.run(["docker", "info"], capture_output=True, text=True, check=False)
    if run.returncode:
        return f"no Docker engine: {run.stderr.strip().splitlines()[-1]}"
    if subprocess.run([ROOT / "docker/compose", "version"], capture_output=True, check=False).returncode:
        return "no Docker Compose"
    return ""


@pytest.fixture(scope="session", autouse=True)
def _engine() -> None:
    if reason := why_not():
        pytest.skip(reason)
    assert docker("images", "--quiet", IMAGE), f"there is no image {IMAGE!r}; docker/build makes it"


class Project:
    """One `docker/compose up`: five nodes and an experiment."""

    numbers = itertools.count()

    def __init__(self, folder: Path, experiment: str, environment: dict[str, str]) -> None:
        """Say what experiment it is; nothing is started yet."""
        self.name = f"ftcm-test-{os.getpid()}-{next(self.numbers)}"
        self.runs = folder / self.name
        self.runs.mkdir()
        if os.getuid() == 0:  # the containers are not to run as root
            os.chown(self.runs, 12345, 12345)
        owner = self.runs.stat()
        self.environment = {
            **os.environ,
            "FTCM_UID": str(owner.st_uid),
            "FTCM_GID": str(owner.st_gid),
            "FTCM_RUN": "test",
            "FTCM_RUNS": str(self.runs),
            "FTCM_EXPERIMENT": f"{experiment} --no-figures",
            **environment,
        }

    def compose(self, *arguments: str) -> None:
        """Run docker/compose."""
        run = subprocess.run(
            [ROOT / "docker/compose", "-p", self.name, *arguments],
            env=self.environment, capture_output=True, text=True, timeout=HANG_SECONDS, check=False,
        )  # fmt: skip
        assert run.returncode == 0, run.stderr

    def container(self, service: str) -> str:
        """Return a service's container."""
        filters = {"com.docker.compose.project": self.name, "com.docker.compose.service": service}
        return docker("ps", "-aq", *(f"--filter=label={k}={v}" for k, v in filters.items()))

    def network(self) -> str:
        """Return the network that the containers are on."""
        return docker(
            "inspect", "--format", "{{range $k, $v := .NetworkSettings.Networks}}{{$k}}{{end}}",
            self.container("experiment"),
        )  # fmt: skip

    def wait_for_ticks(self) -> None:
        """Wait until 400 ticks or more are in the bag."""
        end = time.monotonic() + HANG_SECONDS
        while time.monotonic() < end:
            if sum(f.stat().st_size for f in self.runs.glob("test/bags/*/*")) > 400_000:
                return
            time.sleep(0.1)
        pytest.fail(f"no ticks: {self.log()}")

    def wait(self) -> int:
        """Wait for the end of the experiment and return its status."""
        return int(docker("wait", self.container("experiment")))

    def log(self) -> str:
        """Return what the experiment has told the user, without the results on its standard output."""
        run = subprocess.run(
            ["docker", "logs", self.container("experiment")], capture_output=True, text=True, check=False
        )
        return run.stderr

    def inside(self, *arguments: str, network: str = "none") -> Any:
        """Run inside.py in a container of its own and return what it says."""
        answer = docker(
            "run", "--rm", "--network", network, "-v", f"{self.runs}:/runs:ro",
            "-v", f"{Path(__file__).parent}:/test:ro",
            "-e", f"ROS_DOMAIN_ID={self.environment.get('ROS_DOMAIN_ID', 0)}",
            "-e", "ROS_AUTOMATIC_DISCOVERY_RANGE=SUBNET", "-e", "FASTDDS_BUILTIN_TRANSPORTS=UDPv4",
            IMAGE, "python", "/test/inside.py", *arguments,
        )  # fmt: skip
        return json.loads(answer)

    def bag(self, controller: str = "ftcm") -> Any:
        """Read the bag, and compare it with the in-process run."""
        return self.inside("compare", f"/runs/test/bags/{controller}")

    def close(self) -> None:
        """Remove containers and network, whatever state they are in."""
        for service in (*NODES, "detector"):
            docker("unpause", self.container(service), check=False)
        self.compose("down", "--timeout", "1")


Up = Callable[..., Project]


@pytest.fixture
def up(tmp_path: Path) -> Iterator[Callable[..., Project]]:
    """Start experiments: ``up("paper --set duration=1")``; environment variables by name."""
    started: list[Project] = []

    def start(experiment: str, **environment: str) -> Project:
        project = Project(tmp_path, experiment, environment)
        started.append(project)
        project.compose("up", "--detach")
        return project

    yield start
    with contextlib.ExitStack() as stack:
        for project in started:
            stack.callback(project.close)


@pytest.fixture
def network() -> Iterator[str]:
    """A network for several experiments."""
    name = f"ftcm-test-{os.getpid()}"
    docker("network", "create", "--label", "ftcm", name)
    yield name
    docker("network", "rm", name)


def equals_the_in_process_run(bag: Any, ticks: int) -> None:
    assert bag["status"] == "completed"
    assert bag["ticks"] == ticks
    assert bag["missing"] == {}
    assert bag["differing"] == []


def test_the_image_is_not_root() -> None:
    assert docker("run", "--rm", IMAGE, "id", "-u") != "0"


@pytest.mark.parametrize("composed", ["", "1"])
def test_lockstep_across_containers_equals_the_in_process_run(up: Up, composed: str) -> None:
    project = up(SHORT, FTCM_COMPOSED=composed)
    assert bool(project.container("composed")) == bool(composed)
    assert bool(project.container("plant")) != bool(composed)
    assert project.wait() == 0, project.log()
    equals_the_in_process_run(project.bag(), 1001)
    owner = project.runs.stat().st_uid
    assert owner != 0
    assert {p.stat().st_uid for p in project.runs.rglob("*")} == {owner}
    summary = json.loads((project.runs / "test" / "summary.json").read_text())
    assert summary["results"][0]["status"] == "completed"


def test_a_detector_has_a_container_of_its_own_where_the_scenario_has_one(up: Up) -> None:
    project = up(f"{SHORT} --set detector=residual_threshold", COMPOSE_PROFILES="detector")
    assert project.container("detector")
    assert project.wait() == 0, project.log()
    bag = project.bag()
    equals_the_in_process_run(bag, 1001)
    assert {"residual", "alarm"} <= set(bag["columns"])


@pytest.mark.parametrize("composed", ["", "1"])
def test_real_time_across_containers(up: Up, composed: str) -> None:
    project = up("paper --controllers ftcm --mode real_time --set duration=3", FTCM_COMPOSED=composed)
    assert project.wait() == 0, project.log()
    bag = project.bag()
    assert bag["status"] == "completed"
    plant = {k: int(bag["plant"][k]) for k in ("late_torque", "late_disturbance", "plant_overrun")}
    missed = int(bag["plant"]["missed_deadlines"])
    assert missed == sum(plant.values())
    assert bag["plant"]["mode"] == "real_time"
    assert bag["held"] <= missed
    if not missed:
        equals_the_in_process_run(bag, 3001)


def test_the_controller_is_swapped_from_another_container(up: Up) -> None:
    project = up("paper --controllers ftcm")
    project.wait_for_ticks()
    end = time.monotonic() + HANG_SECONDS
    health: dict[str, str] = {}
    while set(health.values()) != {"healthy"}:
        assert time.monotonic() < end, health
        time.sleep(0.5)
        health = {
            n: docker("inspect", "--format", "{{.State.Health.Status}}", project.container(n)) for n in NODES
        }
    network = project.network()
    assert project.inside("change", "controller", "controller", "smc", network=network)["successful"]
    refused = project.inside("change", "controller", "controller", "scm", network=network)
    assert "did you mean 'smc'?" in refused["reason"]
    time.sleep(1)
    docker("kill", "--signal", "INT", project.container("experiment"))
    assert project.wait() == 130, project.log()
    bag = project.bag()
    ((kind, law, tick),) = bag["changes"]
    assert (kind, law) == ("controller", "smc")
    assert 0 < tick < bag["ticks"]
    assert bag["status"] == "incomplete"
    assert bag["differing"] == []


def disconnect(project: Project, container: str) -> None:
    docker("network", "disconnect", "--force", project.network(), container)


FAULTS: dict[str, Callable[[Project, str], Any]] = {
    "kill": lambda project, container: docker("kill", container),
    "pause": lambda project, container: docker("pause", container),
    "disconnect": disconnect,
}


@pytest.mark.parametrize("fault", FAULTS)
@pytest.mark.parametrize("victim", NODES)
def test_a_container_that_fails_ends_the_run_and_is_named(up: Up, victim: str, fault: str) -> None:
    project = up("paper --controllers ftcm --set duration=15")
    project.wait_for_ticks()
    container = project.container(victim)
    FAULTS[fault](project, container)
    began = time.monotonic()
    assert project.wait() == 1, project.log()
    assert time.monotonic() - began < 60
    log = project.log()
    assert f"node {victim!r} has said nothing for 5 s, at tick" in log.splitlines()[-1]
    assert "Traceback" not in log
    if fault == "pause":
        docker("unpause", container)
    project.compose("stop")
    if (victim, fault) != ("recorder", "kill"):  # what that keeps: test/ros/test_recovery.py
        bag = project.bag()
        assert bag["status"] == "incomplete"
        assert bag["ticks"] > 400, "what was there when it was waited for"
        assert not {"position", "velocity", "effort"} & set(bag["differing"]), bag


@pytest.mark.parametrize("where", ["two networks", "one network"])
def test_two_experiments_side_by_side(network: str, up: Up, where: str) -> None:
    shared = {"FTCM_NETWORK": network} if where == "one network" else {}
    domains = ("7", "8") if shared else ("7", "7")
    laws = ("ftcm", "smc")
    projects = [
        up(f"paper --controllers {law} --set duration=15", ROS_DOMAIN_ID=domain, **shared)
        for law, domain in zip(laws, domains)
    ]
    for project in projects:
        project.wait_for_ticks()
    running = docker("inspect", "--format", "{{.State.Running}}", projects[0].container("experiment"))
    assert running == "true", "the first ended before the second began: they were not side by side"
    for project, law in zip(projects, laws):
        assert project.wait() == 0, project.log()
        bag = project.bag(law)
        equals_the_in_process_run(bag, 15_001)
        assert {t["repeated"] for t in bag["topics"].values()} == {0}
