# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""The simulator as a ROS 2 node: topics, services and time around a `Session`.

Everything that a command does is the session's business; what is here converts, paces, publishes
and records. All of it runs in one thread, in the order in which it is written.
"""

import contextlib
import gc
import time
from dataclasses import replace
from typing import NoReturn

from diagnostic_msgs.msg import DiagnosticArray
from rcl_interfaces.msg import SetParametersResult
from rclpy.callback_groups import MutuallyExclusiveCallbackGroup
from rclpy.clock import Clock, ClockType
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.parameter import Parameter
from sensor_msgs.msg import JointState
from std_msgs.msg import Bool, Float64MultiArray, String
from std_srvs.srv import SetBool, Trigger
from trajectory_msgs.msg import JointTrajectory

from puma_sim_core.compiling import Compilation
from puma_sim_core.errors import CommandError, NonFiniteStateError, PumaSimError
from puma_sim_core.simulation.session import Command, Effects, Placement, Session
from puma_sim_core.simulation.session_config import SessionConfig
from puma_sim_ros.messages import LOSSLESS, StatePublishers, qos
from puma_sim_ros.node import parameters
from puma_sim_ros.node.bag import NodeBag
from puma_sim_ros.node.description import Description
from puma_sim_ros.node.frames import FramePublisher
from puma_sim_ros.node.health import Health
from puma_sim_ros.node.pacing import Pacer
from puma_sim_ros.node.peers import Peers
from puma_sim_ros.node.trajectories import TOPIC, Following

#: longest wait [s] before the loop looks at signals again
_LONGEST_WAIT = 0.1
#: until the first command after a start or a reset, lockstep sends the state again after this time [s]: a controller
#: whose publisher had not found us yet would otherwise wait for us, and we for it
_REPEAT_AFTER = 5.0
#: the end of the wait for a deadline [s], in which what is there is taken without waiting, and its last part, slept
_TAKEN, _SLEPT = 0.001, 0.0003
#: callbacks that are done when a step is due; a flood of commands cannot hold the step up
_MOST_TAKEN = 32
#: placements and changes of effects that are kept for the next step while time stands still
_MOST_CHANGES = 1000
#: steps of ~/step before other callbacks have their turn
_STEPS_AT_ONCE = 20


class SimNode(Node):
    """The node ``sim_node``; raises PumaSimError for a parameter that cannot be used.

    Between `open_bag` and `close` an interruption must wait.
    """

    def __init__(self) -> None:
        super().__init__("sim_node", automatically_declare_parameters_from_overrides=True)
        self._values, unknown = parameters.declare(self)
        for name in unknown:
            self.get_logger().warning(f"parameter '{name}': this node has none of that name")
        self._plant = parameters.build_plant(self._values)
        self._config = parameters.build_config(self._values, self._plant)
        Compilation(self.get_logger().info, lambda: _warm_up(self._config))
        self._session = Session(self._config)
        self._compiled = self._session.compiled
        if self._compiled:
            _warm_up(self._config)
        self._paused = self._values["paused"]
        self._lockstep = self._values["mode"] == "lockstep"
        self._failed_step: int | None = None
        self._inputs: list[Command | Placement | Effects] = []
        self._describe = Description(self, self._values["urdf_inertias"])
        self._make_topics()
        self._make_services()
        self._health = Health(self.get_fully_qualified_name())
        path, frames = self._values["bag_path"], self._values["record_tf"]
        self._bag = NodeBag(path, self.get_namespace(), frames, self.get_logger().error)
        self._executor = SingleThreadedExecutor()
        self._executor.add_node(self)
        self._pacer = Pacer(self._config.period_ns, self._values["real_time_factor"])
        self._restart_pacer = self._stepping = self._commanded = False
        self._sent_at, self._activity = 0.0, 0

    def _make_topics(self) -> None:
        joints, frame = self._config.joint_names, self._config.frame_id
        interface, last = self._config.command_interface, qos(LOSSLESS if self._lockstep else 1)
        topics = [(Float64MultiArray, f"{interface}_controller/commands", self._on_values, last)]
        if interface == "position":
            # messages that name different joints add up: none of them may push out another
            topics.append((JointState, "joint_commands", self._on_joints, qos(LOSSLESS)))
        names = [self.resolve_topic_name(name) for _, name, *_ in topics]
        self._peers = Peers(self, self.resolve_topic_name("joint_states"), names)
        events = self._peers.state_events()
        self._states = StatePublishers(self, joints, frame, self._values["publish_clock"], events)
        self._diagnostics = self.create_publisher(DiagnosticArray, "/diagnostics", qos(10))
        self._description = self.create_publisher(String, "robot_description", qos(1, latched=True))
        self._model = self.create_publisher(String, "~/model", qos(1, latched=True))
        self._brakes = self.create_publisher(Bool, "~/brakes", qos(1, latched=True))
        for topic, name in zip(topics, names):
            self.create_subscription(*topic, event_callbacks=self._peers.command_events(name))
        self._commands_on = names[0]
        self._following = Following()
        if interface == "position" and not self._lockstep:
            self.create_subscription(JointTrajectory, TOPIC, self._on_trajectory, qos(1))
        self._frames = (
            FramePublisher(self, self._describe.texts(self._config)[1], joints) if self._values["publish_tf"] else None
        )
        self.create_subscription(JointState, "~/set_state", self._on_placement, qos(10))

    def _make_services(self) -> None:
        self.create_service(Trigger, "~/reset", self._on_reset)
        self.create_service(SetBool, "~/pause", self._on_pause)
        self.create_service(SetBool, "~/brakes", self._on_brakes)
        # many steps are a coroutine, which other callbacks need not wait for
        self.create_service(Trigger, "~/step", self._on_step, callback_group=MutuallyExclusiveCallbackGroup())
        self.add_on_set_parameters_callback(self._check_change)
        self.add_post_set_parameters_callback(self._on_changed)
        self.create_timer(1.0, self._publish_diagnostics, clock=Clock(clock_type=ClockType.STEADY_TIME))

    # ---- commands and other inputs

    def _on_values(self, message: Float64MultiArray) -> None:
        self._take(self._session.command, message.data)

    def _on_joints(self, message: JointState) -> None:
        self._take(self._session.command_joints, message.name, message.position)

    def _take(self, accept, *arguments) -> None:
        self._activity += 1
        try:
            command = accept(*arguments)
        except CommandError as error:
            self.get_logger().warning(f"command refused: {error}", throttle_duration_sec=1.0)
            return
        if not self._commanded:
            self._commanded = True
            self._peers.all_served()
        self._following.stop()
        # while paused they come without end: what a later one covers is not kept
        self._inputs = [
            earlier
            for earlier in self._inputs
            if not (isinstance(earlier, Command) and command.names in (None, earlier.names))
        ]
        self._inputs.append(command)
        if self._lockstep and not self._paused:
            self._step()

    def _on_trajectory(self, message: JointTrajectory) -> None:
        self._activity += 1
        try:
            self._following.start(message, self._config, self._session.setpoint)
        except CommandError as error:
            self._session.counters.rejected += 1
            self.get_logger().warning(f"trajectory refused: {error}", throttle_duration_sec=1.0)

    def _on_placement(self, message: JointState) -> None:
        self._activity += 1
        try:
            if not self._paused:
                self._refuse("time is running", "set_state", "parameter paused true")
            self._check_room()
            placement = self._session.place(message.name, message.position, message.velocity)
        except CommandError as error:
            self.get_logger().warning(f"joints not put there: {error}", throttle_duration_sec=1.0)
            return
        self._following.stop()
        covered = set(placement.names)
        self._inputs = [e for e in self._inputs if not (isinstance(e, Placement) and covered.issuperset(e.names))]
        self._inputs.append(placement)
        self._publish_state()

    def _check_room(self) -> None:
        """Raise CommandError where no more changes are kept for the next step."""
        if sum(not isinstance(each, Command) for each in self._inputs) >= _MOST_CHANGES:
            self._refuse("too many changes at one time", self._where(), f"a step after {_MOST_CHANGES} changes")

    def _refuse(self, what: str, where: str, expected: str) -> NoReturn:
        """Count a refusal, and raise it as a CommandError."""
        self._session.counters.rejected += 1
        raise CommandError(what, where=where, expected=expected)

    def _on_brakes(self, request, response):
        try:
            self._session.brake(request.data)
        except CommandError as error:
            return self._answer(response, str(error))
        self._following.stop()
        return self._answer(response)

    def _watch_controllers(self) -> None:
        """Engage the brakes when the last publisher of commands has gone."""
        if self._peers.lost:
            self._peers.lost = False
            if self._commanded and self._config.brakes and not self._following.active:
                self._session.brake(True)
                if not self._lockstep:
                    self.get_logger().warning("the last publisher of commands has gone: the brakes engage")

    # ---- steps

    def _step(self) -> str | None:
        """One period; returns the error if the state stopped being finite."""
        begin_ns = self._session.state.time_ns
        if self._following.active:
            self._inputs.append(self._session.command(self._following.next()))
        self._bag.inputs(begin_ns, self._inputs)
        self._inputs.clear()
        braked = self._session.braked
        try:
            state = self._session.step()
        except NonFiniteStateError as error:
            self._failed_step = error.step
            self.get_logger().error(f"{error}; paused, call ~/reset to start again")
            self.set_parameters([Parameter("paused", value=True)])
            return str(error)
        if braked != self._session.braked:
            self._publish_brakes()
        self._publish_state()
        self._bag.step(begin_ns, self._session.braked, state)
        if self._session.compiled != self._compiled:
            self._compiled = self._session.compiled
            self.get_logger().info(f"the compiled model runs from step {state.step} on")
        return None

    def _publish_state(self) -> None:
        before = self._states.subscriptions
        if self._frames is not None:
            self._frames.publish(self._session.state)
        self._states.publish(self._session.state)
        # who came in between may have it or not: while paused it does no harm to send it twice
        self._peers.sent(before if self._paused else self._states.subscriptions)
        self._sent_at = time.monotonic()

    def _publish_brakes(self) -> None:
        self._brakes.publish(Bool(data=self._session.braked))

    def _publish_model(self) -> None:
        for publisher, text in zip((self._model, self._description), self._describe.texts(self._config)):
            publisher.publish(String(data=text))

    # ---- services and parameters

    def _on_reset(self, _request, response):
        former = self._config
        try:
            self._config = parameters.build_config(self._values, self._plant)
            session = Session(self._config)
            self._bag.start(self._config, *self._describe.texts(self._config), session.state)
        except PumaSimError as error:
            self._config = former
            return self._answer(response, str(error))
        self._health.add(self._session.counters)
        self._session, self._failed_step = session, None
        self._inputs.clear()
        self._following.stop()
        self._restart_pacer, self._commanded = True, False
        if self._config != former:
            self._publish_model()
        self._publish_brakes()
        self._publish_state()
        return self._answer(response)

    def _on_pause(self, request, response):
        (result,) = self.set_parameters([Parameter("paused", value=request.data)])
        return self._answer(response, None if result.successful else result.reason)

    async def _on_step(self, _request, response):
        """`step_count` steps; in between others have their turn, and a reset or the end of the pause ends it."""
        session, count = self._session, self._values["step_count"]
        for done in range(count):
            if not self._paused:
                refused = "refused: the simulation is not paused"
                return self._answer(response, refused if not done else f"ended after {done} steps: no longer paused")
            if self._session is not session:
                return self._answer(response, f"ended after {done} steps: the simulation was reset")
            if error := self._refusal() or self._step():
                return self._answer(response, error)
            if done % _STEPS_AT_ONCE == _STEPS_AT_ONCE - 1:
                self._stepping = True
                await _Turn()
        self._stepping = False
        return self._answer(response)

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
        if any(c.name == "effects" for c in changes):
            try:
                self._check_room()
            except CommandError as error:
                return SetParametersResult(successful=False, reason=str(error))
        return parameters.check_change(changes, self._values, self._plant)

    def _on_changed(self, changes) -> None:
        changed = parameters.values_of(changes)
        self._values.update(changed)
        factor = self._values["real_time_factor"]
        if self._pacer.real_time_factor != factor:
            self._pacer.real_time_factor = factor
        if "effects" in changed:
            self._plant = parameters.with_effects(self._plant, self._values)
            self._inputs.append(self._session.use_effects(self._plant.effects))
            self._config = replace(self._config, plant=self._plant)
            self._publish_model()
        if self._paused != self._values["paused"]:
            self._paused = self._values["paused"]
            self._restart_pacer = True

    # ---- health

    def _publish_diagnostics(self) -> None:
        if self._peers.most_publishers > 1:
            text = f"{self._peers.most_publishers} publishers on one topic of commands: each overrides the others"
            self.get_logger().warning(text, throttle_duration_sec=10.0)
        values = {"mode": self._values["mode"], "bag": self._bag.path}
        now = self.get_clock().now().to_msg()
        self._diagnostics.publish(
            self._health.message(now, self._session, self._pacer, self._peers.most_publishers, self._standing(), values)
        )

    def _standing(self) -> str:
        """What the simulation does, in a word; the reason where it failed."""
        if self._failed_step is not None:
            return f"the state stopped being finite at step {self._failed_step}"
        return "paused" if self._paused else "running"

    # ---- the loop

    def open_bag(self) -> None:
        """Begin the bag, if there is to be one. Raises BagError."""
        self._bag.start(self._config, *self._describe.texts(self._config), self._session.state)

    def run(self, stopped) -> None:
        """Run until `stopped()` is true. Raises BagError when the bag cannot be written on."""
        self._publish_model()
        self._publish_brakes()
        self._publish_state()
        # what exists now stays: a full collection of it would hold a step up
        gc.collect()
        gc.freeze()
        paused = ", paused" if self._paused else ""
        self.get_logger().info(f"{self._values['mode']}, commands on {self._commands_on}{paused}")
        self._pacer.restart()
        turn = self._turn_lockstep if self._lockstep else self._turn_realtime
        while not stopped():
            turn()
            self._watch_controllers()

    def _turn_realtime(self) -> None:
        wait = _LONGEST_WAIT if self._paused else self._pacer.remaining() - _TAKEN
        self._executor.spin_once(timeout_sec=0.0 if self._stepping else min(max(wait, 0.0), _LONGEST_WAIT))
        if self._restart_pacer:
            # not in the service that asked for it: the answer to a new client may take a tenth of a second
            self._restart_pacer = False
            self._pacer.restart()
        if self._paused:
            self._serve_newcomers()
            return
        if self._pacer.remaining() > _TAKEN:
            return
        self._take_what_is_there()
        if not self._paused:
            time.sleep(self._pacer.remaining())
            self._pacer.begin_step()
            self._step()

    def _take_what_is_there(self) -> None:
        """Commands that came before the step that is due, or come while there is time."""
        idle = taken = 0
        while taken < _MOST_TAKEN and (idle < 2 or self._pacer.remaining() > _SLEPT):
            before = self._activity
            self._executor.spin_once(timeout_sec=0.0)
            # one look may serve another callback than that of a command
            idle = idle + 1 if self._activity == before else 0
            taken += 1

    def _turn_lockstep(self) -> None:
        if self._inputs and not self._paused and any(isinstance(each, Command) for each in self._inputs):
            self._step()  # it came while the simulation was paused
        self._executor.spin_once(timeout_sec=0.0 if self._stepping else _LONGEST_WAIT)
        self._serve_newcomers()

    def _serve_newcomers(self) -> None:
        """Send the present state again, to who subscribed since, where nobody might answer it twice."""
        quiet = time.monotonic() - self._sent_at
        if self._peers.newcomer and quiet >= _LONGEST_WAIT:
            wanted = True if self._paused else self._peers.waits_for_a_state()
            if wanted:
                self._publish_state()
            if wanted is not None:
                self._peers.all_served()
        elif not self._peers.newcomer:
            self._peers.all_served()
        quiet = time.monotonic() - self._sent_at
        if self._lockstep and not self._paused and not self._commanded and quiet > _REPEAT_AFTER:
            self._publish_state()

    def close(self) -> None:
        """Finish the bag. Raises BagError when that fails."""
        self._bag.close()

    def summary(self) -> str:
        """One line on what was done."""
        return self._where() if self._lockstep else f"{self._where()}; {self._pacer.summary()}"


class _Turn:
    """Awaited, lets the executor do something else."""

    def __await__(self):
        yield


def _warm_up(config: SessionConfig) -> None:
    """A step of a session that is thrown away: what it needs is loaded before time runs."""
    with contextlib.suppress(NonFiniteStateError):
        Session(config).step()
