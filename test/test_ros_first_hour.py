# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""What happens to an arm whose controller comes late, is slow, or goes away: brakes, stops, lockstep, pauses."""

from __future__ import annotations

import math
import os
import signal
import time

import pytest

pytest.importorskip("rclpy")

from ros_support import PERIOD_NS, Diagnostics, Node, Peer, Watcher, arguments, run_program, step_of
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import JointState
from std_msgs.msg import Bool, Float64MultiArray

from puma_sim_core.arm.parameters import load_parameters
from puma_sim_core.recording.bag import RecordedBrakes, read_bag
from puma_sim_core.simulation.replay import replay
from puma_sim_ros.messages import qos

# ---- brakes


@pytest.mark.long
def test_the_first_use_of_the_readme(tmp_path):
    """A simulator, and three seconds later a controller that moves down a line from where the arm is."""
    bag = tmp_path / "bag"
    with Node(bag_path=bag) as node, Peer(node.namespace) as peer:
        peer.find_simulator(reset=False)
        peer.wait_for(lambda: peer.states and step_of(peer.states[-1]) * PERIOD_NS > 3_000_000_000, "three seconds")
        assert {tuple(state.position) for state in peer.states} == {(0.0, 0.0, 0.0)}
        done = run_program(
            "puma_sim_ros.external_controller", *arguments({"duration": 3.0}), "-r", f"__ns:={node.namespace}"
        )
        assert done.returncode == 0, done.stderr
        diagnostics = Diagnostics(peer)
        peer.wait_for(lambda: diagnostics()[2]["brakes"] == "engaged", "the brakes")
        # what the controller brought about is still on its way to this process
        peer.wait_for(lambda: len({tuple(state.position) for state in peer.states[-50:]}) == 1, "an arm that stands")
    contents = read_bag(bag)
    moments = [(step, each.engaged) for step, each in contents.inputs if isinstance(each, RecordedBrakes)]
    assert [engaged for _, engaged in moments] == [True, False, True]
    # they let go with the first command, and engage after the last one
    assert moments[1][0] == contents.commands[0][0] and moments[2][0] > contents.commands[-1][0]
    assert replay(bag).identical


@pytest.fixture(scope="module")
def braked():
    with Node(paused=True, command_timeout=0.112) as node, Peer(node.namespace) as peer:
        peer.find_simulator()
        yield peer


def test_brakes_by_service_and_on_their_topic(braked):
    braked.fresh()
    brakes = Watcher(braked, Bool, "sim_node/brakes", qos(1, latched=True))
    braked.wait_for(lambda: brakes.messages, "the present state of the brakes")
    assert brakes.messages[-1].data is True
    assert tuple(braked.step().position) == (0.0, 0.0, 0.0)
    assert braked.call("brakes", data=False).success
    assert braked.step().position[1] != 0.0
    braked.wait_for(lambda: brakes.messages[-1].data is False, "free brakes")
    assert braked.call("brakes", data=True).success
    held = braked.step()
    assert tuple(held.velocity) == (0.0, 0.0, 0.0) and braked.step().position == held.position
    # a command lets go, a time-out brings them back, a reset begins with them
    braked.send(0.0, 0.0, 0.0)
    assert braked.step().velocity[1] != 0.0
    assert tuple(braked.step(4).velocity) == (0.0, 0.0, 0.0)
    braked.send(0.0, 0.0, 0.0)
    braked.step()
    braked.fresh()
    assert tuple(braked.step(3).position) == (0.0, 0.0, 0.0)


def test_without_brakes_the_arm_falls_freely(braked):
    assert braked.set(brakes=False)[0].successful
    try:
        braked.fresh()
        assert braked.step(20).position[1] > 0.05
        answer = braked.call("brakes", data=True)
        assert not answer.success and "no brakes" in answer.message
    finally:
        braked.set(brakes=True)


def test_the_brakes_engage_when_the_last_controller_has_gone_whatever_the_time_out():
    with Node(command_timeout=0.0) as node, Peer(node.namespace) as peer:
        peer.find_simulator(reset=False)
        with Peer(node.namespace) as controller:
            controller.find_simulator(reset=False)
            # the peer's own publisher of commands goes first
            peer.node.destroy_publisher(peer.commands)
            controller.send(3.0, 3.0, 3.0)
            peer.wait_for(lambda: peer.states and abs(peer.states[-1].velocity[0]) > 0.01, "motion")
        peer.wait_for(lambda: tuple(peer.states[-1].velocity) == (0.0, 0.0, 0.0), "the brakes")


def test_a_command_whose_sender_has_gone_before_the_step_does_not_move_the_arm(tmp_path):
    bag = tmp_path / "bag"
    with Node(bag_path=bag, paused=True) as node, Peer(node.namespace, None, "watcher") as peer:
        diagnostics = Diagnostics(peer)
        # the second time the brakes hold already
        for _ in range(2):
            with Peer(node.namespace) as controller:
                controller.find_simulator(reset=False)
                controller.send(3.0, 3.0, 3.0)
            peer.wait_for(lambda: diagnostics()[2]["publishers of commands"] == "0", "the loss of the controller")
            assert peer.call("step").success
    contents = read_bag(bag)
    assert [command.values for _, command in contents.commands] == [(3.0, 3.0, 3.0)] * 2
    assert not contents.velocity.any() and not contents.voltage.any()
    assert replay(bag).identical


def test_a_bag_of_an_arm_without_brakes_replays(tmp_path):
    bag = tmp_path / "bag"
    with Node(bag_path=bag, brakes=False, paused=True) as node, Peer(node.namespace) as peer:
        peer.find_simulator()
        peer.send(3.0, -2.0, 1.0)
        peer.step(3)
    bags = list(tmp_path.iterdir())
    assert len(bags) > 1 and all(replay(each).identical for each in bags)
    assert read_bag(max(bags)).velocity[-1].all()


# ---- stops


def test_a_joint_stays_at_its_stop_and_diagnostics_say_so():
    with Node(command_timeout=0.0, paused=True) as node, Peer(node.namespace) as peer:
        peer.find_simulator()
        diagnostics = Diagnostics(peer)
        assert diagnostics()[2]["joints at a limit"] == "none"
        peer.send(40.0, 0.0, 40.0)
        assert peer.set(step_count=500)[0].successful
        assert peer.call("step").message == "step 500, time 14 s"
        ranges = load_parameters("bejczy").joint_ranges
        # more than this subscription's queue holds
        peer.wait_for(lambda: step_of(peer.states[-1]) == 500, "state 500")
        state = peer.states[-1]
        for j in (0, 2):
            assert ranges[j][1] < state.position[j] < ranges[j][1] + math.radians(1.0)
        level, text, values = diagnostics()
        assert level == b"\x01" and text.startswith("at a limit: joint1") and "joint3" in text
        assert values["joints at a limit"].split(", ")[0] == "joint1"
        assert int(values["steps at a joint limit"]) > 300
        peer.fresh()
        _, _, values = diagnostics()
        assert values["steps at a joint limit"] == "0" and int(values["steps at a joint limit, in all"]) > 300


# ---- lockstep


class Slow:
    """A controller that answers every message, the same for the same state, and takes its time for it."""

    def __init__(self, peer, pause, last):
        self.answered, self._peer, self._pause, self._last = [], peer, pause, last
        peer.on_state = self

    def __call__(self, state):
        if step_of(state) >= self._last:
            return
        time.sleep(self._pause)
        self.answered.append(step_of(state))
        volts = [5.0 * math.sin(0.5 * step_of(state) + j) for j in range(3)]
        self._peer.commands.publish(Float64MultiArray(data=volts))


def slow_run(bag, namespace, joins, last=12):
    """A run in which another node subscribes to the states at a step; returns what was answered."""
    with Node(namespace, mode="lockstep", bag_path=bag), Peer(namespace) as peer:
        slow = Slow(peer, 0.7, last)
        viewers = []

        def reached():
            if len(slow.answered) >= joins and not viewers:
                viewers.append(Peer(namespace, None, "viewer"))
            return peer.states and step_of(peer.states[-1]) == last

        peer.wait_for(reached, f"state {last}")
        for _ in range(10):
            peer.executor.spin_once(timeout_sec=0.1)
        for viewer in viewers:
            viewer.close()
    return slow.answered


@pytest.mark.long
def test_each_command_of_a_slow_controller_makes_one_step_and_runs_are_equal(tmp_path):
    for name, joins in (("first", 3), ("second", 8)):
        (tmp_path / name).mkdir()
        answered = slow_run(tmp_path / name / "bag", f"/slow{os.getpid()}", joins)
        # a command that was sent before the simulator knew its publisher is lost: the first state comes again after 5 s
        assert answered == [0] * answered.count(0) + list(range(1, 12))
        contents = read_bag(tmp_path / name / "bag")
        assert [step for step, _ in contents.commands] == list(range(12)) and len(contents.steps) == 13
    for file in ("bag_0.mcap", "metadata.yaml"):
        one, two = ((tmp_path / name / "bag" / file).read_bytes() for name in ("first", "second"))
        assert one == two


def test_clock_is_there_by_default_in_lockstep_alone():
    for mode, there in (("lockstep", True), ("realtime", False)):
        with Node(mode=mode) as node, Peer(node.namespace) as peer:
            peer.find_simulator(reset=False)

            def published(peer=peer, namespace=node.namespace):
                topic = peer.node.get_publishers_info_by_topic("/clock")
                return any(info.node_namespace == namespace for info in topic)

            if there:
                # services are found before publishers at times
                peer.wait_for(published, "a publisher of the clock")
            assert published() == there
            (value,) = peer.call("get_parameters", names=["publish_clock"]).values
            assert value.bool_value == there
            if there:
                clock = Watcher(peer, Clock, "/clock")
                peer.wait_for(lambda: peer.node.count_publishers("/clock") and clock.messages, "the clock")


# ---- paused


@pytest.mark.parametrize("mode", ["realtime", "lockstep"])
def test_a_late_subscriber_gets_the_present_state_while_paused(mode):
    with Node(mode=mode, paused=True) as node, Peer(node.namespace) as peer:
        peer.find_simulator()
        peer.step(4)
        with Peer(node.namespace) as late:
            late.wait_for(lambda: late.states, "the present state")
            assert step_of(late.states[-1]) == 4


def test_step_makes_as_many_steps_as_asked_for_and_others_have_their_turn(braked):
    braked.fresh()
    # so many that they are not over before the other answer, however late that is read
    assert braked.set(step_count=100_000)[0].successful
    try:
        future = braked.clients["step"].call_async(braked.clients["step"].srv_type.Request())
        (value,) = braked.call("get_parameters", names=["step_count"]).values
        assert value.integer_value == 100_000 and not future.done()
        assert braked.call("pause", data=False).success
        braked.wait_for(future.done, "the answer")
        assert not future.result().success and "no longer paused" in future.result().message
        braked.fresh()
        assert braked.set(step_count=1000)[0].successful
        assert braked.call("step").message == "step 1000, time 28 s"
    finally:
        braked.set(step_count=1)


@pytest.fixture
def placing(tmp_path):
    effects = "['viscous_friction:joint=1,coefficient=2']"
    with Node(paused=True, bag_path=tmp_path / "bag", effects=effects) as node, Peer(node.namespace) as peer:
        peer.find_simulator()
        publisher = peer.node.create_publisher(JointState, "sim_node/set_state", 10)
        peer.wait_for(lambda: publisher.get_subscription_count() > 0, "the subscription")
        yield peer, publisher
    bags = list(tmp_path.iterdir())
    assert bags and all(replay(bag).identical for bag in bags)


def test_joints_are_put_somewhere_and_effects_change_while_the_bag_records(placing):
    peer, publisher = placing
    names = ["joint3", "joint1"]
    peer.publish(publisher, JointState(name=names, position=[0.5, -0.25], velocity=[0.1, 0.2]))
    peer.wait_for(lambda: tuple(peer.states[-1].position) == (-0.25, 0.0, 0.5), "the placed state")
    assert step_of(peer.states[-1]) == 0 and tuple(peer.states[-1].velocity) == (0.2, 0.0, 0.1)
    peer.send(0.0, -10.0, 0.0)
    peer.states.clear()
    peer.call("step")
    peer.wait_for(lambda: peer.states, "a state")
    light = peer.states[-1].velocity[1]
    # again from the same pose, with a load
    assert peer.set(effects=["payload:mass=4,x=0.1"])[0].successful
    peer.publish(publisher, JointState(name=["joint1", "joint2", "joint3"], position=[-0.25, 0.0, 0.5]))
    peer.send(0.0, -10.0, 0.0)
    peer.call("step")
    peer.wait_for(lambda: step_of(peer.states[-1]) == 2, "a state")
    assert peer.states[-1].velocity[1] > light
    # out of range, unknown, and while time runs: refused and counted
    diagnostics = Diagnostics(peer)
    for bad in (JointState(name=["joint2"], position=[2.0]), JointState(name=["elbow"], position=[0.0])):
        peer.publish(publisher, bad)
    assert diagnostics()[2]["commands rejected"] == "2"
    assert peer.set(effects=["payload:mass=-1"])[0].successful is False


def test_two_publishers_on_one_topic_of_commands_are_reported(braked):
    diagnostics = Diagnostics(braked)
    assert diagnostics()[2]["publishers of commands"] == "1"
    with Peer(braked.node.get_namespace()) as second:
        second.find_simulator(reset=False)
        # a message from before may still be on its way
        braked.wait_for(lambda: diagnostics()[2]["publishers of commands"] == "2", "the second publisher")
        level, text, _ = diagnostics()
        assert level == b"\x01" and "2 publishers" in text


# ---- ends


@pytest.mark.parametrize("number", [signal.SIGHUP, signal.SIGTERM])
def test_a_signal_closes_the_bag(tmp_path, number):
    bag = tmp_path / "bag"
    with Node(bag_path=bag) as node, Peer(node.namespace) as peer:
        peer.find_simulator(reset=False)
        peer.wait_for(lambda: peer.states and step_of(peer.states[-1]) > 5, "steps")
        assert node.end(number) == 0
    assert read_bag(bag).complete and replay(bag).identical


def test_a_bag_has_the_names_that_the_node_and_its_topics_were_given(tmp_path):
    bag = tmp_path / "bag"
    words = ["-r", "__node:=puma", "-r", "joint_states:=arm/states", "-r", "~/set_state:=put"]
    with Node(f"/cell{os.getpid()}", words, mode="lockstep", bag_path=bag) as node, Peer(node.namespace) as peer:
        states = Watcher(peer, JointState, "arm/states")
        peer.wait_for(lambda: states.messages, "a state")
        peer.send_plainly(1.0, 2.0, 3.0)
        peer.wait_for(lambda: step_of(states.messages[-1]) == 1, "state 1")
    contents = read_bag(bag)
    assert f"{node.namespace}/arm/states" in (bag / "metadata.yaml").read_text()
    assert f"{node.namespace}/puma/model" in (bag / "metadata.yaml").read_text()
    assert len(contents.steps) == 2 and len(contents.commands) == 1
    assert replay(bag).identical
