# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""Controllers in the node and over topics: what the core does, and bags that replay."""

from __future__ import annotations

import math

import numpy as np
import pytest
import yaml

pytest.importorskip("rclpy")

from ros_support import Node, Peer, arguments, run_program

from puma_sim_core.plant.plant import Plant
from puma_sim_core.plant.stops import with_stops
from puma_sim_core.recording.bag import read_bag
from puma_sim_core.recording.recording import read_csv
from puma_sim_core.resources import config_path
from puma_sim_core.servo.pid import PidGains
from puma_sim_core.servo.servo import ServoConfig
from puma_sim_core.simulation.replay import replay, session_of
from puma_sim_core.simulation.session import Session, SessionConfig

START = (0.0, -1.2, 1.0)
STEPS = 20


def target_of(step):
    return tuple(q + 0.01 * step * by for q, by in zip(START, (1.0, -0.8, 0.5)))


def assert_follows(peer, session):
    """Steps with a setpoint each; the node's states are those of the session, to the last bit."""
    for step in range(STEPS):
        peer.send(*target_of(step))
        session.command(target_of(step))
        message, state = peer.step(), session.step()
        assert tuple(message.position) == state.position
        assert tuple(message.velocity) == state.velocity
        assert peer.voltages[state.step] == state.voltage
    assert abs(state.position[0] - START[0]) > 0.05


@pytest.mark.parametrize("kind", ["scheduled", "computed_torque"])
def test_the_node_runs_a_controller_and_its_bag_replays(kind, tmp_path):
    bag = tmp_path / "bag"
    with (
        Node(
            paused=True, command_interface="position", controller=kind, bag_path=bag, initial_position=list(START)
        ) as node,
        Peer(node.namespace, "position") as peer,
    ):
        peer.find_simulator()
        common = {"command_interface": "position", "initial_position": START, "brakes": True}
        config = SessionConfig(with_stops(Plant.of()), controller=kind, **common)
        assert_follows(peer, Session(config))
    # each reset starts a bag; the last one has the steps
    last = max(tmp_path.glob("bag*"), key=lambda path: len(read_bag(path).steps))
    found, _ = session_of(last, read_bag(last).config_text)
    assert found == config
    result = replay(last)
    assert result.identical and result.steps == result.commands == STEPS


def test_controller_and_servo_change_at_a_reset_and_bags_tell_which(tmp_path):
    other = yaml.safe_load(config_path("controllers.yaml").read_text())
    other["servo"]["computed_torque"]["bandwidth"] = [20.0, 25.0, 30.0]
    file = tmp_path / "controllers.yaml"
    file.write_text(yaml.safe_dump(other))
    with (
        Node(
            paused=True, command_interface="position", bag_path=tmp_path / "bag", initial_position=list(START)
        ) as node,
        Peer(node.namespace, "position") as peer,
    ):
        peer.find_simulator()
        values = {
            "servo.gain": [700.0, 1200.0, 600.0],
            "servo.integral_time": [0.0, 0.3, 0.3],
            "servo.derivative_time": [0.02, 0.02, 0.02],
            "servo.amplifier_gain": 4.0,
            "servo.converter_bits": 12,
            "servo.encoder_counts": 1000,
            "servo.derivative_on_measurement": False,
        }
        assert all(result.successful for result in peer.set(**values))
        peer.fresh()
        servo = ServoConfig(
            (PidGains(700.0, math.inf, 0.02), PidGains(1200.0, 0.3, 0.02), PidGains(600.0, 0.3, 0.02)),
            4.0,
            12,
            1000,
            False,
        )
        common = {"command_interface": "position", "initial_position": START, "servo": servo, "brakes": True}
        assert_follows(peer, Session(SessionConfig(with_stops(Plant.of()), **common)))
        (result,) = peer.set(controller="computed_torque")
        assert result.successful
        (result,) = peer.set(controllers_file=str(file))
        assert result.successful
        peer.fresh()
        config = SessionConfig(
            with_stops(Plant.of()),
            controller="computed_torque",
            controller_settings=other["servo"]["computed_torque"],
            **common,
        )
        assert_follows(peer, Session(config))
        (result,) = peer.set(controller="pid")
        assert not result.successful and "given with controller pid" in result.reason
    bags = [path for path in tmp_path.glob("bag*") if len(read_bag(path).steps) == STEPS + 1]
    assert len(bags) == 2 and all(replay(path).identical for path in bags)


@pytest.mark.parametrize("kind", ["pid", "scheduled", "computed_torque"])
def test_an_external_controller_of_any_kind_follows_the_line(kind, tmp_path):
    log = tmp_path / "log.csv"
    bag = tmp_path / "bag"
    with Node(mode="lockstep", bag_path=bag, initial_position=[0.2, -0.9, 0.6]) as node:
        done = run_program(
            "puma_sim_ros.external_controller",
            *arguments({"controller": kind, "duration": 2.0, "drop": 0.2, "settle": 1.0, "log_path": log}),
            "-r",
            f"__ns:={node.namespace}",
        )
        assert done.returncode == 0, done.stderr
    run = read_csv(log, ("voltage", "setpoint", "position"))
    error = np.abs(run.position - run.setpoint)
    assert error[-1].max() < 0.01
    assert error.max() < 0.15
    if kind == "computed_torque":
        assert error.max() < 0.02
    assert replay(bag).identical


def test_an_external_controller_that_cannot_be_is_named():
    for parameters, words in (
        ({"controller": "pd"}, ["'controller'", "pd", "computed_torque"]),
        ({"controller": "scheduled", "controllers_file": "/nowhere.yaml"}, ["/nowhere.yaml"]),
        ({"gain": "[1.0, 2.0]"}, ["three numbers"]),
    ):
        done = run_program("puma_sim_ros.external_controller", *arguments(parameters))
        assert done.returncode == 1
        line = done.stderr.strip().splitlines()[-1]
        assert line.startswith("external_controller: ") and all(word in line for word in words)


def test_the_files_of_parameters_have_the_defaults_of_the_nodes():
    from puma_sim_ros.external_controller import PARAMETERS as external
    from puma_sim_ros.node.parameters import PARAMETERS as node

    def flat(values, prefix=""):
        for name, value in values.items():
            if isinstance(value, dict):
                yield from flat(value, f"{prefix}{name}.")
            else:
                yield f"{prefix}{name}", value

    for program, defaults in (
        ("sim_node", {name: entry["default"] for name, entry in node.items()}),
        ("external_controller", external),
    ):
        found = yaml.safe_load(config_path(f"{program}.yaml").read_text())[f"/**/{program}"]["ros__parameters"]
        assert dict(flat(found)) == defaults
