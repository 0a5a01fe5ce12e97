# SPDX-License-Identifier: Apache-2.0
# Copyright the puma-sim contributors
"""What a motor does beyond a constant resistance and a torque in proportion to its current."""

from __future__ import annotations

from math import exp, sin

from puma_sim_core.effects.base import CURRENT, SMOOTH, TIMED, TORQUE, Kind, Parameter
from puma_sim_core.effects.columns import SCREENINGS
from puma_sim_core.jit import inlined

RIPPLE = Kind(
    name="torque_ripple",
    acts=TORQUE,
    stage=SMOOTH,
    screening=SCREENINGS["torque_ripple"],
    equation="tau = A sin(n N q + f)",
    sentence="Torque that comes back with each turn of the motor: cogging, or ripple of its poles.",
    parameters=(
        Parameter("amplitude", "N.m", 0.0, 500.0, "A, at the joint"),
        Parameter("order", "1", 0.01, 1000.0, "n, periods a turn of the motor", neutral=1.0),
        Parameter("phase", "rad", -10.0, 10.0, "f", default=0.0),
        Parameter(
            "ratio",
            "1",
            -1000.0,
            1000.0,
            "N, motor turns a joint turn",
            neutral=1.0,
            from_arm=lambda arm, joint: float(arm.motors[joint - 1].gear_ratio),
        ),
    ),
)

DRIFT = Kind(
    name="resistance_drift",
    acts=CURRENT,
    stage=TIMED,
    screening=SCREENINGS["resistance_drift"],
    equation="R(t) = R (1 + share (1 - exp(-t/T)))",
    sentence="The winding's resistance grows as the motor gets warm; at time 0 it is cold.",
    parameters=(
        Parameter("share", "1", 0.0, 3.0, "growth of R in the end"),
        Parameter("time_constant", "s", 0.01, 1e5, "T", neutral=1.0),
    ),
)

KINDS = (RIPPLE, DRIFT)


@inlined
def ripple_torque(p, k, q):
    """Torque [N.m] at the joint's position q [rad], positive against positive motion."""
    if p[k] == 0.0:
        return 0.0
    return p[k] * sin(p[k + 1] * p[k + 3] * q + p[k + 2])


@inlined
def resistance_growth(p, k, time):
    """Factor of the resistance after `time` [s]; 1 before 0."""
    return 1.0 + p[k] * (1.0 - exp(-max(time, 0.0) / p[k + 1]))
