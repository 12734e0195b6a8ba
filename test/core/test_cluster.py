# SPDX-License-Identifier: Apache-2.0
"""Runs on the processes of a cluster: the results of this machine's, whatever happens to a process."""

import contextlib
import os
import signal
import subprocess
import sys
from concurrent.futures.process import BrokenProcessPool
from pathlib import Path

import pytest

from campaigns import contents, planned
from ftcm_core import campaign, cluster, extras
from ftcm_core.cli import main
from ftcm_core.cluster import Cluster
from ftcm_core.errors import FtcmError
from plugins import registry_kept

PLANNED = planned(runs=30, fault=0.05, seed=1)
ROOT = Path(__file__).resolve().parents[2]
PLUGIN = ROOT / "docs" / "template" / "my_lab" / "pd_plus.py"


@contextlib.contextmanager
def dask(folder, count):
    """Start a scheduler and processes as on a cluster; give the former's process and address."""
    pytest.importorskip("distributed", reason="distributed is not installed")
    where = folder / "scheduler.json"
    path = os.pathsep.join([str(ROOT / "src" / "ftcm_core"), os.environ.get("PYTHONPATH", "")])
    shared = ["--scheduler-file", str(where), "--no-dashboard", "--host", "127.0.0.1"]
    workers = ["--nworkers", str(count), "--nthreads", "1", "--local-directory", str(folder)]
    with contextlib.ExitStack() as stack:
        started = []
        for more in (["scheduler", "--port", "0"], ["worker", *workers]):
            process = subprocess.Popen(
                [sys.executable, "-m", "dask", *more, *shared],
                env={**os.environ, "PYTHONPATH": path}, cwd=folder,
                stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL,
            )  # fmt: skip
            started.append(process)
            stack.callback(process.wait, 20)
            stack.callback(process.terminate)
        from distributed import Client

        with Client(scheduler_file=str(where), timeout=30, set_as_default=False) as client:
            client.wait_for_workers(count, timeout=60)
            address = client.scheduler.address
        yield started[0], address


@pytest.fixture(scope="module")
def address(tmp_path_factory):
    """The address of a scheduler with two processes."""
    with dask(tmp_path_factory.mktemp("dask"), 2) as (_, address):
        yield address


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    """The same campaign in this process alone."""
    folder = tmp_path_factory.mktemp("whole")
    campaign.run_campaign(PLANNED, engine="plain", jobs=1, folder=folder)
    return folder


def processes(address):
    from distributed import Client

    with Client(address, set_as_default=False) as client:
        client.wait_for_workers(2, timeout=60)
        return set(client.run(os.getpid).values())


@pytest.mark.nightly
def test_the_results_are_those_of_this_machine_though_a_process_is_killed(address, whole, tmp_path):
    before = processes(address)
    killed = []

    def kill_one(done, total):
        if done >= 10 and not killed:
            killed.append(min(before))
            os.kill(killed[0], signal.SIGKILL)
            assert done < total / 2, "there is enough left to be done"

    with Cluster(address) as engine:
        assert engine.count == 2
        campaign.run_campaign(PLANNED, engine="plain", jobs=engine, folder=tmp_path, progress=kill_one)
    assert contents(tmp_path) == contents(whole)
    after = processes(address)
    assert not after & set(killed)
    assert after & before, "the other one went on"


@pytest.mark.nightly
def test_an_ended_campaign_goes_on_there(address, whole, tmp_path, capsys):
    text = (whole / "runs.jsonl").read_bytes()
    text = text[: len(text) // 2]
    (tmp_path / "runs.jsonl").write_bytes(text)
    (tmp_path / "campaign.json").write_bytes((whole / "campaign.json").read_bytes())
    told = []
    with Cluster(address) as engine:
        campaign.run_campaign(
            PLANNED, engine="plain", jobs=engine, folder=tmp_path, resume=True,
            progress=lambda *x: told.append(x),
        )  # fmt: skip
    assert told[0] == (text.count(b"\n"), 60)
    assert contents(tmp_path) == contents(whole)


@pytest.mark.nightly
def test_plug_ins_are_loaded_there_before_what_is_made_of_them(address, tmp_path, capsys):
    """Of a campaign the names are sent, of a suite the components themselves."""
    plugin = tmp_path / "brought.py"
    plugin.write_text(PLUGIN.read_text("utf-8").replace("my_pd_plus", "brought"), "utf-8")
    commands = (
        ["campaign", "paper", "--runs", "2", "--controllers", "brought", "--engine", "plain", "--json",
         "--set", "duration=0.05"],
        ["suite", "faults", "--controllers", "brought", "--faults", "actuator_bias", "--json",
         "--onset", "0.02", "--duration", "0.05"],
    )  # fmt: skip
    with registry_kept():
        for command in commands:
            said = []
            for more in (["--jobs", "1"], ["--cluster", address]):
                assert main([*command, "--plugin", str(plugin), *more]) == 0
                said.append(capsys.readouterr())
            assert said[0].out == said[1].out
            assert f"cluster {address}: 2 processes" in said[1].err


@pytest.mark.nightly
def test_mistakes_are_told_in_one_line(address, capsys, monkeypatch, tmp_path):
    command = ["campaign", "paper", "--runs", "1", "--engine", "plain", "--set", "duration=0.01"]

    def error(*more):
        assert main([*command, *more]) == 2
        text = capsys.readouterr().err
        return next(line for line in text.splitlines() if "error: " in line)

    assert "--jobs: is of this machine, and --cluster is given too" in error(
        "--cluster", address, "--jobs", "2"
    )
    monkeypatch.setattr(cluster, "WAIT", 0.5)
    folder = tmp_path / "results"
    said = error("--cluster", "tcp://127.0.0.1:9", "--output", str(folder))
    assert "cluster 'tcp://127.0.0.1:9' cannot be reached: " in said
    assert not folder.exists()
    assert "cannot be reached: " in error("--cluster", "nonsense://")
    monkeypatch.undo()
    monkeypatch.setattr(cluster, "_about", lambda: {"numpy": "0.9"})
    said = error("--cluster", address)
    assert " numpy is " in said
    assert ", here it is 0.9; use the same everywhere" in said
    monkeypatch.undo()
    monkeypatch.setattr(cluster, "plugins", lambda: (str(tmp_path / "gone.py"),))
    assert "gone.py': no such file" in error("--cluster", address)


def test_without_the_package_one_line_says_what_to_install(monkeypatch, capsys):
    monkeypatch.setattr(extras, "has", lambda package: package != "distributed")
    assert main(["campaign", "paper", "--runs", "1", "--cluster", "tcp://127.0.0.1:8786"]) == 2
    assert 'a cluster needs distributed; pip install "ftcm_core[cluster]"' in capsys.readouterr().err


@pytest.mark.nightly
def test_what_kills_every_process_is_given_up(address):
    with Cluster(address) as engine, pytest.raises(BrokenProcessPool):
        list(engine.each(signal.raise_signal, [signal.SIGKILL]))
    assert len(processes(address)) == 2


@pytest.mark.nightly
def test_a_scheduler_that_is_gone_ends_the_campaign_with_one_line(tmp_path):
    gone = pytest.raises(FtcmError, match=r"the scheduler is gone.*--resume")
    with dask(tmp_path, 1) as (scheduler, address), Cluster(address) as processes, gone:
        campaign.run_campaign(
            PLANNED, engine="plain", jobs=processes, progress=lambda done, _: done and scheduler.kill()
        )


@pytest.mark.nightly
def test_what_an_item_raises_is_raised_here(address):
    with Cluster(address) as engine, pytest.raises(FtcmError, match="no scenario file 'gone'"):
        list(engine.each(campaign.from_file, ["gone"]))
