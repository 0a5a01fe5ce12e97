# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""Between the session's tuples and ROS messages."""

from array import array
from collections.abc import Mapping, Sequence

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from rclpy.event_handler import PublisherEventCallbacks
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray, Header

from puma_sim_core.simulation.session import SessionState

#: messages that may wait where each of them counts: half a minute at the rate of the robot
LOSSLESS = 1000


def qos(depth: int, *, latched: bool = False) -> QoSProfile:
    """Reliable, keep last `depth`; `latched` messages reach those who subscribe later, too."""
    durability = DurabilityPolicy.TRANSIENT_LOCAL if latched else DurabilityPolicy.VOLATILE
    return QoSProfile(depth=depth, reliability=ReliabilityPolicy.RELIABLE, durability=durability)


def stamp_ns(stamp) -> int:
    """Time [ns] of a builtin_interfaces/Time."""
    return stamp.sec * 1_000_000_000 + stamp.nanosec


class StatePublishers:
    """Publishes the states of a node's session.

    The messages are made once and filled again: rclpy serialises a message while it publishes it,
    so nobody else sees the object. `array('d')` fields are what its fast path takes.
    """

    def __init__(
        self, node: Node, joint_names: Sequence[str], frame_id: str, clock: bool, events: PublisherEventCallbacks
    ) -> None:
        self._joints = JointState(name=list(joint_names), header=Header(frame_id=frame_id))
        self._array, self._clock = Float64MultiArray(), Clock()
        self._joint_publisher = node.create_publisher(JointState, "joint_states", qos(10), event_callbacks=events)
        self._current_publisher = node.create_publisher(Float64MultiArray, "motor_currents", qos(10))
        self._voltage_publisher = node.create_publisher(Float64MultiArray, "motor_voltages", qos(10))
        self._clock_publisher = node.create_publisher(Clock, "/clock", qos(10)) if clock else None

    @property
    def subscriptions(self) -> int:
        """Subscriptions to joint_states."""
        return self._joint_publisher.get_subscription_count()

    def publish(self, state: SessionState) -> None:
        """Publish a state; joint_states last: who reacts to it has had the rest."""
        sec, nanosec = divmod(state.time_ns, 1_000_000_000)
        if self._clock_publisher is not None:
            self._clock.clock.sec, self._clock.clock.nanosec = sec, nanosec
            self._clock_publisher.publish(self._clock)
        for publisher, values in ((self._current_publisher, state.current), (self._voltage_publisher, state.voltage)):
            self._array.data = array("d", values)
            publisher.publish(self._array)
        joints = self._joints
        joints.header.stamp.sec, joints.header.stamp.nanosec = sec, nanosec
        for name in ("position", "velocity", "effort"):
            setattr(joints, name, array("d", getattr(state, name)))
        self._joint_publisher.publish(joints)


def diagnostics(now, name: str, level: bytes, message: str, values: Mapping[str, object]) -> DiagnosticArray:
    """A DiagnosticArray with one status; `now` is the stamp, a builtin_interfaces/Time."""
    status = DiagnosticStatus(level=level, name=name, message=message, hardware_id="puma560")
    status.values = [KeyValue(key=key, value=str(value)) for key, value in values.items()]
    return DiagnosticArray(header=Header(stamp=now), status=[status])
