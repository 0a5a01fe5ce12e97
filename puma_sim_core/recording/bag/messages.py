# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""What stands in a bag: topics, their quality of service, and messages as CDR bytes.

CDR is the encoding that ROS 2 middleware uses for messages. It is written here with padding
bytes of zero, so equal messages are equal bytes; `rclpy.serialization` leaves arbitrary bytes
in the padding. Message types, their definitions and their hashes are those of ROS 2 Jazzy.
"""

import struct
from collections.abc import Sequence
from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np
import yaml
from rosbags.typesys import Stores, get_typestore

STRING = "std_msgs/msg/String"
ARRAY = "std_msgs/msg/Float64MultiArray"
JOINT_STATE = "sensor_msgs/msg/JointState"


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
JOINT_COMMANDS = Topic("joint_commands", JOINT_STATE)
#: the topics of a state in the order in which they are written, with the fields that each holds
STATE_FIELDS = {STATES: ("position", "velocity", "effort"), CURRENTS: ("current",), VOLTAGES: ("voltage",)}
#: command interface -> topic of the commands that name no joints
ARRAY_COMMANDS = {name: Topic(f"{name}_controller/commands", ARRAY) for name in ("voltage", "position")}


@lru_cache(maxsize=1)
def typestore() -> Any:
    """Message types of ROS 2 Jazzy, as the `rosbags` package holds them."""
    return get_typestore(Stores.ROS2_JAZZY)


def definition(type_name: str) -> str:
    """Text of a message type in the ``ros2msg`` form, dependencies included."""
    return typestore().generate_msgdef(type_name, ros_version=2)[0]


def type_hash(type_name: str) -> str:
    """Hash of a message type (REP-2011)."""
    return typestore().hash_rihs01(type_name)


def qos(topic: Topic) -> list[dict[str, Any]]:
    """Offered quality of service of a topic, as rosbag2 writes it at metadata version 9.

    A new list at each call, so that YAML is written without anchors.
    """
    unlimited = {"sec": 9223372036, "nsec": 854775807}
    profile = {
        "history": "keep_last",
        "depth": 1 if topic.latched else 10,
        "reliability": "reliable",
        "durability": "transient_local" if topic.latched else "volatile",
        "deadline": dict(unlimited),
        "lifespan": dict(unlimited),
        "liveliness": "automatic",
        "liveliness_lease_duration": dict(unlimited),
        "avoid_ros_namespace_conventions": False,
    }
    return [profile]


def qos_text(topic: Topic) -> str:
    """`qos` as the text that stands in the channel of an MCAP file."""
    return yaml.safe_dump(qos(topic), sort_keys=False).strip()


def encode_text(text: str) -> bytes:
    """CDR bytes of a ``std_msgs/String``."""
    store = typestore()
    return bytes(store.serialize_cdr(store.types[STRING](text), STRING, little_endian=True))


def decode(data: bytes, type_name: str) -> Any:
    """Message object from CDR bytes; ``ValueError`` if they do not decode."""
    try:
        return typestore().deserialize_cdr(data, type_name)
    except Exception as error:  # the decoder raises several kinds on arbitrary bytes
        raise ValueError(f"{type(error).__name__}: {error}") from error


# Bytes that no valid UTF-8 holds, so they stand in a message only where they were put.
_MARK = bytes.fromhex("f8f9fafbfcfdfef0")
_STAMP_OFFSET = 4  # a std_msgs/Header comes first in its message; 4 bytes of encapsulation


class MismatchError(Exception):
    """A message is not of the expected fixed form; args: its index, what was found, what was expected."""


class FixedMessage:
    """A message whose names and sizes are constant: only its numbers, and its stamp, vary.

    The `rosbags` serializer makes the bytes once, the numbers are then written in place. That
    is some twenty times faster than serializing each message, and gives the same bytes.

    ``counts`` are the lengths of the float64 arrays. With ``names`` the message is a
    ``sensor_msgs/JointState``, without them a ``std_msgs/Float64MultiArray``.
    """

    def __init__(self, counts: Sequence[int], names: Sequence[str] | None = None, frame_id: str = ""):
        types = typestore().types
        arrays = [np.frombuffer(_MARK * count, "<f8") for count in counts]
        if names is None:
            layout = types["std_msgs/msg/MultiArrayLayout"](dim=[], data_offset=0)
            type_name, message = ARRAY, types[ARRAY](layout, *arrays)
        else:
            time = types["builtin_interfaces/msg/Time"](sec=0, nanosec=0)
            header = types["std_msgs/msg/Header"](stamp=time, frame_id=frame_id)
            type_name, message = JOINT_STATE, types[JOINT_STATE](header, list(names), *arrays)
        self.stamped = names is not None
        self._buffer = bytearray(typestore().serialize_cdr(message, type_name, little_endian=True))
        self._constant = np.ones(len(self._buffer), dtype=bool)
        self._constant[_STAMP_OFFSET : _STAMP_OFFSET + 8] = not self.stamped
        self._packers: list[tuple[struct.Struct, int]] = []
        end = 0
        for count in counts:
            start = self._buffer.index(_MARK * count, end)
            end = start + 8 * count
            self._constant[start:end] = False
            self._packers.append((struct.Struct(f"<{count}d"), start))
        self._constant_bytes = np.array(self._buffer)[self._constant]
        self._form = np.dtype(
            {
                "names": ["sec", "nanosec", *map(str, range(len(counts)))],
                "formats": ["<i4", "<u4", *(("<f8", (count,)) for count in counts)],
                "offsets": [_STAMP_OFFSET, _STAMP_OFFSET + 4, *(start for _, start in self._packers)],
                "itemsize": len(self._buffer),
            }
        )

    def encode(self, time_ns: int, *arrays: Sequence[float]) -> bytes:
        """CDR bytes with these numbers; ``struct.error`` if an array has another length."""
        if self.stamped:
            struct.pack_into("<iI", self._buffer, _STAMP_OFFSET, *divmod(time_ns, 1_000_000_000))
        for (packer, start), values in zip(self._packers, arrays, strict=True):
            packer.pack_into(self._buffer, start, *values)
        return bytes(self._buffer)

    def decode(self, messages: Sequence[bytes]) -> tuple[np.ndarray | None, list[np.ndarray]]:
        """Stamps (n,) [ns] (None if there are none) and arrays, each (n, count).

        Raises `MismatchError` with the index of the first message of another form.
        """
        size = len(self._buffer)
        for index, data in enumerate(messages):
            if len(data) != size:
                raise MismatchError(index, f"{len(data)} bytes", f"{size} bytes")
        rows = np.frombuffer(b"".join(messages), self._form)
        same = (rows.view(np.uint8).reshape(-1, size)[:, self._constant] == self._constant_bytes).all(axis=1)
        if not same.all():
            raise MismatchError(int(np.argmin(same)), "other names or array sizes", "those of the first state")
        stamps = rows["sec"].astype(np.int64) * 1_000_000_000 + rows["nanosec"] if self.stamped else None
        return stamps, [rows[str(place)].astype(float) for place in range(len(self._packers))]


def state_forms(joint_names: Sequence[str], frame_id: str) -> dict[Topic, FixedMessage]:
    """The fixed messages of a state, by topic in the order of `STATE_FIELDS`."""
    array = FixedMessage([len(joint_names)])
    return {STATES: FixedMessage([len(joint_names)] * 3, joint_names, frame_id), CURRENTS: array, VOLTAGES: array}
