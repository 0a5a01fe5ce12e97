# SPDX-License-Identifier: Apache-2.0
# Copyright the puma-sim contributors
"""Setpoints as VAL gives them: one for each joint and period, along a straight line of the wrist."""

from __future__ import annotations

from math import ceil, isfinite

import numpy as np

from ..errors import ParameterError
from ..inverse_kinematics import wrist_angles
from ..kinematics import wrist_position
from ..parameters import ArmParameters


def smooth_share(tau):
    """Share of a path covered at the share tau of its time: 10 tau^3 - 15 tau^4 + 6 tau^5.

    Velocity and acceleration vanish at both ends (quintic, minimum jerk).
    """
    tau = np.clip(tau, 0.0, 1.0)
    return tau ** 3 * (10.0 + tau * (6.0 * tau - 15.0))


def straight_line(arm: ArmParameters, start, displacement, duration: float,
                  period: float = 0.028) -> tuple[np.ndarray, np.ndarray]:
    """Setpoints that move the wrist along a straight line.

    start : (3,) joint angles at its beginning [rad]; displacement : (3,) of the wrist in the base
    frame [m]; duration [s]; period between setpoints [s].

    Returns
    -------
    (time (n,) [s], setpoint (n, 3) [rad]); the first is the start, the last the end of the line.

    Raises
    ------
    ParameterError : times that are not positive, or a line that leaves the reach or the range of
        a joint; names the joint and the height.
    """
    for name, value in (("duration", duration), ("period", period)):
        if not (isfinite(value) and value > 0.0):
            raise ParameterError(f"{name} = {value!r} s", expected="a positive number")
    start = np.asarray(start, dtype=float)
    displacement = np.asarray(displacement, dtype=float)
    time = period * np.arange(ceil(duration / period - 1e-9) + 1)
    origin = wrist_position(start, arm)
    setpoint = np.empty((len(time), 3))
    before = start
    for row, share in enumerate(smooth_share(time / duration)):
        point = origin + share * displacement
        before = setpoint[row] = wrist_angles(point, arm, before) if share > 0.0 else start
        for joint, (q, (low, high)) in enumerate(zip(before, arm.joint_ranges), start=1):
            if not low <= q <= high:
                raise ParameterError(
                    f"joint {joint} at {q:.4f} rad", where=f"wrist at height {point[2]:.4f} m",
                    expected=f"{low:.4f} to {high:.4f} rad along the whole line")
    return time, setpoint


def vertical_line(arm: ArmParameters, start, rise: float, duration: float,
                  period: float = 0.028) -> tuple[np.ndarray, np.ndarray]:
    """Setpoints down (rise < 0) or up a vertical line [m], as in the tests of section 7.5.

    Arguments, result and errors of `straight_line`.
    """
    return straight_line(arm, start, (0.0, 0.0, rise), duration, period)
