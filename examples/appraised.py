# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""A controller that an appraisal starts, over ROS 2 topics. It uses rclpy alone, and nothing of this project.

  ros2 run puma_sim_ros appraise --ros-args -p out:=board -p controllers:=[mine,pid] \
      -p mine.command:="python3 appraised.py voltage"

`python3 appraised.py voltage` is a PID controller in volts; `python3 appraised.py position` sends the setpoints of the
digital servo, each two periods early (or as many as a number behind it says). To try a law of your own, write another
class like `Pid`.
"""

from __future__ import annotations

import sys

import rclpy
from rclpy.executors import ExternalShutdownException
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile
from rclpy.utilities import remove_ros_args
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray
from trajectory_msgs.msg import JointTrajectory

PERIOD = 0.028  # s, between two states
LIMIT = 40.0  # V


class Pid:
    """Three PID controllers: setpoints and positions [rad] in, volts out."""

    gain = (150.0, 260.0, 135.0)  # V/rad
    integral_time, derivative_time = 0.15, 0.02  # s
    period = PERIOD

    def reset(self) -> None:
        """Forget the past."""
        self.sum = [0.0, 0.0, 0.0]  # V
        self.before: list[float] | None = None

    def update(self, t: float, setpoint: list[float], measurement: list[float]) -> list[float]:
        """Volts for one state."""
        error = [wanted - q for wanted, q in zip(setpoint, measurement)]
        before, self.before = self.before or error, error
        volts = []
        for j, (gain, now, last) in enumerate(zip(self.gain, error, before)):
            rate = self.derivative_time * (now - last) / PERIOD
            more = gain * PERIOD / self.integral_time * now
            # what has no effect behind the limit is not summed up
            if abs(gain * (now + rate) + self.sum[j] + more) < LIMIT:
                self.sum[j] += more
            volts.append(gain * (now + rate) + self.sum[j])
        return volts


class Early:
    """The setpoints of a trial, each some periods early: two are about the lag of the servo that follows them."""

    def __init__(self, reference: list[list[float]], periods: int) -> None:
        self.reference, self.periods = reference, periods

    def update(self, t: float, setpoint: list[float], measurement: list[float]) -> list[float]:
        """Setpoints for one state [rad]."""
        return self.reference[min(round(t / PERIOD) + self.periods, len(self.reference) - 1)]


class Appraised(Node):
    """Answers each state of a trial with one command.

    interface : voltage, or position with setpoints that come some periods early.
    """

    def __init__(self, interface: str, early: int) -> None:
        super().__init__("appraised")
        self.interface, self.early, self.law = interface, early, None
        self.trial = ""
        self.reference = self.state = None
        self.commands = self.create_publisher(Float64MultiArray, f"{interface}_controller/commands", 10)
        latched = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
        self.create_subscription(JointTrajectory, "reference", self.on_reference, latched)
        self.create_subscription(JointState, "joint_states", self.on_state, 10)

    def on_reference(self, message: JointTrajectory) -> None:
        """Setpoints of the trial."""
        self.reference = message
        self.answer()

    def on_state(self, message: JointState) -> None:
        """A state."""
        self.state = message
        self.answer()

    def answer(self) -> None:
        """Answer the last state, once the reference of its trial is there."""
        if self.state is None or self.reference is None:
            return
        header, trial = self.state.header, self.reference.header.frame_id
        if header.frame_id != trial:
            return
        if self.trial != trial:
            self.trial = trial
            self.begin()
        t = header.stamp.sec + 1e-9 * header.stamp.nanosec
        setpoint = self.points[round(t / PERIOD)]
        command = self.law.update(t, setpoint, list(self.state.position))
        self.state = None
        self.commands.publish(Float64MultiArray(data=command))

    def begin(self) -> None:
        """Begin a trial."""
        self.points = [list(point.positions) for point in self.reference.points]
        if self.interface == "position":
            self.law = Early(self.points, self.early)
        else:
            self.law = Pid()
            self.law.reset()


def main() -> None:
    """Answer states until the appraisal ends this process."""
    rclpy.init()
    _, interface, *early = remove_ros_args(sys.argv)
    node = Appraised(interface, int(early[0]) if early else 2)
    try:
        rclpy.spin(node)
    except (KeyboardInterrupt, ExternalShutdownException):
        pass
    finally:
        rclpy.try_shutdown()


if __name__ == "__main__":
    main()
