# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""Section 2.4: the kinematics of six links at precision points."""

import itertools
from contextlib import suppress

import numpy as np
from scipy.spatial.transform import Rotation

from puma_sim_core.arm.arm import ArmParameters
from puma_sim_core.arm.inverse_kinematics import wrist_angles
from puma_sim_core.arm.kinematics import forward_kinematics, link_transforms, wrist_position
from puma_sim_core.arm.parameters import load_parameters
from puma_sim_core.errors import ParameterError
from puma_sim_core.thesis.motions import FOLDED
from puma_sim_core.thesis.registry import Context
from puma_sim_core.thesis.result import Curve, Figure, Result, Row, matrix_text
from puma_sim_core.thesis.wording import Words

words = Words(__name__)
WRIST_RANGES = words.table("WRIST_RANGES")
#: poses drawn at random over the ranges
COUNT = 2000


def independent_frame(q, arm: ArmParameters) -> tuple[np.ndarray, np.ndarray]:
    """Position (3,) [m] and rotation matrix (3, 3) of the last link, without the matrices; q : (6,) [rad].

    Each joint turns everything outside it about a line in space, that of the arm at q = 0 (figure 2.6). The
    joints are applied from the outermost inwards, so that every line is still where it was drawn.
    """
    elbow, wrist = (arm.a2, 0.0, 0.0), (arm.a2 + arm.a3, arm.d3, arm.d4)
    axes = np.eye(3)[[2, 1, 1, 2, 1, 2]]
    points = np.array([(0, 0, 0), (0, 0, 0), elbow, wrist, wrist, wrist])
    position, turn = np.array(wrist), Rotation.identity()
    for angle, axis, point in reversed(list(zip(q, axes, points))):
        step = Rotation.from_rotvec(angle * axis)
        position = step.apply(position - point) + point
        turn = step * turn
    return position, turn.as_matrix()


def printed_frame(q, arm: ArmParameters, d2: float) -> np.ndarray:
    """(4, 4) transform of the last link with T2 and T3 as printed, d2 [m]; q : (6,) [rad]."""
    steps = [np.linalg.solve(a, b) for a, b in itertools.pairwise(link_transforms(q, arm))]
    steps[1][2, 3] = d2
    steps[2][1:3, 3] = arm.a3 * np.cos(q[2]), 0.0
    return np.linalg.multi_dot(steps)


def random_poses(arm: ArmParameters, rng: np.random.Generator, count: int) -> np.ndarray:
    """(count, 6) angles [rad], evenly over the ranges of the joints."""
    low, high = np.array([*arm.joint_ranges, *np.radians(WRIST_RANGES)]).T
    return rng.uniform(low, high, (count, 6))


def _compared(q, arm: ArmParameters) -> tuple[np.ndarray, float, float]:
    """(frame, difference of position [m], of orientation) from the independent construction."""
    frame, (position, turn) = forward_kinematics(q, arm), independent_frame(q, arm)
    return frame, np.abs(frame[:3, 3] - position).max(), np.abs(frame[:3, :3] - turn).max()


def _point_row(name: str, degrees, arm: ArmParameters) -> Row:
    frame, *off = _compared(np.radians(np.array(degrees, dtype=float)), arm)
    text = ", ".join(f"{1000.0 * each + 0.0:.2f}" for each in np.round(frame[:3, 3], 9))
    return words.row("point", text.replace("-", "\N{MINUS SIGN}"), case=max(off) < 1e-12, name=name, off=max(off))


def _matrix_rows(arm: ArmParameters, poses) -> list[Row]:
    def aligned(matrix):
        return matrix_text([row.split() for row in matrix])

    def off(d2):
        return max(np.linalg.norm(printed_frame(q, arm, d2)[:3, 3] - forward_kinematics(q, arm)[:3, 3]) for q in poses)

    return [
        words.row(
            "matrix", aligned(each.get("correct", each["printed"])), matrix=each, printed=aligned(each["printed"])
        )
        for each in words.table("MATRICES")
    ] + [
        words.row("as_printed", 1000.0 * off(d2), case=case, d2=d2) for case, d2 in (("offset", arm.d3), ("none", 0.0))
    ]


def _round_trip_row(arm: ArmParameters, poses) -> Row:
    """Greatest angle error [rad] from angles to the wrist and back, where the way back is unique to rounding: not
    within 1 mm of a fold or of full stretch."""
    off = []
    for q in poses[:, :3]:
        point = wrist_position(q, arm)
        unique = np.hypot(*point[:2]) - abs(arm.d3) >= 1e-3 and abs(np.sin(q[2] - np.arctan2(arm.d4, arm.a3))) >= 1e-3
        with suppress(ParameterError):
            error = np.abs(wrist_angles(point, arm, q) - q).max()
            if unique:
                off.append(error)
    return words.row("round_trip", max(off), left_out=len(poses) - len(off))


def _sketch(arm: ArmParameters) -> Figure:
    curves = []
    for name, degrees, style in (("start", (0, 0, 0), "line"), ("moved", (0, -40, 20), "dashed")):
        q = np.radians(degrees)
        frames = link_transforms(q, arm)
        x, _, z = np.array([np.zeros(3), frames[2][:3, 3], frames[3][:3, 3], wrist_position(q, arm)]).T
        curves.append(Curve(name, x, z, style))
    return words.figure("figure 2.7", curves)


@words.experiment("2.4")
def run(context: Context) -> Result:
    """Forward kinematics against a construction that uses no Denavit-Hartenberg matrices."""
    arm = load_parameters("bejczy")
    poses = random_poses(arm, context.rng("2.4 poses"), COUNT)
    differences = []
    for index, q in enumerate(poses):
        differences.append(_compared(q, arm)[1:])
        if index % 100 == 0:
            context.progress(0.6 * index / COUNT)
    position_off, turn_off = np.max(differences, axis=0)
    rows = [
        *(_point_row(name, degrees, arm) for name, degrees in words.table("POINTS")),
        words.row("position", position_off, count=COUNT),
        words.row("orientation", turn_off, count=COUNT),
        *_matrix_rows(arm, poses[:400]),
        _round_trip_row(arm, poses[:1000]),
    ]
    context.progress(1.0)
    numbers = {
        "position_difference_m": position_off,
        "orientation_difference": turn_off,
        "d4_m": arm.d4,
        "wrist_ranges_deg": WRIST_RANGES,
        "folded_rad": FOLDED,
    }
    return words.result("2.4", rows, [_sketch(arm)], numbers, count=COUNT, slip=1000.0 * abs(arm.a3) * np.sqrt(2.0))
