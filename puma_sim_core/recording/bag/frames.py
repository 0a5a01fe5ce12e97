# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""The frames of the arm as ``tf2_msgs/TFMessage``, from its URDF: programs that draw a robot move it by them.

The bytes are made once by `rosbags`; what varies, stamps and rotations of the joints, is written in place. A publisher
of ROS takes the same bytes.
"""

import struct
import xml.etree.ElementTree as ET
from collections.abc import Sequence
from math import cos, sin
from typing import Any, NamedTuple

from puma_sim_core.recording.bag.messages import typestore
from puma_sim_core.recording.topics import TF_MESSAGE

Quaternion = tuple[float, float, float, float]
#: stands in the message only where a stamp (seconds, nanoseconds) and a rotation is written later
_STAMP = struct.pack("<iI", 0x71727374, 0x75767778)
_ROTATION = struct.pack("<4d", 1.25e300, -1.25e300, 1.5e300, -1.5e300)


class _Joint(NamedTuple):
    parent: str
    child: str
    place: tuple[float, ...]  #: of the child in the parent [m]
    turned: Quaternion  #: of the child in the parent at angle 0, (x, y, z, w)


class FrameMessages:
    """Messages for the arm of a URDF text, whose joints turn about z of their child.

    joint_names : the joints in the order of the angles. ``fixed`` is the message of what does not move.
    """

    def __init__(self, urdf: str, joint_names: Sequence[str]):
        found = {joint.get("name"): joint for joint in ET.fromstring(urdf).iterfind("joint")}
        moving = [_joint(found.pop(name)) for name in joint_names]
        self.fixed = _encode([(joint, 0, 0, joint.turned) for joint in map(_joint, found.values())])
        stamp, rotation = struct.unpack("<iI", _STAMP), struct.unpack("<4d", _ROTATION)
        self._buffer = bytearray(_encode([(joint, *stamp, rotation) for joint in moving]))
        self._turned = [joint.turned for joint in moving]
        self._places: list[tuple[int, int]] = []
        end = 0
        for _ in moving:
            first = self._buffer.index(_STAMP, end)
            end = self._buffer.index(_ROTATION, first)
            self._places.append((first, end))

    def encode(self, time_ns: int, angles: Sequence[float]) -> bytes:
        """CDR bytes at a time [ns] for the angles [rad] of the joints."""
        stamp = divmod(time_ns, 1_000_000_000)
        for (place, rotation), turned, angle in zip(self._places, self._turned, angles, strict=True):
            struct.pack_into("<iI", self._buffer, place, *stamp)
            turn = (0.0, 0.0, sin(angle / 2), cos(angle / 2))
            struct.pack_into("<4d", self._buffer, rotation, *_product(turned, turn))
        return bytes(self._buffer)


def _joint(element: ET.Element) -> _Joint:
    def of(tag: str, name: str) -> str:
        return element.find(tag).get(name)  # type: ignore[union-attr, return-value]

    place = tuple(map(float, of("origin", "xyz").split()))
    roll, pitch, yaw = ((sin(a / 2), cos(a / 2)) for a in map(float, of("origin", "rpy").split()))
    # about the fixed axes x, y, z in this order
    about = (0.0, 0.0, *yaw), (0.0, pitch[0], 0.0, pitch[1]), (roll[0], 0.0, 0.0, roll[1])
    return _Joint(of("parent", "link"), of("child", "link"), place, _product(_product(*about[:2]), about[2]))


def _product(p: Quaternion, q: Quaternion) -> Quaternion:
    (a, b, c, d), (x, y, z, w) = p, q
    return (
        d * x + a * w + b * z - c * y,
        d * y - a * z + b * w + c * x,
        d * z + a * y - b * x + c * w,
        d * w - a * x - b * y - c * z,
    )


def _encode(transforms: Sequence[tuple[_Joint, int, int, Quaternion]]) -> bytes:
    store = typestore()

    def make(name: str, **fields: Any) -> Any:
        return store.types[name](**fields)

    messages = []
    for joint, sec, nanosec, (x, y, z, w) in transforms:
        stamp = make("builtin_interfaces/msg/Time", sec=sec, nanosec=nanosec)
        header = make("std_msgs/msg/Header", stamp=stamp, frame_id=joint.parent)
        translation = make("geometry_msgs/msg/Vector3", **dict(zip("xyz", joint.place)))
        rotation = make("geometry_msgs/msg/Quaternion", x=x, y=y, z=z, w=w)
        transform = make("geometry_msgs/msg/Transform", translation=translation, rotation=rotation)
        child = {"header": header, "child_frame_id": joint.child, "transform": transform}
        messages.append(make("geometry_msgs/msg/TransformStamped", **child))
    return bytes(store.serialize_cdr(make(TF_MESSAGE, transforms=messages), TF_MESSAGE, little_endian=True))
