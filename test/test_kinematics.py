# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""Kinematics of six links: poses known by geometry, and derivatives against the complex step."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from trace_form import second_derivatives

from puma_sim_core.arm.kinematics import (
    dh_table,
    dh_transform,
    elbow_position,
    first_derivatives,
    forward_kinematics,
    link_transforms,
    wrist_position,
)
from puma_sim_core.arm.parameters import load_parameters

ARM = load_parameters("bejczy")
A2, A3, D3, D4 = ARM.a2, ARM.a3, ARM.d3, ARM.d4
#: below the rounding of a double beside 1, above underflow of its square
STEP = 1e-40

six_angles = st.tuples(*[st.floats(-math.pi, math.pi) for _ in range(6)]).map(np.array)
many = settings(max_examples=40)


def rotation(axis, angle):
    c, s = math.cos(angle), math.sin(angle)
    out = np.eye(4)
    i, j = {"x": (1, 2), "z": (0, 1)}[axis]
    out[[i, i, j, j], [i, j, i, j]] = c, -s, s, c
    return out


def translation(x, y, z):
    out = np.eye(4)
    out[:3, 3] = x, y, z
    return out


@many
@given(q=six_angles)
def test_each_transform_is_the_four_moves_of_denavit_and_hartenberg(q):
    product = np.eye(4)
    transforms = link_transforms(q, ARM)
    for angle, (a, alpha, d), transform in zip(q, dh_table(ARM), transforms[1:]):
        product = product @ rotation("z", angle) @ translation(0, 0, d) @ translation(a, 0, 0) @ rotation("x", alpha)
        np.testing.assert_allclose(transform, product, rtol=0, atol=1e-14)
    assert np.array_equal(transforms[0], np.eye(4))
    assert np.array_equal(forward_kinematics(q, ARM), transforms[-1])


def test_transforms_are_those_of_section_2_3_corrected():
    q = np.array([0.3, -1.1, 0.7, 2.0, -0.4, 1.3])
    c, s = np.cos(q), np.sin(q)
    expected = [
        [[c[0], 0, -s[0], 0], [s[0], 0, c[0], 0], [0, -1, 0, 0]],
        [[c[1], -s[1], 0, A2 * c[1]], [s[1], c[1], 0, A2 * s[1]], [0, 0, 1, 0]],
        [[c[2], 0, s[2], A3 * c[2]], [s[2], 0, -c[2], A3 * s[2]], [0, 1, 0, D3]],
        [[c[3], 0, -s[3], 0], [s[3], 0, c[3], 0], [0, -1, 0, D4]],
        [[c[4], 0, s[4], 0], [s[4], 0, -c[4], 0], [0, 1, 0, 0]],
        [[c[5], -s[5], 0, 0], [s[5], c[5], 0, 0], [0, 0, 1, 0]],
    ]
    for angle, row, rows in zip(q, dh_table(ARM), expected):
        np.testing.assert_allclose(dh_transform(angle, *row)[:3], rows, rtol=0, atol=1e-16)


@many
@given(q=six_angles)
def test_transforms_are_rigid_motions(q):
    for transform in link_transforms(q, ARM):
        turn = transform[:3, :3]
        np.testing.assert_allclose(turn @ turn.T, np.eye(3), atol=1e-14)
        assert abs(np.linalg.det(turn) - 1) < 1e-14
        assert np.array_equal(transform[3], [0, 0, 0, 1])


@many
@given(q=six_angles)
def test_elbow_and_forearm_follow_the_conventions(q):
    c1, s1, c2, s2 = math.cos(q[0]), math.sin(q[0]), math.cos(q[1]), math.sin(q[1])
    np.testing.assert_allclose(elbow_position(q, ARM), [A2 * c1 * c2, A2 * s1 * c2, -A2 * s2], atol=1e-15)
    s23, c23 = math.sin(q[1] + q[2]), math.cos(q[1] + q[2])
    np.testing.assert_allclose(link_transforms(q[:3], ARM)[3][:3, 2], [c1 * s23, s1 * s23, c23], atol=1e-15)


@pytest.mark.parametrize(
    "pose, wrist",
    [
        ((0, 0, 0), (A2 + A3, D3, D4)),
        ((0, 0, 90), (A2 + D4, D3, -A3)),
        ((0, -90, 90), (A3, D3, A2 + D4)),
        ((90, 0, 0), (-D3, A2 + A3, D4)),
        ((0, 90, -90), (A3, D3, D4 - A2)),
    ],
    ids=["L", "stretched", "upright", "L turned", "down and folded back up"],
)
def test_wrist_in_known_poses(pose, wrist):
    # upper arm along x0 and forearm up at zero; positive q2 and q3 turn the arm down
    np.testing.assert_allclose(wrist_position(np.radians(pose), ARM), wrist, atol=1e-15)


@many
@given(q=six_angles)
def test_wrist_joints_turn_about_the_wrist(q):
    np.testing.assert_allclose(forward_kinematics(q, ARM)[:3, 3], wrist_position(q, ARM), atol=1e-15)


@many
@given(q=six_angles)
def test_first_derivatives_are_those_of_the_transforms(q):
    first = first_derivatives(q, ARM)
    for i, unit in enumerate(np.eye(6)):
        slopes = link_transforms(q + 1j * STEP * unit, ARM)[1:].imag / STEP
        np.testing.assert_allclose(first[:, i], slopes, rtol=0, atol=1e-14)


@many
@given(q=six_angles)
def test_second_derivatives_are_those_of_the_first(q):
    second = second_derivatives(q, ARM)
    for j, unit in enumerate(np.eye(6)):
        slopes = first_derivatives(q + 1j * STEP * unit, ARM).imag / STEP
        np.testing.assert_allclose(second[:, :, j], slopes, rtol=0, atol=1e-14)
    np.testing.assert_allclose(second, second.transpose(0, 2, 1, 3, 4), rtol=0, atol=1e-14)


def test_inner_frames_do_not_move_with_outer_joints():
    q = np.linspace(-1, 1, 6)
    first = first_derivatives(q, ARM)
    for p in range(6):
        assert not first[p, p + 1 :].any() and first[p, p].any()


def test_any_table_of_links_is_taken():
    # two links of a plane arm, standing as in any textbook
    table = [(0.5, 0.0, 0.0), (0.3, 0.0, 0.0)]
    q = np.array([0.4, -0.9])
    end = forward_kinematics(q, table)[:3, 3]
    expected = [0.5 * math.cos(0.4) + 0.3 * math.cos(-0.5), 0.5 * math.sin(0.4) + 0.3 * math.sin(-0.5), 0]
    np.testing.assert_allclose(end, expected, atol=1e-16)


@pytest.mark.parametrize("q", [np.zeros(7), np.zeros((2, 3))], ids=["seven", "two rows"])
def test_angles_that_do_not_fit_are_refused(q):
    with pytest.raises(ValueError, match="expected \\(n,\\) with n at most 6"):
        link_transforms(q, ARM)
