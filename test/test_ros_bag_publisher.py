# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""A bag given back to topics: what was recorded, to a viewer or to a simulator."""

from __future__ import annotations

import os

import pytest
import yaml

pytest.importorskip("rclpy")

from ros_support import Node, Peer, Program, run_program

from puma_sim_core.plant.plant import Plant
from puma_sim_core.recording.bag import BagRecorder, read_bag
from puma_sim_core.simulation.session import Session, SessionConfig

STEPS = 30


@pytest.fixture
def recorded(tmp_path, request):
    """A bag of two files, of a session with a command at each step, in a namespace of its own."""
    namespace = f"/bag{os.getpid()}{request.node.name[-8:]}"
    config = SessionConfig(Plant.of("bejczy"))
    session = Session(config)
    bag = tmp_path / "recorded"
    with BagRecorder(
        bag,
        namespace=namespace,
        config_text=yaml.safe_dump(config.to_mapping()),
        urdf="<robot/>",
        joint_names=config.joint_names,
        frame_id=config.frame_id,
        command_interface="voltage",
        period_ns=config.period_ns,
        splits_ns=[STEPS // 2 * config.period_ns],
    ) as recorder:
        recorder.write_state(session.state)
        for step in range(STEPS):
            command = session.command((0.5 * step, -0.3 * step, 10.0))
            recorder.write_command(session.state.time_ns, command)
            recorder.write_state(session.step())
    return namespace, bag


def test_a_viewer_gets_all_that_was_recorded(recorded):
    namespace, bag = recorded
    commands = []
    with Peer(namespace) as peer:
        peer.node.create_subscription(
            peer.commands.msg_type,
            "voltage_controller/commands",
            lambda message: commands.append(tuple(message.data)),
            100,
        )
        with Program("puma_sim_ros.bag_publisher", str(bag), "--rate", "2.0") as publisher:
            peer.wait_for(
                lambda: (
                    len(peer.states) == STEPS + 1
                    and len(commands) == STEPS
                    and len(peer.voltages) == len(peer.currents) == STEPS + 1
                ),
                "all messages",
            )
            publisher.wait()
    contents = read_bag(bag)
    assert [list(state.position) for state in peer.states] == contents.position.tolist()
    assert [list(values) for values in peer.voltages] == contents.voltage.tolist()
    assert [list(values) for values in peer.currents] == contents.current.tolist()
    assert commands == [command.values for _, command in contents.commands]


def test_a_simulator_gets_the_commands_alone_and_moves_the_same(recorded, tmp_path):
    namespace, bag = recorded
    with Node(namespace, mode="lockstep", bag_path=tmp_path / "again"), Peer(namespace) as peer:
        peer.find_simulator(reset=False)
        done = run_program("puma_sim_ros.bag_publisher", str(bag), "--rate", "2.0")
        assert done.returncode == 0, done.stderr
        assert f"{STEPS} messages published" in done.stdout
    first, second = read_bag(bag), read_bag(tmp_path / "again")
    assert second.position.tolist() == first.position.tolist()
    assert second.commands == first.commands


def test_what_is_no_bag_is_refused(tmp_path):
    done = run_program("puma_sim_ros.bag_publisher", str(tmp_path))
    assert done.returncode == 2
    assert str(tmp_path) in done.stderr
    assert "Traceback" not in done.stderr
