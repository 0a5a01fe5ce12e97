# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""The URDF is the thesis's arm: its frames, ranges and names, read back by an own small reader."""

from __future__ import annotations

import math
import xml.etree.ElementTree as ET

import numpy as np
import pytest

from puma_sim_core.arm.kinematics import forward_kinematics, link_transforms
from puma_sim_core.arm.parameters import load_parameters, parameter_sets
from puma_sim_core.arm.urdf import arm_urdf


def rpy_matrix(roll, pitch, yaw):
    """Fixed-axis rotation of the URDF specification: about x, then y, then z."""
    cr, sr, cp, sp = math.cos(roll), math.sin(roll), math.cos(pitch), math.sin(pitch)
    cy, sy = math.cos(yaw), math.sin(yaw)
    rx = np.array([[1, 0, 0], [0, cr, -sr], [0, sr, cr]])
    ry = np.array([[cp, 0, sp], [0, 1, 0], [-sp, 0, cp]])
    rz = np.array([[cy, -sy, 0], [sy, cy, 0], [0, 0, 1]])
    return rz @ ry @ rx


def numbers(text):
    return [float(word) for word in text.split()]


def urdf_frames(text, angles):
    """World transform of each link of a URDF at the given joint angles, by name."""
    robot = ET.fromstring(text)
    joints = robot.findall("joint")
    children = {joint.find("child").get("link") for joint in joints}
    (root,) = [link.get("name") for link in robot.findall("link") if link.get("name") not in children]
    frames = {root: np.eye(4)}
    for joint in joints:  # the text lists parents before children
        local = np.eye(4)
        origin = joint.find("origin")
        local[:3, :3] = rpy_matrix(*numbers(origin.get("rpy")))
        local[:3, 3] = numbers(origin.get("xyz"))
        if joint.get("type") == "revolute":
            assert numbers(joint.find("axis").get("xyz")) == [0, 0, 1]
            c, s = math.cos(angles[joint.get("name")]), math.sin(angles[joint.get("name")])
            turn = np.eye(4)
            turn[:2, :2] = [[c, -s], [s, c]]
            local = local @ turn
        frames[joint.find("child").get("link")] = frames[joint.find("parent").get("link")] @ local
    return root, frames


@pytest.fixture(params=["bejczy", "corke_armstrong_1994"])
def arm(request):
    return load_parameters(request.param)


def test_frames_agree_with_the_denavit_hartenberg_chain(arm):
    rng = np.random.default_rng(7)
    text = arm_urdf(arm)
    for _ in range(50):
        q = rng.uniform(-math.pi, math.pi, 3)
        root, frames = urdf_frames(text, dict(zip(("joint1", "joint2", "joint3"), q)))
        assert root == "base_link"
        # the thesis's frames 0 to 3
        chain = link_transforms(np.concatenate((q, np.zeros(3))), arm)
        tool = chain[3].copy()
        tool[:3, 3] += arm.d4 * tool[:3, 2]
        assert np.allclose(frames["tool0"], tool, atol=1e-14, rtol=0)
        # joint i turns about z of frame i-1, and its link has the origin of that frame
        for i in range(3):
            frame = frames[f"link{i + 1}"]
            assert np.allclose(frame[:3, 2:], chain[i][:3, 2:], atol=1e-14, rtol=0)


def test_tool0_is_at_the_wrist_of_the_six_link_arm(arm):
    rng = np.random.default_rng(8)
    text = arm_urdf(arm)
    for _ in range(20):
        q = rng.uniform(-math.pi, math.pi, 6)
        _, frames = urdf_frames(text, dict(zip(("joint1", "joint2", "joint3"), q[:3])))
        assert np.allclose(frames["tool0"][:3, 3], forward_kinematics(q, arm)[:3, 3], atol=1e-14)


def test_the_l_pose_has_a_horizontal_upper_arm_and_a_vertical_forearm(arm):
    _, frames = urdf_frames(arm_urdf(arm), {"joint1": 0.0, "joint2": 0.0, "joint3": 0.0})
    assert np.allclose(frames["link3"][:3, 3], (arm.a2, 0, 0), atol=1e-15)
    assert np.allclose(frames["tool0"][:3, 3], (arm.a2 + arm.a3, arm.d3, arm.d4), atol=1e-15)


@pytest.mark.parametrize("name", parameter_sets())
def test_limits_are_those_of_the_parameter_set(name):
    arm = load_parameters(name)
    limits = [
        joint.find("limit")
        for joint in ET.fromstring(arm_urdf(arm)).findall("joint")
        if joint.get("type") == "revolute"
    ]
    assert [(float(x.get("lower")), float(x.get("upper"))) for x in limits] == [tuple(r) for r in arm.joint_ranges]
    assert all(float(x.get("effort")) > 0 and float(x.get("velocity")) > 0 for x in limits)


def test_no_load_speed_at_40_volts():
    limits = [joint.find("limit") for joint in ET.fromstring(arm_urdf(load_parameters("bejczy"))).findall("joint")[:3]]
    assert [float(x.get("velocity")) for x in limits] == pytest.approx([2.4596, 1.4270, 2.8687], abs=5e-5)


def test_names_are_those_asked_for():
    text = arm_urdf(load_parameters("bejczy"), ("waist", "shoulder", "elbow"), "arm/base")
    root, _ = urdf_frames(text, {"waist": 0.1, "shoulder": 0.2, "elbow": 0.3})
    assert root == "arm/base"


def test_equal_arms_give_equal_text():
    arm = load_parameters("bejczy")
    assert arm_urdf(arm) == arm_urdf(load_parameters("bejczy"))


def test_pinocchio_reads_the_same_kinematics(arm):
    pinocchio = pytest.importorskip("pinocchio")
    model = pinocchio.buildModelFromXML(arm_urdf(arm))
    data = model.createData()
    q = np.array([0.3, -0.8, 1.1])
    pinocchio.framesForwardKinematics(model, data, q)
    found = data.oMf[model.getFrameId("tool0")].homogeneous
    chain = link_transforms(np.concatenate((q, np.zeros(3))), arm)[3]
    assert np.allclose(found[:3, :3], chain[:3, :3], atol=1e-14)
    assert np.allclose(found[:3, 3], chain[:3, 3] + arm.d4 * chain[:3, 2], atol=1e-14)
