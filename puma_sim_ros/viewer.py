# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""The arm of a running `sim_node` in the browser, with buttons that pause, step and reset it."""

import signal
import sys
import time
from collections import deque
from math import inf, isfinite

from rcl_interfaces.msg import ParameterDescriptor
from rclpy.exceptions import ParameterException
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray, String
from std_srvs.srv import SetBool, Trigger

from puma_sim_core.errors import PumaSimError
from puma_sim_core.view.chain import chain_of_urdf
from puma_sim_core.view.live import Live, Sample
from puma_sim_core.view.server import HOST, address, serving
from puma_sim_ros.messages import LOSSLESS, qos, stamp_ns
from puma_sim_ros.startup import ros_started

PARAMETERS = {
    "simulator": ("sim_node", "Name of the simulator's node."),
    "host": (HOST, "Address to listen on; 127.0.0.1 is this machine alone."),
    "port": (-1, "Port to listen on; -1: the first free one from 8080 on."),
}
#: a button -> the service of the simulator, and the fields of its request
BUTTONS = {
    "Pause": ("pause", SetBool, {"data": True}),
    "Resume": ("pause", SetBool, {"data": False}),
    "Step": ("step", Trigger, {}),
    "Reset": ("reset", Trigger, {}),
}
#: longest wait before the page is drawn again [s]
_LONGEST_WAIT = 0.02
#: from the simulator's model to the page [s]
_DISCOVERY = 0.5
#: states that wait while a page is drawn
_STATES = qos(LOSSLESS)
_SETPOINTS = "position_controller/commands"


class Viewer(Node):
    """The node ``viewer``; its parameters are `PARAMETERS`."""

    def __init__(self) -> None:
        super().__init__("viewer")
        self.p = {
            name: self.declare_parameter(name, default, ParameterDescriptor(description=text, read_only=True)).value
            for name, (default, text) in PARAMETERS.items()
        }
        self.urdf = self.page = None
        self.ready_at, self._held, self._has_setpoints = inf, None, False
        self._time_ns, self._latest, self._pressed = 0, {}, deque()
        services = {service: kind for service, kind, _ in BUTTONS.values()}
        self._of_simulator = {
            name: self.create_client(kind, f"{self.p['simulator']}/{name}") for name, kind in services.items()
        }
        self.create_subscription(String, "robot_description", self._on_description, qos(1, latched=True))
        arrays = {"voltage": "motor_voltages", "current": "motor_currents", "setpoint": _SETPOINTS}
        for name, topic in arrays.items():
            self.create_subscription(Float64MultiArray, topic, lambda m, name=name: self._on_array(name, m), _STATES)
        self.create_subscription(JointState, "joint_states", self._on_state, _STATES)

    def _on_description(self, message: String) -> None:
        self.urdf = message.data
        # by then the topics of its node are known, too
        self.ready_at = time.monotonic() + _DISCOVERY

    def _on_array(self, name: str, message: Float64MultiArray) -> None:
        self._latest[name] = tuple(message.data)

    def _on_state(self, message: JointState) -> None:
        time_ns, position = stamp_ns(message.header.stamp), tuple(message.position)
        if self._held is None or time_ns < self._time_ns:
            # until it is commanded otherwise, the simulator's servo holds where it starts
            self._held = position
            self._latest.pop("setpoint", None)
        self._time_ns = time_ns
        # what the simulator refuses is no setpoint
        found = {k: v for k, v in self._latest.items() if len(v) == len(position) and all(map(isfinite, v))}
        # voltages and currents are published before the state that they belong to
        if self.page is not None and {"voltage", "current"} <= set(found):
            setpoint = found.get("setpoint", self._held) if self._has_setpoints else None
            self.page.push(Sample(time_ns * 1e-9, position, found["voltage"], found["current"], setpoint))

    def open_page(self, server) -> None:
        """Lay the page out, once it is known what the simulator is like."""
        # we are one of those who listen; the simulator is another where it takes positions
        self._has_setpoints = self.count_subscribers(_SETPOINTS) + self.count_publishers(_SETPOINTS) > 1
        chain, name = chain_of_urdf(self.urdf), self.p["simulator"]
        self.page = Live(server, chain, name, tuple(BUTTONS), self._pressed.append)

    def turn(self) -> None:
        """What is due between messages: requests of buttons, and the page."""
        while self._pressed:
            button = self._pressed.popleft()
            service, kind, fields = BUTTONS[button]
            client = self._of_simulator[service]
            if not client.service_is_ready():
                self.page.say(f"{button}: {client.srv_name} does not answer")
                continue
            future = client.call_async(kind.Request(**fields))
            future.add_done_callback(lambda done, button=button: self.page.say(f"{button}: {done.result().message}"))
        if self.page is not None:
            self.page.refresh()


def run(node: Viewer, stopped) -> None:
    """Wait for the simulator's model, and show its motion until `stopped()` is true; raises PumaSimError."""
    executor = SingleThreadedExecutor()
    executor.add_node(node)
    p, log = node.p, node.get_logger()
    port = None if p["port"] < 0 else p["port"]
    with serving(p["host"], port) as server:
        log.info(
            f"{address(server)} shows {node.resolve_topic_name('joint_states')} once its robot_description is there"
        )
        while not stopped():
            executor.spin_once(timeout_sec=_LONGEST_WAIT)
            if node.page is None and time.monotonic() > node.ready_at:
                node.open_page(server)
            node.turn()


def main(args=None) -> int:
    """Entry point of ``viewer``; returns the exit status."""
    stop = []
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda *_: stop.append(True))
    try:
        with ros_started(args):
            node = Viewer()
            run(node, lambda: bool(stop))
            node.destroy_node()
    except (PumaSimError, ParameterException) as error:
        print(f"viewer: {error}", file=sys.stderr)
        return 2
    return 0


if __name__ == "__main__":
    sys.exit(main())
