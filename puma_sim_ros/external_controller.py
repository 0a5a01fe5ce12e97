# SPDX-License-Identifier: Apache-2.0
"""An example of a controller outside the simulator: PID control in volts, over topics.

It leads the wrist down a straight vertical line, as in section 7.5 of the thesis: setpoints each
28 ms, one PID for each joint, volts back to the simulator. Each state that arrives is answered
by one command, so the same program works in realtime and in lockstep. Copy it and replace
`control` by your own law.
"""

from __future__ import annotations

import sys
import time
from array import array

import numpy as np
import rclpy
from rclpy.executors import ExternalShutdownException, SingleThreadedExecutor
from rclpy.node import Node
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray
from std_srvs.srv import SetBool

from puma_sim_core.control.pid import Pid, PidGains
from puma_sim_core.control.setpoints import vertical_line
from puma_sim_core.errors import PumaSimError
from puma_sim_core.parameters import load_parameters
from puma_sim_core.recording import Recording, write_csv

from .messages import qos, stamp_ns

PARAMETERS = {
    "joints": ["joint1", "joint2", "joint3"],
    "parameter_set": "bejczy",  # of it only the lengths of the links are used
    "drop": 0.4,  # length of the line [m], downwards
    "duration": 6.0,  # time to move along it [s]
    "settle": 0.5,  # time to stay at its end [s]
    "gain": [150.0, 260.0, 135.0],  # Kg [V/rad], three tenths of the ultimate gains at 28 ms
    "integral_time": [0.15, 0.15, 0.15],  # Ti [s]
    "derivative_time": [0.02, 0.02, 0.02],  # Td [s]
    "voltage_limit": 40.0,  # [V]
    "period": 0.028,  # of the simulator's states [s]
    "timeout": 15.0,  # wait for the simulator no longer than this [s]
    "resume": True,  # start the simulator if it is paused
    "log_path": "",  # CSV file of time, voltages, setpoints and positions
}


class ExternalController(Node):
    """The node ``external_controller``; `done` when the line has been followed."""

    def __init__(self) -> None:
        super().__init__("external_controller")
        p = {name: self.declare_parameter(name, default).value
             for name, default in PARAMETERS.items()}
        self.p = p
        gains = [PidGains(*row) for row in zip(p["gain"], p["integral_time"],
                                               p["derivative_time"])]
        self._pid = Pid(gains, p["period"], limit=p["voltage_limit"])
        self._arm = load_parameters(p["parameter_set"])
        self._setpoints = None
        self._start_ns = self._answered_ns = -1
        self._answered_at = 0.0
        self._command = Float64MultiArray()
        self.rows = []
        self.done = False
        self.heard_at = time.monotonic()
        self.publisher = self.create_publisher(Float64MultiArray, "voltage_controller/commands",
                                               qos(10))
        self.resume = self.create_client(SetBool, "sim_node/pause")
        self.create_subscription(JointState, "joint_states", self._on_state, qos(10))

    def ready(self) -> bool:
        """Whether the simulator listens, so that no command is lost."""
        return self.publisher.get_subscription_count() > 0

    def _on_state(self, message: JointState) -> None:
        self.heard_at = time.monotonic()
        if self.done or not self.ready():
            return
        time_ns = stamp_ns(message.header.stamp)
        if time_ns == self._answered_ns:
            # in lockstep the simulator sends a state again after half a second without an answer
            if self.heard_at - self._answered_at > 0.25:
                self.publisher.publish(self._command)
                self._answered_at = self.heard_at
            return
        by_name = dict(zip(message.name, message.position))
        position = [by_name[name] for name in self.p["joints"]]
        volts = self.control(time_ns, position)
        if volts is not None:
            self._command.data = array("d", volts)
            self.publisher.publish(self._command)
            self._answered_ns, self._answered_at = time_ns, self.heard_at

    def control(self, time_ns: int, position: list[float]) -> tuple[float, ...] | None:
        """Volts for the state of simulated time `time_ns` [ns]; None at the end of the line."""
        if self._setpoints is None:
            self._start_ns = time_ns
            self._setpoints = self._plan(position)
        seconds = (time_ns - self._start_ns) * 1e-9
        place = round(seconds / self.p["period"])
        if place >= len(self._setpoints):
            self.done = True
            return None
        setpoint = self._setpoints[place]
        volts = self._pid.update(seconds, setpoint, position)
        self.rows.append((time_ns * 1e-9, volts, setpoint, tuple(position)))
        return volts

    def _plan(self, position: list[float]) -> list[tuple[float, ...]]:
        """Setpoints [rad] along the line from the present position, then at its end."""
        _, line = vertical_line(self._arm, position, -self.p["drop"], self.p["duration"],
                                self.p["period"])
        stay = [line[-1]] * round(self.p["settle"] / self.p["period"])
        return [tuple(row) for row in [*line.tolist(), *stay]]

    def recording(self) -> Recording:
        """What was done, as a table."""
        columns = [np.array(column) for column in zip(*self.rows)]
        return Recording(time=columns[0], voltage=columns[1], setpoint=columns[2],
                         position=columns[3])


def report(recording: Recording, period: float) -> str:
    """Lines for a person: tracking errors, and states that never arrived."""
    error = np.degrees(recording.setpoint - recording.position)
    rms, worst = np.sqrt((error**2).mean(axis=0)), np.abs(error).max(axis=0)
    missed = round((recording.time[-1] - recording.time[0]) / period) + 1 - len(recording)
    lines = [f"tracking error of joint {j + 1}: rms {rms[j]:.3f} deg, worst {worst[j]:.3f} deg"
             for j in range(3)]
    return "\n".join([*lines, f"states answered: {len(recording)}, missed: {missed}"])


def _run(node: ExternalController) -> str | None:
    """Follow the line; returns what went wrong."""
    executor = SingleThreadedExecutor()
    executor.add_node(node)
    resumed = not node.p["resume"]
    while not node.done:
        executor.spin_once(timeout_sec=0.1)
        if not resumed and node.ready() and node.resume.service_is_ready():
            node.resume.call_async(SetBool.Request(data=False))
            resumed = True
        if time.monotonic() - node.heard_at > node.p["timeout"]:
            topic = node.resolve_topic_name("joint_states")
            return (f"no state on {topic} for {node.p['timeout']:g} s; is a sim_node running in "
                    "this namespace and ROS_DOMAIN_ID, with command_interface voltage?")
    return None


def main(args=None) -> int:
    """Entry point of ``external_controller``; returns the exit status."""
    rclpy.init(args=args)
    try:
        node = ExternalController()
        problem = _run(node)
        if problem is None and node.rows:
            recording = node.recording()
            if node.p["log_path"]:
                write_csv(recording, node.p["log_path"])
            print(report(recording, node.p["period"]), flush=True)
            return 0
    except PumaSimError as error:
        problem = str(error)
    except (KeyboardInterrupt, ExternalShutdownException):
        problem = "interrupted"
    finally:
        rclpy.try_shutdown()
    print(f"external_controller: {problem}", file=sys.stderr)
    return 1


if __name__ == "__main__":
    sys.exit(main())
