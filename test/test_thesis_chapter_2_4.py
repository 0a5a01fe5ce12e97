# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""Experiments of chapters 2 and 4: kinematics against MuJoCo, coefficients against the bodies."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from puma_sim_core.arm.kinematics import forward_kinematics
from puma_sim_core.arm.parameters import load_parameters, parameter_sets
from puma_sim_core.arm.printed_coefficients import COEFFICIENTS
from puma_sim_core.arm.rigid_body import coriolis, gravity_torque, inertia
from puma_sim_core.thesis import chapter_2, chapter_4
from puma_sim_core.thesis.misprints import chapter_4_forms as terms
from puma_sim_core.thesis.registry import Context, experiments

ARM = load_parameters("bejczy")
POSES = np.random.default_rng(24).uniform(-math.pi, math.pi, (60, 6))
every_set = pytest.mark.parametrize("name", parameter_sets())


def result_of(number):
    return experiments()[number].run(Context(seed=1))


def row(result, start):
    found = [each for each in result.rows if each.quantity.startswith(start)]
    assert len(found) == 1, f"{len(found)} rows start with {start!r}"
    return found[0]


# ---------------------------------------------------------------------------------- section 2.4


def test_six_links_against_mujoco():
    # the arm as figure 2.6 draws it: axes and distances, no Denavit-Hartenberg angles
    mujoco = pytest.importorskip("mujoco")
    joints = [
        ("z", (0, 0, 0)),
        ("y", (0, 0, 0)),
        ("y", (ARM.a2, 0, 0)),
        ("z", (ARM.a3, ARM.d3, 0)),
        ("y", (0, 0, ARM.d4)),
        ("z", (0, 0, 0)),
    ]
    axes = {"y": "0 1 0", "z": "0 0 1"}
    opening = "".join(
        f'<body pos="{x!r} {y!r} {z!r}"><inertial pos="0 0 0" mass="1" diaginertia="1 1 1"/>'
        f'<joint type="hinge" axis="{axes[axis]}"/>'
        for axis, (x, y, z) in joints
    )
    model = mujoco.MjModel.from_xml_string(f"<mujoco><worldbody>{opening}{'</body>' * 6}</worldbody></mujoco>")
    data = mujoco.MjData(model)
    for q in POSES:
        data.qpos[:] = q
        mujoco.mj_kinematics(model, data)
        frame = forward_kinematics(q, ARM)
        np.testing.assert_allclose(frame[:3, 3], data.xpos[-1], rtol=0, atol=1e-14)
        np.testing.assert_allclose(frame[:3, :3], data.xmat[-1].reshape(3, 3), rtol=0, atol=1e-14)


@every_set
def test_turns_about_lines_give_the_same_frames(name):
    arm = load_parameters(name)
    for q in POSES:
        frame = forward_kinematics(q, arm)
        position, turn = chapter_2.independent_frame(q, arm)
        np.testing.assert_allclose(position, frame[:3, 3], rtol=0, atol=1e-14)
        np.testing.assert_allclose(turn, frame[:3, :3], rtol=0, atol=1e-14)


def test_printed_matrices_are_off_by_the_slip_in_t3_alone_when_t2_has_the_offset():
    for q in POSES:
        off = np.linalg.norm((chapter_2.printed_frame(q, ARM, ARM.d3) - forward_kinematics(q, ARM))[:3, 3])
        assert off == pytest.approx(abs(ARM.a3 * (math.cos(q[2]) - math.sin(q[2]))), abs=1e-14)


def test_random_poses_stay_within_the_ranges():
    poses = chapter_2.random_poses(ARM, np.random.default_rng(1), 500)
    low, high = np.array([*ARM.joint_ranges, *np.radians(chapter_2.WRIST_RANGES)]).T
    assert poses.shape == (500, 6)
    assert np.all(poses >= low) and np.all(poses <= high)
    assert np.all(poses.max(axis=0) - poses.min(axis=0) > 0.9 * (high - low))


def test_experiment_2_4_finds_rounding_and_shows_all_six_matrices():
    result = result_of("2.4")
    assert result.numbers["position_difference_m"] < 1e-14
    assert result.numbers["orientation_difference"] < 1e-14
    assert sum(each.quantity.startswith("T") for each in result.rows) == 6
    assert row(result, "T3").printed.count("a3C3") == 2
    assert row(result, "T3").ours.count("a3S3") == 1
    assert row(result, "angles to wrist and back").ours < 1e-9


# ------------------------------------------------------------------------------ sections 4.3, 4.5


@every_set
def test_terms_add_up_to_the_coefficients(name):
    arm = load_parameters(name)
    q = POSES[:, :3]
    d, c, g = inertia(q, arm) + np.diag(arm.motor_inertia), coriolis(q, arm), gravity_torque(q, arm)
    for key, numbers in terms.coefficient_terms(arm).items():
        index = (slice(None), *(int(digit) - 1 for digit in key[1:]))
        np.testing.assert_allclose(
            terms.value(numbers, q), {"D": d, "C": c, "G": g}[key[0]][index], rtol=0, atol=1e-12, err_msg=key
        )


@pytest.mark.parametrize("name", ["bejczy", "paul", "armstrong"])
@pytest.mark.parametrize(
    "coefficient, number, slips, words", chapter_4.EQUATIONS, ids=[each[0] for each in chapter_4.EQUATIONS]
)
def test_an_equation_is_wrong_with_its_slips_and_right_without(name, coefficient, number, slips, words):
    arm = load_parameters(name)
    right = [chapter_4.corrected_value(coefficient, q, arm) for q in POSES[:, :3]]
    printed = [chapter_4.printed_value(coefficient, slips, q, arm) for q in POSES[:, :3]]
    assert bool(words) == bool(slips)
    if slips:
        assert np.max(np.abs(np.subtract(printed, right))) > 1e-3
    else:
        np.testing.assert_allclose(printed, right, rtol=0, atol=1e-12)
    if slips and coefficient != "C311":
        np.testing.assert_allclose(
            [chapter_4.printed_value(coefficient, (), q, arm) for q in POSES[:, :3]], right, rtol=0, atol=1e-12
        )


def test_the_pose_of_experiment_4_3_hides_no_misprint():
    for each in result_of("4.3").rows:
        assert (abs(each.printed - each.ours) > 1e-3) == bool(each.note)


def test_bejczy_made_the_printed_numbers():
    matched = result_of("4.5").numbers["matched"]
    numbers = chapter_4._held_against(ARM)
    off = {(name, basis) for name, basis, printed, ours, tolerance in numbers if abs(printed - ours) > tolerance}
    # these two are one unit of the fourth decimal off, as no other number is
    assert off == {("D11", "S23^2"), ("D11", "C2C23")}
    assert matched["bejczy"] == len(numbers) - 2
    # "tuned" is a reading that keeps Bejczy's masses; no independent set comes near
    assert all(
        hits <= 10 for name, hits in matched.items() if name in ("armstrong", "average", "paul", "corke_armstrong_1994")
    )


def test_every_misprinted_number_has_its_reason():
    listed = {(name, basis) for name, basis, *_ in terms.printed_terms() if terms.is_misprint(name, basis)}
    cases = chapter_4.words.content["rows"]["term"]["note"]
    assert {f"{name} {basis}" for name, basis in listed} == set(cases) - {"rounded", "fits"}
    assert {name for name, _ in listed} == {
        name for name, each in COEFFICIENTS.items() if any(term.printed != term.corrected for term in each)
    }


def test_lengths_follow_from_the_printed_numbers():
    for each in chapter_4._recovered_rows(ARM):
        assert each.printed == pytest.approx(each.ours, abs=2e-4)


def test_the_offset_of_d22_is_the_sign_of_a3():
    wrong = replace(ARM, a3=-ARM.a3)
    # with a3 positive throughout the constant is the printed one, the terms with a3 in them not
    assert terms.coefficient_terms(wrong)["D22"]["1"] == pytest.approx(2.3616 + 3.0574, abs=1e-4)
    assert terms.coefficient_terms(wrong)["D22"]["C3"] != pytest.approx(-0.0331, abs=1e-2)


# ----------------------------------------------------------------------------------- section 4.4


def test_tables_4_2_and_4_3_differ_by_more_than_the_text_says():
    greatest, name = chapter_4._greatest_difference(ARM, load_parameters("armstrong"))
    assert (name, round(100 * greatest)) == ("y3", 87)


def test_every_published_set_is_an_arm_and_table_7_1_is_not():
    result = result_of("4.4")
    lowest = {each.quantity: each.ours for each in result.rows if each.quantity.startswith("smallest eigenvalue")}
    assert len(lowest) == len(parameter_sets()) + 1
    for name in parameter_sets():
        assert lowest[f"smallest eigenvalue of D + Ia, {name}"] > 0.5
    assert lowest["smallest eigenvalue of D + Ia, table 7.1 as printed"] < -2.0
