# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""Setpoints as VAL gives them, one for each joint and period: along a straight line of the wrist,
or of the joints by steps, ramps and smooth moves."""

from collections.abc import Sequence
from dataclasses import dataclass
from math import ceil, isfinite

import numpy as np
from numpy.typing import ArrayLike

from puma_sim_core.arm.arm import ArmParameters
from puma_sim_core.arm.inverse_kinematics import wrist_angles
from puma_sim_core.arm.kinematics import wrist_position
from puma_sim_core.checks import check_choice, check_numbers, check_positive
from puma_sim_core.errors import ParameterError


def smooth_share(tau: ArrayLike) -> np.ndarray:
    """Share of a path covered at the share tau of its time: 10 tau^3 - 15 tau^4 + 6 tau^5.

    Velocity and acceleration vanish at both ends (quintic, minimum jerk).
    """
    tau = np.clip(tau, 0.0, 1.0)
    return tau**3 * (10.0 + tau * (6.0 * tau - 15.0))


SHAPES = ("step", "ramp", "quintic")


@dataclass(frozen=True)
class Move:
    """One move of the joints.

    start : when it begins [s]; duration [s], 0 for a step; by : (3,) how far [rad];
    shape : "step", "ramp" (constant velocity, as in the thesis's tests) or "quintic" (smooth).

    Raises ParameterError: a shape, times or distances that cannot be.
    """

    start: float
    duration: float
    by: Sequence[float]
    shape: str = "quintic"

    def __post_init__(self) -> None:
        check_choice(self.shape, "shape", SHAPES, "move")
        check_numbers(self.by, "by", where="move")
        good = self.duration == 0.0 if self.shape == "step" else self.duration > 0.0
        if not (isfinite(self.start) and isfinite(self.duration) and good):
            what = f"{self.shape} at {self.start!r} s for {self.duration!r} s"
            raise ParameterError(what, where="move", expected="times [s]: 0 for a step, else positive")

    def at(self, time: ArrayLike) -> np.ndarray:
        """(n, 3) what it adds at times (n,) [s]."""
        # a step at a setpoint's own time is in that setpoint, whatever the rounding of times
        since = np.asarray(time, dtype=float) - self.start
        if self.shape == "step":
            share = (since >= -1e-9) * 1.0
        else:
            share = np.clip(since / self.duration, 0.0, 1.0)
            share = smooth_share(share) if self.shape == "quintic" else share
        return share[:, None] * np.asarray(self.by, dtype=float)


def joint_path(start: ArrayLike, moves: Sequence[Move], time: np.ndarray) -> np.ndarray:
    """(n, 3) joint angles [rad] at times (n,) [s]: start (3,) and all moves."""
    return np.asarray(start, dtype=float) + sum((move.at(time) for move in moves), np.zeros((len(time), 3)))


def joint_setpoints(
    start: ArrayLike, moves: Sequence[Move], duration: float, period: float = 0.028
) -> tuple[np.ndarray, np.ndarray]:
    """(time (n,) [s], setpoint (n, 3) [rad]) of `joint_path`, one every period, over `duration`.

    Raises ParameterError: times that are not positive.
    """
    time = _times(duration, period)
    return time, joint_path(start, moves, time)


def _times(duration: float, period: float) -> np.ndarray:
    """(n,) times [s], one every period, that cover the duration."""
    duration, period = check_positive(duration, "duration", "s"), check_positive(period, "period", "s")
    return period * np.arange(ceil(duration / period - 1e-9) + 1)


def straight_line(
    arm: ArmParameters, start: ArrayLike, displacement: ArrayLike, duration: float, period: float = 0.028
) -> tuple[np.ndarray, np.ndarray]:
    """Setpoints that move the wrist along a straight line.

    start : (3,) joint angles at its beginning [rad]; displacement : (3,) of the wrist in the base
    frame [m]; duration [s]; period between setpoints [s].

    Returns (time (n,) [s], setpoint (n, 3) [rad]); the first is the start, the last the end of the line.

    Raises ParameterError: times that are not positive, or a line that leaves the reach or the range of a joint; names
    the joint and the height.
    """
    start, displacement = np.asarray(start, dtype=float), np.asarray(displacement, dtype=float)
    time = _times(duration, period)
    origin = wrist_position(start, arm)
    setpoint = np.empty((len(time), 3))
    before = start
    for row, share in enumerate(smooth_share(time / duration)):
        point = origin + share * displacement
        before = setpoint[row] = wrist_angles(point, arm, before) if share > 0.0 else start
        for joint, (q, (low, high)) in enumerate(zip(before, arm.joint_ranges), start=1):
            if not low <= q <= high:
                where = f"wrist at height {point[2]:.4f} m"
                expected = f"{low:.4f} to {high:.4f} rad along the whole line"
                raise ParameterError(f"joint {joint} at {q:.4f} rad", where=where, expected=expected)
    return time, setpoint


def vertical_line(
    arm: ArmParameters, start: ArrayLike, rise: float, duration: float, period: float = 0.028
) -> tuple[np.ndarray, np.ndarray]:
    """Setpoints down (rise < 0) or up a vertical line [m], as in the tests of section 7.5.

    Arguments, result and errors of `straight_line`.
    """
    return straight_line(arm, start, (0.0, 0.0, rise), duration, period)
