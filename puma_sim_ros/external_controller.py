# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""An example of a controller outside the simulator: control in volts, over topics.

It leads the wrist down a straight vertical line, as in section 7.5 of the thesis: setpoints every
28 ms, volts back to the simulator, by PID, scheduled PID or computed torque: the same objects
that the simulator has inside. Each state that arrives is answered by one command, so the same
program works in realtime and in lockstep. To try another law, copy this file and give
`connect` another object with `reset()` and `update(t, setpoint, measurement) -> volts`.
"""

import signal
import sys
import time
from array import array
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
from rcl_interfaces.msg import Parameter as ParameterMessage
from rclpy.exceptions import ParameterException
from rclpy.executors import ExternalShutdownException, SingleThreadedExecutor
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.parameter_client import AsyncParameterClient
from rclpy.signals import SignalHandlerOptions
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray

from puma_sim_core.arm.parameters import load_parameters
from puma_sim_core.control.controllers import KINDS, load_settings, make_controller
from puma_sim_core.control.setpoints import vertical_line
from puma_sim_core.errors import PumaSimError
from puma_sim_core.recording.recording import Recording, write_csv
from puma_sim_ros.messages import qos, stamp_ns
from puma_sim_ros.startup import ros_started

PARAMETERS = {
    "simulator": "sim_node",  # its name
    "parameter_set": "bejczy",  # the arm, as path and computed torque know it
    "controller": "pid",  # pid, scheduled or computed_torque
    "controllers_file": "",  # YAML file with settings; config/controllers.yaml when empty
    "drop": 0.25,  # length of the line [m], downwards
    "duration": 6.0,  # time to move along it [s]
    "settle": 0.5,  # time to stay at its end [s]
    # of controller pid:
    "gain": [150.0, 260.0, 135.0],  # Kg [V/rad], three tenths of the ultimate gains at 28 ms
    "integral_time": [0.15, 0.15, 0.15],  # Ti [s]
    "derivative_time": [0.02, 0.02, 0.02],  # Td [s]
    "timeout": 30.0,  # longest wait for an answer of the simulator [s]
    "log_path": "",  # CSV file to write: time, voltages, setpoints, positions
}


class ControllerError(PumaSimError):
    """The simulator does not answer, or is not one for this controller."""


def settings_of(p: Mapping[str, Any]) -> dict:
    """Settings of the controller that parameters describe; raises ControllerError on what cannot be."""
    kind, path = p["controller"], p["controllers_file"]
    if kind not in KINDS:
        raise ControllerError(kind, where="parameter 'controller'", expected=" or ".join(KINDS))
    if kind != "pid":
        return load_settings(kind, "external", path or None)
    columns = {name: list(p[name]) for name in ("gain", "integral_time", "derivative_time")}
    if any(len(column) != 3 for column in columns.values()):
        expected = "three numbers of each, one for each joint"
        raise ControllerError(f"gains {list(columns.values())}", expected=expected)
    return {**columns, "derivative_on_measurement": False}


class ExternalController(Node):
    """The node ``external_controller``; `done` when the line has been followed."""

    def __init__(self, name: str = "external_controller", parameters=PARAMETERS) -> None:
        super().__init__(name)
        self.p = {name: self.declare_parameter(name, default).value for name, default in parameters.items()}
        self.arm = load_parameters(self.p["parameter_set"])
        self.settings = self.controller_settings()
        self.spinner = SingleThreadedExecutor()
        self.spinner.add_node(self)
        self.controller = self.setpoints = None
        self.rows, self.done = [], False
        self.answered_ns, self.first = -1, True
        self.heard_at = time.monotonic()
        self.command = Float64MultiArray()
        self.publisher = self.create_publisher(Float64MultiArray, "voltage_controller/commands", qos(10))
        self.create_subscription(JointState, "joint_states", self.on_state, qos(10))
        # made last: a simulator that answers it has found the two topics before, and no command is lost
        self.simulator = AsyncParameterClient(self, self.p["simulator"])

    def controller_settings(self) -> dict:
        """Settings of the controller."""
        return settings_of(self.p)

    def connect(self) -> None:
        """Ask the simulator for its parameters, and start it if it is paused."""
        self.wait_until(self.simulator.services_are_ready, "its parameter services")
        names = ["command_interface", "joints", "period", "voltage_limit", "paused"]
        values = [parameter_value(message) for message in self.answer(self.simulator.get_parameters, names).values]
        interface, self.joints, self.period, limit, paused = values
        if interface != "voltage":
            raise ControllerError(f"command_interface is {interface}", where=self.p["simulator"], expected="voltage")
        self.wait_until(lambda: self.publisher.get_subscription_count() > 0, "its subscription of commands")
        self.controller = self.make_controller(limit)
        if paused:
            self.answer(self.simulator.set_parameters, [Parameter("paused", value=False)])

    def make_controller(self, limit: float):
        """The controller, for motors that take up to `limit` [V]."""
        return make_controller(
            self.p["controller"], self.arm, self.settings, self.period, limit, setpoint_period=self.period
        )

    def on_state(self, message: JointState) -> None:
        """Answer a state with a command."""
        if self.controller is None or self.done:
            return
        self.heard_at = time.monotonic()
        time_ns = stamp_ns(message.header.stamp)
        if time_ns == self.answered_ns:
            # in lockstep the simulator may send a state again as long as no command has come
            if self.first:
                self.publisher.publish(self.command)
            return
        self.first = self.answered_ns < 0
        position = dict(zip(message.name, message.position))
        volts = self.control(time_ns * 1e-9, [position[name] for name in self.joints])
        if volts is not None:
            self.command.data = array("d", volts)
            self.answered_ns = time_ns
            self.publisher.publish(self.command)

    def control(self, t: float, position: list[float]) -> tuple[float, ...] | None:
        """Volts for positions [rad] at simulated time t [s]; None when the path is over."""
        if self.setpoints is None:
            self.start = t
            _, self.setpoints = vertical_line(self.arm, position, -self.p["drop"], self.p["duration"], self.period)
        if t - self.start > self.p["duration"] + self.p["settle"]:
            self.done = True
            return None
        # by time, not by counting: a state that never came leaves no offset
        place = min(round((t - self.start) / self.period), len(self.setpoints) - 1)
        setpoint = tuple(self.setpoints[place].tolist())
        volts = self.controller.update(t, setpoint, position)
        self.rows.append((t, volts, setpoint, tuple(position)))
        return volts

    def wait_until(self, condition, what: str, repeat=lambda: None) -> None:
        """Spin until `condition()` holds, calling `repeat()` every 2 s; raises ControllerError, which names what was
        waited for, after a long silence."""
        self.heard_at = repeated_at = time.monotonic()
        while not condition():
            self.spinner.spin_once(timeout_sec=0.1)
            now = time.monotonic()
            if now - repeated_at > 2.0:
                repeat()
                repeated_at = now
            if now - self.heard_at > self.p["timeout"]:
                found = f"no answer for {self.p['timeout']:g} s: waited for {what}"
                expected = "a sim_node of that name in this namespace and ROS_DOMAIN_ID"
                raise ControllerError(found, where=self.p["simulator"], expected=expected)

    def answer(self, call, argument):
        """The result of a service call, which is repeated while no answer comes: a service drops its
        answer when it has not yet discovered who asks."""
        futures = [call(argument)]
        self.wait_until(
            lambda: any(future.done() for future in futures),
            "an answer about its parameters",
            lambda: futures.append(call(argument)),
        )
        return next(future.result() for future in futures if future.done())

    def recording(self) -> Recording:
        """What was done, as a table."""
        time_s, voltage, setpoint, position = (np.array(column) for column in zip(*self.rows))
        return Recording(time=time_s, voltage=voltage, setpoint=setpoint, position=position)


def parameter_value(message):
    """The Python value of an rcl_interfaces/ParameterValue."""
    return Parameter.from_parameter_msg(ParameterMessage(name="value", value=message)).value


def report(recording: Recording, period: float) -> str:
    """Lines for a person: tracking errors, and states that never arrived."""
    error = np.degrees(recording.setpoint - recording.position)
    rms, worst = np.sqrt((error**2).mean(axis=0)), np.abs(error).max(axis=0)
    missed = round((recording.time[-1] - recording.time[0]) / period) + 1 - len(recording)
    lines = [f"tracking error of joint {j + 1}: rms {rms[j]:.3f} deg, worst {worst[j]:.3f} deg" for j in range(3)]
    return "\n".join([*lines, f"states answered: {len(recording)}, missed: {missed}"])


def run_to_its_end(name: str, make: Callable[[], ExternalController], finish: Callable[..., None], args=None) -> int:
    """Make a controller's node, connect it, wait until it is done, and finish; returns the exit status, 0 as well
    where it was interrupted."""
    try:
        with ros_started(args, SignalHandlerOptions.ALL):
            try:
                node = make()
                node.connect()
                node.wait_until(lambda: node.done, "its next state")
                finish(node)
            except (KeyboardInterrupt, ExternalShutdownException):
                # `ros2 launch` sends on what the terminal has sent, and takes another status than 0 for a failure
                signal.signal(signal.SIGINT, signal.SIG_IGN)
                print(f"{name}: interrupted", file=sys.stderr)
        return 0
    except (PumaSimError, ParameterException) as error:
        print(f"{name}: {error}", file=sys.stderr)
        return 1


def _finish(node: ExternalController) -> None:
    recording = node.recording()
    if node.p["log_path"]:
        write_csv(recording, node.p["log_path"])
    print(report(recording, node.period), flush=True)


def main(args=None) -> int:
    """Entry point of ``external_controller``; returns the exit status."""
    return run_to_its_end("external_controller", ExternalController, _finish, args)


if __name__ == "__main__":
    sys.exit(main())
