# SPDX-License-Identifier: Apache-2.0
"""Signals to and from ``sensor_msgs/JointState`` in CDR, without message objects on the tick path.

The suite's own messages have one of three fixed layouts (which arrays are filled), encoded and
decoded with one :mod:`struct` call. Any other JointState (another joint order, extra joints, another
byte order) is read by rosbags and its joints are taken by name, or it is refused with the reason. Those that
follow it mostly have the same layout, which is then read in the same way.
"""

from __future__ import annotations

import struct
from collections.abc import Sequence
from functools import cache
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt
from rosbags.serde import SerdeError
from rosbags.typesys import Stores, get_typestore

from ftcm_core.errors import shown
from ftcm_core.signals import NANOSECONDS, Vector

JOINT_STATE = "sensor_msgs/msg/JointState"
_CDR_BIG_ENDIAN, _CDR_LITTLE_ENDIAN = b"\x00\x00\x00\x00", b"\x00\x01\x00\x00"
"""The first bytes of a message."""


class CodecError(ValueError):
    """A message that cannot be a signal of this robot; the text says why."""


class JointSample(NamedTuple):
    """A decoded JointState: stamp and the three arrays, empty where the message has none."""

    time_ns: int
    position: Vector
    velocity: Vector
    effort: Vector


class Layout:
    """One fixed CDR layout: which of position, velocity and effort are filled.

    Padding is not looked at: other publishers leave whatever was in memory there.
    """

    def __init__(
        self, joint_names: tuple[str, ...], filled: tuple[bool, bool, bool], frame_id: bytes = b""
    ) -> None:
        """Lay the message out once: constants, padding and doubles in their order."""
        self.joints = joints = len(joint_names)
        self.filled = filled
        offset = 8  # after the stamp, counted from the end of the 4-byte CDR header
        parts = ["<4siI"]
        self.constants: list[tuple[int, bytes]] = []
        """Constant fields: index among the unpacked fields, and value."""
        self._constant_bytes: list[tuple[int, bytes]] = [(0, _CDR_LITTLE_ENDIAN)]
        self._array_bytes: list[int | None] = []
        self.slices: list[slice] = []
        """Where each array is among the unpacked fields; empty for one that is not filled."""
        field = 3

        def constant(data: bytes, align: int) -> None:
            nonlocal offset, field
            pad = -offset % align
            parts.append(f"{pad}x{len(data)}s")
            self.constants.append((field, data))
            self._constant_bytes.append((4 + offset + pad, data))
            offset += pad + len(data)
            field += 1

        constant(struct.pack("<I", len(frame_id) + 1) + frame_id + b"\0", 4)
        constant(struct.pack("<I", joints), 4)
        for name in joint_names:
            text = name.encode() + b"\0"
            constant(struct.pack("<I", len(text)) + text, 4)
        for has in filled:
            constant(struct.pack("<I", joints if has else 0), 4)
            if not has:
                self.slices.append(slice(0))
                self._array_bytes.append(None)
                continue
            pad = -offset % 8
            parts.append(f"{pad}x{joints}d")
            self.slices.append(slice(field, field + joints))
            self._array_bytes.append(4 + offset + pad)
            offset += pad + 8 * joints
            field += joints
        self.struct = struct.Struct("".join(parts))
        self.size = self.struct.size
        self._arrays = [s for s in self.slices if s.stop]
        self._template: list[Any] = [_CDR_LITTLE_ENDIAN, *([0] * (field - 1))]
        for index, data in self.constants:
            self._template[index] = data

    def encode(self, time_ns: int, *vectors: Vector) -> bytes:
        """Encode a stamp (ns) and the filled arrays, in order, as CDR."""
        fields = self._template.copy()
        fields[1], fields[2] = divmod(time_ns, NANOSECONDS)
        for where, vector in zip(self._arrays, vectors):
            fields[where] = vector
        return self.struct.pack(*fields)

    def sample(self, time_ns: int, *vectors: Vector) -> JointSample:
        """Return what a message of this stamp (ns) and these filled arrays, in order, decodes to."""
        arrays = iter(vectors)
        a, b, c = [next(arrays) if has else () for has in self.filled]
        return JointSample(time_ns, a, b, c)

    def decode(self, data: bytes) -> JointSample | None:
        """Decode a message of this layout; return None if it is of another one of the same length.

        Raises:
            struct.error: it has another length.
        """
        fields = self.struct.unpack(data)
        if fields[0] != _CDR_LITTLE_ENDIAN or fields[2] >= NANOSECONDS:
            return None
        for index, value in self.constants:
            if fields[index] != value:
                return None
        a, b, c = self.slices
        return JointSample(fields[1] * NANOSECONDS + fields[2], fields[a], fields[b], fields[c])

    def decode_all(
        self, messages: Sequence[bytes]
    ) -> tuple[npt.NDArray[np.int64], list[npt.NDArray[np.float64] | None]] | None:
        """Decode many messages at once.

        Args:
            messages: serialized messages.

        Returns:
            Stamps (ns), shape (messages,), and position, velocity and effort, each of shape
            (messages, joints) or None where the layout has none; None if any message is of another layout.
        """
        if any(len(m) != self.size for m in messages):
            return None
        table = np.frombuffer(b"".join(messages), dtype=np.uint8).reshape(-1, self.size)
        for start, value in self._constant_bytes:
            if not (table[:, start : start + len(value)] == np.frombuffer(value, dtype=np.uint8)).all():
                return None
        stamps = table[:, 4:12].copy()
        sec, nanosec = stamps.view("<i4")[:, 0], stamps.view("<u4")[:, 1]
        width = 8 * self.joints
        arrays = [
            None if i is None else table[:, i : i + width].copy().view("<f8") for i in self._array_bytes
        ]
        return sec.astype(np.int64) * NANOSECONDS + nanosec.astype(np.int64), arrays


class JointStateCodec:
    """Encoder and decoder of one robot's JointState messages."""

    def __init__(self, joint_names: tuple[str, ...]) -> None:
        """Prepare the layouts for these joints."""
        self.joint_names = joint_names
        self.state = Layout(joint_names, (True, True, True))
        """joint_states: position, velocity and effort. detection: alarms, verdicts and residuals."""
        self.motion = Layout(joint_names, (True, True, False))
        """reference: position and velocity."""
        self.torque = Layout(joint_names, (False, False, True))
        """joint_torques, disturbance, disturbance_estimate: effort."""
        self.layouts = (self.state, self.torque, self.motion)
        """All of the suite's own."""
        self._foreign: tuple[Layout, list[int]] | None = None
        """That of the last message of others, and where its values of this robot's joints are."""
        typestore().get_msgdef(JOINT_STATE)  # now: no message of the general path is to wait for it

    def decode(self, data: bytes) -> JointSample:
        """Decode any JointState that names all joints of this robot.

        Raises:
            CodecError: it cannot be decoded, lacks a joint, or an array has another length.
        """
        for layout in self.layouts:
            if layout.size == len(data) and (sample := layout.decode(data)) is not None:
                return sample
        if self._foreign is not None:
            layout, order = self._foreign
            if layout.size == len(data) and (sample := layout.decode(data)) is not None:
                time_ns, *arrays = sample
                return JointSample(time_ns, *[tuple([a[i] for i in order]) if a else () for a in arrays])
        return self._decode_by_name(data)

    def _decode_by_name(self, data: bytes) -> JointSample:
        time_ns, names, position, velocity, effort = read_joint_state(data)
        missing = [name for name in self.joint_names if name not in names]
        if missing:
            raise CodecError(f"joints {shown(missing)} are missing; the message names {shown(names)}")
        if len(set(names)) < len(names):
            raise CodecError(f"a joint is named twice: {shown(names)}")
        order = [names.index(name) for name in self.joint_names]

        def pick(array: Vector, what: str) -> Vector:
            if not array:
                return ()
            if len(array) != len(names):
                raise CodecError(f"{what} has {len(array)} entries for {len(names)} names")
            return tuple([array[i] for i in order])

        sample = JointSample(
            time_ns, pick(position, "position"), pick(velocity, "velocity"), pick(effort, "effort")
        )
        if data[:4] == _CDR_LITTLE_ENDIAN:  # the next one will be like this one
            (length,) = struct.unpack_from("<I", data, 12)
            filled = (bool(position), bool(velocity), bool(effort))
            self._foreign = Layout(tuple(names), filled, data[16 : 15 + length]), order
        return sample


@cache
def typestore() -> Any:
    """Return rosbags' definitions of ROS 2 Jazzy's messages; loading them takes a tenth of a second."""
    return get_typestore(Stores.ROS2_JAZZY)


def read_joint_state(data: bytes) -> tuple[int, list[str], Vector, Vector, Vector]:
    """Read any JointState, in either byte order.

    Bytes after its end are ignored, as rclpy leaves some. ``Typestore.deserialize_cdr`` would refuse them,
    so the function is called that it calls. That function checks every length against the size of the
    message before it makes room.

    Returns:
        Stamp (ns), joint names, position, velocity, effort as the message has them.

    Raises:
        CodecError: the bytes are not a JointState.
    """
    if data[:4] not in (_CDR_LITTLE_ENDIAN, _CDR_BIG_ENDIAN):
        raise CodecError(f"not a {JOINT_STATE} in plain CDR: begins with {data[:4].hex()}")
    store = typestore()
    definition = store.get_msgdef(JOINT_STATE)
    little = data[:4] == _CDR_LITTLE_ENDIAN
    read = definition.deserialize_cdr_le if little else definition.deserialize_cdr_be
    try:
        message, _ = read(data[4:], 0, definition.cls, store)
    except (SerdeError, struct.error, ValueError) as error:
        raise CodecError(f"not a {JOINT_STATE}: {error}") from None
    stamp = message.header.stamp
    if stamp.nanosec >= NANOSECONDS:
        raise CodecError(f"the stamp has {stamp.nanosec} nanoseconds; expected less than {NANOSECONDS}")
    arrays = (tuple(values.tolist()) for values in (message.position, message.velocity, message.effort))
    return (stamp.sec * NANOSECONDS + stamp.nanosec, message.name, *arrays)


def stamp_of(data: bytes) -> int:
    """Stamp of a serialized message that begins with a ``std_msgs/Header``, ns.

    Raises:
        CodecError: the message is too short to have one.
    """
    if len(data) < 12:
        raise CodecError(f"no stamp in a message of {len(data)} bytes")
    order = "<" if data[1:2] == b"\x01" else ">"
    sec, nanosec = struct.unpack_from(order + "iI", data, 4)
    return int(sec) * NANOSECONDS + int(nanosec)
