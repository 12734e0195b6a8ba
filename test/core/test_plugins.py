# SPDX-License-Identifier: Apache-2.0
"""Components from a file of the user: loaded, used everywhere, refused in one line where they are wrong."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from ftcm_core import campaign, compiled, registry
from ftcm_core.campaign import Campaign
from ftcm_core.cli import main
from ftcm_core.controllers.ctc import CTC
from ftcm_core.errors import FtcmError, ScenarioError
from ftcm_core.recording.trace_file import load_trace, save_trace
from ftcm_core.registry import KINDS, components, find, load_plugin
from ftcm_core.scenario import from_mapping, load
from ftcm_core.signals import Measurement
from ftcm_core.simulation import simulate
from ftcm_core.simulation.stages import ControllerStage
from plugins import ROBOTS_FILE, registry_kept
from traces import close, rows_of, same

TEXT = '''\
"""A law of the user."""

from ftcm_core.controllers.ctc import CTC
from ftcm_core.params import param
from ftcm_core.registry import register


def part(share: float, x: float) -> float:
    """A share of an estimate, none below a threshold: a decision on a number."""
    if abs(x) < 1e-3:
        return 0.0
    return share * x


@register("controller", "cautious")
class Cautious(CTC):
    """Computed torque that trusts the observer in part: u = u_ctc + share tau_hat."""

    share: float = param(0.5, unit="-", doc="share of the estimate", source="chosen")

    needs_observer = True

    def prepare(self, model, dt, y, reference, state):
        """All but the estimate, and a number that step() must get back."""
        return self.feedback(model, dt, y, reference, state), y.position[0]

    def step(self, model, dt, y, reference, disturbance_estimate, state, prepared):
        """Add a share of the estimate."""
        (u, following), seen = prepared
        return tuple([x + part(self.share, d) for x, d in zip(u, disturbance_estimate)]), following
'''
SHORT = ["duration=0.1", "transient=0.02"]


@pytest.fixture(autouse=True)
def _restore() -> Iterator[None]:
    """What a test loads is gone after it."""
    with registry_kept():
        yield


@pytest.fixture
def file(tmp_path: Path) -> Path:
    """The user's file."""
    path = tmp_path / "mine.py"
    path.write_text(TEXT)
    return path


def child(
    *arguments: str, cwd: Path | None = None, cache: Path | None = None
) -> subprocess.CompletedProcess[str]:
    """The command line in a process of its own."""
    path = os.pathsep.join(x for x in sys.path if x)
    environment = {**os.environ, "PYTHONPATH": path, **({compiled.CACHE: str(cache)} if cache else {})}
    return subprocess.run(
        [sys.executable, "-m", "ftcm_core.cli", *arguments],
        capture_output=True, text=True, timeout=200, cwd=cwd, env=environment, check=False,
    )  # fmt: skip


# A law that uses the estimate otherwise than by adding it.


def test_a_law_may_use_the_estimate_in_its_own_way(file: Path) -> None:
    """In a run: each command is that of computed torque plus the share of that tick's estimate."""
    load_plugin(str(file))
    trace = simulate(load("paper", [*SHORT, "controller={type: cautious, share: 0.7}"]))
    ctc, scenario = CTC(), trace.scenario
    assert scenario is not None
    for k, row in enumerate(rows_of(trace)):
        y = Measurement(row["position"], row["velocity"], row["effort"])
        (u, _) = ctc.feedback(scenario.model, 1e-3, y, scenario.reference.at(k * 1e-3, 3), ctc.init(3))
        share = [0.7 * d if abs(d) >= 1e-3 else 0.0 for d in row["disturbance_estimate"]]
        assert row["command"] == tuple(map(float.__add__, u, share))
    assert np.abs(trace.disturbance_estimate).max() > 0.5
    none = simulate(load("paper", [*SHORT, "controller={type: cautious, share: 0}"]))
    plain = simulate(load("paper", SHORT, "ctc"))
    assert same(none, plain)


def test_what_its_prepare_returns_is_what_its_step_gets(file: Path) -> None:
    """Also ahead of time; a preparation for another tick or motion is dropped."""
    load_plugin(str(file))
    scenario = load("paper", SHORT, "cautious")
    one, ahead = ControllerStage(scenario), ControllerStage(scenario)
    zero = (0.0, 0.0, 0.0)
    for k in range(20):
        y = Measurement((0.01 * k, 0.2, -0.1), (0.1, -0.2, 0.05 * k), zero)
        ahead.prepare(k * 1_000_000 + (k % 3) * 1_000_000, y if k % 2 else Measurement(zero, zero, zero))
        tau_hat = (1.0 * k, -2.0, 5e-4)
        assert ahead.step(k * 1_000_000, y, tau_hat) == one.step(k * 1_000_000, y, tau_hat)


@pytest.mark.slow
def test_it_is_compiled_as_any_other(file: Path) -> None:
    """Its own function of plain floats too."""
    pytest.importorskip("numba")
    load_plugin(str(file))
    scenario = load("paper", SHORT, "cautious")
    trace = compiled.simulate(scenario)
    assert trace.engine == "compiled"
    close(trace, simulate(scenario))


# Loading.


def test_a_file_is_loaded_once(file: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """By whatever path it is named; its components are there as if they were the suite's."""
    known = load_plugin(str(file))
    assert known == str(file)
    cls = find("controller", "cautious")
    monkeypatch.chdir(file.parent)
    assert load_plugin("mine.py") == known
    assert find("controller", "cautious") is cls
    assert registry.plugins()[-1] == known
    assert cls.__module__ in sys.modules
    assert cls().to_mapping() == {"type": "cautious", **CTC().values, "share": 0.5}


def test_a_module_may_be_named_too(file: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """As one that is installed somewhere."""
    (file.parent / "some_lab_laws.py").write_text(TEXT)
    monkeypatch.syspath_prepend(str(file.parent))
    assert load_plugin("some_lab_laws") == "some_lab_laws"
    assert find("controller", "cautious").__module__ == "some_lab_laws"
    sys.modules.pop("some_lab_laws")


def test_two_files_of_one_name(file: Path, tmp_path: Path) -> None:
    """In two folders: two modules."""
    other = tmp_path / "other" / "mine.py"
    other.parent.mkdir()
    other.write_text(TEXT.replace("cautious", "careful"))
    load_plugin(str(file))
    load_plugin(str(other))
    assert {"cautious", "careful"} <= set(components("controller"))


BROKEN = {
    "a syntax error": (TEXT + "\n\ndef f(:\n", f"SyntaxError in line {len(TEXT.splitlines()) + 3}"),
    "an exception": (
        TEXT + "\n1 / 0\n",
        f"ZeroDivisionError in line {len(TEXT.splitlines()) + 2}: division by zero",
    ),
    "a missing module": (
        "import no_such_thing\n",
        "ModuleNotFoundError in line 1: No module named 'no_such_thing'",
    ),
    "a name that is taken": (TEXT.replace("cautious", "smc"), "controller 'smc' is registered twice"),
    "the same name twice": (TEXT + TEXT.partition("\n\n\n")[2], "controller 'cautious' is registered twice"),
    "an unknown kind": (TEXT.replace('"controller",', '"law",'), "no component kind 'law'"),
    "a field without declaration": (
        TEXT.replace("    needs_observer = True", "    other: float = 1.0\n\n    needs_observer = True"),
        "fields without param(...): ['other']",
    ),
    "two lines": (TEXT + '\nraise ValueError("a\\nb")\n', "ValueError in line"),
}


@pytest.mark.parametrize("what", BROKEN)
def test_a_file_that_is_wrong_is_refused_in_one_line(what: str, file: Path) -> None:
    """Nothing of it stays registered or imported; mended, it can be loaded."""
    text, message = BROKEN[what]
    before = {kind: components(kind) for kind in KINDS}
    plugins, modules = registry.plugins(), set(sys.modules)
    file.write_text(text)
    with pytest.raises(FtcmError) as error:
        load_plugin(str(file))
    assert message in str(error.value)
    assert str(error.value).startswith(f"plug-in {str(file)!r}")
    assert len(str(error.value).splitlines()) == 1
    assert {kind: components(kind) for kind in KINDS} == before
    assert registry.plugins() == plugins
    assert not {name for name in set(sys.modules) - modules if name.startswith("ftcm_plugin")}
    file.write_text(TEXT)
    load_plugin(str(file))
    assert "cautious" in components("controller")


@pytest.mark.parametrize(
    ("source", "message"),
    [
        ("no_such.py", "plug-in 'no_such.py': no such file; expected a Python file with components"),
        ("/", "cannot be loaded: "),
        ("no_such_module", "plug-in 'no_such_module' cannot be loaded: ModuleNotFoundError"),
        ("", "cannot be loaded: "),
        ("folder.py", "no such file"),
    ],
)
def test_what_is_no_file_is_refused_in_one_line(
    source: str, message: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Missing, a folder, no module, nothing at all."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "folder.py").mkdir()
    with pytest.raises(FtcmError) as error:
        load_plugin(source)
    assert message in str(error.value)
    assert len(str(error.value).splitlines()) == 1


# On the command line.


def test_simulate_and_describe(file: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """With ``--plugin`` before everything else is looked up; without it the name is not known."""
    assert main(["simulate", "paper", "--controller", "cautious"]) == 2
    assert "no controller 'cautious'" in capsys.readouterr().err
    plugin = ["--plugin", str(file)]
    assert main(["simulate", "paper", *plugin, "--controller", "cautious", "--set", *SHORT, "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert (found["controller"], found["status"]) == ("cautious", "completed")
    assert main(["describe", "cautious", *plugin]) == 0
    assert "share of the estimate" in capsys.readouterr().out
    assert main(["list", "controller", *plugin, "--json"]) == 0
    assert "cautious" in json.loads(capsys.readouterr().out)["controller"]


def test_a_mistake_in_it_is_one_line_and_status_2(file: Path) -> None:
    """As any other mistake."""
    file.write_text("x = (\n")
    done = child("simulate", "paper", "--plugin", str(file))
    assert (done.returncode, done.stdout) == (2, "")
    (line,) = done.stderr.splitlines()
    assert line.startswith(f"ftcm: error: plug-in '{file}' cannot be loaded: SyntaxError in line 1")


def test_workers_of_compare_and_campaign_know_it(file: Path, tmp_path: Path) -> None:
    """Processes of their own, which load the file themselves."""
    plugin = ["--plugin", str(file)]
    done = child("compare", "paper", *plugin, "--controllers", "cautious", "ctc", "--set", *SHORT, "--json")
    assert done.returncode == 0, done.stderr
    results = json.loads(done.stdout)["results"]
    assert [(r["controller"], r["status"]) for r in results] == [
        ("cautious", "completed"),
        ("ctc", "completed"),
    ]
    more = ["--runs", "8", "--jobs", "2", "--engine", "plain", "--vary", "controller.share=uniform(0, 1)"]
    done = child("campaign", "paper", *plugin, "--controllers", "cautious", *more, "--set", *SHORT, "--json")
    assert done.returncode == 0, done.stderr
    found = json.loads(done.stdout)["results"]["cautious"]
    assert (found["runs"], found["completed"], found["engines"]) == (8, 1.0, {"plain": 8})


@pytest.mark.slow
def test_a_second_process_finds_it_compiled(file: Path, tmp_path: Path) -> None:
    """In the cache; once the file says something else, so does the run."""
    pytest.importorskip("numba")
    cache, plugin = tmp_path / "cache", ["--plugin", str(file)]
    command = ["simulate", "paper", *plugin, "--controller", "cautious", "--engine", "compiled", "--json"]

    def error() -> Any:
        done = child(*command, "--set", *SHORT, cache=cache)
        assert done.returncode == 0, done.stderr
        return json.loads(done.stdout)["metrics"]["whole"]["mean_abs_error"]

    first = error()
    files = {p.name: p.stat().st_mtime_ns for p in cache.rglob("*") if p.is_file()}
    assert files
    assert error() == first
    assert {p.name: p.stat().st_mtime_ns for p in cache.rglob("*") if p.is_file()} == files
    file.write_text(TEXT.replace("return share * x", "return -share * x"))
    assert error() != first
    assert len([p for p in cache.rglob("tick_*.py")]) == 2
    campaign_run = [
        "campaign",
        "paper",
        *plugin,
        "--controllers",
        "cautious",
        "--engine",
        "compiled",
        "--runs",
        "4",
    ]
    done = child(*campaign_run, "--jobs", "2", "--set", *SHORT, "--json", cache=cache)
    assert done.returncode == 0, done.stderr
    assert json.loads(done.stdout)["results"]["cautious"]["engines"] == {"compiled": 4}


def test_the_robots_of_the_tests_are_such_a_file(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    """Arms of other joint counts from the command line alone."""
    path = tmp_path / "arm.yaml"
    for robot, joints in (("pendulum", 1), ("planar_arm", 2), ("serial_arm", 6)):
        path.write_text(f"robot: {robot}\nreference: sine\ncontroller: ftcm\nobserver: do\nduration: 0.02\n")
        assert main(["simulate", str(path), "--plugin", str(ROBOTS_FILE), "--json"]) == 0
        found = json.loads(capsys.readouterr().out)
        assert (found["status"], len(found["first_torque"])) == ("completed", joints)


# Named by the scenario.


def scenario_file(folder: Path, plugins: str, controller: str = "cautious") -> Path:
    """A scenario that names its plug-ins."""
    path = folder / "mine.yaml"
    path.write_text(
        f"plugins: {plugins}\nrobot: puma560\nreference: vo_kang_cosine\ncontroller: {controller}\n"
        "observer: do\nduration: 0.05\ntransient: 0.01\n"
    )
    return path


def test_a_scenario_names_its_plug_ins(file: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Relative to the scenario's folder, wherever one is; written out with the absolute path."""
    monkeypatch.chdir("/")
    scenario = load(str(scenario_file(tmp_path, "[mine.py]")))
    assert scenario.controller.type_name == "cautious"
    assert scenario.plugins == (str(file),)
    assert scenario.to_mapping()["plugins"] == [str(file)]
    elsewhere = tmp_path / "elsewhere" / "again.yaml"
    elsewhere.parent.mkdir()
    elsewhere.write_text(scenario.to_yaml())
    assert load(str(elsewhere)) == scenario
    assert from_mapping(scenario.to_mapping()) == scenario
    assert simulate(scenario).status == "completed"


def test_other_processes_get_it_from_the_scenario(file: Path, tmp_path: Path) -> None:
    """Workers without ``--plugin``; and the scenario that a run writes is enough to repeat it."""
    path, out = str(scenario_file(tmp_path, "[mine.py]")), tmp_path / "out"
    done = child("campaign", path, "--runs", "8", "--jobs", "2", "--engine", "plain", "--json")
    assert done.returncode == 0, done.stderr
    assert json.loads(done.stdout)["results"]["cautious"]["completed"] == 1.0
    done = child("simulate", path, "--no-figures", "--output", str(out), "--json")
    assert done.returncode == 0, done.stderr
    again = child("simulate", str(out / "scenario.yaml"), "--json", cwd=tmp_path)
    assert again.returncode == 0, again.stderr
    assert json.loads(again.stdout)["metrics"] == json.loads(done.stdout)["metrics"]


@pytest.mark.parametrize(
    "options",
    [
        ["simulate", "--controller", "cautious"],
        ["compare", "--controllers", "cautious", "smc"],
        ["compare"],
        ["campaign", "--controllers", "cautious", "--runs", "2", "--jobs", "1", "--engine", "plain"],
    ],
    ids=["simulate", "compare some", "compare all", "campaign"],
)
def test_a_law_of_the_scenario_s_plug_in_may_be_asked_for(
    options: list[str], file: Path, tmp_path: Path
) -> None:
    """By name, and it is among all laws where none is named."""
    command, *more = options
    done = child(command, str(scenario_file(tmp_path, "[mine.py]", "smc")), *more, "--json")
    assert done.returncode == 0, done.stderr
    assert '"cautious"' in done.stdout


def test_plug_ins_of_the_command_line_stand_in_the_record(file: Path, tmp_path: Path) -> None:
    """So that a run is repeated from its scenario alone."""
    out = tmp_path / "out"
    done = child("simulate", "paper", "--plugin", str(file), "--controller", "cautious", "--set", *SHORT,
                 "--no-figures", "--output", str(out))  # fmt: skip
    assert done.returncode == 0, done.stderr
    again = child("simulate", str(out / "scenario.yaml"), "--json")
    assert again.returncode == 0, again.stderr
    assert json.loads(again.stdout)["controller"] == "cautious"


def test_a_campaign_in_python(file: Path, tmp_path: Path) -> None:
    """Its scenario file alone is enough."""
    path = scenario_file(tmp_path, "[mine.py]")
    summary = campaign.run_campaign(Campaign(str(path), runs=2), engine="plain", jobs=1)
    assert summary["results"]["cautious"]["completed"] == 1.0


@pytest.mark.parametrize(
    ("plugins", "message"),
    [
        ("mine.py", "mine.yaml: plugins: 'mine.py' is not a list of Python files or modules"),
        ("[1]", "mine.yaml: plugins: [1] is not a list of Python files or modules"),
        ("[other.py]", "no such file; expected a Python file with components"),
        ("[no_such_module]", "cannot be loaded: ModuleNotFoundError"),
    ],
)
def test_a_list_that_is_wrong_is_refused_in_one_line(plugins: str, message: str, tmp_path: Path) -> None:
    """By the scenario's name, or the plug-in's."""
    with pytest.raises(FtcmError) as error:
        load(str(scenario_file(tmp_path, plugins, "ctc")))
    assert message in str(error.value)
    assert len(str(error.value).splitlines()) == 1


def test_plain_data_run_no_code(file: Path) -> None:
    """A mapping that names a file, as a bag brings it, does not load it: its components are not known."""
    data = {**load("paper").to_mapping(), "plugins": [str(file)], "controller": {"type": "cautious"}}
    with pytest.raises(ScenarioError, match=r"controller\.type: no controller 'cautious'"):
        from_mapping(data)
    assert registry.plugins() == ()
    load_plugin(str(file))
    assert from_mapping(data).controller.type_name == "cautious"


def test_a_trace_with_it_reads_back(file: Path, tmp_path: Path) -> None:
    """Once the plug-in is loaded."""
    load_plugin(str(file))
    trace = simulate(load("paper", SHORT, "cautious"))
    save_trace(tmp_path / "trace.npz", trace)
    assert load_trace(tmp_path / "trace.npz").scenario == trace.scenario
