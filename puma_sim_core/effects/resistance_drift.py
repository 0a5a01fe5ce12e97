# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""A winding whose resistance grows as it gets warm."""

from math import exp

import numpy as np

from puma_sim_core.effects.base import CURRENT, RATE, SIZE, VOLTAGE_DRIVE, Kind, Law, Needs, Parameter, Point
from puma_sim_core.effects.screening import VOLTAGE_COLUMN, ByJoint, Candidate, Screening, Signals, Values
from puma_sim_core.effects.shared.columns import grown, positive, sized, warming
from puma_sim_core.jit import Table, inlined

#: growth on machines, middle and one deviation: a log shorter than the time constant tells only how fast it begins
_SHARE = (0.2, 0.2)


@inlined
def resistance_growth(p: Table, k: int, time: float) -> float:
    """Factor of the resistance after `time` [s]; 1 before 0."""
    return 1.0 + p[k] * (1.0 - exp(-max(time, 0.0) / p[k + 1]))


def drift(signals: Signals, joint: int) -> list[Candidate]:
    """k tau (1 - exp(-t/T)) for a grid of T; the coefficient is the share by which R grows."""
    volts = signals.volts_per_torque[joint] * signals.torque[:, joint]
    values = sized("share", positive, "growth of the resistance", "", 3.0)
    return warming(signals, joint, volts, values, _SHARE, VOLTAGE_COLUMN)


def known_voltage(signals: Signals, joint: int, values: Values, torque: np.ndarray) -> ByJoint:
    """Voltage [V] that the grown resistance takes along a measured motion."""
    share = values["share"] * grown(signals, values["time_constant"])
    return {joint: share * signals.volts_per_torque[joint] * torque[:, joint]}


EFFECT = Kind(
    name="resistance_drift",
    order=220,
    acts=CURRENT,
    equation="R(t) = R (1 + share (1 - exp(-t/T)))",
    sentence="The winding's resistance grows as the motor gets warm; at time 0 it is cold.",
    parameters=(
        Parameter(
            "share",
            "1",
            0.0,
            3.0,
            "growth of R in the end",
            SIZE,
            (0.05, 0.5),
            prior=(_SHARE[0], (_SHARE[0] + _SHARE[1]) / _SHARE[0]),
        ),
        Parameter("time_constant", "s", 0.01, 1e5, "T", RATE, (1.0, 600.0), neutral=1.0),
    ),
    laws=(Law(Point.RESISTANCE_FACTOR, resistance_growth),),
    needs=Needs(VOLTAGE_DRIVE, "a motor on voltage"),
    known_voltage=known_voltage,
    screening=Screening(drift, "Long holds against gravity, and the same motion at the beginning and the end."),
    drawn_against=("time",),
    example="resistance_drift:joint=2,share=0.3,time_constant=120",
)
