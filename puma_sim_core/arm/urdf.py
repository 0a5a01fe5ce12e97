# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""The arm as URDF text, for RViz, Foxglove and MoveIt: frames, ranges and simple shapes.

URDF turns a joint about an axis of the child's own frame, before the constant transform to the
next joint. The thesis's (distal) Denavit-Hartenberg matrix of link i is the rotation q_i about
z_{i-1}, then a constant transform; so the URDF link i has the thesis's frame i-1 turned by q_i,
and the constant part of matrix i is the origin of joint i+1. The base link is the thesis's frame
0, at the height of the shoulder. ``tool0`` stands at the wrist, a distance d4 along z3, with the
directions of the thesis's frame 3.

With ``inertias`` each link has mass, centre and inertia: a program that computes the arm's dynamics
from the text gets D, C and G of the rigid arm. They are those of `bodies.link_bodies`, and not always
those of possible bodies: a comment in the text says so then, and programs that check inertias
refuse it. URDF has no place for the inertia of a motor, which stays outside: D here is without Ia.

The block ``ros2_control`` is for its topic hardware: setpoints on ``joint_commands``, states from
``joint_states``.
"""

import math
import xml.etree.ElementTree as ET
from collections.abc import Sequence

import numpy as np

from puma_sim_core.arm.arm import ArmParameters
from puma_sim_core.arm.bodies import link_bodies, mass_properties

#: names of the links behind the root
LINKS = ("link1", "link2", "link3", "tool0")
_HALF_TURN = math.pi / 2
#: height of the shoulder above the floor [m]; it is drawn only
_SHOULDER_HEIGHT = 0.672
_COLOURS = {"grey": "0.35 0.36 0.38 1", "white": "0.90 0.90 0.87 1", "orange": "0.86 0.45 0.14 1"}
_NOWHERE = (0.0, 0.0, 0.0)
#: the hardware of ros2_control that talks over topics of sensor_msgs/JointState
_TOPIC_HARDWARE = "joint_state_topic_hardware_interface/JointStateTopicSystem"
_TOPICS = {
    "joint_commands_topic": "joint_commands",
    "joint_states_topic": "joint_states",
    # send each command, also those that differ little from the state: the simulator watches for their coming
    "trigger_joint_command_threshold": "-1",
}
_IMPOSSIBLE = " the inertias have the arm's D, C and G and are not those of possible bodies "


def _numbers(values: Sequence[float]) -> str:
    return " ".join(repr(float(value)) for value in values)


def _origin(parent: ET.Element, xyz: Sequence[float], rpy: Sequence[float]) -> None:
    ET.SubElement(parent, "origin", xyz=_numbers(xyz), rpy=_numbers(rpy))


def _shape(
    link: ET.Element,
    colour: str,
    xyz: Sequence[float],
    form: str,
    rpy: Sequence[float] = _NOWHERE,
    **sizes: float | str,
) -> None:
    """Add the same shape as what is seen and what collides."""
    for kind in ("visual", "collision"):
        element = ET.SubElement(link, kind)
        _origin(element, xyz, rpy)
        ET.SubElement(ET.SubElement(element, "geometry"), form, {name: str(size) for name, size in sizes.items()})
        if kind == "visual":
            ET.SubElement(element, "material", name=colour)


def _joint(
    robot: ET.Element, name: str, kind: str, links: Sequence[str], xyz: Sequence[float], rpy: Sequence[float]
) -> ET.Element:
    joint = ET.SubElement(robot, "joint", name=name, type=kind)
    _origin(joint, xyz, rpy)
    ET.SubElement(joint, "parent", link=links[0])
    ET.SubElement(joint, "child", link=links[1])
    return joint


def _inertial(link: ET.Element, pseudo_inertia: np.ndarray) -> None:
    mass, centre, inertia = mass_properties(pseudo_inertia)
    element = ET.Element("inertial")
    link.insert(0, element)
    _origin(element, centre.tolist(), _NOWHERE)
    ET.SubElement(element, "mass", value=repr(mass))
    values = {f"i{'xyz'[i]}{'xyz'[j]}": repr(float(inertia[i, j])) for i in range(3) for j in range(i, 3)}
    ET.SubElement(element, "inertia", values)


def _topic_hardware(robot: ET.Element, joint_names: Sequence[str]) -> None:
    system = ET.SubElement(robot, "ros2_control", name="puma560", type="system")
    hardware = ET.SubElement(system, "hardware")
    ET.SubElement(hardware, "plugin").text = _TOPIC_HARDWARE
    for name, value in _TOPICS.items():
        ET.SubElement(hardware, "param", name=name).text = value
    for name in joint_names:
        joint = ET.SubElement(system, "joint", name=name)
        ET.SubElement(joint, "command_interface", name="position")
        for interface in ("position", "velocity", "effort"):
            ET.SubElement(joint, "state_interface", name=interface)


def arm_urdf(
    arm: ArmParameters,
    joint_names: Sequence[str] = ("joint1", "joint2", "joint3"),
    base_link: str = "base_link",
    voltage_limit: float = 40.0,
    *,
    inertias: bool = True,
    damping: Sequence[float] = _NOWHERE,
    friction: Sequence[float] = _NOWHERE,
) -> str:
    """URDF of the three-joint arm.

    Parameters
    ----------
    arm : the arm; its lengths [m], links, joint ranges [rad] and motors are used.
    joint_names : the three joint names, as in ``joint_states``.
    base_link : name of the root link, which is the thesis's frame 0.
    voltage_limit : the greatest motor voltage [V]; limits of effort (stalled motor, N.m) and of
        velocity (no load, rad/s) follow from it.
    inertias : whether the links have inertias and the joints ``dynamics``.
    damping, friction : (3,) viscous [N.m.s/rad] and dry [N.m] friction of the joints.
    """
    robot = ET.Element("robot", name="puma560")
    for name, colour in _COLOURS.items():
        ET.SubElement(ET.SubElement(robot, "material", name=name), "color", rgba=colour)

    link_names = (base_link, *LINKS)
    links = {name: ET.SubElement(robot, "link", name=name) for name in link_names}
    a2, a3, d3, d4 = arm.a2, arm.a3, arm.d3, arm.d4

    column = _SHOULDER_HEIGHT - 0.10
    foot = _numbers((0.34, 0.34, 0.02))
    _shape(links[base_link], "grey", (0, 0, -0.10 - column / 2), "cylinder", radius=0.09, length=column)
    _shape(links[base_link], "grey", (0, 0, -_SHOULDER_HEIGHT + 0.01), "box", size=foot)
    # the shoulder lies along z1, which is y of the link that turns with joint 1
    across = (_HALF_TURN, 0, 0)
    _shape(links["link1"], "white", (0, d3 / 4, 0), "cylinder", across, radius=0.10, length=0.18 + d3 / 2)
    _shape(links["link2"], "white", (a2 / 2 - 0.06, 0, d3 + 0.09), "box", size=_numbers((a2 + 0.26, 0.20, 0.08)))
    _shape(links["link2"], "orange", (a2, 0, d3 + 0.04), "cylinder", radius=0.065, length=0.16)
    # z3 is -y of the link that turns with joint 3
    _shape(links["link3"], "white", (a3, -d4 / 2 + 0.04, d3), "box", size=_numbers((0.11, d4 + 0.08, 0.09)))
    _shape(links["link3"], "orange", (a3, -d4, d3), "sphere", radius=0.055)

    origins = ((_NOWHERE, _NOWHERE), (_NOWHERE, (-_HALF_TURN, 0, 0)), ((a2, 0, 0), _NOWHERE))
    for index, (xyz, rpy) in enumerate(origins):
        joint = _joint(robot, joint_names[index], "revolute", link_names[index : index + 2], xyz, rpy)
        ET.SubElement(joint, "axis", xyz="0 0 1")
        motor, (low, high) = arm.motors[index], arm.joint_ranges[index]
        ratio = abs(motor.gear_ratio)
        limits = {
            "lower": low,
            "upper": high,
            "effort": ratio * motor.torque_constant * voltage_limit / motor.resistance,
            "velocity": voltage_limit / (ratio * motor.back_emf),
        }
        ET.SubElement(joint, "limit", {name: repr(float(value)) for name, value in limits.items()})
        if inertias:
            values = {"damping": repr(float(damping[index])), "friction": repr(float(friction[index]))}
            ET.SubElement(joint, "dynamics", values)
    _joint(robot, "tool0_fixed", "fixed", link_names[3:], (a3, -d4, d3), across)
    if inertias:
        bodies = link_bodies(arm)
        for name, pseudo_inertia in zip(link_names[1:], bodies.pseudo_inertias):
            _inertial(links[name], pseudo_inertia)
        if not bodies.possible:
            robot.insert(0, ET.Comment(_IMPOSSIBLE))
    _topic_hardware(robot, joint_names)

    ET.indent(robot)
    return '<?xml version="1.0"?>\n' + ET.tostring(robot, encoding="unicode") + "\n"
