# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""The URDF is the thesis's arm: its frames, ranges and names, read back by an own small reader."""

from __future__ import annotations

import math
import xml.etree.ElementTree as ET
from dataclasses import replace

import numpy as np
import pytest
import yaml
from scipy.optimize import minimize

from puma_sim_core.arm.arm import Link
from puma_sim_core.arm.bodies import link_bodies
from puma_sim_core.arm.kinematics import dh_table, dh_transform, forward_kinematics, link_transforms
from puma_sim_core.arm.parameters import load_parameters, parameter_sets
from puma_sim_core.arm.rigid_body import coriolis, gravity_torque, inertia
from puma_sim_core.arm.urdf import arm_urdf
from puma_sim_core.effects import parse_effect
from puma_sim_core.plant.plant import Plant
from puma_sim_core.plant.urdf import plant_urdf
from puma_sim_core.resources import config_path


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


# -- inertias --------------------------------------------------------------------------------------


def dynamics_by_pinocchio(text, gravity, q, v):
    """(D, C(q, v) v, G) of a URDF."""
    pinocchio = pytest.importorskip("pinocchio")
    model = pinocchio.buildModelFromXML(text)
    model.gravity.linear = np.array([0.0, 0.0, -gravity])
    data = model.createData()
    upper = np.triu(pinocchio.crba(model, data, q))
    held = pinocchio.computeGeneralizedGravity(model, data, q).copy()
    return upper + np.triu(upper, 1).T, pinocchio.nonLinearEffects(model, data, q, v) - held, held


@pytest.mark.parametrize("name", parameter_sets())
def test_pinocchio_reads_the_same_dynamics(name):
    plant = Plant.of(name, [parse_effect("payload:mass=2,x=0.1,z=0.4")])
    rng = np.random.default_rng(9)
    for arm, text in ((plant.arm, arm_urdf(plant.arm)), (plant.loaded_arm, plant_urdf(plant))):
        for _ in range(20):
            q, v = rng.uniform(-math.pi, math.pi, 3), rng.uniform(-3.0, 3.0, 3)
            mass, moving, held = dynamics_by_pinocchio(text, arm.gravity, q, v)
            assert np.allclose(mass, inertia(q, arm), atol=1e-9, rtol=0)
            assert np.allclose(moving, np.einsum("ijk,j,k", coriolis(q, arm), v, v), atol=1e-9, rtol=0)
            assert np.allclose(held, gravity_torque(q, arm), atol=1e-9, rtol=0)


def test_mujoco_takes_the_links_that_are_bodies_and_computes_the_same_inertia():
    mujoco = pytest.importorskip("mujoco")
    arm = load_parameters("corke_armstrong_1994")
    model = mujoco.MjModel.from_xml_string(arm_urdf(arm))
    data, mass = mujoco.MjData(model), np.zeros((3, 3))
    rng = np.random.default_rng(10)
    for _ in range(20):
        data.qpos[:] = rng.uniform(-math.pi, math.pi, 3)
        mujoco.mj_forward(model, data)
        mujoco.mj_fullM(*((model, mass, data.qM) if hasattr(data, "qM") else (model, data, mass)))
        assert np.allclose(mass, inertia(data.qpos, arm), atol=1e-6, rtol=0)


def principal_moments(text):
    """Of each link of a URDF that has an inertia, by name [kg.m^2]."""
    found = {}
    for link in ET.fromstring(text).findall("link"):
        element = link.find("inertial/inertia")
        if element is not None:
            entry = {key: float(value) for key, value in element.attrib.items()}
            rows = [[entry[f"i{min(i, j)}{max(i, j)}"] for j in "xyz"] for i in "xyz"]
            found[link.get("name")] = np.linalg.eigvalsh(np.array(rows))
    return found


@pytest.mark.parametrize("name", parameter_sets())
def test_the_text_says_where_the_links_are_no_bodies(name):
    text = arm_urdf(load_parameters(name))
    moments = principal_moments(text)
    assert list(moments) == ["link1", "link2", "link3"]
    bodies = all(low > 0.0 and high < low + middle for low, middle, high in moments.values())
    assert bodies == ("not those of possible bodies" not in text)
    assert bodies == (name == "corke_armstrong_1994")


def test_published_links_that_are_bodies_are_kept():
    rods = Link(mass=3.0, centre=(-0.2, 0.0, 0.02), gyration_squared=(0.02, 0.07, 0.07))
    arm = replace(load_parameters("bejczy"), links=(rods, rods, rods))
    bodies = link_bodies(arm)
    assert bodies.possible
    for matrix, row in zip(bodies.pseudo_inertias, dh_table(arm)):
        frame = dh_transform(0.0, *row)
        assert np.allclose(matrix, frame @ rods.pseudo_inertia @ frame.T, atol=1e-15, rtol=0)


@pytest.mark.parametrize("name", [name for name in parameter_sets() if name != "corke_armstrong_1994"])
def test_no_three_bodies_have_the_dynamics_of_the_thesis_links(name):
    """Whatever the masses and centres. Needed across the plane are, by Schur complements, at least
    what is minimised here, a convex function of two numbers; there is the sum of three."""
    arm = load_parameters(name)
    frames = [dh_transform(0.0, *row) for row in dh_table(arm)[:3]]
    first, second, third = (frame @ link.pseudo_inertia @ frame.T for frame, link in zip(frames, arm.links))
    if np.linalg.eigvalsh(third[:2, :2])[0] < 0.0:
        return
    bound = third[:2, 2:].T @ np.linalg.solve(third[:2, :2], third[:2, 2:])

    def needed(chosen):
        mass, moment = chosen  # of link 3, and its mass times distance across the plane
        more = arm.a2 * (third[3, 3] - mass)
        planar, across = second[:2, :2].copy(), second[:2, 2].copy()
        planar[0, 0] += arm.a2 * more
        across[0] += arm.a2 * (third[2, 3] - moment)
        if mass <= bound[1, 1] or np.linalg.eigvalsh(planar)[0] <= 0.0:
            return math.inf
        own = bound[0, 0] + (moment - bound[0, 1]) ** 2 / (mass - bound[1, 1])
        return own + across @ np.linalg.solve(planar, across)

    least = minimize(needed, (third[3, 3], third[2, 3]), method="Nelder-Mead", options={"xatol": 1e-6, "fatol": 1e-9})
    assert least.success
    assert least.fun > 1.5 * (first[0, 0] + first[1, 1] + second[2, 2] + third[2, 2])


def test_without_inertias_none_are_there():
    robot = ET.fromstring(arm_urdf(load_parameters("bejczy"), inertias=False))
    assert not robot.findall("link/inertial")
    assert not robot.findall("joint/dynamics")


def test_friction_stands_in_the_dynamics_of_its_joint():
    effects = ["coulomb_friction:joint=2,torque=12.5", "viscous_friction:joint=3,coefficient=4"]
    robot = ET.fromstring(plant_urdf(Plant.of("bejczy", map(parse_effect, effects))))
    found = [dict(element.attrib) for element in robot.findall("joint/dynamics")]
    nothing = {"damping": "0.0", "friction": "0.0"}
    assert found == [nothing, {**nothing, "friction": "12.5"}, {**nothing, "damping": "4.0"}]


def test_ros2_control_drives_the_same_joints():
    system = ET.fromstring(arm_urdf(load_parameters("bejczy"), ("waist", "shoulder", "elbow"))).find("ros2_control")
    assert [joint.get("name") for joint in system.findall("joint")] == ["waist", "shoulder", "elbow"]
    for joint in system.findall("joint"):
        assert [x.get("name") for x in joint.findall("command_interface")] == ["position"]
        assert [x.get("name") for x in joint.findall("state_interface")] == ["position", "velocity", "effort"]
    parameters = {x.get("name"): x.text for x in system.findall("hardware/param")}
    assert (parameters["joint_commands_topic"], parameters["joint_states_topic"]) == ("joint_commands", "joint_states")


def test_the_controllers_of_ros2_control_use_what_the_hardware_has():
    manager = yaml.safe_load(config_path("ros2_controllers.yaml").read_text())
    system = ET.fromstring(arm_urdf(load_parameters("bejczy"))).find("ros2_control")
    names = set(manager["controller_manager"]["ros__parameters"]) - {"update_rate"}
    assert names == set(manager) - {"controller_manager"}
    for name in names:
        settings = manager[name]["ros__parameters"]
        assert settings["joints"] == [joint.get("name") for joint in system.findall("joint")]
        for kind in ("command", "state"):
            known = {x.get("name") for x in system.findall(f"joint/{kind}_interface")}
            assert set(settings[f"{kind}_interfaces"]) <= known
