# SPDX-License-Identifier: Apache-2.0
"""Torques to and from ``std_msgs/Float64MultiArray``, as ros2_control's effort controllers take them.

Such a message has numbers and no names, and no stamp. Which joint a number is for, both sides must know.
"""

from __future__ import annotations

import struct
from collections.abc import Sequence

from rosbags.serde import SerdeError

from ftcm_core.errors import FtcmError
from ftcm_core.signals import Vector
from ftcm_ros.transport.codec import CodecError, typestore

FLOAT_ARRAY = "std_msgs/msg/Float64MultiArray"
_LITTLE_ENDIAN = b"\x00\x01\x00\x00"


class FloatArray:
    """Encoder and decoder of the commands of one robot, each number for the joint that is named."""

    def __init__(self, joint_names: tuple[str, ...], order: Sequence[str] = ()) -> None:
        """Say which number is for which joint.

        Args:
            joint_names: of the robot.
            order: the same in the order of the numbers; none: as the robot has them.

        Raises:
            FtcmError: these are not the robot's joints.
        """
        order = tuple(order) or joint_names
        if sorted(order) != sorted(joint_names):
            raise FtcmError(
                f"command_joints: {', '.join(order)} is not possible; expected each of "
                f"{', '.join(joint_names)} once, in the order of the numbers of the command"
            )
        self.order = order
        self._sent = [joint_names.index(name) for name in order]
        self._taken = [order.index(name) for name in joint_names]
        self._struct = struct.Struct(f"<4sIII4x{len(order)}d")  # no dimensions, offset 0, the numbers

    def encode(self, torque: Vector) -> bytes:
        """Encode torques in the robot's order, N·m, as CDR."""
        return self._struct.pack(_LITTLE_ENDIAN, 0, 0, len(self.order), *[torque[i] for i in self._sent])

    def decode(self, data: bytes) -> Vector:
        """Return the torques of a message in the robot's order, N·m.

        Raises:
            CodecError: it cannot be decoded, or has another number of numbers.
        """
        if len(data) == self._struct.size:
            header, dimensions, offset, count, *numbers = self._struct.unpack(data)
            if (header, dimensions, offset, count) == (_LITTLE_ENDIAN, 0, 0, len(self.order)):
                return tuple([numbers[i] for i in self._taken])
        numbers = _read(data)
        if len(numbers) != len(self.order):
            raise CodecError(f"{len(numbers)} numbers for {len(self.order)} joints ({', '.join(self.order)})")
        return tuple([numbers[i] for i in self._taken])


def _read(data: bytes) -> list[float]:
    """Read any Float64MultiArray: with dimensions, which say nothing here, or of another byte order."""
    try:
        message = typestore().deserialize_cdr(data, FLOAT_ARRAY)
    except (SerdeError, struct.error, ValueError, AssertionError, IndexError) as error:
        raise CodecError(f"not a {FLOAT_ARRAY}: {error}") from None
    numbers: list[float] = message.data.tolist()[message.layout.data_offset :]
    return numbers


def joints_of(text: str) -> tuple[str, ...]:
    """Return the joints that the parameter ``command_joints`` names."""
    return tuple(name.strip() for name in text.split(",") if name.strip())
