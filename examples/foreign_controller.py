# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""A controller from the documentation alone, without any import of puma-sim, for each interface and mode of `sim_node`.

`python foreign_controller.py voltage|position|joints`: voltages, setpoints, or setpoints by the names of the joints.
"""

import math
import sys

import rclpy
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray

GAINS = ((150.0, 1000.0, 3.0), (260.0, 1700.0, 5.0), (135.0, 900.0, 2.7))  # V/rad, V/(rad s), V s/rad
PATH, DURATION = (0.3, -0.3, 0.2), 4.0  # there and back [rad], each joint, in this time [s]


class Controller:
    def __init__(self, node, interface):
        self.interface, self.first, self.last, self.errors, self.sums = interface, None, None, [], [0.0] * 3
        kind = JointState if interface == "joints" else Float64MultiArray
        topic = "joint_commands" if interface == "joints" else f"{interface}_controller/commands"
        self.publisher = node.create_publisher(kind, topic, 10)
        node.create_subscription(JointState, "joint_states", self.on_state, 10)

    def on_state(self, state):
        time, q = state.header.stamp.sec + 1e-9 * state.header.stamp.nanosec, state.position
        if self.first is None:
            self.first, self.start = time, q
        if self.last == time != self.first:
            return  # in lockstep each command makes a step: a state is answered once, the first one until it is heard
        dt, self.last = 0.0 if self.last is None else time - self.last, time
        share = 0.5 - 0.5 * math.cos(2.0 * math.pi * (time - self.first) / DURATION)
        wanted = [start + share * path for start, path in zip(self.start, PATH)]
        error = [r - measured for r, measured in zip(wanted, q)]
        self.errors.append(math.hypot(*error))
        self.sums = [total + e * dt for total, e in zip(self.sums, error)]
        volts = [kp * e + ki * s - kd * w for (kp, ki, kd), e, s, w in zip(GAINS, error, self.sums, state.velocity)]
        array = Float64MultiArray(data=volts if self.interface == "voltage" else wanted)
        by_name = JointState(name=state.name, position=wanted)
        self.publisher.publish(by_name if self.interface == "joints" else array)


rclpy.init()
node = rclpy.create_node("foreign_controller")
controller = Controller(node, sys.argv[1])
while controller.last is None or controller.last - controller.first < DURATION:
    rclpy.spin_once(node)
rms, greatest = math.sqrt(sum(e * e for e in controller.errors) / len(controller.errors)), max(controller.errors)
print(f"{len(controller.errors)} states answered, error: rms {rms:.4f} rad, greatest {greatest:.4f} rad")
