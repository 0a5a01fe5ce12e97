# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""The topics between an appraisal and the process of a controller, in lockstep: one answer to each state."""

import time
from array import array
from collections import deque
from collections.abc import Callable, Sequence

import numpy as np
from rclpy.event_handler import PublisherEventCallbacks, SubscriptionEventCallbacks
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray
from std_srvs.srv import Trigger
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

from puma_sim_core.appraisal.settings import SETPOINT_PERIOD, Patience
from puma_sim_core.appraisal.trials.trial import Ending
from puma_sim_ros.messages import qos
from puma_sim_ros.node.peers import UNKNOWN

STATES, SETPOINTS, REFERENCE = "joint_states", "setpoint", "reference"
#: commands that wait: as many as a process that answers more than once may send before it is found out
_DEPTH = 100
#: seconds between two looks at whether the process lives; between two first states; after which no more answers to them
#: come, which all wait at the same time; for answers that nobody asked for
_LOOK, _AGAIN, _QUIET, _EXTRA = 0.1, 1.0, 2.0, 0.005
#: seconds in which the service of a node whose name is known shows itself, for the middleware tells of each by itself:
#: what was lost on the way is sent again each second (Fast DDS, `edp_heartbeat_period`), and may be lost again
_RESET = 4.0
_NS = 1_000_000_000


class Topics:
    """What a process is told and what it answers.

    node : whose topics they are; names : of the joints.
    """

    def __init__(self, node: Node, names: Sequence[str], patience: Patience) -> None:
        self._node, self._patience = node, patience
        self._executor = SingleThreadedExecutor(context=node.context)
        self._executor.add_node(node)
        # made once and filled again: rclpy serialises a message while it publishes it
        self._state, self._setpoint = JointState(name=list(names)), JointState(name=list(names))
        # each event that is listened to slows down each look at the topics
        quiet = {"event_callbacks": PublisherEventCallbacks(use_default_callbacks=False)}
        self._states = node.create_publisher(JointState, STATES, qos(10), **quiet)
        self._setpoints = node.create_publisher(JointState, SETPOINTS, qos(10), **quiet)
        self._references = node.create_publisher(JointTrajectory, REFERENCE, qos(1, latched=True), **quiet)
        self._start = time.monotonic()
        self._trial, self._since = 0, 0.0
        self._answers: deque[tuple[float, ...]] = deque()
        self._commands = self._reset = None
        self._ended: Callable[[], str] = str
        #: identities of the publishers and subscriptions of processes that have ended
        self._gone: set[tuple[int, ...]] = set()
        #: set by another thread to have all waiting end with KeyboardInterrupt
        self.stopped = False

    # -- meeting a process

    def listen(self, interface: str) -> None:
        """Take commands of an interface, voltage or position, from now on."""
        self._forget()
        self._topic = self._commands_of(interface)
        self._commands = self._node.create_subscription(
            Float64MultiArray,
            self._topic,
            lambda message: self._answers.append(tuple(message.data)),
            qos(_DEPTH),
            event_callbacks=SubscriptionEventCallbacks(use_default_callbacks=False),
        )

    def _commands_of(self, interface: str) -> str:
        return self._node.resolve_topic_name(f"{interface}_controller/commands")

    def strangers(self, patience: float) -> list[str]:
        """Names of nodes that send commands though no process was started.

        patience : time from the start on to find them in [s].
        """
        while time.monotonic() < self._start + patience:
            self._spin(_LOOK)
        topics = map(self._commands_of, ("voltage", "position"))
        found = [info for topic in topics for info in self._node.get_publishers_info_by_topic(topic)]
        return sorted({f"{one.node_namespace.rstrip('/')}/{one.node_name}" for one in found})

    def connect(self, reference: np.ndarray, ended: Callable[[], str]) -> None:
        """Wait until a process that was started answers a state; ended : says why it has ended, if it has.

        Raises Ending: it ends, or does not answer in time.
        """
        self._ended = ended
        end, sent_at, sent = time.monotonic() + self._patience.start, 0.0, 0
        self._answers.clear()
        while not self._answers:
            if reason := ended():
                raise Ending("died", f"{reason} before its first answer")
            now = time.monotonic()
            if now > end:
                raise Ending("late", f"no command on {self._topic} within {self._patience.start:g} s")
            if now - sent_at > _AGAIN and self._is_met():
                sent, sent_at = sent + 1, now
                self._begin(f"connect {sent}", reference)
                self._send(0.0, reference[0], reference[0])
            self._spin(0.02)
        # it answers each first state that has reached it, or the last one of those that came together
        there, since = len(self._answers), time.monotonic()
        while there < sent and time.monotonic() < since + _QUIET:
            self._spin(_LOOK)
            if len(self._answers) > there:
                there, since = len(self._answers), time.monotonic()
        self._reset = self._found_reset()
        self._answers.clear()

    def _is_met(self) -> bool:
        """Whether the process has its publisher and its subscription."""
        listeners = self._node.get_subscriptions_info_by_topic(self._states.topic_name)
        return any(map(self._new, self._senders())) and any(map(self._new, listeners))

    def _senders(self):
        return self._node.get_publishers_info_by_topic(self._topic)

    def _new(self, info) -> bool:
        return tuple(info.endpoint_gid) not in self._gone

    def _found_reset(self):
        """A client of the service ``~/reset`` of the node that sends commands; None where none shows itself in time."""
        since, known = time.monotonic(), False
        while not self._ended() and time.monotonic() < since + (_RESET if known else self._patience.answer):
            if name := self._reset_name():
                client = self._node.create_client(Trigger, name)
                client.wait_for_service(self._patience.answer)
                return client
            if not known and all(info.node_name != UNKNOWN for info in self._new_senders()):
                since, known = time.monotonic(), True
            self._spin(_LOOK)
        return None

    def _new_senders(self):
        return list(filter(self._new, self._senders()))

    def _reset_name(self) -> str:
        """The name of the service ``~/reset`` of the node that sends commands, empty as long as none is known."""
        # of all services, for which of them a node has is told by another topic, which may be seconds behind
        services = dict(self._node.get_service_names_and_types())
        nodes = {f"{info.node_namespace.rstrip('/')}/{info.node_name}" for info in self._new_senders()}
        own = sorted(f"{node}/reset" for node in nodes)
        return next((name for name in own if "std_srvs/srv/Trigger" in services.get(name, ())), "")

    def leave(self) -> None:
        """Take no commands until the next `listen`: the process was ended, and what it has sent counts no more."""
        if self._commands is not None:
            listeners = self._node.get_subscriptions_info_by_topic(self._states.topic_name)
            self._gone |= {tuple(info.endpoint_gid) for info in (*self._senders(), *listeners)}
        self._forget()

    def _forget(self) -> None:
        if self._commands is not None:
            self._node.destroy_subscription(self._commands)
        if self._reset is not None:
            self._node.destroy_client(self._reset)
        self._commands = self._reset = None
        self._answers.clear()

    # -- a trial

    def begin(self, reference: np.ndarray) -> None:
        """Begin a trial: reset the process, and tell it setpoints (n, 3) [rad], one each 28 ms.

        Raises Ending: it does not reset, or sends commands that nobody asked for.
        """
        self._since = time.monotonic()
        if self._reset is None and self._reset_name():
            self._reset = self._found_reset()
        if self._reset is not None:
            future = self._reset.call_async(Trigger.Request())
            self._wait(future.done, "~/reset")
            if not future.result().success:
                raise Ending("refused", f"~/reset: {' '.join(future.result().message.split())[:200]}")
        if self.extra():
            raise Ending("refused", "it sent a command before the first state")
        self._trial += 1
        self._begin(f"trial {self._trial}", reference)

    def _begin(self, name: str, reference: np.ndarray) -> None:
        message = JointTrajectory(joint_names=list(self._state.name))
        for part in (message, self._state, self._setpoint):
            part.header.frame_id = name
        for k, row in enumerate(reference):
            point = JointTrajectoryPoint(positions=array("d", row.tolist()))
            point.time_from_start.sec, point.time_from_start.nanosec = divmod(round(k * SETPOINT_PERIOD * _NS), _NS)
            message.points.append(point)
        self._references.publish(message)

    def ask(self, t: float, setpoint: Sequence[float], measurement: Sequence[float]) -> tuple[float, ...]:
        """The command that answers a state. Raises Ending: the process ends, or does not answer in time."""
        self._send(t, setpoint, measurement)
        self._wait(lambda: self._answers, "no answer")
        return self._answers.popleft()

    def _send(self, t: float, setpoint: Sequence[float], measurement: Sequence[float]) -> None:
        sec, nanosec = divmod(round(t * _NS), _NS)
        # the state last: who reacts to it has mostly had the setpoint
        parts = [(self._states, self._state, measurement)]
        if self._setpoints.get_subscription_count():
            parts.insert(0, (self._setpoints, self._setpoint, setpoint))
        for publisher, message, values in parts:
            message.header.stamp.sec, message.header.stamp.nanosec = sec, nanosec
            message.position = array("d", values)
            publisher.publish(message)

    def _wait(self, there: Callable[[], object], what: str) -> None:
        begun = time.monotonic()
        while not there():
            self._spin(_LOOK)
            if there():
                return
            if reason := self._ended():
                raise Ending("died", reason)
            now = time.monotonic()
            if now - begun > self._patience.answer:
                raise Ending("late", f"{what} within {self._patience.answer:g} s")
            if now - self._since > self._patience.trial:
                raise Ending("late", f"all answers of the trial took more than {self._patience.trial:g} s")

    def objection(self) -> str:
        """Why a trial that has come to its end does not count: a sentence, empty where it does."""
        if self.extra():
            return "it sent more commands than it got states"
        if self._reset is None and self._reset_name():
            return "its service ~/reset showed itself only after the trial had begun, which was not reset"
        return ""

    def extra(self) -> bool:
        """Whether there are commands that nobody asked for; they are dropped."""
        self._spin(_EXTRA)
        found = bool(self._answers)
        self._answers.clear()
        return found

    def _spin(self, patience: float) -> None:
        if self.stopped:
            raise KeyboardInterrupt
        self._executor.spin_once(timeout_sec=patience)
