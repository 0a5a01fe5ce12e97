# SPDX-License-Identifier: Apache-2.0
# Copyright the puma-sim contributors
"""Between the session's tuples and ROS messages.

The messages that go out at each step are made once and filled again: rclpy serialises a message
while it publishes it, so nobody else sees the object. `array('d')` fields are what its fast path
takes.
"""

from __future__ import annotations

from array import array
from collections.abc import Mapping, Sequence

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray


def qos(depth: int, *, latched: bool = False) -> QoSProfile:
    """Reliable, keep last `depth`; `latched` messages reach those who subscribe later, too."""
    durability = DurabilityPolicy.TRANSIENT_LOCAL if latched else DurabilityPolicy.VOLATILE
    return QoSProfile(depth=depth, reliability=ReliabilityPolicy.RELIABLE, durability=durability)


def set_stamp(stamp, time_ns: int) -> None:
    """Write a time [ns] into a builtin_interfaces/Time."""
    stamp.sec, stamp.nanosec = divmod(time_ns, 1_000_000_000)


def stamp_ns(stamp) -> int:
    """Time [ns] of a builtin_interfaces/Time."""
    return stamp.sec * 1_000_000_000 + stamp.nanosec


class StateMessages:
    """The messages of one state, for joints of the given names."""

    def __init__(self, joint_names: Sequence[str], frame_id: str) -> None:
        self._joints = JointState(name=list(joint_names))
        self._joints.header.frame_id = frame_id
        self._currents = Float64MultiArray()
        self._voltages = Float64MultiArray()
        self._clock = Clock()

    def joint_state(self, state) -> JointState:
        """Positions [rad], velocities [rad/s], efforts at the joints [N.m], simulated time."""
        message = self._joints
        set_stamp(message.header.stamp, state.time_ns)
        message.position = array("d", state.position)
        message.velocity = array("d", state.velocity)
        message.effort = array("d", state.effort)
        return message

    def currents(self, state) -> Float64MultiArray:
        """Motor currents [A]."""
        self._currents.data = array("d", state.current)
        return self._currents

    def voltages(self, state) -> Float64MultiArray:
        """Voltages applied during the step that led to the state [V]."""
        self._voltages.data = array("d", state.voltage)
        return self._voltages

    def clock(self, state) -> Clock:
        """Simulated time."""
        set_stamp(self._clock.clock, state.time_ns)
        return self._clock


def diagnostics(now, name: str, level: bytes, message: str, values: Mapping[str, object]) -> DiagnosticArray:
    """A DiagnosticArray with one status; `now` is the stamp, a builtin_interfaces/Time."""
    status = DiagnosticStatus(level=level, name=name, message=message, hardware_id="puma560")
    status.values = [KeyValue(key=key, value=str(value)) for key, value in values.items()]
    array_message = DiagnosticArray(status=[status])
    array_message.header.stamp = now
    return array_message
