# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""The simulator, and the example controller that leads the wrist down a straight line; ends with it.

ros2 launch puma_sim_ros demo.launch.py rviz:=true
"""

from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument, IncludeLaunchDescription, Shutdown
from launch.launch_description_sources import PythonLaunchDescriptionSource
from launch.substitutions import LaunchConfiguration, PathJoinSubstitution, ThisLaunchFileDir
from launch_ros.actions import Node

ARGUMENTS = {
    "mode": ("realtime", "realtime or lockstep"),
    "bag_path": ("", "path of the bag to record; none when empty"),
    "effects": ("", "effects beyond the thesis's model, separated by ';'"),
    "model": ("", "path of a model.yaml with parameters and effects"),
    "rviz": ("false", "start RViz and robot_state_publisher"),
    "view": ("false", "start the viewer of this package in the browser"),
}


def generate_launch_description():
    declared = [
        DeclareLaunchArgument(name, default_value=value, description=text) for name, (value, text) in ARGUMENTS.items()
    ]
    simulator = IncludeLaunchDescription(
        PythonLaunchDescriptionSource(PathJoinSubstitution([ThisLaunchFileDir(), "sim.launch.py"])),
        # the controller starts it
        launch_arguments=[*((name, LaunchConfiguration(name)) for name in ARGUMENTS), ("paused", "true")],
    )
    controller = Node(
        package="puma_sim_ros",
        executable="external_controller",
        output="screen",
        on_exit=[Shutdown(reason="the line has been followed")],
    )
    return LaunchDescription([*declared, simulator, controller])
