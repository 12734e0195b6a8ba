# SPDX-License-Identifier: Apache-2.0
"""``ftcm doctor``: one line for each thing, what to do, and a status that says whether a run is possible."""

from __future__ import annotations

import json
import os
import re
import resource
import shutil
import subprocess
import sys
from importlib import metadata
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

import ftcm_core
from ftcm_core.cli import brought, doctor, main
from ftcm_core.cli.doctor import MISSING, OK, WARNING, Finding
from ftcm_core.errors import FtcmError

SETUP = Path(__file__).resolve().parents[2] / "src" / "ftcm_core" / "setup.py"
STATES = {OK, WARNING, MISSING}


@pytest.fixture
def alone(monkeypatch: pytest.MonkeyPatch) -> None:
    """As where only the core is installed; no other process is started."""
    monkeypatch.setattr(doctor, "brought", lambda name: None)
    monkeypatch.setattr(doctor, "importing", lambda modules: {})


def found(name: str) -> Finding:
    """What the doctor says of one thing."""
    (finding,) = [finding for finding in doctor.examined() if finding.name == name]
    return finding


# The command.


def test_one_line_for_each_thing(alone: None, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["doctor"]) == 0
    lines = capsys.readouterr().out.splitlines()
    named = [re.fullmatch(r"(ok|warning|missing) +(\S.*?)  +\S.*", line) for line in lines]
    assert None not in named
    names = [match[2] for match in named if match]
    assert len(names) == len({*names})
    assert {"Python", "numpy", "ftcm_core", "numba", "real-time priority", "clock source", "disk"} < {*names}


def test_the_same_as_json(alone: None, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["doctor", "--json"]) == 0
    findings = json.loads(capsys.readouterr().out)
    assert [finding["name"] for finding in findings] == [finding.name for finding in doctor.examined()]
    assert {finding["status"] for finding in findings} <= STATES
    for finding in findings:
        assert finding["value"]
        assert finding["advice"] or finding["status"] == OK, "it says what to do"


def test_without_ros_it_says_what_that_means(alone: None) -> None:
    finding = found("ftcm_ros")
    assert (finding.status, finding.needed) == (MISSING, False)
    assert "only runs over the ROS graph need it" in finding.advice


def test_the_part_of_the_other_package_follows(alone: None, monkeypatch: pytest.MonkeyPatch) -> None:
    of_ros = [Finding("ROS 2", MISSING, "no rclpy", "get it")]
    monkeypatch.setattr(doctor, "brought", lambda name: {"doctor": lambda: of_ros}[name])
    assert doctor.examined()[-1:] == of_ros
    assert main(["doctor"]) == 0, "not every run needs ROS"


def test_another_package_that_is_broken_is_a_line(alone: None, monkeypatch: pytest.MonkeyPatch) -> None:
    def fail(name: str) -> None:
        raise FtcmError(f"{name}: the package ftcm_ros cannot be imported: no rosbags")

    monkeypatch.setattr(doctor, "brought", fail)
    assert found("ftcm_ros").status == MISSING
    assert "no rosbags" in found("ftcm_ros").value


def test_an_entry_point_that_cannot_be_loaded_is_one_line(monkeypatch: pytest.MonkeyPatch) -> None:
    points = [metadata.EntryPoint("doctor", "ftcm_core.no_such_module:examine", brought.GROUP)]
    monkeypatch.setattr(brought.metadata, "entry_points", lambda group: points)
    assert brought.brought("other") is None
    with pytest.raises(
        FtcmError, match=r"^doctor: the package ftcm_ros cannot be imported: .*no_such_module"
    ):
        brought.brought("doctor")


@pytest.mark.parametrize(
    ("finding", "status"),
    [
        (Finding("a", MISSING, "x", needed=True), 1),
        (Finding("a", WARNING, "x", needed=True), 0),
        (Finding("a", MISSING, "x", needed=False), 0),
    ],
)
def test_the_status_is_that_of_what_every_run_needs(
    alone: None, monkeypatch: pytest.MonkeyPatch, finding: Finding, status: int
) -> None:
    monkeypatch.setattr(doctor, "packages", lambda: [finding])
    assert main(["doctor"]) == status


# What every run needs.


def test_what_is_needed_is_what_the_package_declares() -> None:
    text = SETUP.read_text("utf-8")
    (declared,) = re.findall(r"install_requires=\[(.*?)\]", text)
    assert dict(re.findall(r'"(\w+)>=([\d.]+)"', declared)) == doctor.NEEDED
    extras = dict(re.findall(r'"(\w+)": \["(\w+)>=', text))
    assert {extra: name for name, _, extra in doctor.EXTRAS.values() if extra} == extras


@pytest.mark.parametrize(
    ("version", "status"),
    [("1.26", OK), ("2.0rc1", OK), ("1.25.9", MISSING), ("1.3", MISSING), ("", MISSING)],
)
def test_a_package_is_there_and_new_enough(
    monkeypatch: pytest.MonkeyPatch, version: str, status: str
) -> None:
    monkeypatch.setattr(doctor, "version_of", lambda name: version)
    finding = doctor.package("numpy", "1.26", needed=True)
    assert finding.status == status
    assert finding.needed
    assert finding.advice == ("" if status == OK else "python -m pip install 'numpy>=1.26'")


def test_an_old_python_is_not_enough(monkeypatch: pytest.MonkeyPatch) -> None:
    assert doctor.python().status == OK
    monkeypatch.setattr(sys, "version_info", (3, 9, 18, "final", 0))
    assert doctor.python()[:2] == ("Python", MISSING)
    assert doctor.python().needed


def test_a_package_without_its_scenarios_runs_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    assert doctor.core().status in (OK, WARNING)
    monkeypatch.setattr(doctor, "shipped_scenarios", dict)
    assert doctor.core()[:2] == ("ftcm_core", MISSING)
    assert doctor.core().needed


def test_what_runs_is_compared_with_what_is_installed(monkeypatch: pytest.MonkeyPatch) -> None:
    for installed, status in ((ftcm_core.__version__, OK), ("0.0.1", WARNING), ("", OK)):
        monkeypatch.setattr(doctor, "version_of", lambda name, installed=installed: installed)
        assert doctor.suite_package("ftcm_core", "here", needed=True).status == status


# Extras: imported where that cannot do harm.


def test_an_import_that_fails_or_ends_its_process_is_told(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    (tmp_path / "breaks_itself.py").write_text("import os; os.abort()\n", encoding="utf-8")
    monkeypatch.setenv("PYTHONPATH", os.pathsep.join([str(tmp_path), os.environ.get("PYTHONPATH", "")]))
    failed = doctor.importing(["math", "breaks_itself", "no_such_module"])
    assert sorted(failed) == ["breaks_itself", "no_such_module"]
    assert failed["no_such_module"] == "ModuleNotFoundError: No module named 'no_such_module'"
    assert "status -6" in failed["breaks_itself"]


def test_an_extra_is_there_or_missing_or_broken(monkeypatch: pytest.MonkeyPatch) -> None:
    def said(version: str, reasons: dict[str, str]) -> Finding:
        monkeypatch.setattr(doctor, "version_of", lambda name: version)
        monkeypatch.setattr(doctor, "importing", lambda modules: reasons)
        return doctor.extras()[0]

    assert said("3.6", {}) == Finding("matplotlib", OK, "3.6")
    missing = said("", {"matplotlib": "ModuleNotFoundError"})
    assert (missing.status, missing.needed) == (MISSING, False)
    assert missing.advice.endswith("pip install matplotlib, or the extra ftcm_core[figures]")
    broken = said("3.6", {"matplotlib": "made for another numpy"})
    assert broken.status == WARNING
    assert "3.6 cannot be imported: made for another numpy" in broken.value


# The machine.


def test_one_processor_is_a_warning(monkeypatch: pytest.MonkeyPatch) -> None:
    for usable, status in (({3}, WARNING), ({0, 1}, OK)):
        monkeypatch.setattr(os, "sched_getaffinity", lambda pid, usable=usable: usable)
        assert doctor.processors().status == status


def test_real_time_is_tried_and_leaves_this_process_as_it_was(monkeypatch: pytest.MonkeyPatch) -> None:
    before = os.sched_getscheduler(0), os.sched_getparam(0)
    doctor.real_time()
    assert (os.sched_getscheduler(0), os.sched_getparam(0)) == before

    def refuse(*arguments: Any) -> None:
        raise PermissionError(1, "Operation not permitted")

    monkeypatch.setattr(os, "sched_setscheduler", refuse)
    finding = doctor.real_time()
    assert finding.status == WARNING
    assert "Operation not permitted" in finding.value
    assert "rtprio" in finding.advice


def test_locked_memory_is_what_the_limit_or_the_capability_says(monkeypatch: pytest.MonkeyPatch) -> None:
    for limit, capable, status in (
        (8 << 20, False, WARNING),
        (8 << 20, True, OK),
        (resource.RLIM_INFINITY, False, OK),
    ):
        monkeypatch.setattr(resource, "getrlimit", lambda kind, limit=limit: (limit, limit))
        monkeypatch.setattr(doctor, "_capable", lambda number, capable=capable: capable)
        assert doctor.locked_memory().status == status
    monkeypatch.setattr(doctor, "_capable", lambda number: False)
    monkeypatch.setattr(resource, "getrlimit", lambda kind: (8 << 20, 8 << 20))
    assert "8.4 MB" in doctor.locked_memory().value


@pytest.mark.parametrize(("source", "status"), [("tsc", OK), ("kvm-clock", OK), ("hpet", WARNING)])
def test_the_clock_source_is_one_that_is_quick(tmp_path: Path, source: str, status: str) -> None:
    (tmp_path / "current_clocksource").write_text(source + "\n", encoding="ascii")
    assert doctor.clock_source(tmp_path)[1:3] == (status, source)
    assert doctor.clock_source(tmp_path / "none").status == WARNING


def test_a_coarse_clock_is_a_warning(monkeypatch: pytest.MonkeyPatch) -> None:
    for resolution, status in ((1e-9, OK), (4e-3, WARNING)):
        monkeypatch.setattr(doctor.time, "clock_getres", lambda clock, resolution=resolution: resolution)
        assert doctor.clock_resolution().status == status


def test_room_in_shared_memory_and_on_the_disk(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    assert doctor.shared_memory(tmp_path / "none").status == WARNING
    for free, of_memory, of_disk in ((1e12, OK, OK), (1e8, OK, WARNING), (1e6, WARNING, WARNING)):
        usage = SimpleNamespace(total=int(2e12), used=int(2e12 - free), free=int(free))
        monkeypatch.setattr(shutil, "disk_usage", lambda folder, usage=usage: usage)
        assert doctor.shared_memory(tmp_path).status == of_memory
        assert doctor.disk(tmp_path).status == of_disk


def test_on_this_machine_in_a_process_of_its_own(tmp_path: Path) -> None:
    """Whatever there is here: every extra that the doctor calls ok can be imported."""
    source = Path(ftcm_core.__file__).resolve().parents[1]
    path = os.pathsep.join([str(source), os.environ.get("PYTHONPATH", "")])
    run = subprocess.run(
        [sys.executable, "-m", "ftcm_core.cli", "doctor", "--json"],
        cwd=tmp_path, env={**os.environ, "PYTHONPATH": path}, capture_output=True, text=True, timeout=120,
    )  # fmt: skip
    assert (run.returncode, run.stderr) == (0, "")
    status = {finding["name"]: finding["status"] for finding in json.loads(run.stdout)}
    assert {status[name] for name in ("Python", *doctor.NEEDED)} == {OK}
    for module, (name, _, _) in doctor.EXTRAS.items():
        assert (status[name] == OK) == (doctor.importing([module]) == {})
