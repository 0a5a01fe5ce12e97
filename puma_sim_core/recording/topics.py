# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""The topics of a session: their types, the names that bags know them by, and those that a node was given instead."""

from collections.abc import Callable
from typing import NamedTuple

STRING = "std_msgs/msg/String"
ARRAY = "std_msgs/msg/Float64MultiArray"
JOINT_STATE = "sensor_msgs/msg/JointState"
BOOL = "std_msgs/msg/Bool"
TF_MESSAGE = "tf2_msgs/msg/TFMessage"


class Topic(NamedTuple):
    """A topic of a bag; ``name`` is relative to the namespace, where it was not given another. Of a latched one those
    who subscribe later get the last message."""

    name: str
    type: str
    latched: bool = False


MODEL = Topic("sim_node/model", STRING, latched=True)
URDF = Topic("robot_description", STRING, latched=True)
STATES = Topic("joint_states", JOINT_STATE)
CURRENTS = Topic("motor_currents", ARRAY)
VOLTAGES = Topic("motor_voltages", ARRAY)
JOINT_COMMANDS = Topic("joint_commands", JOINT_STATE)
#: whether the brakes hold from a state on; where joints were put; effects from a state on, as a model file has them
BRAKES = Topic("sim_node/brakes", BOOL, latched=True)
PLACEMENTS = Topic("sim_node/set_state", JOINT_STATE)
EFFECTS = Topic("sim_node/effects", STRING, latched=True)
CHANGES = (BRAKES, PLACEMENTS, EFFECTS)
#: the topics of a state in the order in which they are written, with the fields that each holds
STATE_FIELDS = {STATES: ("position", "velocity", "effort"), CURRENTS: ("current",), VOLTAGES: ("voltage",)}
#: command interface -> topic of the commands that name no joints
ARRAY_COMMANDS = {name: Topic(f"{name}_controller/commands", ARRAY) for name in ("voltage", "position")}
#: frames of the arm, moving and fixed; absolute names, whatever the namespace, as all programs know them
FRAMES = Topic("/tf", TF_MESSAGE)
FIXED_FRAMES = Topic("/tf_static", TF_MESSAGE, latched=True)
#: all of them but the frames
TOPICS = (MODEL, URDF, *STATE_FIELDS, *ARRAY_COMMANDS.values(), JOINT_COMMANDS, *CHANGES)


def other_names(namespace: str, name_of: Callable[[str], str]) -> dict[str, str]:
    """Full names of all topics by the names here, where one of them is not that name in the namespace; else none."""
    prefix = namespace.rstrip("/") + "/"
    found = {topic.name: name_of(topic.name) for topic in TOPICS}
    return found if any(full != prefix + name for name, full in found.items()) else {}
