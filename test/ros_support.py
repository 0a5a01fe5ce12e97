# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""A `sim_node` in a process of its own, and a peer in this one that talks to it over DDS."""

from __future__ import annotations

import itertools
import os
import re
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path

import pytest

rclpy = pytest.importorskip("rclpy")

from diagnostic_msgs.msg import DiagnosticArray
from rcl_interfaces.srv import DescribeParameters, GetParameters, SetParameters
from rclpy.context import Context
from rclpy.executors import SingleThreadedExecutor
from rclpy.parameter import Parameter
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray
from std_srvs.srv import SetBool, Trigger

ROOT = Path(__file__).resolve().parent.parent
DOMAIN = 1 + os.getpid() % 100
PERIOD_NS = 28_000_000
# [s]; a limit for what never comes, not a measure of speed: machines that run tests are busy
PATIENCE = 60.0

_names = itertools.count()


def environment() -> dict[str, str]:
    """For programs under test: their own domain, this machine only, this checkout.

    The model runs as plain Python, which gives the same bits and starts at once.
    """
    path = os.pathsep.join(filter(None, (str(ROOT), os.environ.get("PYTHONPATH"))))
    return {
        **os.environ,
        "ROS_DOMAIN_ID": str(DOMAIN),
        "PYTHONPATH": path,
        "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST",
        "PUMA_SIM_KERNEL": "python",
    }


def arguments(parameters: dict) -> list[str]:
    """ROS arguments that set parameters; values are YAML."""
    words = [word for name, value in parameters.items() for word in ("-p", f"{name}:={value}")]
    return ["--ros-args", *words]


def run_program(program: str | Path, *words: str) -> subprocess.CompletedProcess:
    """A module of the package, or a file, until it ends, with its status and its texts."""
    start = [str(program)] if isinstance(program, Path) else ["-m", program]
    return subprocess.run(
        [sys.executable, *start, *words], env=environment(), text=True, capture_output=True, timeout=2 * PATIENCE
    )


class Program:
    """A program of the package that runs beside the test; as a context, it must end well."""

    def __init__(self, module: str, *words: str, **variables: str) -> None:
        # files: a pipe that nobody reads would hold up who writes much
        self._files = tempfile.TemporaryFile(), tempfile.TemporaryFile()  # noqa: SIM115
        self.process = subprocess.Popen(
            [sys.executable, "-m", module, *words],
            env={**environment(), **variables},
            stdout=self._files[0],
            stderr=self._files[1],
        )
        self.output = self.errors = ""

    def __enter__(self):
        return self

    def __exit__(self, kind, *_exception) -> None:
        status = self.end()
        assert kind is not None or status == 0, self.errors

    def end(self, number: int = signal.SIGINT) -> int:
        """Send a signal, wait, and return the status."""
        if self.process.returncode is None:
            if self.process.poll() is None:
                self.process.send_signal(number)
            return self.wait()
        return self.process.returncode

    def wait(self) -> int:
        """The status when it has ended by itself."""
        try:
            self.process.wait(timeout=PATIENCE)
        except subprocess.TimeoutExpired:
            self.process.kill()
            self.process.wait()
            raise AssertionError(f"it did not end:\n{self._read()[1]}") from None
        self.output, self.errors = self._read()
        return self.process.returncode

    def _read(self) -> list[str]:
        """What it has said so far, on both outputs."""
        # its place in the file is where it writes on
        return [os.pread(file.fileno(), os.fstat(file.fileno()).st_size, 0).decode() for file in self._files]

    def wait_for(self, pattern: str) -> re.Match[str]:
        """The first place of its log that matches, once there is one."""
        end = time.monotonic() + PATIENCE
        while not (found := re.search(pattern, self._read()[1])):
            assert time.monotonic() < end, f"no {pattern!r} in {self._read()[1]}"
            time.sleep(0.05)
        return found


class Node(Program):
    """`sim_node` with parameters, in a namespace that no other test has."""

    def __init__(
        self, namespace: str | None = None, words: Sequence[str] = (), variables: dict | None = None, **parameters
    ) -> None:
        self.namespace = namespace or f"/t{os.getpid()}_{next(_names)}"
        words = (*arguments(parameters), "-r", f"__ns:={self.namespace}", *words)
        super().__init__("puma_sim_ros.sim_node", *words, **(variables or {}))


class Peer:
    """A ROS node in this process, in the namespace of the node under test.

    ``states``, ``currents`` and ``voltages`` collect what the simulator publishes. Without an interface it
    only listens.
    """

    def __init__(self, namespace: str, interface: str | None = "voltage", name: str = "peer") -> None:
        os.environ["ROS_AUTOMATIC_DISCOVERY_RANGE"] = "LOCALHOST"
        self.context = Context()
        rclpy.init(context=self.context, domain_id=DOMAIN)
        self.node = rclpy.create_node(name, namespace=namespace, context=self.context)
        self.executor = SingleThreadedExecutor(context=self.context)
        self.executor.add_node(self.node)
        self.states, self.currents, self.voltages = [], [], []
        self.on_state = None
        node = self.node
        node.create_subscription(JointState, "joint_states", self._state, 100)
        node.create_subscription(
            Float64MultiArray, "motor_currents", lambda m: self.currents.append(tuple(m.data)), 100
        )
        node.create_subscription(
            Float64MultiArray, "motor_voltages", lambda m: self.voltages.append(tuple(m.data)), 100
        )
        self.commands = None
        if interface is not None:
            self.commands = node.create_publisher(Float64MultiArray, f"{interface}_controller/commands", 10)
        self.clients = {
            name: node.create_client(kind, f"sim_node/{name}")
            for name, kind in (
                ("reset", Trigger),
                ("pause", SetBool),
                ("step", Trigger),
                ("brakes", SetBool),
                ("set_parameters", SetParameters),
                ("get_parameters", GetParameters),
                ("describe_parameters", DescribeParameters),
            )
        }

    def _state(self, message: JointState) -> None:
        self.states.append(message)
        if self.on_state is not None:
            self.on_state(message)

    def __enter__(self):
        return self

    def __exit__(self, *_exception) -> None:
        self.close()

    def close(self) -> None:
        self.executor.shutdown()
        self.node.destroy_node()
        rclpy.shutdown(context=self.context)

    def wait_for(self, condition, what: str = "the condition", patience: float = PATIENCE):
        """Spin until `condition()` is true, and return its value."""
        end = time.monotonic() + patience
        while not (value := condition()):
            assert time.monotonic() < end, f"{what} did not come"
            self.executor.spin_once(timeout_sec=0.05)
        return value

    def find_simulator(self, reset: bool = True) -> None:
        """Wait until all that the tests use is connected; with `reset` in both directions.

        The simulator is then paused at step 0.
        """
        self.wait_for(
            lambda: (
                self.commands.get_subscription_count() > 0
                and all(client.service_is_ready() for client in self.clients.values())
                and self.node.count_publishers("joint_states") > 0
                and self.node.count_publishers("motor_voltages") > 0
            ),
            "the simulator",
        )
        # a service drops its answer when it has not yet found who asks: ask again until one comes,
        # by the client that was made last; the others are found then, too
        client = self.clients["describe_parameters"]
        futures, asked = [], 0.0

        def answered():
            nonlocal asked
            if time.monotonic() - asked > 1.0:
                futures.append(client.call_async(client.srv_type.Request()))
                asked = time.monotonic()
            return any(future.done() for future in futures)

        self.wait_for(answered, "an answer of a service")
        if reset:
            self.call("pause", data=True)
            self.wait_for(self._reaches_us, "a first state")
            self.fresh()

    def _reaches_us(self) -> bool:
        self.call("reset")
        self.executor.spin_once(timeout_sec=0.1)
        return bool(self.states and self.currents and self.voltages)

    def call(self, service: str, **fields):
        """The answer of a service of the simulator."""
        client = self.clients[service]
        future = client.call_async(client.srv_type.Request(**fields))
        self.wait_for(future.done, f"an answer of {service}")
        return future.result()

    def set(self, **values) -> list:
        """Set parameters; returns the results."""
        messages = [Parameter(name, value=value).to_parameter_msg() for name, value in values.items()]
        return self.call("set_parameters", parameters=messages).results

    def send(self, *values: float) -> None:
        """Publish a command; the simulator has it before what is asked of it next."""
        self.publish(self.commands, Float64MultiArray(data=[float(value) for value in values]))

    def send_plainly(self, *values: float) -> None:
        """Publish a command to a simulator of whatever name."""
        self.wait_for(lambda: self.commands.get_subscription_count() > 0, "a subscription")
        self.commands.publish(Float64MultiArray(data=[float(value) for value in values]))

    def publish(self, publisher, message) -> None:
        publisher.publish(message)
        # sent on the same way, so behind it: when this is answered, the message has been handled
        self.call("get_parameters", names=["paused"])

    def step(self, count: int = 1) -> JointState:
        """Paused: make steps, and return the last state."""
        for _ in range(count):
            answer = self.call("step")
            assert answer.success, answer.message
        return self.state_of(int(answer.message.split()[1].rstrip(",")))

    def state_of(self, step: int) -> JointState:
        """After `fresh`: the state of a step; its arrays are ``voltages[step]`` and so on."""
        self.wait_for(lambda: min(len(self.states), len(self.voltages), len(self.currents)) > step, f"state {step}")
        assert step_of(self.states[step]) == step
        return self.states[step]

    def fresh(self) -> None:
        """Paused, at step 0, which is the first of all that is collected."""
        self.call("pause", data=True)
        # what was sent before is on its way on other topics
        seen = -1
        while seen != len(self.states) + len(self.voltages) + len(self.currents):
            seen = len(self.states) + len(self.voltages) + len(self.currents)
            for _ in range(5):
                self.executor.spin_once(timeout_sec=0.02)
        for collected in (self.states, self.currents, self.voltages):
            collected.clear()
        answer = self.call("reset")
        assert answer.success, answer.message
        self.state_of(0)


class Watcher:
    """What a topic said last, for a peer."""

    def __init__(self, peer, kind, topic, profile=10):
        self.messages = []
        peer.node.create_subscription(kind, topic, self.messages.append, profile)


class Diagnostics(Watcher):
    def __init__(self, peer):
        super().__init__(peer, DiagnosticArray, "/diagnostics")
        self._peer, self._name = peer, f"{peer.node.get_namespace()}/sim_node"

    def __call__(self):
        """The next status: level, text and values."""
        self.messages.clear()
        self._peer.wait_for(lambda: self._found() is not None, "diagnostics")
        status = self._found()
        return status.level, status.message, {item.key: item.value for item in status.values}

    def _found(self):
        found = [status for message in self.messages for status in message.status if status.name == self._name]
        return found[-1] if found else None


def time_ns(message: JointState) -> int:
    return message.header.stamp.sec * 1_000_000_000 + message.header.stamp.nanosec


def step_of(message: JointState, period_ns: int = PERIOD_NS) -> int:
    step, rest = divmod(time_ns(message), period_ns)
    assert rest == 0
    return step
