# SPDX-License-Identifier: Apache-2.0
"""Generated bad messages, parameters and bags: each is refused with its reason, and the node lives on."""

from __future__ import annotations

import shutil
import signal
import struct
import tempfile
import tracemalloc
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import strategies as st

from inputs import NOT_BAD, inputs, promised

pytest.importorskip("rclpy", reason="ROS 2 (rclpy) is not installed")
pytest.importorskip("rosbags")
import rclpy
from diagnostic_msgs.msg import DiagnosticArray
from rclpy.context import Context
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.serialization import deserialize_message, serialize_message
from sensor_msgs.msg import JointState

from ftcm_core.errors import FtcmError
from ftcm_core.params import ParamSpec, specs
from ftcm_core.registry import components
from ftcm_core.scenario import load
from ftcm_core.simulation import simulate
from ftcm_ros.bags.reader import read_bag
from ftcm_ros.bags.writer import STORAGE, Recording
from ftcm_ros.parameters.component_parameters import ComponentParameters
from ftcm_ros.transport.codec import CodecError, JointStateCodec, stamp_of
from ftcm_ros.transport.topics import DISTURBANCE, ESTIMATE, JOINT_STATES, REFERENCE, TORQUES

NAMES = ("joint1", "joint2", "joint3")
CODEC = JointStateCodec(NAMES)
GOOD = (
    CODEC.state.encode(5, (1.0, 2.0, 3.0), (4.0, 5.0, 6.0), (7.0, 8.0, 9.0)),
    CODEC.motion.encode(5, (1.0, 2.0, 3.0), (4.0, 5.0, 6.0)),
    CODEC.torque.encode(5, (1.0, 2.0, 3.0)),
)
SIZE_FIELDS = (12, 20, 24, 36, 48, 60)
"""Where a message has the lengths of its texts and the number of names and of the first array."""


def refused(data: bytes) -> str:
    """Why the codec refuses a message: one short line."""
    with pytest.raises(CodecError) as error:
        CODEC.decode(data)
    return one_line(error.value)


def one_line(error: Exception) -> str:
    """Check and return a reason."""
    message = str(error)
    assert len(message.splitlines()) == 1
    assert len(message) < 500
    return message


# ---- messages ----


@inputs(200, of=260, data=st.sampled_from(GOOD), keep=st.integers(0, 155))
def test_a_message_cut_short(data: bytes, keep: int) -> object:
    """A message lacks some of its end."""
    if keep >= len(data):
        return NOT_BAD
    return refused(data[:keep])


@inputs(
    300,
    data=st.sampled_from(GOOD),
    where=st.sampled_from(SIZE_FIELDS),
    size=st.one_of(
        st.integers(1000, 2**32 - 1), st.sampled_from([2**32 - 1, 2**31, 2**31 - 1, 2**29, 10**9])
    ),
)
def test_a_count_beyond_the_message(data: bytes, where: int, size: int) -> None:
    """It says how many there are not, without room made for them."""
    tracemalloc.start()
    message = refused(data[:where] + struct.pack("<I", size) + data[where + 4 :])
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert str(size) in message
    assert peak < 1_000_000


@inputs(
    200,
    data=st.sampled_from(GOOD),
    head=st.binary(min_size=4, max_size=4).filter(lambda h: h not in (b"\0\1\0\0", b"\0\0\0\0")),
)
def test_another_encoding(data: bytes, head: bytes) -> None:
    """Only plain CDR is known."""
    assert head.hex() in refused(head + data[4:])


def test_another_byte_order_than_it_says() -> None:
    """Counts read the wrong way round are far too many."""
    for data in GOOD:
        refused(b"\0\0\0\0" + data[4:])


@inputs(100, data=st.sampled_from(GOOD), nanosec=st.integers(10**9, 2**32 - 1))
def test_a_stamp_that_is_none(data: bytes, nanosec: int) -> None:
    """A thousand million nanoseconds are a second: such a stamp would pass for another tick's."""
    assert str(nanosec) in refused(data[:8] + struct.pack("<I", nanosec) + data[12:])


some_names = st.lists(
    st.one_of(st.sampled_from([*NAMES, "gripper"]), st.text(max_size=5).filter(lambda s: "\0" not in s)),
    max_size=5,
)
arrays = st.lists(st.floats(), max_size=5)


@inputs(300, of=500, names=some_names, position=arrays, velocity=arrays, effort=arrays)
def test_another_robot(
    names: list[str], position: list[float], velocity: list[float], effort: list[float]
) -> object:
    """Other joints, or arrays that are not as long as the names."""
    data = serialize_message(JointState(name=names, position=position, velocity=velocity, effort=effort))
    if set(names) >= set(NAMES) and all(len(a) in (0, len(names)) for a in (position, velocity, effort)):
        return NOT_BAD
    return refused(data)


def test_very_many_names() -> None:
    """The reason does not repeat them all."""
    refused(serialize_message(JointState(name=["other"] * 50_000)))


edits = st.lists(
    st.tuples(
        st.sampled_from(["set", "insert", "delete", "copy"]),
        st.integers(0, 155),
        st.one_of(
            st.binary(min_size=1, max_size=8),
            st.sampled_from([b"\xff" * 4, b"\0" * 8, struct.pack("<d", np.nan), struct.pack("<d", np.inf)]),
        ),
    ),
    min_size=1,
    max_size=4,
)


@inputs(700, of=1500, data=st.sampled_from(GOOD), changes=edits)
def test_a_damaged_message(data: bytes, changes: list[tuple[str, int, bytes]]) -> object:
    """Refused, or read as the middleware's own reader reads it."""
    for what, i, new in changes:
        if what == "copy":
            data += data[i:]
        else:
            data = data[:i] + (b"" if what == "delete" else new) + data[i + len(new) * (what != "insert") :]
    try:
        sample = CODEC.decode(data)
    except CodecError as error:
        return one_line(error)
    for array in sample[1:]:
        assert len(array) in (0, 3)
    message = deserialize_message(data, JointState)
    assert sample.time_ns == message.header.stamp.sec * 10**9 + message.header.stamp.nanosec
    names = list(message.name)
    for array, theirs in zip(sample[1:], (message.position, message.velocity, message.effort)):
        expected = [theirs[names.index(n)] for n in NAMES] if len(theirs) else []
        assert np.array_equal(array, expected, equal_nan=True)
    return NOT_BAD


@inputs(300, data=st.binary(max_size=400))
def test_any_bytes(data: bytes) -> None:
    """None of these is a JointState."""
    refused(data)


@pytest.mark.parametrize("size", range(12))
def test_a_message_too_short_for_a_stamp(size: int) -> None:
    """Which the recorder asks for before it writes."""
    with pytest.raises(CodecError, match=f"no stamp in a message of {size} bytes"):
        stamp_of(b"\0\1\0\0\0\0\0\0\0\0\0"[:size])


# ---- parameters ----


OTHERS = {"controller": "pid.kp", "observer": "do.k2", "detector": "residual_threshold.hold"}
"""Kinds whose parameters are those of nodes, and a parameter of each."""


class Holder:
    """Nodes with the parameters of every component that has some, in this process; nothing is sent."""

    def __init__(self) -> None:
        self.context = Context()
        rclpy.init(context=self.context, domain_id=231)
        self.changes: list[Any] = []
        self.nodes: dict[str, Node] = {}
        scenario = load("paper", ["detector=residual_threshold"])
        for kind in OTHERS:
            self.nodes[kind] = node = Node(kind, context=self.context)
            ComponentParameters(node, kind, getattr(scenario, kind), 3, self.changes.append)

    def close(self) -> None:
        for node in self.nodes.values():
            node.destroy_node()
        rclpy.shutdown(context=self.context)


@pytest.fixture(scope="module")
def holder() -> Iterator[Holder]:
    made = Holder()
    yield made
    made.close()


numbers = st.one_of(st.floats(), st.integers(-(2**63), 2**63 - 1))
any_value = st.one_of(
    st.none(),
    st.booleans(),
    numbers,
    st.text(max_size=10).filter(lambda s: "\0" not in s),
    st.lists(st.floats(), max_size=5),
    st.lists(st.integers(-(2**63), 2**63 - 1), max_size=5),
    st.lists(st.booleans(), min_size=1, max_size=4),
    st.lists(st.sampled_from(["a", "1.0"]), min_size=1, max_size=4),
    st.binary(min_size=1, max_size=4).map(lambda b: [bytes([x]) for x in b]),
)
PLACES: list[tuple[str, str, ParamSpec | None]] = [
    (kind, f"{name}.{spec.name}", spec)
    for kind in OTHERS
    for name, cls in components(kind).items()
    for spec in specs(cls).values()
] + [(kind, kind, None) for kind in OTHERS]


def fits(kind: str, name: str, value: Any) -> bool:
    """Whether the component takes the value, by its own account."""
    if name == kind:
        return isinstance(value, str) and value in components(kind)
    component, _, parameter = name.partition(".")
    try:
        components(kind)[component](**{parameter: value}).check_joints(3)
    except FtcmError:
        return False
    return True


def test_parameters_that_do_not_fit(holder: Holder) -> None:
    """Refused whole, with the reason in one line; the value and the component in use stay."""

    @inputs(1200, of=2000, place=st.sampled_from(PLACES), value=any_value)
    def check(place: Any, value: Any) -> object:
        kind, name, _ = place
        if fits(kind, name, value):
            return NOT_BAD
        node, other = holder.nodes[kind], OTHERS[kind]
        before, kept = node.get_parameter(name), node.get_parameter(other)
        results = [
            node.set_parameters_atomically(
                [Parameter(name, value=value), *([Parameter(other, value=77.0)] * (name != other))]
            )
        ]
        if name != other:  # the service sets one by one
            results += node.set_parameters([Parameter(name, value=value)])
        for result in results:
            assert not result.successful
            assert result.reason
            assert len(result.reason.splitlines()) == 1
            assert len(result.reason) < 500
        assert node.get_parameter(name) == before
        assert node.get_parameter(other) == kept
        assert holder.changes == []
        return results

    check()


# ---- bags ----


@pytest.fixture(scope="module")
def bags() -> Iterator[dict[str, Path]]:
    """A bag of each storage, of a short run."""
    scenario = load("paper", ["duration=0.02"])
    trace = simulate(scenario)
    with tempfile.TemporaryDirectory() as folder:
        found = {}
        for storage in STORAGE:
            found[storage] = Path(folder) / storage
            recording = Recording(found[storage], storage, scenario)
            for k in range(trace.ticks):
                t = int(trace.time_ns[k])

                def row(column: str, k: int = k) -> tuple[float, ...]:
                    return tuple(getattr(trace, column)[k].tolist())

                for topic, data in (
                    (JOINT_STATES, CODEC.state.encode(t, row("position"), row("velocity"), row("effort"))),
                    (ESTIMATE, CODEC.torque.encode(t, row("disturbance_estimate"))),
                    (TORQUES, CODEC.torque.encode(t, row("command"))),
                    (DISTURBANCE, CODEC.torque.encode(t, row("disturbance"))),
                    (REFERENCE, CODEC.motion.encode(t, row("reference_position"), row("reference_velocity"))),
                ):
                    recording.write(topic, 10**18 + t, data)
            recording.close()
        yield found


@pytest.mark.slow
def test_damaged_bags(bags: dict[str, Path]) -> None:
    """Bytes of the bag or its metadata changed, cut or added: read, or refused in one line."""

    @inputs(
        25,
        of=120,
        storage=st.sampled_from(sorted(STORAGE)),
        file=st.sampled_from(["metadata.yaml", "data"]),
        what=st.sampled_from(["cut", "change", "insert", "delete"]),
        share=st.floats(0.0, 1.0),
        new=st.one_of(
            st.binary(min_size=1, max_size=20), st.sampled_from([b"\n- x: [", b"null", b"\xff" * 8])
        ),
    )
    def check(storage: str, file: str, what: str, share: float, new: bytes) -> object:
        with tempfile.TemporaryDirectory() as folder:
            bag = Path(folder) / "bag"
            shutil.copytree(bags[storage], bag)
            path = (
                bag / file
                if file == "metadata.yaml"
                else next(p for p in bag.iterdir() if p.suffix in (".mcap", ".db3"))
            )
            data = path.read_bytes()
            i = int(share * len(data))
            rest = {
                "cut": b"",
                "change": new + data[i + len(new) :],
                "insert": new + data[i:],
                "delete": data[i + len(new) :],
            }[what]
            path.write_bytes(data[:i] + rest)
            try:
                trace = read_bag(bag).trace
            except FtcmError as error:
                return one_line(error)
            assert trace.ticks <= 21
            return NOT_BAD

    check()


# ---- nodes ----


def health_of(watcher: Any) -> dict[str, str]:
    """What the last diagnostics of the one node say, kept up to date."""
    health: dict[str, str] = {}

    def on_diagnostics(message: DiagnosticArray) -> None:
        for status in message.status:
            health.update(message=status.message, **{v.key: v.value for v in status.values})

    watcher.node.create_subscription(DiagnosticArray, "/diagnostics", on_diagnostics, 10)
    return health


def bad_messages(count: int) -> list[bytes]:
    """Messages that cannot be signals, drawn at random, the same every time."""
    rng = np.random.default_rng(1)
    found = []
    while len(found) < count:
        data = bytearray(GOOD[rng.integers(3)])
        for _ in range(rng.integers(1, 4)):
            data[rng.integers(len(data))] = rng.integers(256)
        data = data[: rng.integers(len(data) + 1)] if rng.random() < 0.3 else data
        try:
            CODEC.decode(bytes(data))
        except CodecError:
            found.append(bytes(data))
    return found


@pytest.mark.ros
@pytest.mark.parametrize("name", ["observer", "controller"])
def test_a_node_outlives_bad_messages(start: Callable[..., Any], watcher: Any, name: str) -> None:
    """Every one is refused and counted; then a good one is answered."""
    process = start(f"nodes.{name}", *(["--ros-args", "-p", "controller:=pid"] * (name == "controller")))
    publisher = watcher.node.create_publisher(JointState, "/joint_states", 1000)
    answers: list[JointState] = []
    topic = {"observer": "/disturbance_estimate", "controller": "/joint_torques"}[name]
    watcher.node.create_subscription(JointState, topic, answers.append, 10)
    health = health_of(watcher)
    watcher.spin_until(lambda: publisher.get_subscription_count() == 1 and health, f"the {name}")
    watcher.spin_until(lambda: watcher.node.count_publishers(topic) == 1, f"the {name}'s publisher")
    messages = bad_messages(300)
    for message in messages:
        publisher.publish(message)
    watcher.spin_until(lambda: int(health["refused"]) >= len(messages), "all refusals in the diagnostics")
    assert int(health["refused"]) == len(messages)
    assert process.poll() is None
    assert answers == []
    good = CODEC.state.encode(0, (0.0,) * 3, (0.0,) * 3, (0.0,) * 3)
    watcher.spin_until(lambda: publisher.publish(good) or answers, "an answer to the message that fits")
    assert all(np.isfinite(answers[0].effort))


def test_what_is_no_tick_of_the_run_is_left_out_of_a_bag(tmp_path: Path) -> None:
    """As another recorder takes it, or another node has sent it; the run is read as if it were not there."""
    scenario = load("paper", ["duration=0.02"])
    trace = simulate(scenario)
    other = JointStateCodec(("jointA", "jointB", "jointC"))
    recording = Recording(tmp_path / "bag", "mcap", scenario)
    bad = [
        other.state.encode(3_000_000, *((9.0,) * 3,) * 3),  # of the usual size
        CODEC.state.encode(3_000_001, *((9.0,) * 3,) * 3),
        CODEC.state.encode(10**15, *((9.0,) * 3,) * 3),
        CODEC.state.encode(-1_000_000, *((9.0,) * 3,) * 3),
        b"\x00\x01\x00\x00" + bytes(20),
    ]
    for k, time_ns in enumerate(trace.time_ns.tolist()):
        q, v, u = (tuple(a[k].tolist()) for a in (trace.position, trace.velocity, trace.effort))
        recording.write(JOINT_STATES, 10**18 + time_ns, CODEC.state.encode(time_ns, q, v, u))
        recording.write(
            TORQUES, 10**18 + time_ns + 10, CODEC.torque.encode(time_ns, trace.command[k].tolist())
        )
        if k == 7:
            for i, message in enumerate(bad):
                recording.write(JOINT_STATES, 10**18 + time_ns + i, message)
    recording.close()
    bag = read_bag(tmp_path / "bag")
    assert bag.unusable == {"joint_states": len(bad)}
    assert bag.trace.status == "completed"
    assert {"joint_states", "joint_torques"} & set(bag.missing) == set()
    for column in ("position", "velocity", "effort", "command"):
        assert np.array_equal(getattr(bag.trace, column), getattr(trace, column))


@pytest.mark.ros
def test_a_recorder_outlives_bad_messages(start: Callable[..., Any], watcher: Any, tmp_path: Path) -> None:
    """None is in the bag, which is closed and can be read."""
    process = start("nodes.recorder", "--ros-args", "-p", "bag:=bag")
    publisher = watcher.node.create_publisher(JointState, "/joint_states", 1000)
    health = health_of(watcher)
    watcher.spin_until(lambda: publisher.get_subscription_count() == 1 and health, "the recorder")
    messages = bad_messages(200)
    messages += [JointStateCodec(("jointA", "jointB", "jointC")).state.encode(0, *((9.0,) * 3,) * 3)] * 100
    good = CODEC.state.encode(0, (0.0,) * 3, (0.0,) * 3, (0.0,) * 3)
    for message in (*messages, good):
        publisher.publish(message)
    watcher.spin_until(lambda: int(health["refused"]) >= len(messages), "all refusals in the diagnostics")
    assert int(health["refused"]) == len(messages)
    watcher.spin_until(lambda: health["joint_states_messages"] == "1", "the message that fits")
    process.send_signal(signal.SIGINT)
    out, err = process.communicate(timeout=60)
    assert process.returncode == 0, out + err
    bag = read_bag(tmp_path / "bag")
    assert bag.unusable == {}
    assert bag.trace.ticks == 1


def test_thousands_of_bad_messages() -> None:
    """Each of the tests above fails if it has had fewer than it says."""
    assert promised(globals()) >= 2000
