# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""The simulator with what shows it.

ros2 launch puma_sim_ros sim.launch.py mode:=lockstep bag_path:=session1 rviz:=true
"""

import importlib.util
import os
from pathlib import Path

from ament_index_python.packages import PackageNotFoundError, get_package_prefix, get_package_share_directory
from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument, OpaqueFunction, Shutdown
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node
from launch_ros.parameter_descriptions import ParameterValue

#: arguments that are parameters of sim_node
TEXTS = {
    "mode": ("realtime", "realtime or lockstep"),
    "command_interface": ("voltage", "voltage or position"),
    "bag_path": ("", "path of the bag to record; none when empty"),
    "controller": ("pid", "with command_interface position: pid, scheduled or computed_torque"),
    "effects": ("", "effects beyond the thesis's model, separated by ';'"),
    "model": ("", "path of a model.yaml with parameters and effects"),
    "paused": ("false", "start with simulated time standing still"),
}
SWITCHES = {"rviz": "start RViz and robot_state_publisher", "view": "start the viewer of this package in the browser"}
YES = {"true": True, "1": True, "yes": True, "false": False, "0": False, "no": False}


def generate_launch_description():
    declared = [
        DeclareLaunchArgument(name, default_value=value, description=text) for name, (value, text) in TEXTS.items()
    ]
    declared += [
        DeclareLaunchArgument(name, default_value="false", description=text) for name, text in SWITCHES.items()
    ]
    return LaunchDescription([*declared, OpaqueFunction(function=programs)])


def programs(context):
    """The programs that the arguments ask for; one that is not installed is said before any starts."""
    values = {name: LaunchConfiguration(name).perform(context) for name in (*TEXTS, *SWITCHES)}
    rviz, view, paused = (switch(name, values.pop(name)) for name in ("rviz", "view", "paused"))
    effects = [effect.strip() for effect in values.pop("effects").split(";") if effect.strip()]
    parameters = {name: ParameterValue(value, value_type=str) for name, value in values.items()}
    parameters.update(paused=paused, effects=effects or [""])
    if rviz:
        # RViz and robot_state_publisher go by the time in the messages, which is the simulated one
        parameters["publish_clock"] = True
    simulator = Node(
        package="puma_sim_ros",
        executable="sim_node",
        name="sim_node",
        parameters=[parameters],
        output="screen",
        on_exit=[Shutdown(reason="sim_node has ended")],
    )
    found = [simulator]
    if rviz:
        apt = "sudo apt install ros-jazzy-rviz2 ros-jazzy-robot-state-publisher"
        require("rviz", "rviz2", "rviz2", apt)
        require("rviz", "robot_state_publisher", "robot_state_publisher", apt)
        clock = {"use_sim_time": True}
        text = ParameterValue(description(values["model"], effects), value_type=str)
        own = [{"robot_description": text, **clock}]
        found.append(Node(package="robot_state_publisher", executable="robot_state_publisher", parameters=own))
        settings = os.path.join(get_package_share_directory("puma_sim_ros"), "config", "puma560.rviz")
        found.append(Node(package="rviz2", executable="rviz2", arguments=["-d", settings], parameters=[clock]))
    if view:
        require("view", "puma_sim_ros", "viewer", "build this package")
        if importlib.util.find_spec("viser") is None:
            raise RuntimeError("view:=true needs the Python package viser, which is not installed: pip install viser")
        found.append(Node(package="puma_sim_ros", executable="viewer", output="screen"))
    return found


def switch(name, value):
    if value.lower() not in YES:
        raise RuntimeError(f"{name}:={value}: expected true or false")
    return YES[value.lower()]


def require(argument, package, executable, how):
    try:
        if os.access(Path(get_package_prefix(package), "lib", package, executable), os.X_OK):
            return
    except PackageNotFoundError:
        pass
    raise RuntimeError(f"{argument}:=true needs the program {executable}, which is not installed: {how}")


def description(model, effects):
    """URDF of the arm, as sim_node will publish it."""
    from puma_sim_core.effects import parse_effect
    from puma_sim_core.plant.model_file import load_model
    from puma_sim_core.plant.plant import Plant
    from puma_sim_core.plant.urdf import plant_urdf

    return plant_urdf(load_model(model) if model else Plant.of(effects=map(parse_effect, effects)))
