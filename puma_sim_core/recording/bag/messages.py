# SPDX-License-Identifier: Apache-2.0
# Copyright the puma-sim contributors
"""What stands in a bag: topics, their quality of service, and messages as CDR bytes.

CDR is the encoding that ROS 2 middleware uses for messages. It is written here with padding
bytes of zero, so equal messages are equal bytes; `rclpy.serialization` leaves arbitrary bytes
in the padding. Message types, their definitions and their hashes are those of ROS 2 Jazzy.
"""

from __future__ import annotations

import struct
from collections.abc import Sequence
from functools import lru_cache
from typing import NamedTuple

import numpy as np
import yaml
from rosbags.typesys import Stores, get_typestore

STRING = "std_msgs/msg/String"
ARRAY = "std_msgs/msg/Float64MultiArray"
JOINT_STATE = "sensor_msgs/msg/JointState"

COMMAND_INTERFACES = ("voltage", "position")


class Topic(NamedTuple):
    """A topic of a bag; ``name`` is relative to the namespace. A latched one is sent once."""

    name: str
    type: str
    latched: bool = False


MODEL = Topic("sim_node/model", STRING, latched=True)
URDF = Topic("robot_description", STRING, latched=True)
STATES = Topic("joint_states", JOINT_STATE)
CURRENTS = Topic("motor_currents", ARRAY)
VOLTAGES = Topic("motor_voltages", ARRAY)
VOLTAGE_COMMANDS = Topic("voltage_controller/commands", ARRAY)
POSITION_COMMANDS = Topic("position_controller/commands", ARRAY)
JOINT_COMMANDS = Topic("joint_commands", JOINT_STATE)


def array_command_topic(command_interface: str) -> Topic:
    """Topic of commands that name no joints, for ``command_interface``."""
    return VOLTAGE_COMMANDS if command_interface == "voltage" else POSITION_COMMANDS


@lru_cache(maxsize=1)
def typestore():
    """Message types of ROS 2 Jazzy, as the `rosbags` package holds them."""
    return get_typestore(Stores.ROS2_JAZZY)


def definition(type_name: str) -> str:
    """Text of a message type in the ``ros2msg`` form, dependencies included."""
    return typestore().generate_msgdef(type_name, ros_version=2)[0]


def type_hash(type_name: str) -> str:
    """Hash of a message type, as ROS 2 defines it (REP-2011)."""
    return typestore().hash_rihs01(type_name)


def qos(topic: Topic) -> list[dict]:
    """Offered quality of service of a topic, as rosbag2 writes it at metadata version 9.

    A new list at each call, so that YAML is written without anchors.
    """

    def unlimited() -> dict[str, int]:
        return {"sec": 9223372036, "nsec": 854775807}

    return [
        {
            "history": "keep_last",
            "depth": 1 if topic.latched else 10,
            "reliability": "reliable",
            "durability": "transient_local" if topic.latched else "volatile",
            "deadline": unlimited(),
            "lifespan": unlimited(),
            "liveliness": "automatic",
            "liveliness_lease_duration": unlimited(),
            "avoid_ros_namespace_conventions": False,
        }
    ]


def qos_text(topic: Topic) -> str:
    """`qos` as the text that stands in the channel of an MCAP file."""
    return yaml.safe_dump(qos(topic), sort_keys=False).strip()


def encode_text(text: str) -> bytes:
    """CDR bytes of a ``std_msgs/String``."""
    store = typestore()
    return bytes(store.serialize_cdr(store.types[STRING](text), STRING, little_endian=True))


def decode(data: bytes, type_name: str):
    """Message object from CDR bytes; ``ValueError`` if they do not decode."""
    try:
        return typestore().deserialize_cdr(data, type_name)
    except Exception as error:  # the decoder raises several kinds on arbitrary bytes
        raise ValueError(f"{type(error).__name__}: {error}") from error


# Bytes that no valid UTF-8 holds, so they stand in a message only where they were put.
_MARK = bytes.fromhex("f8f9fafbfcfdfef0")
_STAMP_OFFSET = 4  # a std_msgs/Header comes first in its message; 4 bytes of encapsulation


class MismatchError(Exception):
    """A message is not of the expected fixed form."""

    def __init__(self, index: int, found: str, expected: str):
        super().__init__(index, found, expected)
        self.index, self.found, self.expected = index, found, expected


class FixedMessage:
    """A message whose names and sizes are constant: only its numbers, and its stamp, vary.

    The `rosbags` serializer makes the bytes once, the numbers are then written in place. That
    is some twenty times faster than serializing each message, and gives the same bytes.

    Parameters
    ----------
    counts : lengths of the float64 arrays, in the order of the message's fields.
    names, frame_id : of a ``sensor_msgs/JointState``; without names the message is a
        ``std_msgs/Float64MultiArray``.
    """

    def __init__(self, counts: Sequence[int], names: Sequence[str] | None = None, frame_id: str = ""):
        store = typestore()
        mark = struct.unpack("<d", _MARK)[0]
        arrays = [np.full(count, mark) for count in counts]
        if names is None:
            layout = store.types["std_msgs/msg/MultiArrayLayout"](dim=[], data_offset=0)
            message, type_name = store.types[ARRAY](layout, *arrays), ARRAY
        else:
            time = store.types["builtin_interfaces/msg/Time"](sec=0, nanosec=0)
            header = store.types["std_msgs/msg/Header"](stamp=time, frame_id=frame_id)
            message, type_name = store.types[JOINT_STATE](header, list(names), *arrays), JOINT_STATE
        self.stamped = names is not None
        self._buffer = bytearray(store.serialize_cdr(message, type_name, little_endian=True))
        self._arrays: list[tuple[int, struct.Struct]] = []
        offset = 0
        for count in counts:
            offset = self._buffer.index(_MARK * count, offset)
            self._arrays.append((offset, struct.Struct(f"<{count}d")))
            offset += 8 * count
        varying = np.zeros(len(self._buffer), dtype=bool)
        for offset, packer in self._arrays:
            varying[offset : offset + packer.size] = True
        if self.stamped:
            varying[_STAMP_OFFSET : _STAMP_OFFSET + 8] = True
        self._constant = ~varying
        self._constant_bytes = np.frombuffer(bytes(self._buffer), np.uint8)[self._constant]

    @property
    def size(self) -> int:
        """Length of the message [bytes]."""
        return len(self._constant)

    def encode(self, time_ns: int, *arrays: Sequence[float]) -> bytes:
        """CDR bytes with these numbers; ``struct.error`` if an array has another length."""
        buffer = self._buffer
        if self.stamped:
            struct.pack_into("<iI", buffer, _STAMP_OFFSET, *divmod(time_ns, 1_000_000_000))
        for (offset, packer), values in zip(self._arrays, arrays, strict=True):
            packer.pack_into(buffer, offset, *values)
        return bytes(buffer)

    def decode(self, messages: Sequence[bytes]) -> tuple[np.ndarray | None, list[np.ndarray]]:
        """Stamps (n,) [ns] (None if there are none) and arrays, each (n, count).

        Raises `MismatchError` with the index of the first message of another form.
        """
        for index, data in enumerate(messages):
            if len(data) != self.size:
                raise MismatchError(index, f"{len(data)} bytes", f"{self.size} bytes")
        rows = np.frombuffer(b"".join(messages), np.uint8).reshape(len(messages), self.size)
        same = (rows[:, self._constant] == self._constant_bytes).all(axis=1)
        if not same.all():
            raise MismatchError(int(np.argmin(same)), "other names or array sizes", "those of the first state")

        def columns(offset: int, size: int, kind: str) -> np.ndarray:
            return np.ascontiguousarray(rows[:, offset : offset + size]).view(kind)

        stamps = None
        if self.stamped:
            seconds = columns(_STAMP_OFFSET, 4, "<i4")[:, 0].astype(np.int64)
            stamps = seconds * 1_000_000_000 + columns(_STAMP_OFFSET + 4, 4, "<u4")[:, 0]
        arrays = [
            columns(offset, packer.size, "<f8").astype(float) if packer.size else np.empty((len(messages), 0))
            for offset, packer in self._arrays
        ]
        return stamps, arrays
