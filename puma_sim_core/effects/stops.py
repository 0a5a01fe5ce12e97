# SPDX-License-Identifier: Apache-2.0
# Copyright the puma-sim contributors
"""Where the motion of a joint ends: stops as stiff springs with damping."""

from __future__ import annotations

from math import inf

from puma_sim_core.effects.base import SMOOTH, TORQUE, Kind, Parameter
from puma_sim_core.effects.columns import SCREENINGS
from puma_sim_core.jit import inlined

SOFT_STOP = Kind(
    name="soft_stop",
    acts=TORQUE,
    stage=SMOOTH,
    screening=SCREENINGS["soft_stop"],
    equation="tau = K d + B qd while d = q - upper > 0 or d = q - lower < 0; never pulls back",
    sentence="A stiff stop at each end of the joint's range, or where it is put.",
    parameters=(
        Parameter(
            "lower",
            "rad",
            -10.0,
            10.0,
            "where the lower stop begins",
            neutral=-inf,
            from_arm=lambda arm, joint: arm.joint_ranges[joint - 1][0],
        ),
        Parameter(
            "upper",
            "rad",
            -10.0,
            10.0,
            "where the upper stop begins",
            neutral=inf,
            from_arm=lambda arm, joint: arm.joint_ranges[joint - 1][1],
        ),
        Parameter("stiffness", "N.m/rad", 0.0, 1e6, "K", default=1e4),
        Parameter("damping", "N.m.s/rad", 0.0, 1000.0, "B", default=100.0),
    ),
    check=lambda values: None if values["lower"] < values["upper"] else "lower below upper",
)

KINDS = (SOFT_STOP,)


@inlined
def stop_torque(p, k, q, qd):
    """Torque [N.m] of the stops, positive against positive motion."""
    if q > p[k + 1]:
        return max(p[k + 2] * (q - p[k + 1]) + p[k + 3] * qd, 0.0)
    if q < p[k]:
        return min(p[k + 2] * (q - p[k]) + p[k + 3] * qd, 0.0)
    return 0.0
