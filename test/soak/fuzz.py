# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""Messages, parameters and service calls, bad and good, in each mode and interface.

The node must live, publish nothing that is not finite, answer every call, and count every refusal. Messages are sent in
rounds that its queues hold, and each round ends when it has been handled, so that none is lost on the way and the
count can be compared with what was sent.
"""

from __future__ import annotations

import math
import random
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

from rclpy.parameter import Parameter
from ros_support import Diagnostics, Node, Peer
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

from puma_sim_core.arm.parameters import load_parameters
from puma_sim_core.effects import KINDS
from puma_sim_core.simulation.replay import replay
from puma_sim_ros.node.parameters import PARAMETERS
from puma_sim_ros.node.trajectories import TOPIC

#: what the queues of the node hold
_ROUND = 10
_JOINTS = ("joint1", "joint2", "joint3")
_RANGES = dict(zip(_JOINTS, load_parameters("bejczy").joint_ranges))
_NUMBERS = (0.0, -0.0, 1e-320, 5e-324, 1e308, -1e308, math.inf, -math.inf, math.nan)
_TEXTS = ("", "voltage", "lockstep", "\x00", "joint1", "a" * 5000, "payload:mass=-1", "/", "ä ö", "coulomb_friction:")
#: bags that are replayed of each run
_REPLAYED = 3


def run(folder: Path, count: int, seed: int, _cold: bool) -> Iterator[tuple[str, bool]]:
    """Send `count` things, a quarter in each mode and interface; a line for each of these."""
    for mode in ("lockstep", "realtime"):
        for interface in ("voltage", "position"):
            chosen = random.Random(f"{seed} {mode} {interface}")
            bag = folder / f"{mode}_{interface}"
            with (
                Node(mode=mode, command_interface=interface, bag_path=bag) as node,
                Peer(node.namespace, interface) as peer,
            ):
                peer.find_simulator()
                fuzzed = _Fuzzed(peer, mode, interface, chosen, lambda: node.process.poll() is None)
                while fuzzed.sent < count // 4 and fuzzed.alive():
                    fuzzed.round()
                alive = fuzzed.alive()
                refused = fuzzed.refused() if alive else 0
            bags = sorted(folder.glob(f"{bag.name}*"))
            picked = chosen.sample(bags, min(_REPLAYED, len(bags)))
            identical = all(replay(each).identical for each in picked)
            low, high = fuzzed.least, fuzzed.most
            held = alive and identical and not fuzzed.not_finite and not fuzzed.unanswered and low <= refused <= high
            yield (
                f"{mode}, {interface}: {fuzzed.sent} sent, {fuzzed.calls} calls, {fuzzed.unanswered} unanswered; "
                f"{fuzzed.states} states, {fuzzed.not_finite} messages not finite; "
                f"{refused} refusals counted, {low} to {high} sent; {len(bags)} bags, {len(picked)} replay {identical}",
                held,
            )


class _Fuzzed:
    """What was sent to a node, and what came back. alive : whether the node runs."""

    def __init__(self, peer: Peer, mode: str, interface: str, chosen: random.Random, alive: Callable[[], bool]) -> None:
        self._peer, self._random, self._interface, self.alive = peer, chosen, interface, alive
        self._diagnostics = Diagnostics(peer)
        self.sent = self.calls = self.unanswered = self.states = self.not_finite = 0
        self.least = self.most = 0  # refusals that are to be counted
        self._before = self.refused()
        publisher = peer.node.create_publisher
        self._place = publisher(JointState, "sim_node/set_state", 20)
        self._joints = publisher(JointState, "joint_commands", 20) if interface == "position" else None
        following = mode == "realtime" and interface == "position"
        self._trajectories = publisher(JointTrajectory, TOPIC, 20) if following else None
        # in real time its queue holds one
        self._arrays = _ROUND if mode == "lockstep" else 1
        for each in filter(None, (self._place, self._joints, self._trajectories)):
            peer.wait_for(lambda each=each: each.get_subscription_count() > 0, "a subscription")

    def refused(self) -> int:
        """Refusals that the node has counted since the first call of this."""
        # of a message that began after all was handled
        self._diagnostics()
        total = int(self._diagnostics()[2]["commands rejected, in all"])
        return total - getattr(self, "_before", 0)

    def round(self) -> None:
        """As many messages and calls as the queues hold, and their answers."""
        paused = self._pause()
        for k in range(_ROUND):
            if k < self._arrays:
                values = self._values()
                self._publish(self._peer.commands, Float64MultiArray(data=values), not _all_finite(values, 3))
            if self._joints is not None:
                message, bad = self._joint_state()
                self._publish(self._joints, message, bad)
            message, bad = self._joint_state(velocity=True)
            # refused as long as time runs, which it does unless the state has stopped being finite
            self._publish(self._place, message, bad, maybe=not paused)
        if self._trajectories is not None:
            # it depends on where the arm is
            self._publish(self._trajectories, self._trajectory(), False, maybe=True)
        # a turn of the node handles a message of each topic and a request of each service: when as many of one service
        # as the queues hold are answered, the messages before them have been handled
        futures = [self._call() for _ in range(_ROUND)]
        futures += [("get", self._ask("get_parameters", names=["paused"])) for _ in range(_ROUND)]
        self._wait([future for _, future in futures])
        for name, future in futures:
            if name == "brakes" and future.done() and not future.result().success:
                self.least, self.most = self.least + 1, self.most + 1
        self._look()

    def _pause(self) -> bool:
        """Pause or go on at random; whether the node is paused for certain."""
        wanted = self._random.random() < 0.5
        answer = self._request("pause", data=wanted)
        if answer is not None and not answer.success:
            # the state stopped being finite: nothing else helps
            self._request("reset")
            answer = self._request("pause", data=wanted)
        return wanted and answer is not None and answer.success

    def _publish(self, publisher: Any, message: Any, bad: bool, maybe: bool = False) -> None:
        publisher.publish(message)
        self.sent += 1
        self.least += bad
        self.most += bad or maybe

    # ---- messages

    def _number(self) -> float:
        kind = self._random.random()
        if kind < 0.6:
            return self._random.uniform(-1.5, 1.5)
        return (
            self._random.choice(_NUMBERS)
            if kind < 0.7
            else self._random.gauss(0.0, 1.0) * 10.0 ** self._random.randint(-3, 6)
        )

    def _values(self, exact: float = 0.9) -> list[float]:
        count = 3 if self._random.random() < exact else self._random.randint(0, 6)
        return [self._number() for _ in range(count)]

    def _joint_state(self, velocity: bool = False) -> tuple[JointState, bool]:
        """A message, and whether it is bad."""
        known = self._random.sample(_JOINTS, self._random.randint(1, 3))
        names = known if self._random.random() < 0.8 else self._random.choices((*_JOINTS, "", "elbow"), k=2)
        values = [self._number() for _ in names]
        speeds = [self._number() for _ in names] if velocity and self._random.random() < 0.5 else []
        for numbers in (values, speeds):
            if self._random.random() < 0.05:
                numbers.append(0.0)
        good = set(names) <= set(_JOINTS) and len(set(names)) == len(names) and _all_finite(values, len(names))
        if velocity and good:
            good = all(_RANGES[n][0] <= v <= _RANGES[n][1] for n, v in zip(names, values))
            good = good and (not speeds or _all_finite(speeds, len(names)))
        return JointState(name=list(names), position=values, velocity=speeds), not good

    def _trajectory(self) -> JointTrajectory:
        points, names = [], list(self._random.sample(_JOINTS, self._random.choice((3, 3, 3, 2))))
        for k in range(self._random.randint(0, 4)):
            position = [
                self._random.uniform(-0.02, 0.02) if self._random.random() < 0.95 else self._number() for _ in names
            ]
            points.append(JointTrajectoryPoint(positions=position, velocities=self._random.choice(([], [0.0] * 3))))
            points[-1].time_from_start.sec = k + self._random.choice((1, 1, 1, 0))
        return JointTrajectory(joint_names=names, points=points)

    # ---- calls

    def _call(self) -> tuple[str, Any]:
        """A request of a service at random, and its future."""
        kind = self._random.random()
        if kind < 0.002:
            return "reset", self._ask("reset")
        if kind < 0.25:
            return "step", self._ask("step")
        if kind < 0.4:
            return "brakes", self._ask("brakes", data=self._random.random() < 0.5)
        if kind < 0.5:
            return "describe", self._ask("describe_parameters", names=[self._name() for _ in range(3)])
        settings = [self._setting() for _ in range(self._random.randint(1, 3))]
        self.sent += len(settings)
        messages = [Parameter(name, value=value).to_parameter_msg() for name, value in settings]
        return "set", self._ask("set_parameters", parameters=messages)

    def _name(self) -> str:
        return self._random.choice([name for name in PARAMETERS if name != "paused"] + ["no_such", "", "a.b"])

    def _setting(self) -> tuple[str, Any]:
        name = self._name()
        if name == "real_time_factor" or name == "step_count":
            # good ones, which would stretch this out, within reason
            good = self._random.uniform(0.5, 5.0) if name == "real_time_factor" else self._random.randint(1, 4)
            return name, self._random.choice((good, -1.0, "1", math.nan))
        if name == "effects" and self._random.random() < 0.3:
            return name, [self._random.choice(_EFFECTS)]
        if name in ("voltage_limit", "command_timeout") and self._random.random() < 0.5:
            return name, self._random.uniform(0.1, 60.0)
        if name == "initial_position" and self._random.random() < 0.5:
            return name, [self._random.uniform(*_RANGES[joint]) for joint in _JOINTS]
        values = (
            self._number(),
            self._values(),
            self._random.choice(_TEXTS),
            True,
            False,
            self._random.getrandbits(62),
        )
        return name, self._random.choice((*values, [self._random.choice(_TEXTS)], [1, -1, 2**40], None))

    def _ask(self, service: str, **fields: Any) -> Any:
        self.sent, self.calls = self.sent + 1, self.calls + 1
        client = self._peer.clients[service]
        return client.call_async(client.srv_type.Request(**fields))

    def _request(self, service: str, **fields: Any) -> Any:
        future = self._ask(service, **fields)
        self._wait([future])
        return future.result() if future.done() else None

    def _wait(self, futures: list[Any]) -> None:
        try:
            self._peer.wait_for(lambda: all(future.done() for future in futures) or not self.alive(), "answers")
        except AssertionError:
            self.unanswered += sum(not future.done() for future in futures)

    def _look(self) -> None:
        """Count what came, and leave it."""
        peer = self._peer
        self.states += len(peer.states)
        messages = [(*m.position, *m.velocity, *m.effort) for m in peer.states] + peer.currents + peer.voltages
        self.not_finite += sum(not all(map(math.isfinite, values)) for values in messages)
        for collected in (peer.states, peer.currents, peer.voltages):
            collected.clear()


_EFFECTS = [kind.example for kind in KINDS.values() if kind.example]


def _all_finite(values: list[float], count: int) -> bool:
    return len(values) == count and all(map(math.isfinite, values))
