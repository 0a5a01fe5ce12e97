# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""What stands in a bag: topics, their quality of service, and messages as CDR bytes.

CDR is the encoding that ROS 2 middleware uses for messages. It is written here with padding
bytes of zero, so equal messages are equal bytes; `rclpy.serialization` leaves arbitrary bytes
in the padding. Message types, their definitions and their hashes are those of ROS 2 Jazzy.
"""

import struct
from collections.abc import Sequence
from functools import lru_cache
from typing import Any

import numpy as np
import yaml
from rosbags.typesys import Stores, get_typestore

from puma_sim_core.recording.topics import ARRAY, CURRENTS, JOINT_STATE, STATES, STRING, VOLTAGES, Topic


@lru_cache(maxsize=1)
def typestore() -> Any:
    """Message types of ROS 2 Jazzy, as the `rosbags` package holds them."""
    return get_typestore(Stores.ROS2_JAZZY)


@lru_cache
def definition(type_name: str) -> str:
    """Text of a message type in the ``ros2msg`` form, dependencies included."""
    return typestore().generate_msgdef(type_name, ros_version=2)[0]


@lru_cache
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


@lru_cache
def qos_text(topic: Topic) -> str:
    """`qos` as the text that stands in the channel of an MCAP file."""
    return yaml.safe_dump(qos(topic), sort_keys=False).strip()


def encode_data(data: str | bool, type_name: str = STRING) -> bytes:
    """CDR bytes of a ``std_msgs/String`` or ``Bool``."""
    store = typestore()
    return bytes(store.serialize_cdr(store.types[type_name](data), type_name, little_endian=True))


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


def names_in(config_text: str) -> dict[str, str]:
    """Full names of topics by the names that stand here, where a session's text tells others; empty otherwise."""
    if "topics" not in config_text:
        return {}  # to read all of it takes longer than many steps of a node
    try:
        names = yaml.safe_load(config_text).get("topics") or {}
        return {str(ours): str(theirs) for ours, theirs in names.items()}
    except (yaml.YAMLError, AttributeError, ValueError, RecursionError):
        return {}


def state_forms(joint_names: Sequence[str], frame_id: str) -> dict[Topic, FixedMessage]:
    """The fixed messages of a state, by topic in the order of `STATE_FIELDS`."""
    array = FixedMessage([len(joint_names)])
    return {STATES: FixedMessage([len(joint_names)] * 3, joint_names, frame_id), CURRENTS: array, VOLTAGES: array}
