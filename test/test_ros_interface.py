# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""The interface of `sim_node`, seen from another process: names, types, quality, services."""

from __future__ import annotations

import math

import pytest
import yaml

pytest.importorskip("rclpy")

from diagnostic_msgs.msg import DiagnosticArray
from rcl_interfaces.msg import ParameterType
from rclpy.qos import DurabilityPolicy, ReliabilityPolicy
from ros_support import PERIOD_NS, Node, Peer, step_of, time_ns
from rosgraph_msgs.msg import Clock
from std_msgs.msg import String

from puma_sim_core.arm.parameters import load_parameters
from puma_sim_core.arm.urdf import arm_urdf
from puma_sim_core.plant.plant import Plant
from puma_sim_core.plant.stops import with_stops
from puma_sim_core.simulation.session import SessionConfig
from puma_sim_ros.messages import qos

ARRAY, JOINTS = "std_msgs/msg/Float64MultiArray", "sensor_msgs/msg/JointState"


@pytest.fixture(scope="module")
def peer():
    with Node(paused=True, publish_clock=True) as node, Peer(node.namespace) as peer:
        peer.find_simulator()
        yield peer


@pytest.fixture(autouse=True)
def at_rest(peer):
    peer.fresh()


@pytest.mark.parametrize(
    "name, kind, latched",
    [
        ("joint_states", JOINTS, False),
        ("motor_currents", ARRAY, False),
        ("motor_voltages", ARRAY, False),
        ("robot_description", "std_msgs/msg/String", True),
        ("sim_node/model", "std_msgs/msg/String", True),
        ("sim_node/brakes", "std_msgs/msg/Bool", True),
        ("/clock", "rosgraph_msgs/msg/Clock", False),
        ("/diagnostics", "diagnostic_msgs/msg/DiagnosticArray", False),
    ],
)
def test_published_topic(peer, name, kind, latched):
    topic = peer.node.resolve_topic_name(name)
    found = [
        info
        for info in peer.node.get_publishers_info_by_topic(topic)
        if (info.node_namespace, info.node_name) == (peer.node.get_namespace(), "sim_node")
    ]
    assert [info.topic_type for info in found] == [kind]
    assert found[0].qos_profile.reliability == ReliabilityPolicy.RELIABLE
    assert found[0].qos_profile.durability == (
        DurabilityPolicy.TRANSIENT_LOCAL if latched else DurabilityPolicy.VOLATILE
    )


def test_only_the_selected_command_topic_is_subscribed(peer):
    def subscribers(name):
        return peer.node.get_subscriptions_info_by_topic(peer.node.resolve_topic_name(name))

    (info,) = subscribers("voltage_controller/commands")
    assert info.topic_type == ARRAY
    assert info.qos_profile.reliability == ReliabilityPolicy.RELIABLE
    assert subscribers("position_controller/commands") == []
    assert subscribers("joint_commands") == []


def test_state_at_the_start_and_at_each_step(peer):
    peer.step(3)
    for step, state in enumerate(peer.states):
        assert time_ns(state) == step * PERIOD_NS
        assert state.header.frame_id == "base_link"
        assert list(state.name) == ["joint1", "joint2", "joint3"]
        for values in (state.position, state.velocity, state.effort, peer.currents[step], peer.voltages[step]):
            assert len(values) == 3
            assert all(map(math.isfinite, values))
    assert len(peer.states) == 4


def test_effort_is_torque_at_the_joint(peer):
    peer.send(10.0, -10.0, 10.0)
    state = peer.step(2)
    kT = Plant.of("bejczy").torque_per_ampere
    assert list(state.effort) == [k * i for k, i in zip(kT, peer.currents[2])]
    assert all(torque != 0.0 for torque in state.effort)


def latched_text(peer, topic):
    """What a subscriber gets that comes long after the message."""
    texts = []
    subscription = peer.node.create_subscription(
        String, topic, lambda message: texts.append(message.data), qos(1, latched=True)
    )
    try:
        peer.wait_for(lambda: texts, topic)
    finally:
        peer.node.destroy_subscription(subscription)
    return texts[-1]


def test_late_subscribers_get_the_urdf(peer):
    assert latched_text(peer, "robot_description") == arm_urdf(load_parameters("bejczy"))


def test_late_subscribers_get_the_model(peer):
    text = latched_text(peer, "sim_node/model")
    assert SessionConfig.from_mapping(yaml.safe_load(text)) == SessionConfig(
        with_stops(Plant.of("bejczy")), brakes=True
    )


def test_clock_is_simulated_time(peer):
    times = []
    subscription = peer.node.create_subscription(
        Clock, "/clock", lambda m: times.append(m.clock.sec * 10**9 + m.clock.nanosec), 10
    )
    try:
        peer.wait_for(
            lambda: (
                peer.node.count_publishers("/clock")
                and (peer.step(), peer.executor.spin_once(timeout_sec=0.1), times)[-1]
            ),
            "/clock",
        )
        peer.wait_for(lambda: times[-1] == time_ns(peer.states[-1]), "the time of the last state")
    finally:
        peer.node.destroy_subscription(subscription)


def test_step_is_refused_unless_paused(peer):
    assert peer.call("pause", data=False).success
    refused = peer.call("step")
    assert not refused.success
    assert "not paused" in refused.message
    assert peer.call("pause", data=True).success
    assert peer.call("step").success


def test_step_answers_with_step_and_time(peer):
    assert peer.call("step").message == "step 1, time 0.028 s"
    assert peer.call("step").message == "step 2, time 0.056 s"


def test_pause_stops_time_and_resume_goes_on(peer):
    peer.call("pause", data=False)
    peer.state_of(2)
    stopped = peer.call("pause", data=True).message
    peer.state_of(int(stopped.split()[1].rstrip(",")))
    count = len(peer.states)
    for _ in range(10):
        peer.executor.spin_once(timeout_sec=0.01)
    assert len(peer.states) == count
    peer.call("pause", data=False)
    peer.state_of(count)


def test_reset_clears_the_state_the_motors_and_the_command(peer):
    peer.send(20.0, 20.0, 20.0)
    moved = peer.step(3)
    assert moved.position[0] != 0.0
    peer.fresh()
    state = peer.states[0]
    assert step_of(state) == 0
    assert list(state.position) == list(state.velocity) == list(state.effort) == [0.0] * 3
    assert peer.currents[0] == peer.voltages[0] == (0.0, 0.0, 0.0)
    peer.step()
    assert peer.voltages[1] == (0.0, 0.0, 0.0)


def test_diagnostics(peer):
    found = {}

    def keep(message):
        for status in message.status:
            if status.name == f"{peer.node.get_namespace()}/sim_node":
                found.update(
                    level=status.level, text=status.message, values={item.key: item.value for item in status.values}
                )

    subscription = peer.node.create_subscription(DiagnosticArray, "/diagnostics", keep, 10)
    try:
        peer.send(50.0, 0.0, -50.0)
        peer.send(1.0, 2.0)
        peer.step(2)
        peer.wait_for(lambda: found.get("values", {}).get("step") == "2", "diagnostics")
    finally:
        peer.node.destroy_subscription(subscription)
    assert found["level"] == b"\x00"
    assert found["text"] == "paused"
    values = found["values"]
    assert values["commands saturated"] == "2"
    assert values["commands rejected"] == "1"
    assert values["command age [s]"] == "0.028"
    assert values["simulated time [s]"] == "0.056"
    assert {"overruns", "lateness median [ms]", "lateness p99 [ms]"} <= values.keys()


PARAMETERS = {
    "joints": ParameterType.PARAMETER_STRING_ARRAY,
    "command_interface": ParameterType.PARAMETER_STRING,
    "mode": ParameterType.PARAMETER_STRING,
    "period": ParameterType.PARAMETER_DOUBLE,
    "substeps": ParameterType.PARAMETER_INTEGER,
    "real_time_factor": ParameterType.PARAMETER_DOUBLE,
    "voltage_limit": ParameterType.PARAMETER_DOUBLE,
    "command_timeout": ParameterType.PARAMETER_DOUBLE,
    "brakes": ParameterType.PARAMETER_BOOL,
    "stops": ParameterType.PARAMETER_BOOL,
    "initial_position": ParameterType.PARAMETER_DOUBLE_ARRAY,
    "parameter_set": ParameterType.PARAMETER_STRING,
    "effects": ParameterType.PARAMETER_STRING_ARRAY,
    "model": ParameterType.PARAMETER_STRING,
    "publish_clock": ParameterType.PARAMETER_BOOL,
    "frame_id": ParameterType.PARAMETER_STRING,
    "bag_path": ParameterType.PARAMETER_STRING,
    "paused": ParameterType.PARAMETER_BOOL,
    "step_count": ParameterType.PARAMETER_INTEGER,
    "controller": ParameterType.PARAMETER_STRING,
    "controllers_file": ParameterType.PARAMETER_STRING,
    "servo.gain": ParameterType.PARAMETER_DOUBLE_ARRAY,
    "servo.integral_time": ParameterType.PARAMETER_DOUBLE_ARRAY,
    "servo.derivative_time": ParameterType.PARAMETER_DOUBLE_ARRAY,
    "servo.derivative_on_measurement": ParameterType.PARAMETER_BOOL,
    "servo.amplifier_gain": ParameterType.PARAMETER_DOUBLE,
    "servo.converter_bits": ParameterType.PARAMETER_INTEGER,
    "servo.encoder_counts": ParameterType.PARAMETER_INTEGER,
}
CHANGEABLE = {
    "real_time_factor",
    "voltage_limit",
    "command_timeout",
    "brakes",
    "effects",
    "initial_position",
    "paused",
    "step_count",
    *(name for name in PARAMETERS if name.startswith(("controller", "servo."))),
}


def test_parameters_are_described(peer):
    names = list(PARAMETERS)
    descriptors = peer.call("describe_parameters", names=names).descriptors
    assert [d.name for d in descriptors] == names
    for descriptor in descriptors:
        assert descriptor.type == PARAMETERS[descriptor.name]
        assert descriptor.description
        assert descriptor.read_only == (descriptor.name not in CHANGEABLE)
        if descriptor.type == ParameterType.PARAMETER_DOUBLE:
            assert len(descriptor.floating_point_range) == 1
        if descriptor.type == ParameterType.PARAMETER_INTEGER:
            assert len(descriptor.integer_range) == 1


@pytest.mark.parametrize(
    "name, value, reason",
    [
        ("period", 0.014, "read-only"),
        ("command_interface", "position", "read-only"),
        ("voltage_limit", -1.0, "range"),
        ("real_time_factor", 0.0, "range"),
        ("command_timeout", math.nan, "range"),
        ("initial_position", [0.0, 0.0], "three finite numbers"),
        ("initial_position", [0.0, math.nan, 0.0], "three finite numbers"),
        ("initial_position", [0.0, 0.8, 0.0], "joint 2: 0.8 rad; expected -3.8921 to 0.7505"),
        ("effects", ["stiction:joint=1"], "unknown effect 'stiction'"),
        ("effects", ["payload:mass=3"] * 2, "stands twice"),
        ("step_count", 0, "range"),
        ("voltage_limit", 0.0, "range"),
        ("controller", "scheduled", "command_interface position"),
        ("controllers_file", "gains.yaml", "given with controller pid"),
        ("servo.gain", [1.0, 2.0], "three numbers, one for each joint"),
        ("servo.gain", [1.0, -2.0, 3.0], "gain = -2.0"),
        ("servo.derivative_time", [1.0, math.nan, 3.0], "derivative_time = nan"),
        ("servo.converter_bits", 33, "range"),
        ("servo.converter_bits", 1, "from 2 to 32"),
        ("servo.encoder_counts", -1, "range"),
        ("servo.amplifier_gain", 0.0, "range"),
        ("use_sim_time", True, "source of simulated time"),
    ],
)
def test_change_of_a_parameter_that_is_refused(peer, name, value, reason):
    (result,) = peer.set(**{name: value})
    assert not result.successful
    assert reason in result.reason


def test_changed_start_and_limit_hold_from_the_next_reset(peer):
    assert all(r.successful for r in peer.set(initial_position=[0.1, -0.2, 0.3], voltage_limit=5.0))
    try:
        peer.send(30.0, 0.0, 0.0)
        peer.step()
        assert peer.voltages[1] == (30.0, 0.0, 0.0)
        peer.fresh()
        assert list(peer.states[0].position) == [0.1, -0.2, 0.3]
        peer.send(30.0, 0.0, 0.0)
        peer.step()
        assert peer.voltages[1] == (5.0, 0.0, 0.0)
    finally:
        peer.set(initial_position=[0.0, 0.0, 0.0], voltage_limit=40.0)


def test_pause_by_parameter(peer):
    assert peer.set(paused=False)[0].successful
    peer.state_of(2)
    assert peer.set(paused=True)[0].successful
    assert peer.call("step").success
