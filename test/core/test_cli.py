# SPDX-License-Identifier: Apache-2.0
"""The ``ftcm`` command as a user runs it: output, files, exit status, one line per mistake."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import pytest
import yaml

import ftcm_core
import reference_page
from ftcm_core.cli import main
from ftcm_core.controllers import Controller
from ftcm_core.params import specs
from ftcm_core.recording.metrics import METRICS
from ftcm_core.recording.trace_file import load_trace
from ftcm_core.registry import KINDS, components
from ftcm_core.scenario import load, shipped_scenarios
from ftcm_core.simulation import simulate

SOURCE = Path(ftcm_core.__file__).resolve().parents[1]
DOCS = Path(__file__).resolve().parents[2] / "docs"
COMMAND = [sys.executable, "-m", "ftcm_core.cli"]
WINDOWS = {"whole", "transient", "after_transient", "before_fault", "after_fault"}


def environment() -> dict[str, str]:
    """The environment in which a child finds this package."""
    path = os.pathsep.join(x for x in (str(SOURCE), os.environ.get("PYTHONPATH")) if x)
    return {**os.environ, "PYTHONPATH": path}


def ftcm(*arguments: str, cwd: Path | None = None) -> subprocess.CompletedProcess[str]:
    """Run the command in a process of its own."""
    return subprocess.run(
        [*COMMAND, *arguments], capture_output=True, text=True, timeout=120, cwd=cwd, env=environment()
    )


def mistake(*arguments: str, cwd: Path | None = None) -> str:
    """Run a command that is a user's mistake; return its one line on stderr."""
    run = ftcm(*arguments, cwd=cwd)
    assert run.returncode == 2
    assert run.stdout == ""
    assert "Traceback" not in run.stderr
    (line,) = run.stderr.splitlines()
    assert line.startswith("ftcm: error: ")
    return line


@pytest.mark.parametrize(
    ("controller", "torque"),
    [
        ("ftcm", (92.634475422, 138.797617516, 34.269263113)),
        ("smc", (73.680662995, 102.837934950, 27.308423934)),
        ("nftsmc", (73.680662995, 102.837934950, 27.308423934)),
    ],
)
def test_simulate_prints_one_json_object(controller: str, torque: tuple[float, ...]) -> None:
    """Every promised key, and the first torque of the paper's experiment, worked out independently."""
    run = ftcm("simulate", "paper", "--controller", controller, "--set", "duration=1.5", "--json")
    assert run.returncode == 0
    assert run.stderr == ""
    found = json.loads(run.stdout, parse_constant=pytest.fail)
    assert (found["scenario"], found["controller"], found["observer"]) == ("paper", controller, "do")
    assert (found["status"], found["ticks"]) == ("completed", 1501)
    assert found["first_torque"] == pytest.approx(torque, rel=1e-9)
    assert set(found["metrics"]) == WINDOWS
    assert found["metrics"]["after_fault"] is None
    for window in WINDOWS - {"after_fault"}:
        assert set(found["metrics"][window]) == set(METRICS)
        assert all(len(values) == 3 for values in found["metrics"][window].values())
    assert found["configuration"]["duration"] == 1.5


def test_simulate_prints_tables_and_settling_times() -> None:
    """The human output; the bound of eq 15 from e(0) = -0.5 is below Table 1's φ = 1: 0.5^0.4/0.8."""
    run = ftcm("simulate", "paper", "--set", "duration=1.5")
    assert (run.returncode, run.stderr) == (0, "")
    assert f"{0.5**0.4 / 0.8:.3f} / {0.5**0.4 / 0.8:.3f}" in run.stdout
    assert "published" not in run.stdout  # not the paper's experiment


def test_warnings_go_to_stderr_and_leave_the_json_alone() -> None:
    """Gains that fail eq 34 run, with a warning."""
    run = ftcm("simulate", "paper", "--set", "controller.upsilon2=1", "duration=0.1", "--json")
    assert run.returncode == 0
    assert "eq 34" in run.stderr
    assert run.stderr.startswith("ftcm: warning: ")
    json.loads(run.stdout)


def test_a_run_that_diverges_is_a_result() -> None:
    """A velocity gain beyond 2/dt is unstable when sampled."""
    arguments = ("simulate", "paper", "--controller", "ctc", "--set", "controller.kd=2010", "duration=3")
    run = ftcm(*arguments, "--json")
    assert run.returncode == 0
    found = json.loads(run.stdout, parse_constant=pytest.fail)
    assert found["status"] == "diverged"
    assert "at t = " in found["detail"]
    assert "diverged at " in ftcm(*arguments).stdout


def test_output_holds_the_whole_run(tmp_path: Path) -> None:
    """The folder replays: its scenario gives the trace in it, bit for bit."""
    folder = tmp_path / "new" / "run"
    run = ftcm("simulate", "paper", "--set", "duration=0.2", "--output", str(folder), "--json")
    assert run.returncode == 0, run.stderr
    names = {p.name for p in folder.iterdir()}
    assert names == {"summary.json", "table.md", "report.html", "scenario.yaml", "trace.npz", "figures"}
    summary = json.loads((folder / "summary.json").read_text(encoding="utf-8"), parse_constant=pytest.fail)
    (found,) = summary["results"]
    assert {k: found[k] for k in json.loads(run.stdout)} == json.loads(run.stdout)
    assert {"python", "numpy", "platform", "seed"} <= set(summary["provenance"])
    trace = load_trace(folder / "trace.npz")
    scenario = load(str(folder / "scenario.yaml"))
    assert trace.scenario == scenario
    again = simulate(scenario)
    assert (trace.command == again.command).all()
    assert (trace.position == again.position).all()
    assert "exists already" in mistake("simulate", "paper", "--output", str(folder))


def test_compare_runs_in_parallel_and_keeps_the_order() -> None:
    """Several scenarios and controllers; progress goes to stderr."""
    run = ftcm("compare", "paper", "paper", "--controllers", "smc", "ftcm", "--set", "duration=0.2", "--json")
    assert run.returncode == 0, run.stderr
    results = json.loads(run.stdout)["results"]
    assert [r["label"] for r in results] == ["paper/smc", "paper/ftcm"] * 2
    assert [r["controller"] for r in results] == ["smc", "ftcm"] * 2
    assert len(run.stderr.splitlines()) == 4
    alone = json.loads(ftcm("simulate", "paper", "--set", "duration=0.2", "--json").stdout)
    assert results[1]["metrics"] == alone["metrics"]


def test_compare_takes_every_controller_that_the_scenario_allows(capsys: pytest.CaptureFixture[str]) -> None:
    """Without an observer, the laws that need one are left out and named."""
    assert main(["compare", "paper", "--set", "duration=0.02", "observer.type=none", "--json"]) == 0
    out, err = capsys.readouterr()
    laws = components("controller").items()
    without = {name for name, cls in laws if issubclass(cls, Controller) and not cls.needs_observer}
    assert {r["controller"] for r in json.loads(out)["results"]} == without
    assert "left out" in err
    assert main(["compare", "paper", "--controllers", "ftcm", "--set", "observer.type=none"]) == 2


@pytest.mark.slow
def test_reproduce_shows_the_published_table() -> None:
    """The paper's three controllers beside its Table 2."""
    run = ftcm("reproduce")
    assert run.returncode == 0, run.stderr
    for text in (
        "0.154244",
        "0.019966",
        "0.002785",
        "published",
        "do not reproduce",
        "all initial transient",
    ):
        assert text in run.stdout


@pytest.mark.parametrize(
    ("arguments", "expected"),
    [
        (["simulate", "papr"], "did you mean 'paper'?"),
        (["simulate", "/no/such/file.yaml"], "no scenario file"),
        (["simulate"], "one scenario"),
        (["simulate", "paper", "--controller", "fctm"], "no controller 'fctm'; did you mean 'ftcm'?"),
        (["simulate", "paper", "--observer", "ddo"], "no observer 'ddo'; did you mean 'do'?"),
        (["simulate", "paper", "--set", "duration"], "expected path=value"),
        (["simulate", "paper", "--set", "duration=-1"], "--set: duration: -1 is out of range"),
        (["simulate", "paper", "--set", "observer.k3=1"], "did you mean 'k2'?"),
        (["simulate", "paper", "--set", "injection.faults.7.start=1"], "numbered from 0"),
        (["simulate", "paper", "--output", "broken.yaml/inner"], "Not a directory"),
        (["simulate", "paper", "--output", "broken.yaml"], "exists already"),
        (["simulate", "broken.yaml"], "broken.yaml:2: not valid YAML"),
        (["compare", "paper", "--controllers", "smc", "ftcmm"], "'ftcmm'; did you mean 'ftcm'?"),
        (["compare", "paper", "--set", "controller.c=3"], "with controller adrc: "),
        (["compare"], "one scenario or more"),
        (["list", "controllr"], "did you mean 'controller'?"),
        (["describe", "nftsm"], "did you mean 'nftsmc'?"),
        (["describe", "fault/smc"], "no fault 'smc'"),
    ],
)
def test_a_mistake_is_one_line(arguments: list[str], expected: str, tmp_path: Path) -> None:
    """Exit status 2, nothing on stdout, and what to do about it."""
    (tmp_path / "broken.yaml").write_text("robot: {type: puma560\ncontroller: ftcm\n", encoding="utf-8")
    assert expected in mistake(*arguments, cwd=tmp_path)
    assert [p.name for p in tmp_path.iterdir()] == ["broken.yaml"]


def test_wrong_arguments_show_the_usage() -> None:
    """What argparse refuses: its usage and one line."""
    run = ftcm("simulate", "paper", "--speed", "3")
    assert run.returncode == 2
    assert run.stderr.startswith("usage: ")
    assert "error: unrecognized arguments" in run.stderr.splitlines()[-1]


def test_scenario_may_follow_the_overrides() -> None:
    """``--set a=1 paper`` means the scenario paper."""
    run = ftcm("simulate", "--json", "--set", "duration=0.01", "paper")
    assert json.loads(run.stdout)["ticks"] == 11


def test_list_and_describe_cover_every_component(capsys: pytest.CaptureFixture[str]) -> None:
    """Names of every kind, and every parameter with its default and source."""

    def output(*arguments: str) -> str:
        assert main(arguments) == 0
        return capsys.readouterr().out

    listing = json.loads(output("list", "--json"))
    assert set(listing) == {"scenario", *KINDS}
    assert set(listing["scenario"]) == set(shipped_scenarios())
    text = output("list")
    for kind in KINDS:
        assert list(listing[kind]) == list(components(kind))
        for name, cls in components(kind).items():
            assert listing[kind][name] in text
            described: dict[str, Any] = json.loads(output("describe", f"{kind}/{name}", "--json"))
            assert (described["kind"], described["name"]) == (kind, name)
            assert described["doc"]
            assert [p["name"] for p in described["parameters"]] == list(specs(cls))
            written = output("describe", f"{kind}/{name}")
            assert all(f"  {parameter} = " in written for parameter in specs(cls))


def test_reference_page_is_up_to_date(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """``--check`` passes on the page in the repository and fails on another, in one line."""

    def page(*arguments: str) -> int:
        monkeypatch.setattr(sys, "argv", ["reference_page.py", *arguments])
        return reference_page.main()

    assert page("--check", str(DOCS)) == 0
    assert page(str(tmp_path)) == 0
    assert page("--check", str(tmp_path)) == 0
    (tmp_path / reference_page.FILE).write_text("old", encoding="utf-8")
    capsys.readouterr()
    assert page("--check", str(tmp_path)) == 1
    assert len(capsys.readouterr().err.splitlines()) == 1


def test_version() -> None:
    """``ftcm --version`` names the program and its version."""
    assert ftcm("--version").stdout == f"ftcm {ftcm_core.__version__}\n"


@pytest.mark.parametrize("seconds", [0.0, 0.02, 0.5])
def test_interrupt_ends_quietly_with_its_workers(seconds: float) -> None:
    """Ctrl-C while processes are being started, and in the middle of a comparison: status 130, no output."""
    process = subprocess.Popen(
        [*COMMAND, "compare", "paper", "paper", "--set", "duration=400"],
        stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, env=environment(),
        # As at a terminal, also where the tests themselves run in the background.
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.SIG_DFL),
    )  # fmt: skip
    children = Path(f"/proc/{process.pid}/task/{process.pid}/children")
    while process.poll() is None and not children.read_text():
        time.sleep(0.0002)
    time.sleep(seconds)  # the runs take far longer
    process.send_signal(signal.SIGINT)
    out, err = process.communicate(timeout=20)  # returns only when no worker holds the pipes any more
    assert (process.returncode, out, err) == (130, "", "")


def test_a_closed_pipe_is_quiet() -> None:
    """``ftcm list | head -0``: nobody reads."""
    process = subprocess.Popen(
        [*COMMAND, "list"], stdout=subprocess.PIPE, stderr=subprocess.PIPE, env=environment()
    )
    assert process.stdout is not None
    process.stdout.close()
    assert process.stderr is not None
    assert process.stderr.read() == b""
    assert process.wait(timeout=20) != 0
    process.stderr.close()


def test_a_closed_standard_output_is_one_line() -> None:
    run = subprocess.run(
        ["sh", "-c", 'exec "$@" >&-', "sh", *COMMAND, "simulate", "paper", "--set", "duration=0.1"],
        stderr=subprocess.PIPE, text=True, timeout=120, env=environment(),
    )  # fmt: skip
    assert run.returncode == 1
    (line,) = run.stderr.splitlines()
    assert line.startswith("ftcm: error: standard output is closed")


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="needs /dev/full")
def test_a_full_disk_is_one_line() -> None:
    """The machine's failure, not the user's: exit status 1."""
    with open("/dev/full", "w", encoding="utf-8") as full:
        run = subprocess.run(
            [*COMMAND, "list"], stdout=full, stderr=subprocess.PIPE, text=True, timeout=60, env=environment()
        )
    assert (run.returncode, run.stderr) == (1, "ftcm: error: No space left on device\n")


def test_output_scenarios_of_several_runs(tmp_path: Path) -> None:
    """Each run's complete scenario is beside the results."""
    folder = tmp_path / "results"
    arguments = ["compare", "paper", "--controllers", "smc", "pid", "--set", "duration=0.05"]
    assert main([*arguments, "--output", str(folder), "--no-figures"]) == 0
    assert not (folder / "figures").exists()
    for name in ("smc", "pid"):
        written = yaml.safe_load((folder / f"scenario-{name}.yaml").read_text(encoding="utf-8"))
        assert written["controller"]["type"] == name
