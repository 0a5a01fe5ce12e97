# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""Over ROS 2 topics: a proportional controller that holds a pose. Start it beside `sim_node`.

It answers each of the first 50 states with three motor voltages, prints the last position and ends.
"""

from __future__ import annotations

import rclpy
from rclpy.node import Node
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray

POSE = (0.1, -0.1, 0.1)  # rad
GAIN = (60.0, 90.0, 50.0)  # V/rad
STATES = 50


class Hold(Node):
    """Holds `POSE`; `left` counts the states that are still to be answered."""

    def __init__(self) -> None:
        super().__init__("hold")
        self.left = STATES
        self.position = [0.0, 0.0, 0.0]
        self._commands = self.create_publisher(Float64MultiArray, "voltage_controller/commands", 10)
        self.create_subscription(JointState, "joint_states", self._on_state, 10)

    def _on_state(self, state: JointState) -> None:
        self.position = list(state.position)
        volts = [gain * (wanted - q) for gain, wanted, q in zip(GAIN, POSE, state.position, strict=True)]
        self._commands.publish(Float64MultiArray(data=volts))
        self.left -= 1


if __name__ == "__main__":
    rclpy.init()
    node = Hold()
    try:
        while node.left > 0:
            rclpy.spin_once(node)
        print(f"position after {STATES} states [rad]:", [round(q, 4) for q in node.position])
    finally:
        node.destroy_node()
        rclpy.shutdown()
