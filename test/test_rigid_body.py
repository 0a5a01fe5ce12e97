# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""D, C and G: the closed form against the trace form, against MuJoCo, and against its properties.

Tolerances are rounding with a margin: entries are of the order of 10 kg.m^2 and 60 N.m.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from trace_form import arm_table, trace_coriolis, trace_gravity, trace_inertia

from puma_sim_core.arm import printed_coefficients as printed
from puma_sim_core.arm.arm import Link
from puma_sim_core.arm.kinematics import dh_table, dh_transform
from puma_sim_core.arm.parameters import load_parameters, parameter_sets, smallest_eigenvalue, within_a_turn
from puma_sim_core.arm.rigid_body import arm_pseudo_inertias, coriolis, gravity_torque, inertia, lumped_constants

angles = st.tuples(*[st.floats(-math.pi, math.pi) for _ in range(3)]).map(np.array)
rates = st.tuples(*[st.floats(-3, 3) for _ in range(3)]).map(np.array)
every_set = pytest.mark.parametrize("name", [*parameter_sets(), "with products"])


def arm_of(name):
    """A published set, or one whose links have large products of inertia in all planes."""
    if name != "with products":
        return load_parameters(name)
    arm = load_parameters("bejczy")
    products = ((0.02, -0.01, 0.03), (-0.05, 0.04, 0.06), (0.01, 0.02, -0.03))
    return replace(arm, links=tuple(replace(link, products=p) for link, p in zip(arm.links, products)))


def random_poses(count, seed=1):
    return np.random.default_rng(seed).uniform(-math.pi, math.pi, (count, 3))


# ------------------------------------------------------------------------------ the trace form


@every_set
def test_closed_form_equals_trace_form(name):
    arm = arm_of(name)
    bodies, table = arm_pseudo_inertias(arm), arm_table(arm)
    for q in random_poses(100):
        for closed, trace in (
            (inertia(q, arm), trace_inertia(q, bodies, table)),
            (coriolis(q, arm), trace_coriolis(q, bodies, table)),
            (gravity_torque(q, arm), trace_gravity(q, bodies, table, arm.gravity)),
        ):
            np.testing.assert_allclose(closed, trace, rtol=0, atol=1e-12)


@pytest.mark.parametrize("name", ["bejczy", "paul", "armstrong"])
def test_closed_form_without_products_is_the_corrected_print_of_chapter_4(name):
    arm = load_parameters(name)
    a2, a3, d3, g = arm.a2, arm.a3, arm.d3, arm.gravity
    link1, link2, link3 = arm.links
    m1, m2, m3 = link1.mass, link2.mass, link3.mass
    (x2, y2, z2), (x3, y3, z3) = link2.centre, link3.centre
    k1yy = link1.gyration_squared[1]
    (k2xx, k2yy, k2zz), (k3xx, k3yy, k3zz) = link2.gyration_squared, link3.gyration_squared
    for q in random_poses(50, seed=2):
        s2, c2, s3, c3 = (f(angle) for angle in q[1:] for f in (math.sin, math.cos))
        s23, c23 = math.sin(q[1] + q[2]), math.cos(q[1] + q[2])
        d11 = (
            m1 * k1yy
            + m2 * (k2xx * s2**2 + k2yy * c2**2 + (a2**2 + 2 * a2 * x2) * c2**2 - 2 * a2 * y2 * s2 * c2)
            + m3
            * (
                k3xx * s23**2
                + k3zz * c23**2
                + d3**2
                + 2 * y3 * d3
                + a2**2 * c2**2
                + a3**2 * c23**2
                + 2 * a2 * a3 * c2 * c23
                + 2 * x3 * (a2 * c2 * c23 + a3 * c23**2)
                + 2 * z3 * (a3 * c23 * s23 + a2 * c2 * s23)
            )
        )
        d13 = m3 * ((d3 * x3 + a3 * y3 + a3 * d3) * s23 - d3 * z3 * c23)
        d12 = m2 * a2 * z2 * s2 + m3 * a2 * (y3 + d3) * s2 + d13
        d33 = m3 * (k3yy + a3**2 + 2 * a3 * x3)
        h = m3 * a2 * ((a3 + x3) * c3 + z3 * s3)
        d22 = m2 * (k2zz + a2**2 + 2 * a2 * x2) + m3 * a2**2 + d33 + 2 * h
        c113 = m3 * (
            (k3xx - k3zz - a3**2 - 2 * a3 * x3) * s23 * c23
            - a2 * (a3 + x3) * c2 * s23
            + a3 * z3 * (2 * c23**2 - 1)
            + a2 * z3 * c2 * c23
        )
        c112 = (
            m2 * ((k2xx - k2yy - a2**2 - 2 * a2 * x2) * s2 * c2 - a2 * y2 * math.cos(2 * q[1]))
            - m3 * a2**2 * s2 * c2
            + c113
            - m3 * a2 * ((a3 + x3) * s2 * c23 + z3 * s2 * s23)
        )
        e = m3 * ((d3 * x3 + a3 * y3 + a3 * d3) * c23 + d3 * z3 * s23)
        c122 = m2 * a2 * z2 * c2 + m3 * a2 * (y3 + d3) * c2 + e
        c223 = m3 * a2 * (z3 * c3 - (a3 + x3) * s3)
        g3 = -m3 * g * ((x3 + a3) * c23 + z3 * s23)
        g2 = -m2 * g * ((x2 + a2) * c2 - y2 * s2) - m3 * g * a2 * c2 + g3
        np.testing.assert_allclose(
            inertia(q, arm), [[d11, d12, d13], [d12, d22, d33 + h], [d13, d33 + h, d33]], rtol=0, atol=1e-13
        )
        np.testing.assert_allclose(
            coriolis(q, arm),
            [
                [[0, c112, c113], [c112, c122, e], [c113, e, e]],
                [[-c112, 0, 0], [0, 0, c223], [0, c223, c223]],
                [[-c113, 0, 0], [0, -c223, 0], [0, 0, 0]],
            ],
            rtol=0,
            atol=1e-13,
        )
        np.testing.assert_allclose(gravity_torque(q, arm), [0, g2, g3], rtol=0, atol=1e-12)


# --------------------------------------------------------------------------------------- MuJoCo


def mujoco_chain(table, bodies, armature, gravity):
    """MuJoCo model of a chain of revolute joints from its Denavit-Hartenberg rows.

    bodies : mass, centre and inertia tensor about the centre, both in the link's distal frame.
    The inertias are written into the compiled model: its compiler would refuse links that are not
    quite bodies, its dynamics do not mind.
    """
    mujoco = pytest.importorskip("mujoco")
    spec = mujoco.MjSpec()
    spec.option.gravity = [0, 0, -gravity]
    parent, frame = spec.worldbody, np.eye(4)
    distal = []
    for i, row in enumerate(table):
        quaternion = np.empty(4)
        mujoco.mju_mat2Quat(quaternion, frame[:3, :3].ravel())
        parent = parent.add_body(
            name=f"link{i + 1}",
            pos=frame[:3, 3],
            quat=quaternion,
            mass=1,
            inertia=[1, 1, 1],
            ipos=[0, 0, 0],
            explicitinertial=True,
        )
        parent.add_joint(type=mujoco.mjtJoint.mjJNT_HINGE, axis=[0, 0, 1])
        frame = dh_transform(0.0, *row)
        distal.append(frame)
    model = spec.compile()
    for i, ((mass, centre, tensor), frame) in enumerate(zip(bodies, distal), start=1):
        moments, axes = np.linalg.eigh(frame[:3, :3] @ tensor @ frame[:3, :3].T)
        axes[:, 0] *= np.linalg.det(axes)
        model.body_mass[i] = mass
        model.body_ipos[i] = frame[:3, :3] @ centre + frame[:3, 3]
        model.body_inertia[i] = moments
        mujoco.mju_mat2Quat(model.body_iquat[i], axes.ravel())
    model.dof_armature[:] = armature
    data = mujoco.MjData(model)
    mujoco.mj_setConst(model, data)
    return model, data


def mujoco_terms(model, data, q, qd):
    """D + armature, C(qd, qd) + G, and G, by MuJoCo."""
    import mujoco

    data.qpos[:], data.qvel[:] = q, qd
    mujoco.mj_kinematics(model, data)
    mujoco.mj_comPos(model, data)
    mujoco.mj_crb(model, data)
    mujoco.mj_comVel(model, data)
    bias, still = np.zeros(model.nv), np.zeros(model.nv)
    mujoco.mj_rne(model, data, 0, bias)
    # the recursion takes the velocities from cvel and from qvel, so that both are cleared
    data.qvel[:] = 0
    mujoco.mj_comVel(model, data)
    mujoco.mj_rne(model, data, 0, still)
    return full_inertia(model, data), bias, still


def full_inertia(model, data):
    """Dense mass matrix, column by column, which every version of MuJoCo can multiply."""
    import mujoco

    columns = np.empty((model.nv, model.nv))
    for j, unit in enumerate(np.eye(model.nv)):
        mujoco.mj_mulM(model, data, columns[j], unit)
    return columns


def central_inertia(link):
    """Inertia tensor about the centre of mass from the numbers of a link."""
    m, c = link.mass, np.array(link.centre)
    second = link.pseudo_inertia[:3, :3] - m * np.outer(c, c)
    return np.trace(second) * np.eye(3) - second


def assert_same_dynamics(arm, model, data, shift=0.0, count=40):
    rng = np.random.default_rng(3)
    for _ in range(count):
        q, qd = rng.uniform(-math.pi, math.pi, 3), rng.uniform(-3, 3, 3)
        mass, bias, still = mujoco_terms(model, data, q - shift, qd)
        np.testing.assert_allclose(inertia(q, arm) + np.diag(arm.motor_inertia), mass, rtol=0, atol=1e-12)
        np.testing.assert_allclose(np.einsum("ijk,j,k->i", coriolis(q, arm), qd, qd), bias - still, rtol=0, atol=1e-12)
        np.testing.assert_allclose(gravity_torque(q, arm), still, rtol=0, atol=1e-12)


@every_set
def test_agrees_with_mujoco(name):
    arm = arm_of(name)
    bodies = [(link.mass, np.array(link.centre), central_inertia(link)) for link in arm.links]
    assert_same_dynamics(arm, *mujoco_chain(dh_table(arm)[:3], bodies, arm.motor_inertia, arm.gravity))


def test_corke_armstrong_agrees_with_mujoco_in_the_frames_of_the_source():
    # built from the published numbers alone; our angles are the source's plus half a turn
    half = math.pi / 2
    table = [(0.0, half, 0.0), (0.4318, 0.0, 0.0), (0.0203, -half, 0.15005)]
    bodies = [
        (0.0, np.zeros(3), np.diag([0.0, 0.35, 0.0])),
        (17.4, np.array([-0.3638, 0.006, 0.2275]), np.diag([0.13, 0.524, 0.539])),
        (4.8, np.array([-0.0203, -0.0141, 0.070]), np.diag([0.066, 0.086, 0.0125])),
    ]
    armature = 200e-6 * np.array([-62.6111, 107.815, -53.7063]) ** 2
    assert_same_dynamics(
        load_parameters("corke_armstrong_1994"), *mujoco_chain(table, bodies, armature, 9.81), shift=math.pi
    )


def test_trace_form_of_six_links_agrees_with_mujoco():
    rng = np.random.default_rng(11)
    table = dh_table(load_parameters("bejczy"))
    links, bodies = [], []
    for _ in table:
        points, weights = rng.normal(size=(8, 3)) * 0.2, rng.uniform(0.1, 1, 8)
        link = link_of_points(points, weights)
        links.append(link.pseudo_inertia)
        bodies.append((link.mass, np.array(link.centre), central_inertia(link)))
    model, data = mujoco_chain(table, bodies, np.zeros(6), 9.81)
    for _ in range(10):
        q, qd = rng.uniform(-math.pi, math.pi, 6), rng.uniform(-2, 2, 6)
        mass, bias, still = mujoco_terms(model, data, q, qd)
        np.testing.assert_allclose(trace_inertia(q, links, table), mass, rtol=0, atol=1e-12)
        np.testing.assert_allclose(
            np.einsum("ijk,j,k->i", trace_coriolis(q, links, table), qd, qd), bias - still, rtol=0, atol=1e-11
        )
        np.testing.assert_allclose(trace_gravity(q, links, table), still, rtol=0, atol=1e-11)


def link_of_points(points, weights):
    """The link made of point masses: its numbers by their definitions."""
    mass = weights.sum()
    x, y, z = points.T

    def mean(values):
        return float(weights @ values / mass)

    return Link(
        float(mass),
        (mean(x), mean(y), mean(z)),
        (mean(y * y + z * z), mean(x * x + z * z), mean(x * x + y * y)),
        (mean(x * y), mean(y * z), mean(x * z)),
    )


# ----------------------------------------------------------------------------------- properties


@every_set
@settings(max_examples=50)
@given(q=angles, qd=rates)
def test_ddot_minus_2c_is_skew_symmetric(name, q, qd):
    # C_ij = sum_k C_ijk qd_k with Christoffel symbols; derivative of D by the complex step
    arm = arm_of(name)
    step = 1e-40
    d_dot = inertia(q + 1j * step * qd, arm).imag / step
    skew = d_dot - 2 * coriolis(q, arm) @ qd
    np.testing.assert_allclose(skew + skew.T, 0, atol=1e-12)


@every_set
@settings(max_examples=25)
@given(q=angles)
def test_coriolis_are_the_christoffel_symbols_of_the_inertia(name, q):
    arm = arm_of(name)
    step = 1e-40
    slope = np.array([inertia(q + 1j * step * unit, arm).imag / step for unit in np.eye(3)])
    # slope[k, i, j] = dD_ij / dq_k
    expected = (np.einsum("kij->ijk", slope) + np.einsum("jik->ijk", slope) - slope) / 2
    np.testing.assert_allclose(coriolis(q, arm), expected, rtol=0, atol=1e-12)
    c = coriolis(q, arm)
    assert np.array_equal(c, c.transpose(0, 2, 1))


@every_set
@settings(max_examples=25)
@given(q=angles)
def test_gravity_torque_is_the_slope_of_the_potential_energy(name, q):
    arm = arm_of(name)

    def energy(angles_):
        frame, total = np.eye(4), 0.0
        for angle, row, link in zip(angles_, arm_table(arm), arm.links):
            frame = frame @ dh_transform(angle, *row)
            total = total + link.mass * arm.gravity * (frame @ np.array([*link.centre, 1.0]))[2]
        return total

    step = 1e-40
    slope = [energy(q + 1j * step * unit).imag / step for unit in np.eye(3)]
    np.testing.assert_allclose(gravity_torque(q, arm), slope, rtol=0, atol=1e-12)


def test_poses_may_stand_in_arrays_and_be_integers():
    arm = arm_of("with products")
    poses = random_poses(6).reshape(2, 3, 3)
    for function in (inertia, coriolis, gravity_torque):
        batch = function(poses, arm)
        for index in np.ndindex(2, 3):
            assert np.array_equal(batch[index], function(poses[index], arm))
        assert np.array_equal(function([0, 1, 2], arm), function([0.0, 1.0, 2.0], arm))


@every_set
def test_lumped_constants_hold_the_motor_inertias(name):
    arm = arm_of(name)
    without = replace(arm, motors=tuple(replace(m, inertia=0.0) for m in arm.motors))
    with_, alone = lumped_constants(arm), lumped_constants(without)
    changed = {key for key in with_._fields if getattr(with_, key) != getattr(alone, key)}
    assert changed == {"A0", "E3", "E4"}
    added = [with_.A0 - alone.A0, with_.E3 - alone.E3, with_.E4 - alone.E4]
    np.testing.assert_allclose(added, arm.motor_inertia, rtol=0, atol=1e-14)
    assert alone.E4 == alone.E0 and len(with_) == 20


# --------------------------------------------------------------------------------- regression


@pytest.mark.parametrize(
    "pose, diagonal",
    [
        ((0, -90, 90), (2.4976, 6.3279, 1.1295)),
        ((0, 0, 90), (6.0466, 6.3279, 1.1295)),
        ((0, 0, 0), (4.5652, 5.3786, 1.1295)),
    ],
    ids=["upright", "horizontal", "zero"],
)
def test_inertia_of_named_poses(pose, diagonal):
    arm = load_parameters("bejczy")
    result = np.diag(inertia(np.radians(pose), arm)) + arm.motor_inertia
    np.testing.assert_allclose(result, diagonal, rtol=0, atol=6e-5)


@pytest.mark.parametrize(
    "pose, joint, torque", [((0, 0, 90), 2, 62.52), ((0, 0, 90), 3, 10.41)], ids=["joint 2 extended", "joint 3"]
)
def test_greatest_gravity_torques(pose, joint, torque):
    result = gravity_torque(np.radians(pose), load_parameters("bejczy"))
    # "extended" is the horizontal pose: its torque is the greatest to three digits
    assert abs(abs(result[joint - 1]) - torque) < 0.01


def test_gravity_torque_of_the_folded_arm():
    # q3 = -0.9075 rad; the greatest over q2, and no torque at -90 deg + 0.1143 rad
    arm = load_parameters("bejczy")
    q2 = np.linspace(-math.pi, math.pi, 3601)
    poses = np.stack([0 * q2, q2, np.full_like(q2, -0.9075)], axis=-1)
    assert abs(np.max(np.abs(gravity_torque(poses, arm)[:, 1])) - 43.96) < 0.005
    balanced = gravity_torque([0.0, -math.pi / 2 + 0.1143, -0.9075], arm)[1]
    assert abs(balanced) < 44 * 1e-4


@pytest.mark.parametrize("name, with_motors", [("bejczy", 0.760), ("tuned", 0.700)])
def test_rigid_links_alone_are_not_positive_definite_but_the_arm_is(name, with_motors):
    arm = load_parameters(name)
    grid = np.radians(np.arange(-180.0, 180.0, 2.0))
    q2, q3 = np.meshgrid(grid, grid, indexing="ij")
    poses = np.stack([0 * q2, q2, q3], axis=-1)
    d = inertia(poses, arm)
    assert np.linalg.eigvalsh(d).min() < -0.4
    lowest = np.linalg.eigvalsh(d + np.diag(arm.motor_inertia)).min()
    assert abs(lowest - with_motors) < 5e-4


def test_lowest_eigenvalue_of_the_rigid_links():
    poses = np.radians([[0, 90, -90], [0, -90, -90]])
    values = np.linalg.eigvalsh(inertia(poses, load_parameters("bejczy")))[:, 0]
    np.testing.assert_allclose(values, -0.405, rtol=0, atol=5e-4)


def test_many_turns_are_looked_at_as_one():
    arm = load_parameters("bejczy")
    wide, whole = (replace(arm, joint_ranges=(ends, ends, ends)) for ends in ((-30.0, 30.0), (-np.pi, np.pi)))
    assert all(high - low == pytest.approx(2.0 * np.pi) for low, high in within_a_turn(wide))
    assert smallest_eigenvalue(wide)[0] == pytest.approx(smallest_eigenvalue(whole)[0], abs=1e-6)
    assert within_a_turn(arm) == [tuple(ends) for ends in arm.joint_ranges[1:]]


# --------------------------------------------------------------------- coefficients of section 4.5


def coefficient_errors(name, corrected):
    """Greatest difference from the closed form of each coefficient that section 4.5 prints."""
    arm, poses = load_parameters(name), random_poses(500, seed=4)
    terms = {
        "D": inertia(poses, arm) + np.diag(arm.motor_inertia),
        "C": coriolis(poses, arm),
        "G": gravity_torque(poses, arm),
    }
    errors = {}
    for key in printed.COEFFICIENTS:
        index = tuple(int(digit) - 1 for digit in key[1:])
        difference = terms[key[0]][(..., *index)] - printed.coefficient(key, poses, corrected)
        errors[key] = np.max(np.abs(difference))
    return errors


def test_corrected_coefficients_are_those_of_bejczy():
    # printed to four decimals: up to ten roundings of half a unit add up
    errors = coefficient_errors("bejczy", corrected=True)
    assert max(errors.values()) < 10 * 0.5e-4


@pytest.mark.parametrize("name", [n for n in parameter_sets() if n != "bejczy"])
def test_corrected_coefficients_are_those_of_no_other_set(name):
    assert max(coefficient_errors(name, corrected=True).values()) > 0.05


def test_printed_coefficients_are_wrong_where_the_errata_say_so():
    errors = coefficient_errors("bejczy", corrected=False)
    wrong = {key for key, error in errors.items() if error > 10 * 0.5e-4}
    assert wrong == {"D11", "D22", "C112", "C113", "C122"}


def test_printed_d22_took_a3_with_the_wrong_sign():
    arm = load_parameters("bejczy")
    link3 = arm.links[2]
    constant = lumped_constants(arm).E3 - arm.motors[1].inertia - 4 * link3.mass * arm.a3 * link3.centre[0]
    assert abs(constant - 3.05737) < 5e-6
