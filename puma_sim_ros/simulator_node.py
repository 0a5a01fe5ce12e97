# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""The simulator as a ROS 2 node: topics, services and time around a `Session`.

Everything that a command does is the session's business; what is here converts, paces, publishes
and records. All of it runs in one thread, in the order in which it is written.
"""

import contextlib
import gc
import signal
import sys
import time

import rclpy
import yaml
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from rcl_interfaces.msg import SetParametersResult
from rclpy.clock import Clock, ClockType
from rclpy.exceptions import ParameterException
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.signals import SignalHandlerOptions
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray, String
from std_srvs.srv import SetBool, Trigger

from puma_sim_core.arm.urdf import arm_urdf
from puma_sim_core.errors import CommandError, NonFiniteStateError, PumaSimError
from puma_sim_core.simulation.session import Command, Session, SessionConfig
from puma_sim_ros import node_parameters
from puma_sim_ros.messages import StatePublishers, diagnostics, qos
from puma_sim_ros.node_bag import NodeBag
from puma_sim_ros.pacing import Pacer

#: longest wait [s] before the loop looks at signals again
_LONGEST_WAIT = 0.1
#: time without a command after which lockstep sends the last state again [s]; a controller that
#: was not yet discovered when the state was sent would otherwise wait for it, and we for him
_REPEAT_AFTER = 0.5
#: the end of the wait for a deadline that is slept, not spent in the executor [s]
_SLEPT = 0.001
#: commands taken from one topic when a step is due; a flood of them cannot hold the step up
_MOST_TAKEN = 32


class SimNode(Node):
    """The node ``sim_node``; raises PumaSimError for a parameter or a bag that cannot be used."""

    def __init__(self) -> None:
        super().__init__("sim_node")
        self._values = node_parameters.declare(self)
        for name in node_parameters.unknown_names(self):
            self.get_logger().warning(f"parameter '{name}': this node has none of that name")
        self._plant = node_parameters.build_plant(self._values)
        self._config = node_parameters.build_config(self._values, self._plant)
        _warm_up(self._config)
        self._session = Session(self._config)
        self._paused = self._values["paused"]
        self._lockstep = self._values["mode"] == "lockstep"
        self._failed_step: int | None = None
        self._commands: list[Command] = []
        self._make_topics()
        self.create_service(Trigger, "~/reset", self._on_reset)
        self.create_service(SetBool, "~/pause", self._on_pause)
        self.create_service(Trigger, "~/step", self._on_step)
        self.add_on_set_parameters_callback(self._check_change)
        self.add_post_set_parameters_callback(self._on_changed)
        self.create_timer(1.0, self._publish_diagnostics, clock=Clock(clock_type=ClockType.STEADY_TIME))
        self._bag = NodeBag(self._values["bag_path"], self.get_namespace())
        self._bag.start(self._config, *_texts(self._config), self._session.state)

        self._executor = SingleThreadedExecutor()
        self._executor.add_node(self)
        self._pacer = Pacer(self._config.period_ns, self._values["real_time_factor"])
        self._restart_pacer = False
        self._sent_at = 0.0

    def _make_topics(self) -> None:
        joints, frame = self._config.joint_names, self._config.frame_id
        self._states = StatePublishers(self, joints, frame, self._values["publish_clock"])
        self._diagnostics = self.create_publisher(DiagnosticArray, "/diagnostics", qos(10))
        self._description = self.create_publisher(String, "robot_description", qos(1, latched=True))
        self._model = self.create_publisher(String, "~/model", qos(1, latched=True))
        interface, last = self._config.command_interface, qos(10 if self._lockstep else 1)
        topics = [(Float64MultiArray, f"{interface}_controller/commands", self._on_values, last)]
        if interface == "position":
            # messages that name different joints add up: none of them may push out another
            topics.append((JointState, "joint_commands", self._on_joints, qos(10)))
        self._command_subscriptions = [self.create_subscription(*topic) for topic in topics]

    # ---- commands

    def _on_values(self, message: Float64MultiArray) -> None:
        self._take(self._session.command, message.data)

    def _on_joints(self, message: JointState) -> None:
        self._take(self._session.command_joints, message.name, message.position)

    def _take(self, accept, *arguments) -> None:
        try:
            command = accept(*arguments)
        except CommandError as error:
            self.get_logger().warning(f"command refused: {error}", throttle_duration_sec=1.0)
            return
        # while paused they come without end: what a later one covers is not kept
        self._commands = [earlier for earlier in self._commands if command.names not in (None, earlier.names)]
        self._commands.append(command)
        if self._lockstep and not self._paused:
            self._step()

    # ---- steps

    def _step(self) -> str | None:
        """One period; returns the error if the state stopped being finite."""
        self._bag.commands(self._session.state.time_ns, self._commands)
        self._commands.clear()
        try:
            state = self._session.step()
        except NonFiniteStateError as error:
            self._failed_step = error.step
            self.get_logger().error(f"{error}; paused, call ~/reset to start again")
            self.set_parameters([Parameter("paused", value=True)])
            return str(error)
        self._publish_state()
        self._bag.state(state)
        return None

    def _publish_state(self) -> None:
        self._states.publish(self._session.state)
        self._sent_at = time.monotonic()

    def _publish_model(self) -> None:
        for publisher, text in zip((self._model, self._description), _texts(self._config)):
            publisher.publish(String(data=text))

    # ---- services and parameters

    def _on_reset(self, _request, response):
        try:
            config = node_parameters.build_config(self._values, self._plant)
            session = Session(config)
            former = self._bag.start(config, *_texts(config), session.state)
        except PumaSimError as error:
            return self._answer(response, str(error))
        changed = config != self._config
        if changed:
            _warm_up(config)
        self._config, self._session = config, session
        self._commands.clear()
        self._failed_step = None
        self._restart_pacer = True
        if changed:
            self._publish_model()
        self._publish_state()
        if former is not None:
            former.close()
        return self._answer(response)

    def _on_pause(self, request, response):
        (result,) = self.set_parameters([Parameter("paused", value=request.data)])
        return self._answer(response, None if result.successful else result.reason)

    def _on_step(self, _request, response):
        if not self._paused:
            return self._answer(response, "refused: the simulation is not paused")
        return self._answer(response, self._refusal() or self._step())

    def _answer(self, response, error: str | None = None):
        response.success, response.message = error is None, error or self._where()
        return response

    def _refusal(self) -> str | None:
        if self._failed_step is not None:
            return f"refused: the state stopped being finite at step {self._failed_step}; call ~/reset first"
        return None

    def _where(self) -> str:
        state = self._session.state
        return f"step {state.step}, time {state.time_ns / 1e9:.9g} s"

    def _check_change(self, changes) -> SetParametersResult:
        if (refusal := self._refusal()) and any(c.name == "paused" and not c.value for c in changes):
            return SetParametersResult(successful=False, reason=refusal)
        return node_parameters.check_change(changes, self._values, self._plant)

    def _on_changed(self, changes) -> None:
        self._values.update(node_parameters.values_of(changes))
        factor = self._values["real_time_factor"]
        if self._pacer.real_time_factor != factor:
            self._pacer.real_time_factor = factor
        if self._paused != self._values["paused"]:
            self._paused = self._values["paused"]
            self._restart_pacer = True

    # ---- health

    def _publish_diagnostics(self) -> None:
        state, counters = self._session.state, self._session.counters
        age, timeout = self._session.command_age_steps, self._config.timeout_steps
        level, text = DiagnosticStatus.OK, "paused" if self._paused else "running"
        if self._failed_step is not None:
            level, text = DiagnosticStatus.ERROR, f"the state stopped being finite at step {self._failed_step}"
        elif not self._paused and timeout and age >= timeout:
            level, text = DiagnosticStatus.WARN, "no command within command_timeout"
        values = {
            "step": state.step,
            "simulated time [s]": f"{state.time_ns / 1e9:.9g}",
            "mode": self._values["mode"],
            "real time factor": self._pacer.real_time_factor,
            "overruns": self._pacer.overruns,
            **{f"lateness {name} [ms]": value for name, value in self._pacer.lateness.in_ms().items()},
            "commands rejected": counters.rejected,
            "commands saturated": counters.saturated,
            "command age [s]": f"{age * self._config.period:.9g}",
            "bag": self._bag.path,
        }
        now, name = self.get_clock().now().to_msg(), self.get_fully_qualified_name()
        self._diagnostics.publish(diagnostics(now, name, level, text, values))

    # ---- the loop

    def run(self, stopped) -> None:
        """Run until `stopped()` is true. Raises BagError when the bag cannot be written on."""
        self._publish_model()
        self._publish_state()
        # what exists now stays: a full collection of it would hold a step up
        gc.collect()
        gc.freeze()
        topic, paused = self._command_subscriptions[0].topic_name, ", paused" if self._paused else ""
        self.get_logger().info(f"{self._values['mode']}, commands on {topic}{paused}")
        self._pacer.restart()
        turn = self._turn_lockstep if self._lockstep else self._turn_realtime
        while not stopped():
            turn()

    def _turn_realtime(self) -> None:
        # an executor leaves its wait some tenths of a millisecond late: the last piece before the
        # deadline is slept instead, and commands that arrive meanwhile are taken then
        wait = _LONGEST_WAIT if self._paused else self._pacer.remaining() - _SLEPT
        self._executor.spin_once(timeout_sec=min(max(wait, 0.0), _LONGEST_WAIT))
        if self._restart_pacer:
            # not in the service that asked for it: the answer to a new client may take a tenth of a second
            self._restart_pacer = False
            self._pacer.restart()
        if self._paused or self._pacer.remaining() > _SLEPT:
            return
        time.sleep(self._pacer.remaining())
        self._take_waiting_commands()
        self._pacer.begin_step()
        self._step()

    def _take_waiting_commands(self) -> None:
        for subscription in self._command_subscriptions:
            for _ in range(_MOST_TAKEN):
                with subscription.handle:
                    taken = subscription.handle.take_message(subscription.msg_type, subscription.raw)
                if taken is None:
                    break
                subscription.callback(taken[0])

    def _turn_lockstep(self) -> None:
        if self._commands and not self._paused:
            self._step()  # it came while the simulation was paused
        self._executor.spin_once(timeout_sec=_LONGEST_WAIT)
        if not self._paused and time.monotonic() - self._sent_at > _REPEAT_AFTER:
            self._publish_state()

    def close(self) -> None:
        """Finish the bag. Raises BagError when that fails."""
        self._bag.close()

    def summary(self) -> str:
        """One line on what was done."""
        return self._where() if self._lockstep else f"{self._where()}; {self._pacer.summary()}"


def _warm_up(config: SessionConfig) -> None:
    """A step of a session that is thrown away: what it needs is compiled before time runs."""
    with contextlib.suppress(NonFiniteStateError):
        Session(config).step()


def _texts(config: SessionConfig) -> tuple[str, str]:
    """Model and URDF of a session, as they are published and recorded."""
    model = yaml.safe_dump(config.to_mapping(), sort_keys=False)
    return model, arm_urdf(config.plant.arm, config.joint_names, config.frame_id, config.voltage_limit)


def main(args=None) -> int:
    """Entry point of ``sim_node``; returns the exit status."""
    stop = []
    # rclpy's own handlers would shut ROS down in the middle of a step, and Python's default one
    # could interrupt a record of the bag
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda *_: stop.append(True))
    node = None
    try:
        rclpy.init(args=args, signal_handler_options=SignalHandlerOptions.NO)
    except Exception as error:  # rclpy gives the binding's own types for bad arguments
        print(f"sim_node: {str(error).splitlines()[0]}", file=sys.stderr)
        return 2
    try:
        node = SimNode()
    except (PumaSimError, ParameterException, OSError) as error:
        print(f"sim_node: {error}", file=sys.stderr)
        rclpy.try_shutdown()
        return 2
    status = 0
    try:
        node.run(lambda: bool(stop))
    except (PumaSimError, OSError) as error:
        node.get_logger().error(str(error))
        status = 1
    finally:
        try:
            node.close()
        except (PumaSimError, OSError) as error:
            node.get_logger().error(str(error))
            status = 1
        node.get_logger().info(node.summary())
        node.destroy_node()
        rclpy.try_shutdown()
    return status
