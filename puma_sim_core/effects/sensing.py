# SPDX-License-Identifier: Apache-2.0
# Copyright the puma-sim contributors
"""What the position sensor makes of the position.

The measured position is what records, joint states, the servo and controllers see; the state of
the simulation stays the true one. The chain is nonlinearity and offset, then lag.
"""

from __future__ import annotations

from math import cos, exp, pi, sin

from puma_sim_core.effects.base import SENSED, SENSING, Kind, Parameter
from puma_sim_core.effects.columns import SCREENINGS
from puma_sim_core.jit import inlined

LAG = Kind(
    name="sensor_lag",
    acts=SENSING,
    stage=SENSED,
    screening=SCREENINGS["sensor_lag"],
    equation="T dm/dt = q - m, m the measured position",
    sentence="The measured position follows the true one with a lag of first order.",
    parameters=(Parameter("time_constant", "s", 0.0, 10.0, "T"),),
)

ENCODER_OFFSET = Kind(
    name="encoder_offset",
    acts=SENSING,
    stage=SENSED,
    screening=SCREENINGS["encoder_offset"],
    equation="m = q + angle",
    sentence="The sensor's zero is not the model's: gravity is felt at other angles than it says.",
    parameters=(Parameter("angle", "rad", -10.0, 10.0, "measured less true position"),),
)

NONLINEARITY = Kind(
    name="sensor_nonlinearity",
    acts=SENSING,
    stage=SENSED,
    screening=SCREENINGS["sensor_nonlinearity"],
    equation="m = q + a sin(2 pi q / period + phase)",
    sentence="The sensor is not straight: the same place is always measured wrong by the same.",
    parameters=(
        Parameter("amplitude", "rad", 0.0, 1.0, "a"),
        Parameter("period", "rad", 1e-4, 100.0, "of the error in q", neutral=1.0),
        Parameter("phase", "rad", -10.0, 10.0, "at q = 0", default=0.0),
    ),
    check=lambda values: (
        None
        if values["amplitude"] * 2.0 * pi < values["period"]
        else "amplitude below period / (2 pi): a sensor that grows with the position"
    ),
)

KINDS = (LAG, ENCODER_OFFSET, NONLINEARITY)


@inlined
def sensed_position(p, offset, curve, q):
    """What the sensor gives [rad] at position q [rad] once it has settled; `offset` and `curve`
    are the places of the two kinds in the table."""
    if p[curve] == 0.0:
        return q + p[offset]
    return q + p[offset] + p[curve] * sin(2.0 * pi * q / p[curve + 1] + p[curve + 2])


@inlined
def sensed_velocity(p, curve, q, qd):
    """Rate [rad/s] of `sensed_position` where the joint moves with qd [rad/s]."""
    if p[curve] == 0.0:
        return qd
    turn = 2.0 * pi / p[curve + 1]
    return qd * (1.0 + p[curve] * turn * cos(turn * q + p[curve + 2]))


@inlined
def lagged_position(p, k, before, u0, u1, d0, d1, step):
    """Position [rad] behind the lag at the end of a step, `before` at its start.

    u0, u1 : `sensed_position` at start and end; d0, d1 : its rates. The exact solution for the
    parabola with the mean slope and the mean curvature of the step.
    """
    T = p[k]
    if T == 0.0:
        return u1
    slope = (u1 - u0) / step
    bow = (d1 - d0) / step
    # slope and curvature add these to a lag that has settled
    shift0 = T * (slope - 0.5 * step * bow) - T * T * bow
    shift1 = T * (slope + 0.5 * step * bow) - T * T * bow
    return u1 - shift1 + (before - u0 + shift0) * exp(-step / T)
