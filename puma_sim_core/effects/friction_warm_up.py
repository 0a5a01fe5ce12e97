# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""Viscous friction that falls as grease gets warm."""

from math import exp

import numpy as np

from puma_sim_core.effects.base import RATE, SIZE, TORQUE, Kind, Law, Parameter, Point
from puma_sim_core.effects.screening import TORQUE_COLUMN, Candidate, Screening, Signals
from puma_sim_core.effects.shared.columns import positive, warming, when_moving
from puma_sim_core.jit import Table, inlined

#: share of the viscous friction lost that a fit may start from
_MOST_WARMED = 0.9
#: share lost on machines, middle and one deviation: a log shorter than the time constant tells only how fast it begins
_SHARE = (0.4, 0.3)


@inlined
def warmed_share(p: Table, k: int, time: float) -> float:
    """Share of the viscous friction that is left after `time` [s]; all of it before 0."""
    return 1.0 - p[k] * (1.0 - exp(-max(time, 0.0) / p[k + 1]))


@when_moving
def warm_up(signals: Signals, joint: int) -> list[Candidate]:
    """-H qd (1 - exp(-t/T)) for a grid of T; the coefficient is the share of H that is lost."""
    if signals.viscous[joint] == 0.0:
        return []

    def values(c: np.ndarray, time_constant: float) -> dict[str, float]:
        # the share is of a friction that was retuned without the effect: it may be too low by half
        share = positive(c[0], "lost share of viscous friction", "", 4.0)
        return {"share": min(share, _MOST_WARMED), "time_constant": time_constant}

    column = -signals.viscous[joint] * signals.velocity[:, joint]
    return warming(signals, joint, column, values, _SHARE, TORQUE_COLUMN)


EFFECT = Kind(
    name="friction_warm_up",
    order=90,
    acts=TORQUE,
    equation="H(t) = H (1 - share (1 - exp(-t/T))), H of viscous_friction",
    sentence="The joint's viscous friction falls as its grease gets warm; at time 0 it is cold.",
    parameters=(
        Parameter(
            "share",
            "1",
            0.0,
            1.0,
            "part of H that is lost in the end",
            SIZE,
            (0.1, 0.9),
            prior=(_SHARE[0], (_SHARE[0] + _SHARE[1]) / _SHARE[0]),
        ),
        Parameter("time_constant", "s", 0.01, 1e5, "T", RATE, (1.0, 2000.0), neutral=1.0),
    ),
    laws=(Law(Point.VISCOUS_FACTOR, warmed_share),),
    screening=Screening(warm_up, "The same fast motion at the beginning and at the end."),
    drawn_against=("time",),
    example="friction_warm_up:joint=1,share=0.4,time_constant=60",
)
