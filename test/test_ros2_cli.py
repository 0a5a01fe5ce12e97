# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""What users of ROS type: `ros2 run`, `topic`, `param`, `service`, `node`, `launch`, with the real tools."""

from __future__ import annotations

import os
import re
import shlex
import urllib.request
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest
import yaml

pytest.importorskip("rclpy")

from ros2_cli_support import ROOT, Ros2

from puma_sim_core.effects import parse_effect
from puma_sim_core.plant.model_file import dump_model, load_model
from puma_sim_core.plant.plant import Plant
from puma_sim_core.recording.bag import read_bag
from puma_sim_core.simulation.replay import replay, session_of

CLI = os.environ.get("PUMA_SIM_ROS2CLI", "")
pytestmark = [
    pytest.mark.skipif(not CLI, reason="PUMA_SIM_ROS2CLI does not name ros2cli and its installer"),
    pytest.mark.long,
    pytest.mark.xdist_group("ros2_cli"),
    # the environment is made when the first of them asks for it
    pytest.mark.timeout(600),
]
ARRAY, STATE = "std_msgs/msg/Float64MultiArray", "sensor_msgs/msg/JointState"
READY = r"(realtime|lockstep), commands on"
#: a domain beside that of the tools
ALONE = str(1 + (os.getpid() + 50) % 100)
STOPPED = r"\[sim_node-1\]: process has finished cleanly"


@pytest.fixture(scope="module")
def ros2(tmp_path_factory):
    tools = Ros2(Path(CLI), tmp_path_factory.mktemp("ros2"))
    yield tools
    for domain in (tools.environment["ROS_DOMAIN_ID"], ALONE):
        tools.environment["ROS_DOMAIN_ID"] = domain
        tools.close()


@pytest.fixture(scope="module")
def node(ros2):
    """A node in real time, which the daemon of the tools knows."""
    with ros2.running("run", "puma_sim_ros", "sim_node") as program:
        program.wait_for(READY)
        wait_for_daemon(ros2)
        yield program
    assert program.process.returncode == 0, program.text
    assert "Traceback" not in program.text


def wait_for_daemon(ros2) -> None:
    """Return when the daemon of the tools knows the simulator: it answers before it knows anything.

    The name of a node comes by another topic than its endpoints do, and may come later.
    """
    ros2("daemon", "start")
    found = (ros2("node", "info", "/sim_node", status=None) for _ in range(100))
    assert any({"/joint_states:", "/sim_node/step:"} <= set(text.split()) for text in found)


@pytest.fixture
def alone(ros2, monkeypatch):
    """The tools in a domain without that node, which has the names that others have, too."""
    monkeypatch.setitem(ros2.environment, "ROS_DOMAIN_ID", ALONE)
    return ros2


def together(*calls):
    """Results of calls that wait for the middleware more than they compute."""
    with ThreadPoolExecutor(3) as pool:
        return [future.result() for future in [pool.submit(*call) for call in calls]]


# -- run -------------------------------------------------------------------------------------------


#: program -> a parameter that it refuses, and what it says then
REFUSED = {
    "sim_node": ("mode:=fast", "realtime or lockstep"),
    "external_controller": ("controller:=nobody", "pid or scheduled or computed_torque"),
    "appraised_controller": ("controller:=nobody", "pid or scheduled or computed_torque"),
    "appraise": ("out:=''", "no folder"),
    "viewer": ("port:=99999", "99999"),
}


def test_every_program_is_found_and_runs(ros2):
    def wrong(program: str, parameter: str):
        return (lambda: ros2("run", "puma_sim_ros", program, "--ros-args", "-p", parameter, status=None),)

    listed, helped, shown, *refused = together(
        (ros2, "pkg", "executables", "puma_sim_ros"),
        (ros2, "run", "puma_sim_ros", "puma-sim", "list"),
        (ros2, "interface", "show", STATE),
        *(wrong(program, parameter) for program, (parameter, _) in REFUSED.items()),
    )
    programs = {line.split()[1] for line in listed.splitlines()}
    assert programs == {path.name for path in (ros2.prefix / "lib" / "puma_sim_ros").iterdir()}
    assert programs == {"puma-sim", *REFUSED}
    assert "bejczy" in helped
    assert "float64[] position" in shown
    for (program, (_, said)), text in zip(REFUSED.items(), refused):
        assert said in text and "Traceback" not in text, (program, text)


def test_the_two_terminals_of_the_documents(alone):
    readme = (ROOT / "README.md").read_text()
    first, *others = re.search(r"### ROS 2 topics\n.*?```bash\n(.*?)```", readme, re.DOTALL).group(1).splitlines()
    assert first == "ros2 run puma_sim_ros sim_node"
    with alone.running(*words_of(first)) as simulator:
        simulator.wait_for(READY)
        commands = [words_of(line) for line in others]
        (publish,) = [words for words in commands if words[:2] == ["topic", "pub"]]
        (echo,) = [words for words in commands if words[:2] == ["topic", "echo"]]
        with alone.running(*publish) as publisher:
            publisher.wait_for("publishing #5")
            wait_for_daemon(alone)
            # brakes hold joint 1 at zero until the first command has come; then 5 V drive it in its positive direction,
            # and do so until the range of the joint ends it
            moved = r"position:\n- (?!0\.0\n)(\S+)\n- .*\n- .*\n"
            states = alone.until(moved, *echo)
            assert float(re.search(moved, states).group(1)) > 0.0, states
    assert simulator.process.returncode == 0, simulator.text


def ended_well(launched) -> bool:
    return bool(re.search(STOPPED, launched.text)) and "Traceback" not in launched.text


def words_of(line: str) -> list[str]:
    program, *words = shlex.split(line)
    assert program == "ros2"
    return words


# -- topics, nodes, parameters, services -----------------------------------------------------------


def test_topics_and_the_node_are_described(ros2, node):
    topics, info, kinds, services, nodes = together(
        (ros2, "topic", "list", "-t"),
        (ros2, "topic", "info", "-v", "/joint_states"),
        (ros2, "node", "info", "/sim_node"),
        (ros2, "service", "list", "-t"),
        (ros2, "node", "list"),
    )
    assert f"/joint_states [{STATE}]" in topics
    assert f"/voltage_controller/commands [{ARRAY}]" in topics
    assert "/position_controller/commands" not in topics
    assert "Reliability: RELIABLE" in info
    assert f"/voltage_controller/commands: {ARRAY}" in kinds
    for name, kind in (("reset", "Trigger"), ("pause", "SetBool"), ("step", "Trigger")):
        assert f"/sim_node/{name} [std_srvs/srv/{kind}]" in services
    assert "/sim_node" in nodes.split()


def test_topics_are_read_measured_and_written(ros2, node):
    latched = ("--qos-durability", "transient_local", "--qos-reliability", "reliable")
    state, urdf, rate = together(
        (ros2, "topic", "echo", "--once", "/joint_states", STATE),
        (ros2, "topic", "echo", "--once", "--full-length", *latched, "/robot_description", "std_msgs/msg/String"),
        (ros2.until, r"average rate: 3\d\.", "topic", "hz", "/joint_states"),
    )
    assert "frame_id: base_link" in state and "joint3" in state
    assert "<robot" in urdf and "<inertia" in urdf
    assert "average rate" in rate
    # until it is seen: on a busy machine the node finds the publisher after its first messages
    publish = ("topic", "pub", "-r", "20", "/voltage_controller/commands", ARRAY, "{data: [1.0, 0.5, 0.25]}")
    with ros2.running("topic", "echo", "/motor_voltages", ARRAY) as echo, ros2.running(*publish):
        echo.wait_for(r"data:\n- 1\.0\n- 0\.5\n- 0\.25\n")


def test_parameters_are_listed_set_and_dumped_and_loaded_again(ros2, node):
    listed, value, text = together(
        (ros2, "param", "list", "/sim_node"),
        (ros2, "param", "get", "/sim_node", "voltage_limit"),
        (ros2, "param", "describe", "/sim_node", "voltage_limit"),
    )
    defaults = yaml.safe_load((ROOT / "puma_sim_ros" / "node" / "parameters.yaml").read_text())
    assert set(defaults) <= set(listed.split())
    assert "Double value is: 40.0" in value
    assert "Greatest voltage" in text and "1000" in text
    assert "successful" in ros2("param", "set", "/sim_node", "voltage_limit", "30.0")
    dumped = ros2.out / "dumped.yaml"
    dumped.write_text(ros2("param", "dump", "/sim_node"))
    found = yaml.safe_load(dumped.read_text())["/sim_node"]["ros__parameters"]
    assert found["voltage_limit"] == 30.0 and found["mode"] == "realtime"
    assert "fail" in ros2("param", "set", "/sim_node", "voltage_limit", "1e9", status=None).lower()
    ros2("param", "set", "/sim_node", "voltage_limit", "20.0")
    ros2("param", "load", "/sim_node", dumped, status=None)
    assert "Double value is: 30.0" in ros2("param", "get", "/sim_node", "voltage_limit")


def test_services_pause_step_and_reset(ros2, node):
    def call(name, kind="Trigger", *request):
        return ros2("service", "call", f"/sim_node/{name}", f"std_srvs/srv/{kind}", *request)

    assert "success=False" in call("step")
    assert "success=True" in call("pause", "SetBool", "{data: true}")
    assert "success=True" in call("reset")
    assert "step 1, time 0.028 s" in call("step")
    assert "success=True" in call("pause", "SetBool", "{data: false}")


# -- launch ----------------------------------------------------------------------------------------


def test_the_arguments_of_the_launch_file_reach_the_node(alone):
    bag = alone.out / "positions"
    values = {
        "mode": "lockstep",
        "command_interface": "position",
        "controller": "computed_torque",
        "bag_path": bag,
        "effects": "coulomb_friction:joint=2,torque=12.6; viscous_friction:joint=3,coefficient=2",
    }
    arguments = [f"{name}:={value}" for name, value in values.items()]
    with alone.running("launch", "puma_sim_ros", "sim.launch.py", *arguments, group=False) as launched:
        launched.wait_for("lockstep, commands on /position_controller/commands")
        alone(
            "topic",
            "pub",
            "-r",
            "50",
            "-t",
            "20",
            "-w",
            "1",
            "/position_controller/commands",
            ARRAY,
            "{data: [0.1, 0, 0]}",
        )
        # in lockstep without being asked for
        clock = alone("param", "get", "--no-daemon", "--spin-time", "5", "/sim_node", "publish_clock")
        assert "True" in clock
    assert ended_well(launched), launched.text
    assert launched.process.returncode == 0
    session = replay(bag)
    assert session.identical
    # the first may have been sent before the node knew who sends
    assert 0 < session.steps <= 20


def test_the_demonstration_ends_by_itself_and_replays(alone):
    bag = alone.out / "demonstration"
    with alone.running("launch", "puma_sim_ros", "demo.launch.py", "mode:=lockstep", f"bag_path:={bag}") as launched:
        assert launched.wait() == 0
    assert "missed: 0" in launched.text, launched.text
    assert ended_well(launched), launched.text
    assert replay(bag).identical


def test_ctrl_c_in_the_demonstration_ends_both_programs(alone):
    with alone.running("launch", "puma_sim_ros", "demo.launch.py") as launched:
        launched.wait_for(r"\[sim_node-1\].*commands on")
        # the controller lets go of the brakes
        moving = alone.until(r"data: false", "topic", "echo", "/sim_node/brakes", "std_msgs/msg/Bool")
    assert "false" in moving
    assert ended_well(launched), launched.text
    assert len(re.findall("has finished cleanly", launched.text)) == 2, launched.text


def test_what_is_not_installed_is_said_before_anything_starts(alone):
    for argument, hint in (("rviz:=true", "ros-jazzy-rviz2"), ("rviz:=perhaps", "true or false")):
        text = alone("launch", "puma_sim_ros", "sim.launch.py", argument, status=1)
        assert hint in text and "process started" not in text


def test_the_viewer_and_a_model_file_by_arguments(alone, monkeypatch):
    bag, model = alone.out / "modelled", alone.out / "model.yaml"
    dump_model(Plant.of("tuned", [parse_effect("viscous_friction:joint=2,coefficient=9.5")]), model)
    arguments = ("launch", "puma_sim_ros", "sim.launch.py", "view:=true", f"model:={model}", f"bag_path:={bag}")
    with alone.running(*arguments) as launched:
        launched.wait_for(READY)
        page = re.search(r"(http://\S+) shows /joint_states", launched.wait_for("shows /joint_states")).group(1)
        with urllib.request.urlopen(page, timeout=30.0) as answer:
            assert answer.status == 200 and b"<html" in answer.read().lower()
    assert ended_well(launched), launched.text
    assert len(re.findall("has finished cleanly", launched.text)) == 2
    assert session_of(bag, read_bag(bag).config_text)[0].plant.effects[0] == load_model(model).effects[0]
    # where the page's library is missing nothing starts
    (alone.out / "sitecustomize.py").write_text("import sys\nsys.modules['viser'] = None\n")
    monkeypatch.setitem(alone.environment, "PYTHONPATH", f"{alone.out}:{alone.environment['PYTHONPATH']}")
    text = alone(*arguments, status=1)
    assert "pip install viser" in text and "process started" not in text


def test_a_value_that_the_node_refuses_ends_the_launch(alone):
    text = alone("launch", "puma_sim_ros", "sim.launch.py", "mode:=fast", status=None)
    assert "realtime or lockstep" in text and "was required" in text


def test_rviz_gets_its_configuration_and_the_publisher_of_frames_the_urdf(alone, tmp_path, monkeypatch):
    """With programs in their place that write down what they are called with."""
    for package in ("rviz2", "robot_state_publisher"):
        program = tmp_path / "lib" / package / package
        program.parent.mkdir(parents=True)
        called = f'for word; do [ -f "$word" ] && cat "$word"; done > {tmp_path}/{package}.called'
        program.write_text(f"#!/bin/sh\n{called}\nexec sleep 60\n")
        program.chmod(0o755)
        marker = tmp_path / "share" / "ament_index" / "resource_index" / "packages" / package
        marker.parent.mkdir(parents=True, exist_ok=True)
        marker.touch()
    prefixes = f"{tmp_path}:{alone.environment['AMENT_PREFIX_PATH']}"
    monkeypatch.setitem(alone.environment, "AMENT_PREFIX_PATH", prefixes)
    with alone.running("launch", "puma_sim_ros", "sim.launch.py", "rviz:=true", "effects:=payload:mass=2") as launched:
        launched.wait_for(READY)
    display, frames = ((tmp_path / f"{name}.called").read_text() for name in ("rviz2", "robot_state_publisher"))
    assert "Fixed Frame: base_link" in display and "use_sim_time: true" in display
    assert "<robot name=" in frames and "use_sim_time: true" in frames
