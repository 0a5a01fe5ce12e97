# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""The example controller as an appraisal meets it: setpoints from a topic, a command for each state, and a reset."""

import sys
from array import array

import rclpy
from rclpy.exceptions import ParameterException
from rclpy.executors import ExternalShutdownException
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray
from std_srvs.srv import Trigger

from puma_sim_core.appraisal.settings import SETPOINT_PERIOD, VOLTAGE_LIMIT
from puma_sim_core.arm.parameters import load_parameters
from puma_sim_core.control.controllers import make_controller
from puma_sim_core.errors import PumaSimError
from puma_sim_ros.external_controller import PARAMETERS, settings_of
from puma_sim_ros.messages import qos, stamp_ns
from puma_sim_ros.startup import ros_started

#: parameters of `external_controller` that mean something here
_OWN = ("parameter_set", "controller", "controllers_file", "gain", "integral_time", "derivative_time")


class AppraisedController(Node):
    """The node ``appraised_controller``: PID, scheduled PID or computed torque, in volts, a sample every 28 ms."""

    def __init__(self) -> None:
        super().__init__("appraised_controller")
        p = {name: self.declare_parameter(name, PARAMETERS[name]).value for name in _OWN}
        arm, settings = load_parameters(p["parameter_set"]), settings_of(p)
        self.controller = make_controller(
            p["controller"], arm, settings, SETPOINT_PERIOD, VOLTAGE_LIMIT, setpoint_period=SETPOINT_PERIOD
        )
        self.setpoint = self.state = None
        self.commands = self.create_publisher(Float64MultiArray, "voltage_controller/commands", qos(10))
        self.create_service(Trigger, "~/reset", self.on_reset)
        self.create_subscription(JointState, "setpoint", self.on_setpoint, qos(10))
        self.create_subscription(JointState, "joint_states", self.on_state, qos(10))

    def on_reset(self, request: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        """Forget the past: a trial begins."""
        self.controller.reset()
        response.success = True
        return response

    def on_setpoint(self, message: JointState) -> None:
        """The setpoint of a state."""
        self.setpoint = message
        self.answer()

    def on_state(self, message: JointState) -> None:
        """A state."""
        self.state = message
        self.answer()

    def answer(self) -> None:
        """Answer a state once its setpoint is there, too."""
        if self.state is None or self.setpoint is None or self.state.header != self.setpoint.header:
            return
        t = stamp_ns(self.state.header.stamp) * 1e-9
        volts = self.controller.update(t, tuple(self.setpoint.position), tuple(self.state.position))
        self.state = self.setpoint = None
        self.commands.publish(Float64MultiArray(data=array("d", volts)))


def main(args: list[str] | None = None) -> int:
    """Entry point of ``appraised_controller``; returns the exit status."""
    try:
        with ros_started(args, SignalHandlerOptions.ALL):
            rclpy.spin(AppraisedController())
    except (PumaSimError, ParameterException) as error:
        print(f"appraised_controller: {error}", file=sys.stderr)
        return 1
    except (KeyboardInterrupt, ExternalShutdownException):
        pass
    return 0


if __name__ == "__main__":
    sys.exit(main())
