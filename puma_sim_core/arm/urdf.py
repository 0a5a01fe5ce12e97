# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""The arm as URDF text, for RViz, Foxglove and MoveIt: frames, ranges and simple shapes.

URDF turns a joint about an axis of the child's own frame, before the constant transform to the
next joint. The thesis's (distal) Denavit-Hartenberg matrix of link i is the rotation q_i about
z_{i-1}, then a constant transform; so the URDF link i has the thesis's frame i-1 turned by q_i,
and the constant part of matrix i is the origin of joint i+1. The base link is the thesis's frame
0, at the height of the shoulder. ``tool0`` stands at the wrist, a distance d4 along z3, with the
directions of the thesis's frame 3.

The text holds no inertias: the published sets are consistent as joint-space inertias together
with the reflected inertia of the motors, which URDF cannot carry, while link 2 by itself is not
a possible body. Importers that build their own dynamics would get another arm.
"""

import math
import xml.etree.ElementTree as ET
from collections.abc import Sequence

from puma_sim_core.arm.arm import ArmParameters

_HALF_TURN = math.pi / 2
#: height of the shoulder above the floor [m]; it is drawn only
_SHOULDER_HEIGHT = 0.672
_COLOURS = {"grey": "0.35 0.36 0.38 1", "white": "0.90 0.90 0.87 1", "orange": "0.86 0.45 0.14 1"}


_NOWHERE = (0.0, 0.0, 0.0)


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


def arm_urdf(
    arm: ArmParameters,
    joint_names: Sequence[str] = ("joint1", "joint2", "joint3"),
    base_link: str = "base_link",
    voltage_limit: float = 40.0,
) -> str:
    """URDF of the three-joint arm.

    Parameters
    ----------
    arm : the arm; its lengths [m], joint ranges [rad] and motors are used.
    joint_names : the three joint names, as in ``joint_states``.
    base_link : name of the root link, which is the thesis's frame 0.
    voltage_limit : the greatest motor voltage [V]; limits of effort (stalled motor, N.m) and of
        velocity (no load, rad/s) follow from it.
    """
    robot = ET.Element("robot", name="puma560")
    for name, colour in _COLOURS.items():
        ET.SubElement(ET.SubElement(robot, "material", name=name), "color", rgba=colour)

    link_names = (base_link, "link1", "link2", "link3", "tool0")
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
    _joint(robot, "tool0_fixed", "fixed", link_names[3:], (a3, -d4, d3), across)

    ET.indent(robot)
    return '<?xml version="1.0"?>\n' + ET.tostring(robot, encoding="unicode") + "\n"
