# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""Joint angles that put the wrist at a point: the three joints that carry it, in closed form."""

from itertools import product
from math import acos, atan2, cos, hypot, pi, sin, sqrt

import numpy as np
from numpy.typing import ArrayLike

from puma_sim_core.arm.arm import ArmParameters
from puma_sim_core.errors import ParameterError

#: a cosine beyond +-1 by no more than this is rounding at full stretch
_ROUNDING = 1e-12


def wrist_angles(point: ArrayLike, arm: ArmParameters, near: ArrayLike) -> np.ndarray:
    """(3,) joint angles [rad] with the wrist at `point`, the solution nearest to `near`.

    point : (3,) [m] in the base frame; near : (3,) [rad], which also tells shoulder and elbow
    apart: of the four solutions the one whose greatest joint distance from it is smallest.

    With e_r the direction of the upper arm seen from above, the wrist is at
    X e_r + d3 e_t - Y z0, where X = a2 C2 + rho cos(u), Y = a2 S2 + rho sin(u): a plane arm of
    two links, rho = hypot(a3, d4), turned by the shoulder offset d3.

    Raises ParameterError: the point is out of reach, or so near to the base axis that d3 cannot
    pass it.
    """
    x, y, z = (float(value) for value in np.asarray(point))
    where = f"wrist at ({x:.4f}, {y:.4f}, {z:.4f}) m"
    flat = x * x + y * y - arm.d3**2
    if flat < 0.0:
        expected = f"a distance of at least {abs(arm.d3):.4f} m"
        raise ParameterError("too near to the axis of joint 1", where=where, expected=expected)
    rho, phi = hypot(arm.a3, arm.d4), atan2(arm.d4, arm.a3)
    down = -z
    bend = (flat + down * down - arm.a2**2 - rho**2) / (2.0 * arm.a2 * rho)
    if abs(bend) > 1.0 + _ROUNDING:
        expected = f"a distance from the shoulder between {abs(arm.a2 - rho):.4f} and {arm.a2 + rho:.4f} m"
        raise ParameterError("out of reach", where=where, expected=expected)
    bend = max(-1.0, min(1.0, bend))
    solutions = []
    for side, elbow in product((1.0, -1.0), (1.0, -1.0)):
        reach = side * sqrt(flat)
        q1 = atan2(y, x) - atan2(arm.d3, reach)
        gamma = elbow * acos(bend)
        q2 = atan2(down, reach) - atan2(rho * sin(gamma), arm.a2 + rho * cos(gamma))
        solutions.append((q1, q2, gamma + phi))
    near = np.asarray(near, dtype=float)
    q = np.array(solutions)
    q += 2.0 * pi * np.round((near - q) / (2.0 * pi))
    return q[np.argmin(np.abs(q - near).max(axis=1))]
