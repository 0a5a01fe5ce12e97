# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""What cannot be used stops the node before anything moves; what goes wrong later pauses it."""

from __future__ import annotations

import math
from concurrent.futures import ThreadPoolExecutor

import pytest

pytest.importorskip("rclpy")

from ros_support import Node, Peer, arguments, run_program

BAD_PARAMETERS = {
    "unknown set": ({"parameter_set": "nobody"}, ["parameter_set", "nobody", "bejczy"]),
    "unknown effect": ({"effects": "['stiction:joint=1']"}, ["effects", "stiction"]),
    "effect out of bounds": ({"effects": "['coulomb_friction:joint=2,torque=-1']"}, ["effects", "torque", "0 to"]),
    "no model file": ({"model": "/nowhere/model.yaml"}, ["model", "/nowhere/model.yaml"]),
    "model and set": ({"model": "/nowhere/model.yaml", "parameter_set": "paul"}, ["parameter_set", "model"]),
    "step above 8 ms": ({"substeps": 2}, ["substeps", "8 ms"]),
    "range": ({"period": 20.0}, ["period", "20.0", "0.001 to 1"]),
    "type": ({"voltage_limit": 40}, ["voltage_limit", "40", "decimal point"]),
    "array length": ({"initial_position": "[0.0, 0.0]"}, ["initial_position", "three"]),
    "array value": ({"initial_position": "[0.0, .nan, 0.0]"}, ["initial_position", "finite"]),
    "start out of range": ({"initial_position": "[0.0, 0.8, 0.0]"}, ["initial_position", "joint 2", "0.7505"]),
    "no frame": ({"frame_id": "''"}, ["frame_id", "link1"]),
    "frame of a link": ({"frame_id": "link2"}, ["frame_id", "link2", "other than"]),
    "no voltage": ({"voltage_limit": 0.0}, ["voltage_limit", "0.001 to 1000"]),
    "joint names": ({"joints": "[a, b, a]"}, ["joint", "three different names"]),
    "interface": ({"command_interface": "torque"}, ["command_interface", "voltage or position"]),
    "controller": ({"command_interface": "position", "controller": "pd"}, ["controller 'pd'", "computed_torque"]),
    "controller and volts": ({"controller": "scheduled"}, ["command_interface position"]),
    "controllers file": (
        {"command_interface": "position", "controller": "scheduled", "controllers_file": "/nowhere.yaml"},
        ["controllers_file", "/nowhere.yaml"],
    ),
    "gains": ({"servo.gain": "[1.0, 2.0]"}, ["servo.gain", "three numbers"]),
    "mode": ({"mode": "fast"}, ["mode", "realtime or lockstep"]),
    "simulated time": ({"use_sim_time": "true"}, ["use_sim_time", "source of simulated time"]),
    "type of simulated time": ({"use_sim_time": 5}, ["use_sim_time", "5"]),
    "ROS arguments": ({"x:y:": 1}, ["sim_node", "x:y:"]),
}


@pytest.fixture(scope="module")
def refusals():
    """All programs with bad parameters, two at a time."""
    with ThreadPoolExecutor(2) as pool:
        done = pool.map(lambda case: run_program("puma_sim_ros.sim_node", *arguments(case[0])), BAD_PARAMETERS.values())
        return dict(zip(BAD_PARAMETERS, done))


@pytest.mark.parametrize("case", BAD_PARAMETERS)
def test_bad_parameters_end_the_node_with_one_clear_line(refusals, case):
    done = refusals[case]
    assert done.returncode == 2, done.stderr
    # the ROS library may log a line of its own before
    line = done.stderr.strip().splitlines()[-1]
    assert line.startswith("sim_node: ")
    for word in BAD_PARAMETERS[case][1]:
        assert word in line
    assert "Traceback" not in done.stderr


def assert_bag_refused(path):
    done = run_program("puma_sim_ros.sim_node", *arguments({"bag_path": path}))
    assert done.returncode == 2, done.stderr
    (line,) = done.stderr.strip().splitlines()
    assert str(path) in line
    return line


def test_a_bag_path_that_exists_is_refused_and_left_alone(tmp_path):
    bag = tmp_path / "bag"
    bag.mkdir()
    (bag / "precious").write_text("data")
    assert "exists" in assert_bag_refused(bag)
    assert [path.name for path in bag.iterdir()] == ["precious"]


def test_a_bag_path_that_cannot_be_written_is_refused(tmp_path):
    assert "directory" in assert_bag_refused(tmp_path / "nowhere" / "bag")
    (tmp_path / "file").write_text("")
    assert_bag_refused(tmp_path / "file" / "bag")
    assert [path.name for path in tmp_path.iterdir()] == ["file"]


def test_a_parameter_of_another_name_is_told(tmp_path):
    with Node(perod=0.014, paused=True) as node, Peer(node.namespace) as peer:
        peer.find_simulator(reset=False)
    assert "parameter 'perod'" in node.errors


#: a stop far too stiff for steps of 7 ms: the integration diverges
UNSTABLE = {
    "effects": "['soft_stop:joint=3,upper=0.0,stiffness=1e6,damping=1000.0']",
    "initial_position": "[0.0, 0.0, 0.5]",
    "substeps": 4,
    "brakes": False,
}


def test_a_state_that_is_not_finite_pauses_the_node(tmp_path):
    with Node(paused=True, **UNSTABLE) as node, Peer(node.namespace) as peer:
        peer.find_simulator()
        peer.call("pause", data=False)
        peer.wait_for(lambda: peer.call("get_parameters", names=["paused"]).values[0].bool_value, "the pause")
        refused = peer.call("step")
        assert not refused.success
        assert "step" in refused.message and "~/reset" in refused.message
        assert not peer.call("pause", data=False).success
        failed = int(refused.message.split("step ")[1].split(";")[0])
        peer.state_of(failed - 1)
        assert len(peer.states) == failed
        for state, current in zip(peer.states, peer.currents):
            assert all(map(math.isfinite, (*state.position, *state.velocity, *state.effort, *current)))
        # a reset with a start at which nothing is wrong goes on
        assert peer.set(initial_position=[0.0, 0.0, -0.5])[0].successful
        peer.fresh()
        assert peer.call("step").success
        assert peer.call("pause", data=False).success
    assert f"step {failed}: the state is no longer finite" in node.errors
