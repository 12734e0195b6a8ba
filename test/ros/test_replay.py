# SPDX-License-Identifier: Apache-2.0
"""The command replay on bags of real runs: they prove themselves, or say what is not as it was."""

from __future__ import annotations

import json
import os
import re
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
import yaml

pytest.importorskip("rclpy", reason="ROS 2 (rclpy) is not installed")

from rosbags.rosbag2 import Reader
from rosbags.typesys import Stores, get_typestore

from everything import EVERYTHING
from ftcm_core.replay import verdict
from ftcm_core.scenario import from_mapping
from ftcm_ros.analysis.replay import Proof, prove
from ftcm_ros.bags import manifest
from ftcm_ros.bags.reader import read_bag
from ftcm_ros.bags.writer import new_bag
from ftcm_ros.transport.codec import JointStateCodec
from node_processes import node_pids
from programs import program

pytestmark = pytest.mark.ros

BAG = Path("runs/test/bags/ftcm")
FAULTS = [
    {"type": "vo_kang_fault", "start": 0.1},
    {"type": "loss_of_effectiveness", "start": 0.15},
    {"type": "payload_pickup", "start": 0.2},
    {"type": "dropped_messages", "start": 0.05, "topic": "joint_states"},
    {"type": "dropped_messages", "start": 0.05, "topic": "disturbance"},
]  # fmt: skip


def replay(*arguments: object, cwd: Path | None = None) -> subprocess.CompletedProcess[str]:
    command = [*program("replay"), *map(str, arguments)]
    return subprocess.run(command, capture_output=True, text=True, check=False, cwd=cwd)


def proof_of(bag: Path) -> Proof:
    return prove(read_bag(bag))


def custom_data(bag: Path) -> dict[str, str]:
    text = (bag / "metadata.yaml").read_text(encoding="utf-8")
    return dict(yaml.safe_load(text)["rosbag2_bagfile_information"]["custom_data"])


def rewritten(
    bag: Path, target: Path, message: Callable[[str, bytes], bytes] = lambda _, data: data, **data: str
) -> Path:
    """A copy of a bag made by the writer, all checksums right: other messages, or other data about it."""
    writer = new_bag(target, "mcap")
    with Reader(bag) as reader:
        connections = {
            c.id: writer.add_connection(
                c.topic, c.msgtype, msgdef=c.msgdef.data, rihs01=c.digest,
                offered_qos_profiles=c.ext.offered_qos_profiles,
            )
            for c in reader.connections
        }  # fmt: skip
        for connection, when, raw in reader.messages():
            writer.write(connections[connection.id], when, message(connection.topic, raw))
    for key, value in {**custom_data(bag), **data}.items():
        writer.set_custom_data(key, value)
    writer.close()
    manifest.write(target)
    return target


@pytest.mark.parametrize("storage", ["mcap", pytest.param("sqlite3", marks=pytest.mark.nightly)])
def test_a_lockstep_run_proves_itself(experiment: Callable[..., Any], tmp_path: Path, storage: str) -> None:
    injection = {"disturbances": ["vo_kang_friction"], "faults": FAULTS}
    scenario = from_mapping({**EVERYTHING, "injection": injection, "duration": 0.3})
    (tmp_path / "all.yaml").write_text(scenario.to_yaml(), encoding="utf-8")
    run = experiment("all.yaml", "--replay", "--storage", storage)
    assert run.returncode == 0, run.stderr
    assert "- ftcm: equal, float for float: 301 ticks" in run.stdout
    summary = json.loads((tmp_path / "runs/test/summary.json").read_text())["replay"]["ftcm"]
    assert (summary["equal"], summary["as_in_process"], summary["versions"]) == (True, True, {})
    assert {name: stage["ticks"] for name, stage in summary["stages"].items()} == dict.fromkeys(
        ("plant", "observer", "controller", "injector", "detector"), 301
    )
    bag = tmp_path / BAG
    shutil.rmtree(tmp_path / "runs/test/logs")  # the bag alone is enough
    run = replay(bag)
    assert (run.returncode, run.stderr) == (0, "")
    assert run.stdout.startswith(f"{bag}: equal, float for float: 301 ticks\n")
    assert json.loads(replay(bag, "--json").stdout)[str(bag)] == summary

    # One byte.
    shutil.copytree(bag, tmp_path / "byte")
    (file,) = [f for f in (tmp_path / "byte").iterdir() if f.suffix in (".mcap", ".db3")]
    data = bytearray(file.read_bytes())
    data[data.index(b"joint3", len(data) // 2)] ^= 0x41  # in a message
    file.write_bytes(data)
    run = replay("byte", cwd=tmp_path)
    assert run.returncode == 1
    assert run.stderr.startswith("byte: damaged: the file is not what was recorded: ticks ")
    verdict_, remark = run.stdout.splitlines()[:2]
    left = re.fullmatch(r"byte: equal, float for float: (\d+) ticks", verdict_)
    assert left, verdict_
    assert 50 < int(left[1]) <= 301, "ticks that are lost are bridged, but where none follow"
    assert remark == "the bag is damaged: this is about what is left of it"
    assert replay("byte", "--accept-damage", cwd=tmp_path).returncode == 0
    if storage == "sqlite3":
        return

    # A version.
    versions = {**json.loads(custom_data(bag)["provenance"]), "numpy": "1.2.3"}
    proof = proof_of(rewritten(bag, tmp_path / "version", provenance=json.dumps(versions)))
    assert proof.found.whole
    here = json.loads(custom_data(bag)["provenance"])["numpy"]
    assert proof.lines[1:] == [f"equal although recorded with numpy 1.2.3 (here {here})"]

    # The value of one tick.
    codec = JointStateCodec(scenario.robot.joint_names)

    def changed(topic: str, raw: bytes) -> bytes:
        sample = codec.decode(raw) if topic == "/joint_torques" else None
        if sample is None or sample.time_ns != 117_000_000:
            return raw
        u = sample.effort
        return codec.torque.encode(sample.time_ns, (u[0], u[1] + 0.5, u[2]))

    path = rewritten(bag, tmp_path / "value", changed)
    assert read_bag(path).warnings() == read_bag(path).remarks() == []
    run = replay(path)
    assert run.returncode == 1
    first, likely = run.stdout.splitlines()[:2]
    assert f"{path}: differs first at tick 117, t = 0.117 s: command of joint2: recorded " in first
    assert first.endswith(": 0.5 apart")
    assert likely.startswith("likely cause: the record was changed after the run: all else follows")

    # Another scenario than that of the run.
    def heavier(topic: str, raw: bytes) -> bytes:
        if topic != "/scenario":
            return raw
        return raw.replace(b"payload_mass: 0.5", b"payload_mass: 0.6")

    proof = proof_of(rewritten(bag, tmp_path / "heavier", heavier))
    assert [stage.name for stage in proof.found.stages if stage.differing] == ["plant"]
    assert proof.lines[1].startswith("likely cause: other code than that of the run")

    # A recorder that was killed: no metadata, no versions.
    (bag / "metadata.yaml").unlink()
    (bag / "SHA256SUMS").unlink()
    run = replay(bag)
    assert run.returncode == 0
    assert "bag was not closed; recovered: complete to t = 0.3 s" in run.stderr
    assert run.stdout.splitlines()[:2] == [
        f"{bag}: equal, float for float: 301 ticks",
        "the bag does not say with which versions it was recorded",
    ]


def test_components_that_were_swapped_are_swapped_again(live: Callable[..., Any], tmp_path: Path) -> None:
    run = live("paper", "--controllers", "ftcm", "--set", "duration=20")
    run.first_tick(("controller", "ftcm"), ("observer", "do"))
    run.change("controller", controller="smc", smc__c=30.0)
    run.change("observer", do__k1=10000.0)
    run.interrupt()
    proof = proof_of(tmp_path / BAG)
    assert [change.kind for change in proof.found.record.changes] == ["controller", "controller", "observer"]
    assert proof.found.whole
    assert proof.found.record.ticks > proof.found.record.changes[-1].tick


HIDDEN = [
    "torque_delay=2",
    "sensor={type: encoder, noise: 1e-5}",
    "detector=residual_threshold",
    "injection.faults=[{type: loss_of_effectiveness, start: 0.5}, {type: payload_pickup, start: 1.0}]",
]


@pytest.mark.parametrize(
    ("overrides", "stopped", "length", "options"),
    [
        pytest.param(
            ["torque_delay=0"],
            "controller",
            0.3,
            [],
            id="controller, long enough for a safe stop",
            marks=pytest.mark.nightly,
        ),
        pytest.param(HIDDEN, "controller", 0.08, [], id="controller, hidden", marks=pytest.mark.slow),
        pytest.param(HIDDEN, "injector", 0.2, [], id="injector, hidden", marks=pytest.mark.nightly),
        pytest.param(
            HIDDEN, "controller", 0.08, ["--stages", "compiled"], id="compiled", marks=pytest.mark.nightly
        ),
    ],
)
def test_a_real_time_run_with_misses_is_proved(
    live: Callable[..., Any], tmp_path: Path, overrides: list[str], stopped: str, length: float,
    options: list[str],
) -> None:  # fmt: skip
    if options:
        pytest.importorskip("numba", reason="numba is not installed")
    arguments = [a for o in (*overrides, "duration=2.5") for a in ("--set", o)]
    run = live("paper", "--controllers", "ftcm", "--mode", "real_time", "--no-composed", *arguments, *options)
    kinds = [("controller", "ftcm"), ("observer", "do")]
    run.first_tick(*kinds, *[("detector", "residual_threshold")] * (overrides is HIDDEN))
    pid = node_pids(run.process.pid)[stopped]
    os.kill(pid, signal.SIGSTOP)
    time.sleep(length)
    os.kill(pid, signal.SIGCONT)
    run.end()
    bag = read_bag(tmp_path / BAG)
    plant = {name: int(bag.nodes["plant"][name]) for name in (
        "late_torque", "late_disturbance", "safe_stop_ticks"
    )}  # fmt: skip
    found = prove(bag).found
    assert found.equal, verdict(found)
    assert found.undecided == 0
    assert {stage.ticks for stage in found.stages} == {2501}
    held = found.held
    assert held.ticks > 800 * length
    # The plant has counted the same; over the last tick it does not move.
    missed = plant["late_torque"] + plant["late_disturbance"]
    delay = found.record.scenario.torque_delay
    assert missed - 1 <= held.ticks <= missed + delay * plant["late_torque"]
    assert held.safe_stop == plant["safe_stop_ticks"]
    if (
        stopped == "controller" and length > 0.2
    ):  # else only where the machine keeps a node from the processor
        assert held.safe_stop > 0
    if not delay:
        assert missed - 1 <= held.ticks <= missed
        late = plant["late_torque"] - plant["safe_stop_ticks"]
        assert late - 1 <= held.command <= late


def one_line(run: subprocess.CompletedProcess[str]) -> str:
    assert run.returncode == 2, run
    assert run.stdout == ""
    (line,) = run.stderr.splitlines()
    return line


def test_mistakes_are_one_line_each(tmp_path: Path) -> None:
    assert one_line(replay("nowhere", cwd=tmp_path)) == (
        "replay: error: no bag 'nowhere'; expected the folder of a rosbag2 bag"
    )
    assert "plug-in 'my.py': no such file" in one_line(replay("nowhere", "--plugin", "my.py", cwd=tmp_path))
    codec = JointStateCodec(("a",))
    writer = new_bag(tmp_path / "foreign", "mcap")
    connection = writer.add_connection(
        "/joint_states", "sensor_msgs/msg/JointState", typestore=get_typestore(Stores.ROS2_JAZZY)
    )
    writer.write(connection, 0, codec.state.encode(0, (0.0,), (0.0,), (0.0,)))
    writer.close()
    run = replay("foreign", cwd=tmp_path)
    assert run.returncode == 2
    assert run.stderr.splitlines()[-1] == (
        "replay: error: bag 'foreign' does not carry its scenario: it cannot be replayed"
    )


def ftcm(folder: Path, *arguments: str) -> subprocess.CompletedProcess[str]:
    environment = {
        **os.environ,
        "PYTHONPATH": os.pathsep.join([str(folder), os.environ.get("PYTHONPATH", "")]),
    }
    command = [sys.executable, "-m", "ftcm_core.cli", *arguments]
    return subprocess.run(command, capture_output=True, text=True, check=False, cwd=folder, env=environment)


def test_ftcm_replay_finds_the_command_of_this_package(tmp_path: Path) -> None:
    about = tmp_path / "found-0.dist-info"
    about.mkdir()
    (about / "METADATA").write_text("Metadata-Version: 2.1\nName: found\nVersion: 0\n")
    points = about / "entry_points.txt"
    points.write_text("[ftcm.commands]\nreplay = ftcm_ros.analysis.replay:replay_bags\n")
    assert one_line(ftcm(tmp_path, "replay", "nowhere")) == (
        "ftcm: error: no bag 'nowhere'; expected the folder of a rosbag2 bag"
    )
    points.write_text("[ftcm.commands]\nreplay = no_such_module:replay_bags\n")
    assert "ftcm: error: replay: the package ftcm_ros cannot be imported: No module named" in one_line(
        ftcm(tmp_path, "replay", "nowhere")
    )
