# SPDX-License-Identifier: Apache-2.0
"""The codec against rclpy's own serialization, and against messages of others."""

from __future__ import annotations

import contextlib
import struct
from unittest import mock

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

pytest.importorskip("rclpy", reason="ROS 2 (rclpy) is not installed")
from rclpy.serialization import deserialize_message, serialize_message
from sensor_msgs.msg import JointState

from ftcm_ros.transport.codec import CodecError, JointStateCodec, stamp_of

NAMES = ("joint1", "joint2", "joint3")
CODEC = JointStateCodec(NAMES)
LAYOUTS = {
    "state": CODEC.state,
    "motion": CODEC.motion,
    "torque": CODEC.torque,
}
ARRAYS = {
    "state": ("position", "velocity", "effort"),
    "motion": ("position", "velocity"),
    "torque": ("effort",),
}
floats = st.floats(allow_nan=False)
vectors = st.tuples(floats, floats, floats)
stamps = st.integers(0, (2**31 - 1) * 10**9)


@pytest.mark.parametrize("kind", LAYOUTS)
@given(time_ns=stamps, data=st.data())
def test_encoded_messages_are_what_rclpy_reads(kind: str, time_ns: int, data: st.DataObject) -> None:
    values = [data.draw(vectors) for _ in ARRAYS[kind]]
    encoded = LAYOUTS[kind].encode(time_ns, *values)
    message = deserialize_message(encoded, JointState)
    assert message.header.stamp.sec * 10**9 + message.header.stamp.nanosec == time_ns == stamp_of(encoded)
    assert tuple(message.name) == NAMES
    for name in ("position", "velocity", "effort"):
        expected = values[ARRAYS[kind].index(name)] if name in ARRAYS[kind] else ()
        assert tuple(getattr(message, name)) == expected
    sample = CODEC.decode(encoded)
    assert sample.time_ns == time_ns
    assert [getattr(sample, name) for name in ARRAYS[kind]] == values


@given(order=st.permutations([*NAMES, "gripper"]), values=st.tuples(floats, floats, floats, floats))
def test_other_joint_order_and_extra_joints_are_taken_by_name(
    order: list[str], values: tuple[float, ...]
) -> None:
    message = JointState(name=order, effort=list(values), position=list(values))
    sample = CODEC.decode(serialize_message(message))
    expected = tuple(values[order.index(n)] for n in NAMES)
    assert sample.effort == expected
    assert sample.position == expected
    assert sample.velocity == ()


@given(
    order=st.permutations([*NAMES, "gripper"]),
    other=st.permutations([*NAMES, "gripper"]),
    frame=st.sampled_from(["", "base", "base_link"]),
    values=st.tuples(floats, floats, floats, floats),
    filled=st.sampled_from([("position",), ("position", "velocity", "effort")]),
)
def test_messages_like_the_last_foreign_one_are_read_without_names_and_others_still_by_name(
    order: list[str], other: list[str], frame: str, values: tuple[float, ...], filled: tuple[str, ...]
) -> None:
    def message(names: list[str], numbers: tuple[float, ...]) -> bytes:
        made = JointState(name=names, **{array: list(numbers) for array in filled})
        made.header.frame_id = frame
        made.header.stamp.sec = 7
        return serialize_message(made)

    codec = JointStateCodec(NAMES)
    codec.decode(message(order, (1.0, 2.0, 3.0, 4.0)))
    for names in (order, other):  # the other order has the same length
        data = message(names, values)
        assert codec.decode(data) == JointStateCodec(NAMES).decode(data)
    if len(filled) == 3:  # else rclpy leaves bytes behind the end, and the length says nothing
        codec.decode(message(order, (1.0, 2.0, 3.0, 4.0)))
        with mock.patch.object(codec, "_decode_by_name", None):
            sample = codec.decode(message(order, values))
        assert sample.effort == tuple(values[order.index(n)] for n in NAMES)


def test_big_endian_messages_are_read() -> None:
    text = b"".join(struct.pack(">I", 7) + n.encode() + b"\0\0" for n in NAMES)
    body = struct.pack(">iI", 3, 4) + struct.pack(">I", 1) + b"\0\0\0\0" + struct.pack(">I", 3) + text
    body += struct.pack(">III", 0, 0, 3)
    body += b"\0" * (-len(body) % 8) + struct.pack(">3d", 1.0, 2.0, 3.0)
    sample = CODEC.decode(b"\0\0\0\0" + body)
    assert sample == (3 * 10**9 + 4, (), (), (1.0, 2.0, 3.0))


@pytest.mark.parametrize(
    ("message", "reason"),
    [
        (JointState(name=["joint1", "joint2"], effort=[1.0, 2.0]), "joints ['joint3'] are missing"),
        (JointState(name=[*NAMES, "x"], effort=[1.0, 2.0, 3.0]), "effort has 3 entries for 4 names"),
    ],
)
def test_messages_that_do_not_fit_are_refused_with_the_reason(message: JointState, reason: str) -> None:
    with pytest.raises(CodecError, match=reason.replace("[", r"\[").replace("]", r"\]")):
        CODEC.decode(serialize_message(message))


@given(st.binary(max_size=400))
def test_any_bytes_are_a_sample_or_refused(data: bytes) -> None:
    with contextlib.suppress(CodecError):  # any other exception fails the test
        CODEC.decode(data)


@given(st.integers(0, 155), st.integers(0, 255))
def test_a_damaged_message_is_a_sample_or_refused(index: int, value: int) -> None:
    damaged = bytearray(CODEC.state.encode(5, (1.0, 2.0, 3.0), (4.0, 5.0, 6.0), (7.0, 8.0, 9.0)))
    damaged[index] = value
    with contextlib.suppress(CodecError):
        assert len(CODEC.decode(bytes(damaged)).position) in (0, 3)


@pytest.mark.parametrize("kind", LAYOUTS)
def test_many_at_once_equal_one_by_one(kind: str) -> None:
    rng = np.random.default_rng(1)
    layout = LAYOUTS[kind]
    messages = [
        layout.encode(int(t), *[tuple(rng.normal(size=3).tolist()) for _ in ARRAYS[kind]])
        for t in rng.integers(0, 10**15, 50)
    ]
    decoded = layout.decode_all(messages)
    assert decoded is not None
    for i, message in enumerate(messages):
        sample = layout.decode(message)
        assert sample is not None
        assert decoded[0][i] == sample.time_ns
        for array, values in zip(decoded[1], sample[1:]):
            assert (array is None and values == ()) or tuple(array[i].tolist()) == values


def test_many_at_once_refuses_another_layout() -> None:
    other = JointStateCodec(("a_____", "b_____", "c_____")).torque.encode(1, (1.0, 2.0, 3.0))
    assert CODEC.torque.decode_all([CODEC.torque.encode(1, (1.0, 2.0, 3.0)), other]) is None
    assert CODEC.torque.decode_all([other[:-1]]) is None
