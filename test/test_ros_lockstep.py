# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""Lockstep: one command, one step; equal commands, equal bags."""

from __future__ import annotations

import math
import os

import pytest

pytest.importorskip("rclpy")

from ros_support import Node, Peer, arguments, run_program, step_of

from puma_sim_core.recording.bag import read_bag
from puma_sim_core.recording.recording import read_csv
from puma_sim_core.simulation.replay import replay


def volts_of(step):
    """Commands that cross the limit now and then."""
    return tuple(50.0 * math.sin(0.7 * step + j) for j in range(3))


def drive(peer, steps):
    """Answer each new state with one command, until the state of `steps`."""
    answered = set()

    def answer(state):
        step = step_of(state)
        if step < steps and step not in answered:
            answered.add(step)
            peer.commands.publish(type_of_commands(data=volts_of(step)))

    type_of_commands = peer.commands.msg_type
    peer.on_state = answer
    peer.wait_for(lambda: peer.states and step_of(peer.states[-1]) == steps, f"state {steps}")
    peer.on_state = None


def recorded_run(bag, namespace, steps=120):
    with Node(namespace, mode="lockstep", bag_path=bag), Peer(namespace) as peer:
        peer.find_simulator(reset=False)
        drive(peer, steps)
    return peer.states


def test_two_runs_give_byte_equal_bags_that_replay(tmp_path):
    for name in ("first", "second"):
        (tmp_path / name).mkdir()
        states = recorded_run(tmp_path / name / "bag", f"/equal{os.getpid()}")
        assert {step_of(state) for state in states} == set(range(121))
    for file in ("bag_0.mcap", "metadata.yaml"):
        one, two = ((tmp_path / name / "bag" / file).read_bytes() for name in ("first", "second"))
        assert one == two
    contents = read_bag(tmp_path / "first" / "bag")
    assert [step for step, _ in contents.commands] == list(range(120))
    assert [command.values for _, command in contents.commands] == [volts_of(step) for step in range(120)]
    assert replay(tmp_path / "first" / "bag").identical


@pytest.fixture
def lockstep():
    with Node(mode="lockstep") as node, Peer(node.namespace) as peer:
        peer.find_simulator(reset=False)
        peer.wait_for(lambda: peer.states and peer.currents and peer.voltages, "a state")
        yield peer


def test_time_goes_on_by_good_commands_alone(lockstep):
    lockstep.send(1.0, 2.0)
    lockstep.send(math.nan, 0.0, 0.0)
    # the last state is sent again while nothing comes
    lockstep.states.clear()
    lockstep.wait_for(lambda: len(lockstep.states) >= 2, "repeated states")
    assert {step_of(state) for state in lockstep.states} == {0}
    for _ in range(3):
        lockstep.send(1.0, 2.0, 3.0)
    lockstep.wait_for(lambda: step_of(lockstep.states[-1]) == 3, "state 3")
    assert {step_of(state) for state in lockstep.states} == {0, 1, 2, 3}


def test_a_command_during_a_pause_makes_its_step_afterwards(lockstep):
    lockstep.call("pause", data=True)
    lockstep.send(1.0, 2.0, 3.0)
    lockstep.send(4.0, 5.0, 6.0)
    assert step_of(lockstep.states[-1]) == 0
    lockstep.call("pause", data=False)
    lockstep.wait_for(lambda: step_of(lockstep.states[-1]) == 1, "state 1")
    lockstep.wait_for(lambda: lockstep.voltages[-1] == (4.0, 5.0, 6.0), "the later command")


def test_the_example_controller_follows_its_line(tmp_path):
    bag, log = tmp_path / "bag", tmp_path / "log.csv"
    with Node(mode="lockstep", bag_path=bag) as node:
        controller = run_program(
            "puma_sim_ros.external_controller",
            *arguments({"duration": 2.0, "log_path": log}),
            "-r",
            f"__ns:={node.namespace}",
        )
    assert controller.returncode == 0, controller.stderr
    assert controller.stdout.count("tracking error of joint") == 3
    assert "missed: 0" in controller.stdout
    contents = read_bag(bag)
    table = read_csv(log, required=("voltage", "setpoint", "position"))
    # what the controller saw and sent is what the simulator recorded
    assert table.position.tolist() == contents.position[: len(table)].tolist()
    assert table.voltage.tolist() == [list(c.values) for _, c in contents.commands]
    # and the arm went where it should
    assert abs(table.setpoint - table.position).max() < 0.05
    assert replay(bag).identical


def test_the_example_controller_says_when_nobody_answers():
    done = run_program("puma_sim_ros.external_controller", *arguments({"timeout": 1.0}), "-r", "__ns:=/nobody")
    assert done.returncode == 1
    assert "no answer for 1 s" in done.stderr
    assert "sim_node" in done.stderr


def test_the_example_controller_refuses_a_simulator_that_takes_setpoints():
    with Node(mode="lockstep", command_interface="position") as node:
        done = run_program(
            "puma_sim_ros.external_controller", *arguments({"timeout": 10.0}), "-r", f"__ns:={node.namespace}"
        )
    assert done.returncode == 1
    assert "command_interface is position; expected voltage" in done.stderr
