# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""Commands over topics: the node does with them what the session in the core does, exactly."""

from __future__ import annotations

import math

import pytest

pytest.importorskip("rclpy")

from diagnostic_msgs.msg import DiagnosticArray
from ros_support import Node, Peer
from sensor_msgs.msg import JointState

from puma_sim_core.plant.plant import Plant
from puma_sim_core.plant.stops import with_stops
from puma_sim_core.simulation.session import Session, SessionConfig

TIMEOUT = 0.112  # four steps


def connected(interface):
    with (
        Node(paused=True, command_interface=interface, command_timeout=TIMEOUT) as node,
        Peer(node.namespace, interface) as peer,
    ):
        peer.find_simulator()
        yield peer


@pytest.fixture(scope="module")
def volts():
    yield from connected("voltage")


@pytest.fixture(scope="module")
def setpoints():
    yield from connected("position")


@pytest.fixture(autouse=True)
def at_rest(request):
    for name in {"volts", "setpoints"} & set(request.fixturenames):
        request.getfixturevalue(name).fresh()


def reference(interface):
    """The same session without ROS."""
    plant = with_stops(Plant.of("bejczy"))
    return Session(SessionConfig(plant, command_interface=interface, command_timeout=TIMEOUT, brakes=True))


def assert_same(peer, session):
    """All states so far are those of the session, to the last bit."""
    step = session.state.step
    message = peer.state_of(step)
    state = session.state
    assert tuple(message.position) == state.position
    assert tuple(message.velocity) == state.velocity
    assert tuple(message.effort) == state.effort
    assert peer.currents[step] == state.current
    assert peer.voltages[step] == state.voltage


def rejected(peer, least):
    """The number of refused commands, as the diagnostics tell once they tell of so many: a command and a step do not
    come to the node in the order in which they were sent."""
    counts = []

    def keep(message):
        for status in message.status:
            if status.name == f"{peer.node.get_namespace()}/sim_node":
                counts.extend(item.value for item in status.values if item.key == "commands rejected")

    subscription = peer.node.create_subscription(DiagnosticArray, "/diagnostics", keep, 10)
    try:
        peer.wait_for(lambda: counts and int(counts[-1]) >= least, f"diagnostics of {least} refused commands")
    finally:
        peer.node.destroy_subscription(subscription)
    return int(counts[-1])


def test_a_command_is_shown_by_the_next_state(volts):
    session = reference("voltage")
    for command in ((10.0, -7.5, 3.25), (0.1, 0.2, 0.3), (100.0, -100.0, 40.0)):
        volts.send(*command)
        session.command(command)
        volts.step()
        session.step()
        assert_same(volts, session)
    assert volts.voltages[1:] == [(10.0, -7.5, 3.25), (0.1, 0.2, 0.3), (40.0, -40.0, 40.0)]


def test_without_commands_volts_go_to_zero_after_the_timeout(volts):
    volts.send(5.0, 5.0, 5.0)
    session = reference("voltage")
    session.command((5.0, 5.0, 5.0))
    for _ in range(8):
        volts.step()
        session.step()
        assert_same(volts, session)
    assert volts.voltages[1:] == [(5.0, 5.0, 5.0)] * 4 + [(0.0, 0.0, 0.0)] * 4


BAD_VOLTS = [(1.0, 2.0), (1.0, 2.0, 3.0, 4.0), (), (math.nan, 0.0, 0.0), (0.0, math.inf, 0.0)]


def test_bad_commands_are_refused_and_the_last_good_one_stays(volts):
    volts.send(5.0, 6.0, 7.0)
    volts.step()
    for bad in BAD_VOLTS:
        volts.send(*bad)
    volts.step()
    assert volts.voltages[2] == (5.0, 6.0, 7.0)
    assert rejected(volts, len(BAD_VOLTS)) == len(BAD_VOLTS)


def test_bad_commands_do_not_feed_the_watchdog(volts):
    volts.send(5.0, 6.0, 7.0)
    for _ in range(6):
        volts.step()
        volts.send(math.nan, 0.0, 0.0)
    assert volts.voltages[1:] == [(5.0, 6.0, 7.0)] * 4 + [(0.0, 0.0, 0.0)] * 2


@pytest.fixture(scope="module")
def joint_commands(setpoints):
    return setpoints.node.create_publisher(JointState, "joint_commands", 10)


def test_setpoints_go_to_the_servo(setpoints):
    session = reference("position")
    for k in range(12):
        command = (0.01 * k, -0.01 * k, 0.02 * k)
        setpoints.send(*command)
        session.command(command)
        setpoints.step()
        session.step()
    assert_same(setpoints, session)
    assert setpoints.states[12].position[2] > 0.02


def test_joint_commands_name_a_subset_in_any_order(setpoints, joint_commands):
    setpoints.wait_for(lambda: joint_commands.get_subscription_count() > 0)
    session = reference("position")
    for names, values in ((["joint3"], [0.1]), (["joint2", "joint1"], [-0.05, 0.2])):
        # two messages between two steps: the one does not push out the other
        setpoints.publish(joint_commands, JointState(name=names, position=values))
        session.command_joints(names, values)
    for _ in range(3):
        setpoints.step()
        session.step()
    assert_same(setpoints, session)
    assert all(setpoints.states[3].position[j] != 0.0 for j in range(3))


BAD_JOINTS = [
    (["joint4"], [0.1]),
    (["joint1", "joint1"], [0.1, 0.1]),
    (["joint1"], []),
    (["joint1"], [0.1, 0.2]),
    (["joint2"], [math.nan]),
    ([], []),
]


def test_bad_joint_commands_are_refused(setpoints, joint_commands):
    setpoints.wait_for(lambda: joint_commands.get_subscription_count() > 0)
    for names, values in BAD_JOINTS:
        setpoints.publish(joint_commands, JointState(name=names, position=values))
    session = reference("position")
    setpoints.step()
    session.step()
    assert_same(setpoints, session)
    assert rejected(setpoints, len(BAD_JOINTS)) == len(BAD_JOINTS)


def test_without_setpoints_the_arm_is_held_after_the_timeout(setpoints):
    session = reference("position")
    setpoints.send(0.5, 0.5, 0.5)
    session.command((0.5, 0.5, 0.5))
    for _ in range(30):
        setpoints.step()
        session.step()
    assert_same(setpoints, session)
    assert setpoints.states[30].position[0] < 0.45


def test_volts_are_never_read_as_setpoints(setpoints):
    assert (
        setpoints.node.get_subscriptions_info_by_topic(setpoints.node.resolve_topic_name("voltage_controller/commands"))
        == []
    )


def test_commands_reach_the_node_of_their_namespace_only(volts):
    with Node(paused=True) as other, Peer(other.namespace) as peer:
        peer.find_simulator()
        peer.send(1.0, 2.0, 3.0)
        peer.step()
        volts.step()
        assert peer.voltages[1] == (1.0, 2.0, 3.0)
        assert volts.voltages[1] == (0.0, 0.0, 0.0)
