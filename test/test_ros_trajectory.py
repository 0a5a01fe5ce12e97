# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""joint_trajectory_controller/joint_trajectory, as planners and rqt send it, and frames in what the node records."""

from __future__ import annotations

import importlib.util

import pytest

pytest.importorskip("rclpy")

from builtin_interfaces.msg import Duration, Time
from ros_support import Node, Peer
from rosbags.rosbag2 import Reader
from test_bag_frames import placed
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

from puma_sim_core.arm.kinematics import wrist_position
from puma_sim_core.arm.parameters import load_parameters
from puma_sim_core.control.trajectory import Follower, Waypoint, trajectory_setpoints
from puma_sim_core.plant.plant import Plant
from puma_sim_core.plant.stops import with_stops
from puma_sim_core.recording.bag import messages, read_bag, recover
from puma_sim_core.recording.topics import TF_MESSAGE
from puma_sim_core.simulation.replay import replay
from puma_sim_core.simulation.session import Session, SessionConfig

JOINTS = ("joint1", "joint2", "joint3")
POINTS = [Waypoint(0.4, (0.05, -0.06, 0.04)), Waypoint(0.9, (0.1, -0.1, 0.02))]


def trajectory(points=POINTS, names=JOINTS, **fields):
    def point(each):
        seconds, rest = divmod(round(each.time * 1e9), 1_000_000_000)
        values = {"positions": each.position, "velocities": each.velocity, "accelerations": each.acceleration}
        return JointTrajectoryPoint(
            time_from_start=Duration(sec=seconds, nanosec=rest), **{k: list(v) for k, v in values.items()}
        )

    return JointTrajectory(joint_names=list(names), points=[point(each) for each in points], **fields)


@pytest.fixture(scope="module")
def bag(tmp_path_factory):
    return tmp_path_factory.mktemp("trajectory") / "session"


@pytest.fixture(scope="module")
def peer(bag):
    with (
        Node(paused=True, command_interface="position", bag_path=bag, record_tf=True) as node,
        Peer(node.namespace, "position") as peer,
    ):
        peer.find_simulator(reset=False)
        topic = "joint_trajectory_controller/joint_trajectory"
        peer.trajectories = peer.node.create_publisher(JointTrajectory, topic, 1)
        peer.wait_for(lambda: peer.trajectories.get_subscription_count(), "the trajectory topic")
        peer.fresh()
        yield peer


def reference():
    """The same session without ROS, and the setpoints of a trajectory for it."""
    plant = with_stops(Plant.of("bejczy"))
    session = Session(SessionConfig(plant, command_interface="position", brakes=True))
    return session, Follower(plant, JOINTS, session.config.period, session.config.voltage_limit)


def assert_follows(peer, session, setpoints):
    for row in setpoints:
        session.command(list(row))
        assert tuple(peer.step().position) == session.step().position


def test_a_trajectory_is_followed_setpoint_by_setpoint_and_its_end_is_held(peer):
    peer.fresh()
    session, follower = reference()
    peer.publish(peer.trajectories, trajectory())
    setpoints = trajectory_setpoints(follower, JOINTS, POINTS, session.setpoint)
    # longer than command_timeout at the end
    assert_follows(peer, session, [*setpoints, *[setpoints[-1]] * 30])
    # a second one begins at the end of the first, with joints in another order
    back = [Waypoint(0.5, (0.0, 0.05, -0.05), (0.0, 0.0, 0.0), (0.0, 0.0, 0.0))]
    names = ("joint3", "joint1", "joint2")
    peer.publish(peer.trajectories, trajectory(back, names))
    assert_follows(peer, session, trajectory_setpoints(follower, names, back, setpoints[-1]))


def test_what_is_refused_changes_nothing_and_an_empty_one_holds(peer):
    peer.fresh()
    session, follower = reference()
    peer.publish(peer.trajectories, trajectory())
    setpoints = trajectory_setpoints(follower, JOINTS, POINTS, session.setpoint)
    assert_follows(peer, session, setpoints[:10])
    for wrong in (
        trajectory([Waypoint(0.01, (1.0, 0.0, 0.0))]),
        trajectory(names=("joint1", "joint2", "joint4")),
        trajectory(header=messages_header(5)),
    ):
        peer.publish(peer.trajectories, wrong)
    assert_follows(peer, session, setpoints[10:15])
    peer.publish(peer.trajectories, trajectory([]))
    assert_follows(peer, session, [setpoints[14]] * 10)


def messages_header(seconds):
    header = JointTrajectory().header
    header.stamp = Time(sec=seconds)
    return header


def test_another_command_takes_over(peer):
    peer.fresh()
    session, follower = reference()
    peer.publish(peer.trajectories, trajectory())
    assert_follows(peer, session, trajectory_setpoints(follower, JOINTS, POINTS, session.setpoint)[:12])
    target = (0.02, -0.02, 0.01)
    peer.send(*target)
    session.command(target)
    for _ in range(8):
        assert tuple(peer.step().position) == session.step().position


def test_the_bag_replays_and_its_frames_are_those_of_its_states(peer, bag, tmp_path):
    peer.fresh()
    peer.publish(peer.trajectories, trajectory())
    peer.step(20)
    peer.fresh()
    written = max(bag.parent.glob("session_*"), key=lambda path: int(path.name.split("_")[1]))
    written = written.with_name(f"session_{int(written.name.split('_')[1]) - 1}")
    peer.wait_for((written / "metadata.yaml").exists, "the closed bag")
    found = replay(written)
    assert found.identical
    assert found.steps == 20
    contents, arm = read_bag(written), load_parameters("bejczy")
    assert contents.frames
    with Reader(written) as reader:
        raw = {"/tf": [], "/tf_static": []}
        for connection, time_ns, data in reader.messages():
            if connection.topic in raw:
                assert connection.msgtype == TF_MESSAGE
                raw[connection.topic].append((time_ns, messages.decode(data, TF_MESSAGE).transforms))
    ((_, fixed),) = raw["/tf_static"]
    assert [time for time, _ in raw["/tf"]] == contents.time_ns.tolist()
    for (_, moving), position in zip(raw["/tf"], contents.position):
        tool = placed([*moving, *fixed])["tool0"][:3, 3]
        assert tool == pytest.approx(wrist_position(position, arm), abs=1e-12)
    again = recover(written, tmp_path / "again").path
    assert (again / "again_0.mcap").read_bytes() == (written / f"{written.name}_0.mcap").read_bytes()


@pytest.mark.skipif(importlib.util.find_spec("tf2_msgs") is not None, reason="tf2_msgs is installed")
def test_frames_on_topics_need_tf2_msgs():
    node = Node(publish_tf=True)
    assert node.wait() == 2
    assert "parameter 'publish_tf': tf2_msgs is not installed; expected the ROS package tf2_msgs" in node.errors
