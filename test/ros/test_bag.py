# SPDX-License-Identifier: Apache-2.0
"""Bags: what is written is read back float for float; foreign and broken bags are handled."""

from __future__ import annotations

import contextlib
import dataclasses
import json
import random
import resource
import shutil
import sqlite3
import subprocess
import zlib
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

pytest.importorskip("rosbags")
from hypothesis import given, settings
from hypothesis import strategies as st
from mcap import records as records_of_mcap
from mcap.reader import NonSeekingReader
from mcap.stream_reader import StreamReader
from rosbags.highlevel import AnyReader
from rosbags.rosbag2 import Writer
from rosbags.typesys import Stores, get_typestore

from ftcm_core.errors import FtcmError
from ftcm_core.recording.metrics import result
from ftcm_core.recording.trace import Trace
from ftcm_core.scenario import Scenario, load
from ftcm_core.signals import COLUMNS
from ftcm_core.simulation import simulate
from ftcm_ros.bags.reader import read_bag
from ftcm_ros.bags.writer import STORAGE, Recording
from ftcm_ros.transport.codec import JointStateCodec
from ftcm_ros.transport.topics import ESTIMATE, TORQUES, TRUE_STATE, data_topics
from programs import program
from traces import same

TYPESTORE = get_typestore(Stores.ROS2_JAZZY)


@pytest.fixture(scope="module")
def trace() -> Trace:
    """A short run of the paper's experiment."""
    return simulate(load("paper", ["duration=0.3", "injection.faults.0.start=0.2"]))


def messages(trace: Trace, k: int) -> list[tuple[Any, bytes]]:
    """The data messages of a tick."""
    assert trace.scenario is not None
    codec = JointStateCodec(trace.joint_names)
    found = []
    for topic, channel in zip(data_topics(trace.scenario), trace.scenario.channels):
        rows = [tuple(trace.columns[name][k].tolist()) for name in channel.columns if name]
        filled = tuple(map(bool, channel.columns))
        (layout,) = (x for x in codec.layouts if tuple(bool(s.stop) for s in x.slices) == filled)
        found.append((topic, layout.encode(int(trace.time_ns[k]), *rows)))
    return found


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
    assert same(bag.trace, trace)
    assert result(bag.trace) == result(trace)


@pytest.mark.parametrize("storage", STORAGE)
def test_every_column_there_is_reads_back_float_for_float(tmp_path: Path, storage: str) -> None:
    overrides = ["sensor={type: encoder, noise: 1e-4}", "detector=residual_threshold", "duration=0.2"]
    trace = simulate(load("paper", [*overrides, "injection.faults.0.start=0.1"]))
    assert list(trace.columns) == list(COLUMNS)
    write(tmp_path / "bag", trace, storage, leave_out={("detection", 7), ("true_state", 9)})
    bag = read_bag(tmp_path / "bag")
    assert bag.missing == {"detection": 1, "true_state": 1}
    lost = {"residual": 7, "alarm": 7, "verdict": 7, "position": 9, "velocity": 9, "joint_torque": 9}
    for name, column in trace.columns.items():
        expected = column.copy()
        if name in lost:
            expected[lost[name]] = np.nan
        assert np.array_equal(bag.trace.columns[name], expected, equal_nan=True), name


def test_where_another_torque_acted_than_is_recorded_the_bag_says_which(trace: Trace, tmp_path: Path) -> None:
    """The plant shows the true state after such ticks only; elsewhere it was what is recorded."""
    assert trace.joint_torque is None
    assert trace.scenario is not None
    codec = JointStateCodec(trace.joint_names)
    acted = {5: (1.0, -2.0, 3.5), 100: (0.0, 7.0, 0.25)}
    recording = Recording(tmp_path / "bag", "mcap", trace.scenario)
    for k in range(trace.ticks):
        for topic, data in messages(trace, k):
            recording.write(topic, 10**18 + k * 10**6, data)
        if k in acted:
            q, v = (tuple(a[k].tolist()) for a in (trace.position, trace.velocity))
            recording.write(TRUE_STATE, 10**18 + k * 10**6, codec.state.encode(k * 1_000_000, q, v, acted[k]))
    recording.close()
    bag = read_bag(tmp_path / "bag")
    assert bag.missing == {}
    expected = trace.effort.copy()
    expected[1:] += trace.disturbance[:-1]
    for k, torque in acted.items():
        expected[k] = torque
    assert bag.trace.joint_torque is not None
    assert np.array_equal(bag.trace.joint_torque, expected)
    assert same(dataclasses.replace(bag.trace, joint_torque=None), trace)


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


def test_a_flush_does_not_wait_for_the_disk(trace: Trace, tmp_path: Path) -> None:
    assert trace.scenario is not None
    recording = Recording(tmp_path / "bag", "sqlite3", trace.scenario)
    assert recording._writer.storage.conn.execute("PRAGMA synchronous").fetchone() == (0,)
    recording.close()


def test_an_existing_bag_is_never_written_over(trace: Trace, tmp_path: Path) -> None:
    write(tmp_path / "bag", trace)
    before = {p.name: p.read_bytes() for p in (tmp_path / "bag").iterdir()}
    with pytest.raises(FtcmError, match="exists already"):
        Recording(tmp_path / "bag", "mcap", load("paper"))
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
    assert same(bag.trace, trace)


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
        [*program("analyse"), *map(str, arguments)],
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
    damaged.write_bytes(bytes(1000))
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
    page = (tmp_path / "out" / "report.html").read_text(encoding="utf-8")
    assert f"<pre>ros2 run ftcm_ros analyse {tmp_path / 'one'} {tmp_path / 'two'} --output NEW</pre>" in page


def unclosed(folder: Path, trace: Trace, storage: str) -> list[tuple[Path, int, int]]:
    """What a recorder that is killed leaves behind, at several moments: bag, ticks flushed, messages given.

    A copy of the folder has what the process has handed to the system, and nothing else.
    """
    assert trace.scenario is not None
    recording = Recording(folder / "live", storage, trace.scenario)
    if storage == "sqlite3":  # so that a transaction reaches the file before its end
        recording._writer.storage.conn.execute("PRAGMA cache_size = 5")
    found, flushed, given_ = [], 0, 0
    for k in range(trace.ticks):
        for i, (topic, data) in enumerate(messages(trace, k)):
            recording.write(topic, 10**18 + k * 10**6, data)
            given_ += 1
            if (k, i) in {(0, 2), (49, 4), (50, 1), (99, 4), (130, 3), (250, 0)}:
                found.append((folder / f"killed-{k}-{i}", flushed, given_))
                shutil.copytree(folder / "live", found[-1][0])
        if k % 50 == 49:
            recording.flush()
            flushed = k + 1
    recording.close()
    (folder / "live" / "metadata.yaml").unlink()
    found.append((folder / "live", trace.ticks, given_))
    return found


def contents(folder: Path) -> dict[str, bytes]:
    return {p.name: p.read_bytes() for p in folder.iterdir()}


def is_prefix(part: Trace, whole: Trace) -> bool:
    return same(part, whole, slice(part.ticks))


@pytest.mark.parametrize("storage", STORAGE)
def test_of_a_bag_not_closed_all_that_was_flushed_is_read(trace: Trace, tmp_path: Path, storage: str) -> None:
    journals = 0
    for path, flushed, given_ in unclosed(tmp_path, trace, storage):
        before = contents(path)
        journals += any(name.endswith("-journal") for name in before)
        if flushed == 0:
            with pytest.raises(FtcmError, match="nothing could be recovered"):
                read_bag(path)
        else:
            bag = read_bag(path)
            assert flushed <= bag.trace.ticks <= -(-given_ // 5)
            assert is_prefix(bag.trace, trace)
            assert bag.missing == {}
            assert f"complete to t = {(bag.trace.ticks - 1) / 1000:g} s of 0.3 s" in bag.recovered
            assert bag.trace.scenario == trace.scenario
            assert result(bag.trace)["metrics"]["whole"]["torque_rms"][0] is not None
        assert contents(path) == before
    assert bool(journals) == (storage == "sqlite3")


class Torn:
    """The file of a whole bag, to be cut, and its size after each flush with the ticks in it."""

    def __init__(self, file: Path, ticks: dict[int, int], trace: Trace) -> None:
        self.name, self.data, self.ticks, self.trace = file.name, file.read_bytes(), ticks, trace
        self.folder = file.parent.with_name("torn")

    def read(self, data: bytes) -> Trace | str:
        """Read a bag whose file is this instead; or why it cannot be read."""
        shutil.rmtree(self.folder, ignore_errors=True)
        self.folder.mkdir()
        (self.folder / self.name).write_bytes(data)
        try:
            return read_bag(self.folder).trace
        except FtcmError as error:
            return str(error)


@pytest.fixture(scope="module", params=list(STORAGE))
def torn(trace: Trace, tmp_path_factory: pytest.TempPathFactory, request: pytest.FixtureRequest) -> Torn:
    folder = tmp_path_factory.mktemp("torn")
    assert trace.scenario is not None
    recording = Recording(folder / "bag", request.param, trace.scenario)
    (file,) = (folder / "bag").iterdir()
    ticks = {file.stat().st_size: 0}
    for k in range(trace.ticks):
        for topic, data in messages(trace, k):
            recording.write(topic, 10**18 + k * 10**6, data)
        if k % 30 == 29 or k == trace.ticks - 1:
            recording.flush()
            ticks[file.stat().st_size] = k + 1
    recording.close()
    return Torn(file, ticks, trace)


def is_one_line(found: Trace | str) -> bool:
    return isinstance(found, str) and len(found.splitlines()) == 1 and found.startswith("bag ")


@settings(max_examples=40, deadline=None)
@given(share=st.floats(0.0, 1.0))
def test_a_file_cut_anywhere_gives_what_was_flushed_before(torn: Torn, share: float) -> None:
    data = torn.data[: round(share * len(torn.data))]
    found = torn.read(data)
    ticks = 0
    if isinstance(found, Trace):
        ticks = found.ticks
        assert is_prefix(found, torn.trace)
    else:
        assert is_one_line(found)
    if torn.name.endswith("mcap"):  # a page of sqlite3 that is missing makes the whole file useless
        assert ticks >= max((n for size, n in torn.ticks.items() if size <= len(data)), default=0)
        assert ticks in torn.ticks.values()


@settings(max_examples=20, deadline=None)
@given(start=st.floats(0.0, 1.0), length=st.sampled_from([1, 9, 4096, 10**6]))
def test_a_file_with_a_hole_is_read_or_refused_in_one_line(torn: Torn, start: float, length: int) -> None:
    begin = round(start * len(torn.data))
    hole = bytes(min(length, len(torn.data) - begin))
    found = torn.read(torn.data[:begin] + hole + torn.data[begin + len(hole) :])
    assert isinstance(found, Trace) or is_one_line(found)


@pytest.mark.parametrize("storage", STORAGE)
def test_analyse_says_what_it_recovered_and_repairs(trace: Trace, tmp_path: Path, storage: str) -> None:
    path, _, _ = unclosed(tmp_path, trace, storage)[4]
    run = analyse(path, "--repair", tmp_path / "repaired")
    assert run.returncode == 0, run.stderr
    warning, repaired = run.stderr.strip().splitlines()[::-1][:2]
    assert "bag was not closed; recovered: complete to t = 0.0" in warning
    assert "joint_states 100" in warning
    assert "messages in" in repaired
    with AnyReader([tmp_path / "repaired"]) as reader:
        assert {c.ext.offered_qos_profiles[0].depth for c in reader.connections if c.topic[1] == "j"} == {
            4000
        }
    again = read_bag(tmp_path / "repaired")
    assert (tmp_path / "repaired" / "metadata.yaml").exists()
    assert again.recovered in warning
    assert same(again.trace, read_bag(path).trace)
    assert again.trace.scenario == trace.scenario


def test_a_repair_that_makes_no_sense_is_one_line(trace: Trace, tmp_path: Path) -> None:
    path, _, _ = unclosed(tmp_path, trace, "mcap")[4]
    write(tmp_path / "good", trace)
    assert "exists already" in one_line(analyse(path, "--repair", tmp_path / "good"))
    assert "nothing to repair" in one_line(analyse(tmp_path / "good", "--repair", tmp_path / "x"))
    assert "one bag; 2" in one_line(analyse(path, path, "--repair", tmp_path / "x"))


@contextlib.contextmanager
def largest_file(size: int) -> Iterator[None]:
    """No file of this process can grow beyond a size: the same error path as a full disk, without one."""
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (size, hard))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))


@pytest.mark.parametrize("storage", STORAGE)
@pytest.mark.parametrize("at", ["flush", "write", "close"])
def test_a_bag_that_cannot_grow_keeps_what_it_has_and_says_so(
    trace: Trace, tmp_path: Path, storage: str, at: str
) -> None:
    assert trace.scenario is not None
    recording = Recording(tmp_path / "bag", storage, trace.scenario)
    if storage == "sqlite3":
        recording._writer.storage.conn.execute("PRAGMA cache_size = 5")

    def fill(begin: int, end: int) -> None:
        for k in range(begin, end):
            for topic, data in messages(trace, k):
                recording.write(topic, 10**18 + k * 10**6, data)

    def go_on() -> None:
        if at == "write":
            for _ in range(10):  # without a flush: mcap goes to the file at 1 MiB
                fill(100, 300)
        fill(100, 200)
        recording.flush() if at == "flush" else recording.close()

    fill(0, 100)
    recording.flush()
    (file,) = (tmp_path / "bag").iterdir()
    with largest_file(file.stat().st_size + 20_000), pytest.raises(FtcmError) as caught:
        go_on()
    text = str(caught.value)
    assert str(tmp_path / "bag") in text
    assert "cannot be written: " in text
    assert "every tick up to t = 0.099 s is kept in it" in text
    bag = read_bag(tmp_path / "bag")
    assert bag.trace.ticks == 100
    assert is_prefix(bag.trace, trace)


@pytest.mark.parametrize("storage", STORAGE)
def test_a_bag_that_cannot_be_begun_leaves_nothing(tmp_path: Path, storage: str) -> None:
    with largest_file(3000), pytest.raises(FtcmError, match="cannot be made"):
        Recording(tmp_path / "bag", storage, load("paper"))
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("name", "storage", "text"),
    [
        ("file", "mcap", "exists already"),
        ("link", "mcap", "exists already"),
        ("file/bag", "mcap", "cannot be made: Not a directory"),
        ("x" * 300, "mcap", "cannot be made: File name too long"),
        ("run#1", "sqlite3", "sqlite3 storage takes no"),
        ("/proc/bag", "sqlite3", "cannot be made: No such file"),
    ],
)
def test_a_name_that_cannot_be_a_bag_is_one_line(tmp_path: Path, name: str, storage: str, text: str) -> None:
    (tmp_path / "file").write_text("mine")
    (tmp_path / "link").symlink_to(tmp_path / "nowhere")
    with pytest.raises(FtcmError, match=text):
        Recording(tmp_path / name, storage, load("paper"))
    assert sorted(p.name for p in tmp_path.iterdir()) == ["file", "link"]
    assert (tmp_path / "file").read_text() == "mine"


def test_results_that_cannot_be_written_are_one_line(trace: Trace, tmp_path: Path) -> None:
    write(tmp_path / "bag", trace)
    run = subprocess.run(
        ["prlimit", "--fsize=2000", *program("analyse"), tmp_path / "bag", "--output",
         tmp_path / "out"],
        capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert "cannot be written to" in one_line(run)


# Damage.


def in_batches(path: Path, storage: str, trace: Trace) -> Path:
    """A closed bag whose ticks were brought to the file in three batches."""
    assert isinstance(trace.scenario, Scenario)
    recording = Recording(path, storage, trace.scenario)
    for k in range(trace.ticks):
        for topic, data in messages(trace, k):
            recording.write(topic, 10**18 + k * 10**6, data)
        if k % 100 == 99:
            recording.flush()
    recording.close()
    return path


@pytest.fixture(scope="module")
def sound(trace: Trace, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A closed mcap bag of three chunks of ticks."""
    return in_batches(tmp_path_factory.mktemp("sound") / "bag", "mcap", trace)


@pytest.fixture(scope="module")
def sound_sqlite3(trace: Trace, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The same as a sqlite3 bag."""
    return in_batches(tmp_path_factory.mktemp("sound") / "bag", "sqlite3", trace)


def changed(sound: Path, folder: Path, place: int, name: str = "") -> Path:
    """A copy of a bag with one byte changed, of the file with its messages or of another."""
    target = folder / f"bag{place}"
    shutil.copytree(sound, target)
    file = target / name if name else data_file(target)
    data = bytearray(file.read_bytes())
    data[place] ^= 0x41
    file.write_bytes(data)
    return target


def data_file(bag: Path) -> Path:
    """The file that has the messages."""
    (file,) = [f for f in bag.iterdir() if f.suffix in (".mcap", ".db3")]
    return file


def test_a_bag_has_the_checksums_of_the_format(sound: Path) -> None:
    """By the format's own reader."""
    (file,) = sound.glob("*.mcap")
    with file.open("rb") as stream:
        reader = NonSeekingReader(stream, validate_crcs=True)
        assert sum(1 for _ in reader.iter_messages(log_time_order=False)) == 5 * 301 + 1
    with file.open("rb") as stream:
        records = list(StreamReader(stream, emit_chunks=True, validate_crcs=True).records)
    chunks = [record for record in records if isinstance(record, records_of_mcap.Chunk)]
    assert len(chunks) == 5
    assert all(chunk.uncompressed_crc for chunk in chunks)
    (end,) = (record for record in records if isinstance(record, records_of_mcap.DataEnd))
    (footer,) = (record for record in records if isinstance(record, records_of_mcap.Footer))
    assert end.data_section_crc != 0
    data = file.read_bytes()
    assert footer.summary_crc == zlib.crc32(data[footer.summary_start : -12])
    assert read_bag(sound).checked
    assert read_bag(sound).damage == ""


@pytest.mark.slow
def test_one_changed_byte_is_noticed_wherever_it_is(trace: Trace, sound: Path, tmp_path: Path) -> None:
    """What is left is what was recorded; the ticks that are not are named."""
    (file,) = sound.glob("*.mcap")
    size = file.stat().st_size
    with file.open("rb") as stream:
        records = list(StreamReader(stream, emit_chunks=True).records)
    (summary,) = (record.summary_start for record in records if isinstance(record, records_of_mcap.Footer))
    index = [
        record.chunk_start_offset for record in records if isinstance(record, records_of_mcap.ChunkIndex)
    ]
    frames = [start + at for start in index for at in (0, 1, 4, 9, 20, 33, 40, 60)]
    ends = [0, 3, 10, summary - 13, summary - 4, summary, size - 37, size - 20, size - 8, size - 1]
    lost = 0
    for place in [*random.Random(5).sample(range(size), 50), *frames, *ends]:
        bag = read_bag(changed(sound, tmp_path, place))
        assert bag.damage.startswith("the file is not what was recorded"), place
        assert (bag.trace.status, bag.trace.detail) == ("damaged", bag.damage)
        kept = (bag.trace.time_ns // 1_000_000).tolist()
        for name, column in trace.columns.items():
            assert np.array_equal(bag.trace.columns[name], column[kept]), (place, name)
        gone = sorted(set(range(trace.ticks)) - set(kept))
        assert bool(gone) == ("left out" in bag.damage)
        if gone:
            assert f"ticks {gone[0]} to {gone[-1]} are damaged or lost" in bag.damage
            inside = gone[0] > 0 and gone[-1] < trace.ticks - 1
            assert not inside or set(bag.missing.values()) == {len(gone)}
        lost += bool(gone)
    assert 30 < lost < 80


def test_one_changed_byte_of_a_sqlite3_bag_is_noticed_wherever_it_is(
    trace: Trace, sound_sqlite3: Path, tmp_path: Path
) -> None:
    """As in mcap; but the first page, without which nothing can be read, has no second copy."""
    size = data_file(sound_sqlite3).stat().st_size
    page = 4096
    places = {*random.Random(6).sample(range(page, size), 40), *range(page, size, 5 * page)}
    lost = 0
    for place in places:
        bag = read_bag(changed(sound_sqlite3, tmp_path, place))
        assert bag.trace.status == "damaged", place
        assert bag.trace.detail == bag.damage
        assert "not what was recorded" in bag.damage
        kept = (bag.trace.time_ns // 1_000_000).tolist()
        for name, column in trace.columns.items():
            found = bag.trace.columns[name]
            there = ~np.isnan(found)
            assert np.array_equal(found[there], column[kept][there]), (place, name)
        lost += len(kept) < trace.ticks
        assert (len(kept) < trace.ticks) <= ("are damaged or lost" in bag.damage)
    assert 20 < lost < len(places)
    with pytest.raises(FtcmError, match="nothing could be recovered"):
        read_bag(changed(sound_sqlite3, tmp_path, 0))


def test_a_damaged_batch_of_a_sqlite3_bag_is_left_out_and_named(
    trace: Trace, sound_sqlite3: Path, tmp_path: Path
) -> None:
    path = tmp_path / "bag"
    shutil.copytree(sound_sqlite3, path)
    with contextlib.closing(sqlite3.connect(data_file(path))) as database, database:
        assert database.execute("PRAGMA integrity_check").fetchone() == ("ok",)
        ends = [end for (end,) in database.execute("SELECT last_id FROM ftcm_digests ORDER BY last_id")]
        assert ends == [1, 501, 1001, 1501, 1506]  # the scenario, then 5 messages a tick
        database.execute("UPDATE messages SET timestamp = timestamp + 1 WHERE id = 700")
    (path / "SHA256SUMS").unlink()  # the digests of the batches are enough
    bag = read_bag(path)
    assert (
        bag.damage == "the file is not what was recorded: ticks 100 to 199 are damaged or lost, and left out"
    )
    assert (bag.trace.time_ns // 1_000_000).tolist() == [*range(100), *range(200, 301)]
    assert set(bag.missing.values()) == {100}


@pytest.mark.parametrize(
    "harm",
    [
        "DELETE FROM messages WHERE id = 700",
        "UPDATE messages SET id = 5000 WHERE id = 700",
        "UPDATE messages SET topic_id = topic_id + 1 WHERE id = 700",
        "UPDATE messages SET data = 'text' WHERE id = 700",
        "INSERT INTO messages SELECT id + 10000, topic_id, timestamp, data FROM messages WHERE id = 700",
        "DELETE FROM ftcm_digests WHERE last_id = 1001",
        "UPDATE ftcm_digests SET last_id = 1002 WHERE last_id = 1001",
        "UPDATE ftcm_digests SET crc32 = 7 WHERE last_id = 1001",
    ],
)
def test_whatever_happens_to_rows_is_noticed_by_the_digests(
    sound_sqlite3: Path, tmp_path: Path, harm: str
) -> None:
    shutil.copytree(sound_sqlite3, tmp_path / "bag")
    (tmp_path / "bag" / "SHA256SUMS").unlink()
    with contextlib.closing(sqlite3.connect(data_file(tmp_path / "bag"))) as database, database:
        assert database.execute(harm).rowcount == 1
    bag = read_bag(tmp_path / "bag")
    assert bag.trace.status == "damaged"
    if "INSERT" not in harm:
        assert "ticks 100 to" in bag.damage


def test_digests_that_cannot_be_read_lose_no_message(
    trace: Trace, sound_sqlite3: Path, tmp_path: Path
) -> None:
    path = tmp_path / "bag"
    shutil.copytree(sound_sqlite3, path)
    with contextlib.closing(sqlite3.connect(data_file(path))) as database:
        (page,) = database.execute(
            "SELECT rootpage FROM sqlite_master WHERE name = 'ftcm_digests'"
        ).fetchone()
    with data_file(path).open("r+b") as stream:
        stream.seek((page - 1) * 4096)
        stream.write(bytes(4096))
    bag = read_bag(path)
    assert bag.trace.status == "damaged"
    assert same(bag.trace, trace)


def test_other_programs_read_a_sqlite3_bag_with_digests(trace: Trace, sound_sqlite3: Path) -> None:
    """By rosbags, and by what rosbag2's own sqlite3 storage asks of a file."""
    with AnyReader([sound_sqlite3]) as reader:
        assert reader.message_count == 5 * trace.ticks + 1
        assert sum(1 for _ in reader.messages()) == 5 * trace.ticks + 1
    with contextlib.closing(sqlite3.connect(data_file(sound_sqlite3))) as database:
        query = (
            "SELECT data, timestamp, topics.name, messages.id FROM messages JOIN topics "
            "ON messages.topic_id = topics.id ORDER BY messages.timestamp, messages.id"
        )
        assert len(database.execute(query).fetchall()) == 5 * trace.ticks + 1
        assert database.execute("SELECT schema_version FROM schema").fetchone() == (4,)


@pytest.mark.parametrize("storage", STORAGE)
def test_an_unclosed_bag_with_a_damaged_batch_keeps_the_others(
    trace: Trace, sound: Path, sound_sqlite3: Path, tmp_path: Path, storage: str
) -> None:
    source = sound if storage == "mcap" else sound_sqlite3
    data = data_file(source).read_bytes()
    place = data.index(messages(trace, 150)[0][1])  # of tick 150
    path = changed(source, tmp_path, place + 20)
    (path / "metadata.yaml").unlink()
    bag = read_bag(path)
    assert "bag was not closed; recovered: complete to t = 0.3 s" in " ".join(bag.warnings())
    assert (bag.trace.time_ns // 1_000_000).tolist() == [*range(100), *range(200, 301)]


@pytest.mark.parametrize("storage", STORAGE)
def test_analyse_ends_with_an_error_for_a_damaged_bag_unless_it_is_accepted(
    sound: Path, sound_sqlite3: Path, tmp_path: Path, storage: str
) -> None:
    source = sound if storage == "mcap" else sound_sqlite3
    bag = changed(source, tmp_path, data_file(source).stat().st_size // 2)
    run = analyse(bag, "--output", tmp_path / "out")
    assert run.returncode == 1
    (warning,) = [line for line in run.stderr.splitlines() if "damaged: " in line]
    assert warning.startswith("warning: ftcm: damaged: the file is not what was recorded: ticks ")
    summary = json.loads((tmp_path / "out" / "summary.json").read_text())
    assert summary["results"][0]["status"] == "damaged"
    assert f"warning: ftcm: damaged: {summary['damage']['ftcm']}" == warning
    assert "damaged: the file is not what was recorded" in (tmp_path / "out" / "table.md").read_text()
    assert analyse(bag, "--accept-damage").returncode == 0


def test_a_bag_without_checksums_says_so(trace: Trace, sound: Path, tmp_path: Path) -> None:
    foreign_bag(tmp_path / "foreign", trace, {"joint_states"})
    said = "the bag has no checksums: damage would not show"
    assert said in analyse(tmp_path / "foreign").stderr
    assert said not in analyse(sound).stderr


# What the files of a bag were.


@pytest.mark.parametrize("storage", STORAGE)
def test_a_closed_bag_says_what_its_files_are(trace: Trace, tmp_path: Path, storage: str) -> None:
    path = in_batches(tmp_path / "bag", storage, trace)
    check = ["sha256sum", "--check", "--strict", "SHA256SUMS"]
    run = subprocess.run(check, cwd=path, capture_output=True, text=True, check=False)
    assert run.returncode == 0, run.stderr
    assert run.stdout.splitlines() == [f"{data_file(path).name}: OK", "metadata.yaml: OK"]
    path.rename(tmp_path / "moved")
    bag = read_bag(tmp_path / "moved")
    assert bag.warnings() == bag.remarks() == []


def remark(run: subprocess.CompletedProcess[str]) -> str:
    """The one line that is said of a bag."""
    (line,) = run.stderr.splitlines()
    return line


def test_a_bag_whose_files_were_renamed_merged_or_exchanged_says_so(
    trace: Trace, sound: Path, tmp_path: Path
) -> None:
    path = tmp_path / "bag"
    shutil.copytree(sound, path)
    size = data_file(path).stat().st_size
    data_file(path).rename(path / "other.mcap")
    run = analyse(path)
    assert (run.returncode, remark(run)) == (0, "ftcm: bag.mcap is called other.mcap now")
    assert same(read_bag(path).trace, trace)
    (path / "other.mcap").rename(path / "bag.mcap")
    shutil.copy(path / "bag.mcap", path / "more.mcap")
    run = analyse(path)
    assert (run.returncode, remark(run)) == (0, "ftcm: more.mcap was not recorded with it")
    (path / "more.mcap").unlink()
    other = simulate(load("paper", ["duration=0.3"], controller="smc"))
    (path / "bag.mcap").write_bytes(data_file(in_batches(tmp_path / "two", "mcap", other)).read_bytes())
    now = (path / "bag.mcap").stat().st_size
    assert now != size
    run = analyse(path)
    assert run.returncode == 1
    assert remark(run) == (
        f"warning: smc: damaged: bag.mcap is not what was recorded: {now} bytes, {size} were recorded; "
        "every message fits its checksum"
    )
    (path / "bag.mcap").unlink()
    assert "nothing could be recovered" in one_line(analyse(path))


@pytest.mark.parametrize("name", ["metadata.yaml", "SHA256SUMS"])
def test_a_changed_byte_of_the_other_files_is_noticed(
    trace: Trace, sound: Path, tmp_path: Path, name: str
) -> None:
    size = (sound / name).stat().st_size
    for place in [*range(0, size, size // 40), size - 1]:
        bag = read_bag(changed(sound, tmp_path, place, name))
        assert bag.damage or "is called" in bag.files, place  # the name of a file was changed
        assert bag.trace.status == ("damaged" if bag.damage else "completed")
        assert same(bag.trace, trace)
        assert bag.trace.scenario == trace.scenario


def test_a_bag_that_does_not_say_what_its_files_were_is_analysed(
    trace: Trace, sound: Path, tmp_path: Path
) -> None:
    path = tmp_path / "bag"
    shutil.copytree(sound, path)
    (path / "SHA256SUMS").unlink()
    run = analyse(path)
    assert (run.returncode, remark(run)) == (
        0, "ftcm: no SHA256SUMS: whether its files were exchanged is not known"
    )  # fmt: skip
    killed, _, _ = unclosed(tmp_path, trace, "mcap")[4]
    run = analyse(killed)
    assert run.returncode == 0
    assert "bag was not closed; recovered: complete to t = " in remark(run)
    assert remark(run).endswith("; nothing says what its files were (no SHA256SUMS)")
    assert analyse(killed, "--repair", tmp_path / "repaired").returncode == 0
    assert (tmp_path / "repaired" / "SHA256SUMS").is_file()
