# SPDX-License-Identifier: Apache-2.0
"""Bags: what is written is read back float for float; foreign and broken bags are handled."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

pytest.importorskip("rosbags")
from rosbags.highlevel import AnyReader
from rosbags.rosbag2 import Writer
from rosbags.typesys import Stores, get_typestore

from ftcm_core.errors import FtcmError
from ftcm_core.metrics import result
from ftcm_core.scenario import Scenario, load
from ftcm_core.simulation import simulate
from ftcm_core.trace import COLUMNS, Trace
from ftcm_ros.bag import read_bag
from ftcm_ros.codec import JointStateCodec
from ftcm_ros.recording import STORAGE, Recording
from ftcm_ros.topics import DISTURBANCE, ESTIMATE, JOINT_STATES, REFERENCE, TORQUES

TYPESTORE = get_typestore(Stores.ROS2_JAZZY)


@pytest.fixture(scope="module")
def trace() -> Trace:
    """A short run of the paper's experiment."""
    return simulate(load("paper", ["duration=0.3", "injection.faults.0.start=0.2"]))


def messages(trace: Trace, k: int) -> list[tuple[Any, bytes]]:
    """The five data messages of a tick."""
    codec = JointStateCodec(trace.joint_names)
    t = int(trace.time_ns[k])

    def row(column: str) -> tuple[float, ...]:
        return tuple(getattr(trace, column)[k].tolist())

    return [
        (JOINT_STATES, codec.state.encode(t, row("position"), row("velocity"), row("effort"))),
        (ESTIMATE, codec.torque.encode(t, row("disturbance_estimate"))),
        (TORQUES, codec.torque.encode(t, row("command"))),
        (DISTURBANCE, codec.torque.encode(t, row("disturbance"))),
        (REFERENCE, codec.motion.encode(t, row("reference_position"), row("reference_velocity"))),
    ]


def write(
    path: Path, trace: Trace, storage: str = "mcap", leave_out: set[tuple[str, int]] = frozenset()
) -> Recording:
    scenario = trace.scenario
    assert isinstance(scenario, Scenario)
    recording = Recording(path, storage, scenario)
    for k in range(trace.ticks):
        for topic, data in messages(trace, k):
            if (topic.name, k) not in leave_out:
                recording.write(topic, 10**18 + k * 10**6, data)
        if k == 100:
            recording.flush()
    recording.close()
    return recording


@pytest.mark.parametrize("storage", STORAGE)
def test_a_bag_reads_back_float_for_float(trace: Trace, tmp_path: Path, storage: str) -> None:
    write(tmp_path / "bag", trace, storage)
    bag = read_bag(tmp_path / "bag")
    assert bag.trace.scenario == trace.scenario
    assert bag.trace.status == "completed"
    assert bag.missing == {}
    for column in COLUMNS:
        assert np.array_equal(getattr(bag.trace, column), getattr(trace, column)), column
    assert result(bag.trace) == result(trace)


def test_a_bag_names_the_ticks_it_lacks(trace: Trace, tmp_path: Path) -> None:
    recording = write(
        tmp_path / "bag", trace, leave_out={(TORQUES.name, 5), (TORQUES.name, 6), (ESTIMATE.name, 300)}
    )
    assert recording.summary()[TORQUES.name]["missing"] == 2
    bag = read_bag(tmp_path / "bag")
    assert bag.missing == {TORQUES.name: 2, ESTIMATE.name: 1}
    assert np.isnan(bag.trace.command[5:7]).all()
    assert not np.isnan(np.delete(bag.trace.command, [5, 6], axis=0)).any()


def test_metadata_tells_what_the_bag_is(trace: Trace, tmp_path: Path) -> None:
    write(tmp_path / "bag", trace)
    metadata = read_bag(tmp_path / "bag").metadata
    assert {"scenario", "seed", "provenance", "topics"} <= set(metadata)
    with AnyReader([tmp_path / "bag"]) as reader:  # type definitions come from the bag itself
        connection = next(c for c in reader.connections if c.topic == "/joint_states")
        _, _, data = next(iter(reader.messages([connection])))
        assert list(reader.deserialize(data, connection.msgtype).name) == list(trace.joint_names)
        assert connection.ext.offered_qos_profiles[0].depth == 4000


def test_an_existing_bag_is_never_written_over(trace: Trace, tmp_path: Path) -> None:
    write(tmp_path / "bag", trace)
    before = {p.name: p.read_bytes() for p in (tmp_path / "bag").iterdir()}
    with pytest.raises(FtcmError, match="exists already"):
        Recording(tmp_path / "bag", "mcap", trace.scenario)  # type: ignore[arg-type]
    assert {p.name: p.read_bytes() for p in (tmp_path / "bag").iterdir()} == before


def test_of_several_runs_in_a_bag_the_last_is_analysed(trace: Trace, tmp_path: Path) -> None:
    assert trace.scenario is not None
    other = simulate(trace.scenario.with_controller("smc"))
    recording = Recording(tmp_path / "bag", "mcap", trace.scenario)
    for run, ticks in ((other, 120), (trace, trace.ticks)):
        for k in range(ticks):
            for topic, data in messages(run, k):
                recording.write(topic, 10**18 + (run is trace) * 10**9 + k * 10**6, data)
    recording.close()
    assert all(c["missing"] == 0 and c["repeated"] == 0 for c in recording.summary().values())
    bag = read_bag(tmp_path / "bag")
    assert bag.runs == 2
    assert bag.missing == {}
    assert all(np.array_equal(getattr(bag.trace, c), getattr(trace, c)) for c in COLUMNS)


def foreign_bag(path: Path, trace: Trace, topics: set[str], prefix: str = "") -> None:
    """A bag as `ros2 bag record` makes it: no scenario, another joint order, only some topics."""
    joint_state = TYPESTORE.types["sensor_msgs/msg/JointState"]
    header, time = TYPESTORE.types["std_msgs/msg/Header"], TYPESTORE.types["builtin_interfaces/msg/Time"]
    order = [2, 0, 1]
    arrays = {
        "joint_states": ("position", "velocity", "effort"),
        "joint_torques": (None, None, "command"),
        "reference": ("reference_position", "reference_velocity", None),
        "disturbance": (None, None, "disturbance"),
        "disturbance_estimate": (None, None, "disturbance_estimate"),
    }
    with Writer(path, version=9) as writer:
        for name in topics:
            connection = writer.add_connection(
                f"{prefix}/{name}", "sensor_msgs/msg/JointState", typestore=TYPESTORE
            )
            for k in range(trace.ticks):
                t = int(trace.time_ns[k])
                values = [np.array([]) if c is None else getattr(trace, c)[k][order] for c in arrays[name]]
                message = joint_state(
                    header(time(t // 10**9, t % 10**9), "base"),
                    [trace.joint_names[i] for i in order],
                    *values,
                )
                writer.write(
                    connection, 10**18 + t, TYPESTORE.serialize_cdr(message, "sensor_msgs/msg/JointState")
                )


def test_a_foreign_bag_is_analysed(trace: Trace, tmp_path: Path) -> None:
    foreign_bag(tmp_path / "bag", trace, {"joint_states", "joint_torques", "reference"}, prefix="/robot1")
    bag = read_bag(tmp_path / "bag")
    by_name = {n: i for i, n in enumerate(bag.trace.joint_names)}
    order = [by_name[n] for n in trace.joint_names]
    assert np.array_equal(bag.trace.position[:, order], trace.position)
    assert np.array_equal(bag.trace.command[:, order], trace.command)
    assert np.isnan(bag.trace.disturbance).all()
    assert bag.missing == {"disturbance": trace.ticks, "disturbance_estimate": trace.ticks}
    with_scenario = read_bag(tmp_path / "bag", trace.scenario)
    assert np.array_equal(with_scenario.trace.position, trace.position)
    mine, theirs = result(with_scenario.trace)["metrics"], result(trace)["metrics"]
    assert mine["whole"]["mean_abs_error"] == theirs["whole"]["mean_abs_error"]


def analyse(*arguments: object) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, "-m", "ftcm_ros.analyse", *map(str, arguments)],
        capture_output=True,
        text=True,
        check=False,
    )


def one_line(run: subprocess.CompletedProcess[str]) -> str:
    assert run.returncode == 2, run
    assert run.stdout == ""
    lines = run.stderr.strip().splitlines()
    assert len(lines) == 1, run.stderr
    return lines[0]


def test_mistakes_are_one_line_each(trace: Trace, tmp_path: Path) -> None:
    assert "no bag" in one_line(analyse(tmp_path / "nothing"))
    (tmp_path / "empty").mkdir()
    assert "cannot be read" in one_line(analyse(tmp_path / "empty"))
    foreign_bag(tmp_path / "topics", trace, {"reference"})
    assert "no messages on /joint_states" in one_line(analyse(tmp_path / "topics"))
    write(tmp_path / "bag", trace)
    damaged = tmp_path / "bag" / "bag.mcap"
    damaged.write_bytes(damaged.read_bytes()[:-5000])
    assert "cannot be read" in one_line(analyse(tmp_path / "bag"))
    write(tmp_path / "good", trace)
    assert "exists already" in one_line(analyse(tmp_path / "good", "--output", tmp_path))
    assert "did you mean" in one_line(analyse(tmp_path / "good", "--scenario", "papr"))


def test_analyse_compares_bags_and_writes_results(trace: Trace, tmp_path: Path) -> None:
    write(tmp_path / "one", trace)
    write(tmp_path / "two", trace)
    run = analyse(tmp_path / "one", tmp_path / "two", "--output", tmp_path / "out")
    assert run.returncode == 0, run.stderr
    assert "one" in run.stdout
    assert "two" in run.stdout
    assert (tmp_path / "out" / "summary.json").is_file()
    assert len(list((tmp_path / "out" / "figures").glob("*.png"))) >= 6
